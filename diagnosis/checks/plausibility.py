"""Plausibility of the data before a search: signs, units, swapped columns, position taken for
velocity.

A regression of the torque gives J, a2 and Fc; what contradicts the model's nominal values is a
proposal or a finding.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bristle.common.table import Array
from bristle.diagnosis.answer import Finding, Reason, finding
from bristle.diagnosis.checks.torque_regression import (
    Regression,
    explained_share,
    regress,
    regression_rows,
)
from bristle.diagnosis.modelfile import Model
from bristle.plant.known import KNOWN
from bristle.records.layout import Column
from bristle.records.record import Record

REGRESSION_NAMES = ("J", "a2", "Fc")  # what the regression estimates
UNIT_FACTOR = 5.0  # factor beyond which a nominal value is wrong and not merely inaccurate
# factors of J, a2, Fc within which one cause explains their ratios
CAUSE_TOLERANCE = (3.0, 8.0, 3.0)
ABSURD_FACTOR = 30.0  # factor beyond which one wrong value is enough for a proposal
SIGN_ERRORS = 5.0  # standard errors from which on the sign of an estimate is certain
VALUE_ERRORS = 3.0  # standard errors from which on a value is compared with others
# factor by which another reading of the columns must lower the unexplained torque
READING_RATIO = 3.0
# the same if that reading gives the nominal inertia and the given one does not, and for the sign
CLEARER_RATIO = 1.5
# the same if it also gives the other nominal values, from which the given reading is far
NOMINAL_RATIO = 0.7
EXPLAINED_SHARE = 0.8  # of the torque: least that another reading must explain
UNSIGNED_SHARE = 0.005  # of the samples: most that are below zero in a speed without its sign
EITHER_SIGN_SHARE = 0.1  # of the samples: least of each sign in an input that drives both ways
BEYOND_BOUNDS = 1.5  # factor outside its bounds from which on an estimate is a finding
# logarithms of the factors of (J, a2, Fc) by a column that is too large by a factor of e
CAUSES = {"input": (1.0, 1.0, 1.0), "output": (-1.0, -1.0, 0.0), "time": (2.0, 1.0, 0.0)}
KNOWN_FACTORS = {  # factor by which a column is too large: the unit or prefix that gives it
    "input": {1e3: "milli", 1e6: "micro", 100.0: "N.cm", 9.80665: "kgf", 98.0665: "kgf.cm"},
    "output": {
        180 / math.pi: "deg",
        0.5 / math.pi: "rev",
        30 / math.pi: "rpm",
        1e3: "milli",
        1e6: "micro",
    },
    "time": {1e3: "ms", 1e6: "us", 1.0 / 60.0: "min"},
}
ROTARY_UNITS = ("deg", "rev", "rpm")  # no units of a linear axis


@dataclass(frozen=True)
class Plausibility:
    """What the regression shows of the data."""

    # mistakes to be corrected before a search, empty for plausible data
    corrections: tuple[Finding, ...]
    notes: tuple[Finding, ...]  # what is unusual, but may be true
    # value and se of J, a2, Fc (SI); explained
    fit: dict[str, dict[str, float] | float] = field(default_factory=dict)


def check(model: Model, records: Sequence[Record]) -> Plausibility:
    """Compare what a regression on the records gives with the model's nominal values."""
    regression = _regression(model, records)
    unsigned = _unsigned(model, records, regression)
    # a position may keep its sign as well
    if unsigned and not (regression and _wrong_reading(model, records, regression)):
        return Plausibility((unsigned,), ())
    if regression is None:
        return Plausibility((), (finding(Reason.LITTLE_MOTION),))
    fit: dict[str, dict[str, float] | float] = {
        name: {"value": float(regression.value[i]), "se": float(regression.error[i])}
        for i, name in enumerate(REGRESSION_NAMES)
    }
    fit["explained"] = regression.explained
    notes = tuple(_outside_bounds(model, regression))
    single = tuple(_proposals_by_record(model, records)) if len(records) > 1 else ()
    whole = _wrong_reading(model, records, regression) or _wrong_factor(
        model, _nominal(model), regression
    )
    if whole and (not single or len(single) > len(records) / 2):
        return Plausibility((whole,), notes, fit)
    # a mistake in one record may not show in all together, or only blur them
    return Plausibility(single, notes, fit)


def _unsigned(
    model: Model, records: Sequence[Record], regression: Regression | None
) -> Finding | None:
    """Return what is said where the output looks like a speed without its sign."""
    y, u = (np.concatenate([getattr(record, name) for record in records]) for name in ("y", "u"))
    one_sign = min(np.mean(y < 0), np.mean(y > 0)) <= UNSIGNED_SHARE
    if (
        model.output_kind != "velocity"
        or not one_sign
        or min(np.mean(u < 0), np.mean(u > 0)) < EITHER_SIGN_SHARE
    ):
        return None
    share = 0.0 if regression is None else explained_share(regression.rows)[0]
    if share > EXPLAINED_SHARE:  # a drive that brakes with the input, say
        return None
    return finding(Reason.UNSIGNED_SPEED, column=model.output.column, explained=share)


