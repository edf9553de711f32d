"""A model file proposed from measured files alone: which columns to take, and rough parameters from
a regression.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from bristle.common.columns import Columns
from bristle.common.errors import BristleError
from bristle.common.table import Array
from bristle.common.units import interval
from bristle.diagnosis.answer import Finding, Line, Proposal, Reason, Rough, finding
from bristle.diagnosis.checks.excitation import excitation
from bristle.diagnosis.checks.plausibility import CLEARER_RATIO
from bristle.diagnosis.checks.preparation import dataset_of
from bristle.diagnosis.checks.records import NEEDS
from bristle.diagnosis.checks.torque_regression import (
    Regression,
    Rows,
    explained_share,
    regress,
    regression_rows,
)
from bristle.diagnosis.free_parameter import Free
from bristle.diagnosis.init.setpoint import relative_to_inertia
from bristle.diagnosis.modelfile import NO_LIMIT, Model, own_unit
from bristle.diagnosis.sliding.fit import SlidingFit, SlidingModel, fit_sliding
from bristle.diagnosis.sliding.loop import loop_of
from bristle.diagnosis.sliding.screen import with_position_torques
from bristle.plant.controller import CONTROLLER
from bristle.plant.servo import A2, J
from bristle.records.choice import Candidate, Files, at_rate, candidates, fitted
from bristle.records.differences import are_differences
from bristle.records.formats.rate import rate_of
from bristle.records.formats.reading import read_columns
from bristle.records.intake import distinct_files, records_of_tables
from bristle.records.layout import SETPOINT, Layout, LayoutTable, layout_of
from bristle.records.record import Record

KNOWN_ERRORS = 2.0  # standard errors above 0 from which on a value of the regression is taken
BOUND_RATIO = 5.0  # a parameter may move by this factor either way
GUESS_RATIO = 30.0  # the same for an inertia that the records hardly show
ROUGH_PARAMETERS = ("J", "a2", "Fc")
FRICTION_SHARE = 0.5  # of the input's torque, rms: largest friction where the regression gives none
DIGITS = 3  # of a rough parameter
# factor by which another pair must explain more than the one that the names propose
BETTER_RATIO = 2.0
# of two columns: they are one quantity, a reference and what follows it, and no input and output
SAME_CORRELATION = 0.999
MOST_PAIRS = 40  # pairs of input and output that are compared by regression
# of the input: what its motion must explain of one that its name proposes, else all columns are
# compared
LEAST_SHARE = 0.5


@dataclass(frozen=True)
class _Reading:
    """Input and output as they may be, the records read so, and the share of the input that inertia
    and friction explain.

    `turned` is the share with the input's sign turned, and 0 where the input does work on the
    servo: its sign is right then.
    """

    input: Candidate
    output: Candidate
    layout: Layout
    records: list[Record]
    rows: Rows | None
    share: float
    turned: float

    @property
    def best(self) -> float:
        """The larger share."""
        return max(self.share, self.turned)


def propose(
    paths: Path | str | Sequence[Path | str],
    columns: Mapping[str, str | None] | None = None,
    units: Mapping[str, str] | None = None,
    rate: str | None = None,
) -> Proposal:
    """Propose a model file from measured files.

    Parameters
    ----------
    paths : path or sequence of path
        Measured files of one servo, with the same columns.
    columns : mapping of str to str, optional
        Columns that the user wants as "time", "input" or "output".
    units : mapping of str to str, optional
        Units of columns, by the name of the column.
    rate : str, optional
        Sampling rate of files without a time, ``200 Hz``, or interval, ``5 ms``.

    Raises
    ------
    BristleError
        One line, if the files cannot be read or nothing can be proposed.
    """
    listed = distinct_files(paths)
    asked = {role: name for role, name in (columns or {}).items() if name is not None}
    files = Files.of({path: read_columns(path) for path in listed}, dict(units or {}), asked)
    if unknown := [name for name in files.units if name not in files.names]:
        raise BristleError(
            f"unit of '{unknown[0]}': is no column of numbers in every file; there are:"
            f" {', '.join(files.names[:20])}"
        )
    # the reading of the columns that a servo explains best, and rough parameters
    times, inputs, outputs = _candidates_of(files, asked, _rate(rate))
    best, doubts = _best(files.tables, times[0], inputs, outputs)
    best, sign_doubt = _with_sign(best)
    with threadpool_limits(1, user_api="blas"):  # matrices are small: more threads only wait
        seen = _servo_of(best)
    # what was not chosen and what is uncertain
    others = {
        "time": tuple(times[1:]),
        "input": _other(inputs, best.input),
        "output": _other(outputs, best.output),
    }
    doubted: list[Line] = [
        *times[0].doubts,
        *best.input.doubts,
        *best.output.doubts,
        *(*doubts, *sign_doubt, *seen.doubts, *_one_sign(best)),
    ]
    return Proposal(
        tuple(listed),
        times[0],
        best.input,
        best.output,
        others,
        seen.rough,
        tuple(_distinct(doubted)),
        tuple(best.records),
        best.share,
        excitation(model_of(best.layout, seen.rough), best.records),
        best.layout.differences,
        seen.loop,
        seen.controller,
    )


@dataclass(frozen=True)
class _Servo:
    """Rough parameters, what is uncertain of them, and the loop or controller that is seen."""

    rough: dict[str, Rough]
    doubts: list[Finding]
    loop: float | None = None
    controller: Mapping[str, float] | None = None


def _servo_of(best: _Reading) -> _Servo:
    """Return what the records show of the servo."""
    if best.input.kind == SETPOINT:
        rough, controller, doubts = relative_to_inertia(best.layout, best.records)
        return _Servo(rough, doubts, controller=controller)
    regression = _regression(best)
    slides = _sliding(best, regression)
    return _Servo(*_rough(best, regression, slides), _loop(slides))


def _rate(given: str | None) -> float | None:
    """Return a sampling rate [Hz] that the user gives."""
    try:
        return None if given is None else rate_of(given)
    except BristleError as error:
        raise BristleError(f"rate '{given}': {error}") from None


def _candidates_of(
    files: Files, asked: Mapping[str, str], rate: float | None
) -> list[list[Candidate]]:
    """Return the candidates of time, input and output, the best first; a column has one role."""
    times = [at_rate(rate)] if rate else candidates(files, "time", asked.get("time"))
    taken, files = {**asked, "time": times[0].column.column}, files.moving(times[0])

    def of(role: str) -> list[Candidate]:
        others = [name for other, name in taken.items() if other != role]
        return candidates(files, role, asked.get(role), others)

    return [times, of("input"), of("output")]


def _distinct(lines: Sequence[Line]) -> list[Line]:
    """Return each line once."""
    return [line for k, line in enumerate(lines) if line not in lines[:k]]


def _other(rivals: Sequence[Candidate], chosen: Candidate) -> tuple[Candidate, ...]:
    """Return the candidates of other columns, each column once."""
    names = {chosen.column.column: chosen}
    for each in rivals:
        names.setdefault(each.column.column, each)
    return tuple(names.values())[1:]


def model_of(layout: Layout, rough: Mapping[str, Rough]) -> Model:
    """Return the model of a proposal."""
    values = {name: each.value for name, each in rough.items()}
    bounds = {name: (each.low, each.high) for name, each in rough.items()}
    full = {"Fc": "coulomb.Fc"}
    gain = {} if layout.drive in ("torque", "force") else {"b": 1.0}
    return Model(
        friction="coulomb",
        parameters={full.get(name, name): x for name, x in values.items()} | gain,
        bounds={full.get(name, name): ends for name, ends in bounds.items()},
        effects={CONTROLLER.name: {}} if layout.input_kind == SETPOINT else {},
        **vars(layout),
    )


# -- which columns ---------------------------------------------------------------------------------
def _best(
    tables: Mapping[Path, Columns],
    time: Candidate,
    inputs: Sequence[Candidate],
    outputs: Sequence[Candidate],
) -> tuple[_Reading, list[Finding]]:
    """Return the likeliest pair by name and, among equal ones, by the share of torque explained."""
    readings = _by_name(tables, time, inputs, outputs)
    if inputs[0].kind == SETPOINT:
        return readings[0], []
    best = readings[0]
    doubts = [each for role in ("input", "output") for each in _rivals(readings, role)]
    if best.best < LEAST_SHARE:
        doubts.append(_unexplained(best))
    return best, doubts


def _by_name(
    tables: Mapping[Path, Columns],
    time: Candidate,
    inputs: Sequence[Candidate],
    outputs: Sequence[Candidate],
) -> list[_Reading]:
    """Return the readings of the columns that names propose, or of all where those explain little,
    the best first.
    """
    first = [each for each in inputs if each.rank == inputs[0].rank]
    last = [each for each in outputs if each.rank == outputs[0].rank]
    # a goal beside a column that may be an effort says less of the servo
    efforts = [each for each in inputs if each.kind != SETPOINT]
    named = _readings(tables, time, first, last)
    if (
        inputs[0].kind == SETPOINT
        or named[0].best >= LEAST_SHARE
        or (len(first) >= len(efforts) and len(last) == len(outputs))
    ):
        return named
    others = _readings(tables, time, efforts, outputs)
    return others if others[0].best > BETTER_RATIO * named[0].best else named


def _rivals(readings: Sequence[_Reading], role: str) -> list[Finding]:
    """Return a doubt about the column of a role, where others may have it."""
    best = readings[0]
    chosen = getattr(best, role).column.column
    rivals: dict[str, float] = {}
    for each in readings[1:]:
        name = getattr(each, role).column.column
        if name != chosen:
            rivals.setdefault(name, each.best)
    if not rivals:
        return []
    name, share = next(iter(rivals.items()))
    seen = {"explained": best.best, "other": name, "other_explained": share}
    which = {"columns": len(rivals) + 1, "role": role, "chosen": chosen}
    return [finding(Reason.SEVERAL_COLUMNS, **which, **seen)]


def _unexplained(best: _Reading) -> Finding:
    """Return a doubt about a pair of which inertia and friction explain little: what a torque that
    follows the position would explain is another matter.
    """
    beside = explained_share(best.rows)[0]
    if beside < LEAST_SHARE:
        return finding(Reason.UNEXPLAINED_INPUT, explained=best.best)
    return finding(Reason.POSITION_INPUT, explained=best.best, beside=beside)


def _readings(
    tables: Mapping[Path, Columns],
    time: Candidate,
    inputs: Sequence[Candidate],
    outputs: Sequence[Candidate],
) -> list[_Reading]:
    """Return the readings of all pairs that can be records, the one that explains most first."""
    readings, problem = [], None
    same = _same_quantity(tables)
    pairs = [
        (u, y)
        for u, y in product(inputs, outputs)
        if u.column.column != y.column.column
        and (u.kind == SETPOINT or not same(u.column.column, y.column.column))
    ]
    # of an arm, those of one joint first
    pairs.sort(key=lambda pair: _joint(pair[0]) != _joint(pair[1]))
    for u, y in pairs[:MOST_PAIRS]:
        try:
            readings.append(_reading(tables, time, u, y))
        except BristleError as error:
            problem = problem or error
    if not readings:
        name = inputs[0].column.column
        raise problem or BristleError(
            f"'{name}' is the only column for input and output; name the columns of both"
        )
    return sorted(readings, key=lambda each: -each.best)


def _joint(each: Candidate) -> str:
    """Return the end of a column's name, which is that of the joint in the log of an arm."""
    name = each.column.column
    return (
        name[name.index("[") :] if name.endswith("]") and "[" in name else name.rpartition(".")[2]
    )


def _same_quantity(tables: Mapping[Path, Columns]) -> Callable[[str, str], bool]:
    """Return what tells whether two columns hold the same quantity."""

    def same(one: str, other: str) -> bool:
        if one == other:
            return True
        both = np.column_stack(
            [np.concatenate([table[name] for table in tables.values()]) for name in (one, other)]
        )
        both = both[np.isfinite(both).all(axis=1)]
        return bool(abs(np.corrcoef(both.T)[0, 1]) > SAME_CORRELATION)

    return same


def _reading(
    tables: Mapping[Path, Columns], time: Candidate, u: Candidate, y: Candidate
) -> _Reading:
    u = fitted(u, y.linear)
    layout = _layout(time, u, y)
    records = records_of_tables(layout, tables.items(), list(tables), NEEDS)
    if layout.output_kind == "velocity" and all(
        are_differences(r.y, r.resolution) for r in records
    ):
        layout = replace(layout, output_kind="position", differences=True)
        records = records_of_tables(layout, tables.items(), list(tables), NEEDS)
    if u.kind == SETPOINT:
        both = [np.concatenate(each) for each in zip(*((r.u, r.y) for r in records), strict=True)]
        return _Reading(u, y, layout, records, None, float(np.corrcoef(both)[0, 1]) ** 2, 0.0)
    rows = regression_rows([(r.u, r.y) for r in records], records, layout.output_kind == "velocity")
    if rows is None:
        return _Reading(u, y, layout, records, rows, 0.0, 0.0)
    # a reference follows its position: with free terms of the position, that would pass for a
    # torque
    plain = replace(rows, free=rows.free[:, :1])
    work = float(rows.torque @ rows.core[:, 1])
    turned = explained_share(plain, -1.0)[0] if work < 0.0 else 0.0
    return _Reading(u, y, layout, records, rows, explained_share(plain)[0], turned)