def _proposals_by_record(model: Model, records: Sequence[Record]) -> Iterator[Finding]:
    """Give corrections of single records; a factor must tell a record from the others too."""
    regressions = [_regression(model, [r]) for r in records]
    for k, (record, own) in enumerate(zip(records, regressions, strict=True)):
        if own is None:
            continue
        wrong = _wrong_reading(model, [record], own, alone=True)
        others = [
            np.where(each.known(VALUE_ERRORS), each.value, np.nan)
            for i, each in enumerate(regressions)
            if each and i != k and each.known(VALUE_ERRORS)[0]
        ]
        # without another whose inertia is known, all records together tell
        if wrong is None and others and all(_wrong_factor(model, x, own) for x in others):
            wrong = _wrong_factor(model, _nominal(model), own, alone=True)
        if wrong:
            yield finding(Reason.IN_RECORD, record=record.name, what=wrong)


def _regression(model: Model, records: Sequence[Record]) -> Regression | None:
    rows = regression_rows(_as_given(model, records), records, model.output_kind == "velocity")
    return None if rows is None else regress(rows)


def _as_given(model: Model, records: Sequence[Record]) -> list[tuple[Array, Array]]:
    """Return torque and output of the records."""
    gain = model.parameters.get("b", 1.0)
    return [(r.u * gain - r.known.get(f"{KNOWN.name}.torque", 0.0), r.y) for r in records]


def _nominal(model: Model) -> Array:
    """Return nominal J, a2 and Coulomb level; NaN where the law has none or it is 0."""
    own = {name.removeprefix(f"{model.friction}."): x for name, x in model.parameters.items()}
    friction = own.get("Fc", own["J"] * own["sigma0"] / own["c"] if "c" in own else 0.0)
    given = np.array([own["J"], own["a2"], friction])
    return np.where(given > 0.0, given, np.nan)


# -- another reading of the columns ----------------------------------------------------------------
def _wrong_reading(
    model: Model, records: Sequence[Record], regression: Regression, alone: bool = False
) -> Finding | None:
    """Return a proposal to turn the input's sign, swap the columns or differentiate once more or
    less; `alone`: in one record.
    """
    given, constants = explained_share(regression.rows)
    value, nominal = regression.value, _nominal(model)
    if regression.known(SIGN_ERRORS)[0] and _near(value[0] / nominal[0]) and given > 0.5:
        return None
    if flipped := _flipped(regression, given, bool(np.isfinite(nominal[2])), alone):
        return flipped
    best = _best_reading(model, records, given, _distance(constants, nominal))
    if best is None:
        return None
    share, reading = best
    shares = {"explained": share, "as_given": given, "alone": alone}
    if reading == "order":
        other = "position" if model.output_kind == "velocity" else "velocity"
        return finding(Reason.OTHER_OUTPUT, kind=model.output_kind, other=other, **shares)
    columns = (model.input.column, model.output.column)
    return finding(Reason.SWAPPED_COLUMNS, columns=columns, **shares)


def _flipped(regression: Regression, given: float, dry: bool, alone: bool) -> Finding | None:
    """Return a proposal to turn the input's sign; `given` is the share explained as it is, `dry`
    whether the law has an Fc.
    """
    ratio = regression.value / np.maximum(regression.error, 1e-300)
    core = ratio[[0, 2]] if dry else ratio[[0]]
    if not (np.min(core) < -SIGN_ERRORS and np.max(core) < SIGN_ERRORS):
        return None
    flipped, _ = explained_share(regression.rows, -1.0)
    if not (1.0 - given > CLEARER_RATIO * (1.0 - flipped) and flipped > 0.2):
        return None
    values = {"J": float(regression.value[0]), "Fc": float(regression.value[2])}
    return finding(Reason.FLIPPED_SIGN, explained=flipped, as_given=given, alone=alone, **values)


def _best_reading(
    model: Model, records: Sequence[Record], given: float, off: float
) -> tuple[float, str] | None:
    """Return the share of the torque that another reading explains, and its name, if one is clearly
    better.

    `given` is the share that the given reading explains, `off` how far it is from the nominal
    values.
    """
    velocity, nominal = model.output_kind == "velocity", _nominal(model)
    readings = {
        "order": (_as_given(model, records), not velocity),
        "swapped": ([(r.y, r.u) for r in records], velocity),
    }
    best: tuple[float, str] | None = None
    for reading, (columns, as_velocity) in readings.items():
        share, constants = explained_share(
            regression_rows(columns, records, as_velocity, steps=reading == "order")
        )
        ratio = READING_RATIO
        if reading == "order" and _near(constants[0] / nominal[0]):
            # a derivative taken for its integral turns J into a2 and leaves J near 0: the nominal
            # values are evidence too
            ratio = (
                NOMINAL_RATIO
                if off - _distance(constants, nominal) > math.log(ABSURD_FACTOR)
                else CLEARER_RATIO
            )
        if share > EXPLAINED_SHARE and 1.0 - given > ratio * (1.0 - share) and constants[0] > 0.0:
            best = max(best or (0.0, ""), (share, reading))
    return best