def _layout(time: Candidate, u: Candidate, y: Candidate) -> Layout:
    tree = {
        "time": {"rate": f"{time.rate!r} Hz"} if time.rate else time.column.model_dump(),
        "input": u.column.model_dump() | {"kind": u.kind},
        "output": y.column.model_dump() | {"kind": y.kind},
    }
    return layout_of(LayoutTable.model_validate(tree), "proposal")


def _with_sign(reading: _Reading) -> tuple[_Reading, list[Finding]]:
    """Return a reading with the input's sign turned if it acts against its direction."""
    if not (reading.turned > 0.0 and 1.0 - reading.share > CLEARER_RATIO * (1.0 - reading.turned)):
        return reading, []
    column = reading.input.column
    number, _, unit = (column.scale or "1").partition(" ")
    scale = f"{-float(number):g} {unit}".strip()
    turned = replace(reading.input, column=column.model_copy(update={"scale": scale}))
    records = [replace(record, u=-record.u) for record in reading.records]
    layout = replace(reading.layout, input=turned.column)
    rows = None if reading.rows is None else replace(reading.rows, torque=-reading.rows.torque)
    return replace(
        reading,
        input=turned,
        layout=layout,
        records=records,
        rows=rows,
        share=reading.turned,
        turned=0.0,
    ), [finding(Reason.SIGN_TURNED, column=column.column)]


def _one_sign(reading: _Reading) -> list[Finding]:
    """Return a doubt about a speed that may have lost its sign."""
    y, u = (np.concatenate([getattr(r, name) for r in reading.records]) for name in ("y", "u"))
    if reading.output.kind != "velocity" or np.min(y) < 0.0 or not np.min(u) < 0.0 < np.max(u):
        return []
    name = reading.output.column.column
    return [finding(Reason.NEVER_NEGATIVE, column=name)]


# -- rough parameters ------------------------------------------------------------------------------
def _regression(reading: _Reading) -> Regression:
    if reading.rows is None:
        raise BristleError(
            "too little motion in these records for a regression; record steps of several sizes and"
            " slow motion"
        )
    return regress(reading.rows)


def _rough(
    reading: _Reading, regression: Regression, slides: SlidingFit | None
) -> tuple[dict[str, Rough], list[Finding]]:
    """Return rough parameters with bounds, and what the records do not show."""
    slid = _shown(slides) if slides else {}
    torque = float(np.sqrt(np.mean(np.concatenate([r.u for r in reading.records]) ** 2)))
    scale = regression.rows.scale  # rms of acceleration, speed and direction
    # what is not known takes the value of a regression that allows no negative ones
    positive = explained_share(replace(regression.rows, free=regression.rows.free[:, :0]))[1]
    known = regression.known(KNOWN_ERRORS)
    rough, doubts = {}, []
    for k, name in enumerate(ROUGH_PARAMETERS):
        value, error = regression.value[k] if known[k] else positive[k], regression.error[k]
        if name in slid:
            value, error, known[k] = *slid[name], True
        most = FRICTION_SHARE * torque / float(scale[k])
        # an inertia that is not shown is a guess with wide bounds
        if name == "J" and not (known[k] and value > 0.0):
            value = value if value > 0.0 else min(most, max(error, 1e-3 * most))
            rough[name] = Rough(
                _rounded(value), None, _rounded(value / GUESS_RATIO), _rounded(value * GUESS_RATIO)
            )
            doubts.append(finding(Reason.GUESSED_INERTIA))
            continue
        shown = float(error) if known[k] else None
        value = _rounded(max(value, 0.0))
        low = _rounded(value / BOUND_RATIO) if name == "J" else 0.0
        rough[name] = Rough(
            value, shown, low, _rounded(max(BOUND_RATIO * value, 0.0 if name == "J" else most))
        )
    # values that no servo has mean wrong units
    for name, parameter in (("J", J), ("a2", A2)):
        if not parameter.minimum <= rough[name].value <= parameter.maximum:
            unit = own_unit(parameter, reading.layout.linear, reading.layout.input_kind)
            allowed = interval(parameter.minimum, parameter.maximum)
            raise BristleError(
                f"{name} comes out at {rough[name].value:g} {unit}, allowed {allowed}; give the"
                " right units of the columns"
            )
        low, high = max(rough[name].low, parameter.minimum), rough[name].high
        ends = {"low": low, "high": min(high, parameter.maximum)}
        rough[name] = replace(rough[name], **ends)
    return rough, doubts