def _near(ratio: float) -> bool:
    return 1.0 / UNIT_FACTOR < ratio < UNIT_FACTOR


def _distance(value: Array, nominal: Array) -> float:
    """Return how far estimates are from nominal: sum of the log-ratios, each at most log 100."""
    ratio = np.clip(np.where(np.isfinite(nominal), value / nominal, 1.0), 0.01, 100.0)
    return float(np.sum(np.abs(np.log(ratio))))


# -- a wrong unit ----------------------------------------------------------------------------------
def _wrong_factor(
    model: Model, nominal: Array, regression: Regression, alone: bool = False
) -> Finding | None:
    """Return a proposal if one factor on one column explains the ratios of all estimates to
    `nominal` values (3,).
    """
    use = np.isfinite(nominal) & regression.known(VALUE_ERRORS) & (regression.value > 0.0)
    if not use[0]:
        return None
    off = np.log(np.where(use, regression.value / np.where(use, nominal, 1.0), 1.0))
    # the inertia alone tells no column from another
    if use.sum() < 2:
        if abs(off[0]) < math.log(ABSURD_FACTOR):
            return None
        return finding(Reason.WRONG_INERTIA, ratio=math.exp(off[0]))
    causes = sorted(_causes(off, use))
    if not causes or abs(causes[0][2]) < math.log(UNIT_FACTOR):
        return None
    # the column that explains the ratios best, and others that may as well
    (_, cause, size), *others = causes
    ratios = {
        name: math.exp(x) for name, x, used in zip(REGRESSION_NAMES, off, use, strict=True) if used
    }
    kinds = {"input": model.input_kind, "output": model.output_kind, "time": "time"}
    time = model.time or Column(column="rate", unit="Hz")
    column = {"input": model.input, "output": model.output, "time": time}[cause]
    return finding(
        Reason.WRONG_FACTOR,
        what=kinds[cause],
        factor=math.exp(size),
        others=tuple(
            (kinds[other], math.exp(size))
            for _, other, size in others
            if abs(size) > math.log(CAUSE_TOLERANCE[0])
        ),
        ratios=tuple(ratios.items()),
        column=column.column,
        unit=column.unit,
        causes=_reasons(model, cause, size, viscous=bool(use[1])),
        alone=alone,
    )


def _causes(off: Array, use: NDArray[np.bool_]) -> Iterator[tuple[float, str, float]]:
    """Give the columns of which a wrong scale explains log-ratios (3,): misfit (at most 1), cause,
    log of its factor.
    """
    for cause, shape in CAUSES.items():
        d = np.array(shape)
        size = float(np.sum(d[use] * off[use]) / np.sum(d[use] ** 2))
        misfit = float(np.max((np.abs(off - d * size) / np.log(CAUSE_TOLERANCE))[use]))
        if misfit < 1.0:
            yield misfit, cause, size


def _reasons(model: Model, cause: str, size: float, viscous: bool) -> tuple[tuple[str, str], ...]:
    """Return what a factor exp(size) of a column may come from, each with its detail; `viscous`: a2
    was estimated, too.
    """
    known = {
        f: text
        for f, text in KNOWN_FACTORS[cause].items()
        if not (model.linear and text in ROTARY_UNITS)
    }
    distance, text = min(
        (abs(size - s * math.log(f)), text) for f, text in known.items() for s in (1, -1)
    )
    reasons = [("unit", text if distance < math.log(2.0) else "")]
    reasons.append(("scale", "") if cause == "time" else ("gear", ""))
    if cause == "input" and "b" in model.parameters:
        reasons.append(("gain", f"{'force' if model.linear else 'torque'} per {model.input_unit}"))
    # J alone: friction may have been identified from the same data
    if cause == "output" and not viscous:
        reasons.append(("rotor", model.input_kind))
    return tuple(reasons)


def _outside_bounds(model: Model, regression: Regression) -> Iterator[Finding]:
    """Give what is said of estimates well outside their bounds, and of the factor they share."""
    names = ("J", "a2", next((n for n in model.parameters if n.endswith(".Fc")), ""))
    ratios = {}
    for name, value, error, nominal in zip(
        names, regression.value, regression.error, _nominal(model), strict=True
    ):
        low, high = model.bounds.get(name, (-math.inf, math.inf))
        above = high > 0 and value - VALUE_ERRORS * error > BEYOND_BOUNDS * high
        below = low > 0 and 0.0 < value + VALUE_ERRORS * error < low / BEYOND_BOUNDS
        if (above or below) and math.isfinite(nominal) and value > 0:
            ratios[name] = value / nominal
            yield finding(
                Reason.OUTSIDE_BOUNDS,
                name=name,
                value=float(value),
                unit=model.unit(name),
                bounds=(low, high),
            )
    if len(ratios) > 1 and max(ratios.values()) < BEYOND_BOUNDS * min(ratios.values()):
        common = math.exp(sum(map(math.log, ratios.values())) / len(ratios))
        yield finding(Reason.COMMON_FACTOR, names=tuple(ratios), factor=common)