def _sliding(reading: _Reading, regression: Regression) -> SlidingFit | None:
    """Return the fit of the sliding motion, beside torques that a position gives; None where that
    does not show it.

    A regression on an acceleration that is noisy gives too small an inertia; the likelihood knows
    what is noise of the sensor and what is torque.
    """
    start = [max(x, e) for x, e in zip(regression.value, regression.error, strict=True)]
    rough = {
        name: Rough(x, None, x / GUESS_RATIO, x * GUESS_RATIO)
        for name, x in zip(ROUGH_PARAMETERS, start, strict=True)
    }
    model = model_of(reading.layout, rough)
    dataset = dataset_of(model, reading.records)
    free = tuple(Free(name, low, high) for name, (low, high) in model.bounds.items())
    over, values = dataset.stretches, {"b": 1.0, "u_max": NO_LIMIT} | model.parameters
    fit = fit_sliding(SlidingModel(model.friction, (), free, over, dataset.resolution), values)
    if fit is None:
        return None
    return with_position_torques(fit, dataset.turn, model.linear, model.parameters)


def _loop(slides: SlidingFit | None) -> float | None:
    """Return the frequency [Hz] of the position loop that the records show."""
    loop = loop_of(slides) if slides else None
    return loop.frequency if loop else None


def _shown(fit: SlidingFit) -> dict[str, tuple[float, float]]:
    """Return the parameters that a fit shows, each with its standard error."""
    deviations = fit.deviations()
    found = {name.split(".")[-1]: (fit.values[name], sd) for name, sd in deviations.items()}
    return {
        name: found[name]
        for name in ROUGH_PARAMETERS
        if found[name][0] > KNOWN_ERRORS * found[name][1]
    }


def _rounded(value: float | Array) -> float:
    """Return a value with a few digits."""
    return float(f"{float(value):.{DIGITS}g}") if math.isfinite(value) else 0.0
