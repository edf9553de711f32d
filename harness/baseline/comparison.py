"""A run against a baseline or another run: each signal in its tube, numbers within what repeated
runs measure, and provenance.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import BristleError
from bristle.common.files import check_regular
from bristle.common.output import output_folder, replace_files
from bristle.common.signals import Array
from bristle.harness.baseline.baseline import (
    Baseline,
    Judged,
    Signals,
    least_tolerance,
    quantities_of,
    read_baseline,
    read_json,
)
from bristle.harness.baseline.tube import written_margin
from bristle.harness.baseline.verdicts import (
    QuantityVerdict,
    RunComparison,
    SignalCourse,
    SignalVerdict,
    comparison_json,
)
from bristle.harness.metrics.checks import look_up
from bristle.harness.run.results import missing, rows_of, thinned

DURATION_SLACK = 1e-6  # steps by which times of signals.csv may be off their row
RESULT_ORIGINS = (  # what is said where it is not the same: path in result.json, and its name
    ("provenance.version", "version of bristle"),
    ("provenance.platform", "platform"),
    ("provenance.scenario_sha256", "SHA-256 of the scenario file"),
    ("provenance.seed", "seed"),
    ("overrides", "values set by --set"),
    ("record.sha256", "SHA-256 of the record"),
    ("verdict", "verdict of the checks"),
)


# -- reading ---------------------------------------------------------------------------------------


def read_side(folder: Path) -> tuple[Baseline, bool]:
    """Return what a folder holds, and whether tolerances were measured: those of a run are what its
    written digits leave open.

    Raises
    ------
    BristleError
        If it is neither a baseline nor a result folder.
    """
    if (folder / "baseline.json").exists():
        return read_baseline(folder), True
    result = read_json(folder / "result.json")
    try:
        step, total = float(result["step_s"]), rows_of(result)
        if not (0 < step < np.inf and total > 0):
            raise ValueError(step, total)
        quantities = {
            path: each if each.value is None else _least(path, each, step)
            for path, each in quantities_of(result).items()
        }
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError):
        raise BristleError(
            f"{folder / 'result.json'}: is no result of bristle run; give its result folder, or a"
            " baseline"
        ) from None
    rows, values = _read_signals(folder / "signals.csv", step, total)
    with np.errstate(invalid="ignore", over="ignore"):  # of what is no number, which has no bounds
        lower = {name: each - written_margin(each) for name, each in values.items()}
        upper = {name: each + written_margin(each) for name, each in values.items()}
    return Baseline(result, Signals(rows, values, lower, upper), quantities, ()), False


def _least(path: str, each: Judged, step: float) -> Judged:
    assert each.value is not None
    return Judged(each.unit, each.value, least_tolerance(path, each.value, step), each.why)


def _read_signals(
    path: Path, step: float, total: int
) -> tuple[NDArray[np.int64], dict[str, Array]]:
    """Return rows and signals of signals.csv, which may hold nan, of a run of `total` rows."""
    check_regular(path)
    try:
        with path.open(encoding="utf-8") as stream, warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of no data: an error below
            head = stream.readline().rstrip("\n").split(",")
            table = np.loadtxt(stream, delimiter=",", ndmin=2)
    except OSError as error:
        raise BristleError(
            f"{path}: {error.strerror}; give a result folder of bristle run"
        ) from None
    except ValueError as error:
        raise BristleError(
            f"{path}: no table of numbers ({error}); run the scenario again"
        ) from None
    # what is no table of signals
    if not table.size:
        raise BristleError(f"{path}: no numbers below its head; run the scenario again")
    if (
        head[0] != "time"
        or len(set(head)) != len(head)
        or table.shape[1:] != (len(head),)
        or not np.isfinite(table[:, 0]).all()
    ):
        raise BristleError(
            f"{path}: must have a head with one name a column, time first; run the scenario again"
        )
    rows = _rows_at(path, table[:, 0], step, total)
    # all instants that a run writes, be it thinned or at full rate
    written = thinned(total)
    if lost := missing(rows, written if np.isin(rows, written).all() else np.arange(total)):
        raise BristleError(
            f"{path}: {lost.count} of {lost.total} instants are missing, "
            f"the first at {lost.first * step:g} s; run the scenario again"
        )
    return rows, dict(zip(head[1:], table.T[1:], strict=True))


def _rows_at(path: Path, time: Array, step: float, total: int) -> NDArray[np.int64]:
    """Return the rows of a run that a column of times stands for: they rise, lie within the run,
    each at a step.
    """
    last = (total - 1) * step
    if (np.diff(time) <= 0).any() or time[0] < -0.5 * step or time[-1] > last + 0.5 * step:
        raise BristleError(
            f"{path}: its times must rise, from 0 to {last:g} s as result.json says; run the"
            " scenario again"
        )
    place = time / step
    rows = place.round().astype(np.int64)
    if np.abs(place - rows).max() > DURATION_SLACK * max(1.0, float(rows[-1])):
        raise BristleError(
            f"{path}: its times are no multiples of the step of result.json, {step:g} s; run the"
            " scenario again"
        )
    return rows


# -- judging ---------------------------------------------------------------------------------------


def compare_folders(first: Path, second: Path) -> RunComparison:
    """Judge the run or baseline `second` against the baseline or run `first`.

    Raises
    ------
    BristleError
        If one of them is no such folder.
    """
    (a, measured), (b, _) = read_side(first), read_side(second)
    notes = (
        ()
        if measured
        else (f"{first} is no baseline: allowed is only what the written digits leave open",)
    )
    comparison = compare_sides(a, b)
    return replace(
        comparison, first=str(first), second=str(second), notes=(*notes, *comparison.notes)
    )


def compare_sides(a: Baseline, b: Baseline) -> RunComparison:
    """Judge the run of `b` against that of `a`, with tolerances of `a`, at the times of both."""
    result_a, result_b = a.result, b.result
    notes, refused = _origins(result_a, result_b), _refused(result_a, result_b)
    comparison = RunComparison(
        "A",
        "B",
        scenario=str(result_a["scenario"]),
        rows=0,
        instants=len(a.signals.rows),
        refused=refused,
        signals=(),
        quantities=(),
        notes=tuple(notes),
        courses={},
        made=(_made(result_a), _made(result_b)),
    )
    # only a run that has all instants of the reference is judged
    rows, at_a, at_b = np.intersect1d(
        a.signals.rows, b.signals.rows, assume_unique=True, return_indices=True
    )
    if not refused and (lost := missing(rows, thinned(rows_of(result_a)))):
        first = lost.first * float(result_a["step_s"])
        line = f"B lacks {lost.count} of {lost.total} instants of A, the first at {first:g} s; run"
        comparison = replace(comparison, refused=(f"{line} the scenario of B again",))
    if comparison.refused:
        return comparison
    if new := [name for name in b.signals.values if name not in a.signals.values]:
        notes.append(f"signals that only B has, not judged: {', '.join(new)}")
    # signals at the common instants, and the numbers of the results
    time = np.asarray(rows * float(result_a["step_s"]), dtype=np.float64)
    courses = _courses(a.signals, b.signals, time, at_a, at_b)
    return replace(
        comparison,
        rows=len(rows),
        signals=tuple(
            judge_signal(name, courses[name])
            if name in courses
            else SignalVerdict(name, False, why="B has no such signal")
            for name in a.signals.values
        ),
        quantities=tuple(
            judge_quantity(path, each, b.quantities.get(path))
            for path, each in a.quantities.items()
        ),
        notes=tuple(notes),
        courses=courses,
        units={**result_b.get("units", {}), **result_a.get("units", {})},
    )


def _courses(
    a: Signals, b: Signals, time: Array, at_a: NDArray[np.intp], at_b: NDArray[np.intp]
) -> dict[str, SignalCourse]:
    """Return of each signal of A that B has, too, what both have at the same times."""
    return {
        name: SignalCourse(
            time, expected[at_a], a.lower[name][at_a], a.upper[name][at_a], b.values[name][at_b]
        )
        for name, expected in a.values.items()
        if name in b.values
    }


def _made(result: Mapping[str, Any]) -> dict[str, Any]:
    """Return where a result comes from, with the hashes of its FMUs and its record."""
    fmus = {name: fmu["sha256"] for name, fmu in result.get("fmus", {}).items()}
    return {
        **result.get("provenance", {}),
        "fmus_sha256": fmus,
        "record_sha256": look_up(result, "record.sha256"),
    }


def _refused(a: Mapping[str, Any], b: Mapping[str, Any]) -> tuple[str, ...]:
    """Return why two results cannot be compared by samples: another rate or duration."""
    steps, others = (float(each["step_s"]) for each in (a, b))
    if abs(steps - others) > 1e-9 * steps:
        return (f"the communication step is {steps:g} s in A and {others:g} s in B",)
    if a["steps"] != b["steps"]:
        early = [
            f"; {name} ended early: {each['diverged']['message']}"
            for name, each in (("A", a), ("B", b))
            if "diverged" in each
        ]
        return (f"A lasts {a['steps'] * steps:g} s, B {b['steps'] * steps:g} s{''.join(early)}",)
    return ()


def _origins(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[str]:
    """Return in words what is not the same about where two results come from."""
    lines = [
        f"{what}: {_short(_at(a, path))} in A, {_short(_at(b, path))} in B"
        for path, what in RESULT_ORIGINS
        if _at(a, path) != _at(b, path)
    ]
    for name in dict.fromkeys([*a.get("fmus", {}), *b.get("fmus", {})]):
        hashes = [_at(each, f"fmus.{name}.sha256") for each in (a, b)]
        if hashes[0] != hashes[1]:
            lines.append(
                f"SHA-256 of the FMU of the {name}: {_short(hashes[0])} in A, {_short(hashes[1])}"
                " in B"
            )
    return lines


def _at(result: Mapping[str, Any], path: str) -> object:
    return look_up(result, path)


def _short(value: object) -> str:
    """Return a value for a line of text; of a hash its first digits."""
    if value is None or value == []:
        return "none"
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return f"{value:.12}..." if isinstance(value, str) and len(value) == 64 else str(value)


def judge_signal(name: str, course: SignalCourse) -> SignalVerdict:
    """Judge a signal: the reference decides where; it must be a number there, within the bounds."""
    # without a number in the run where the reference has one, it fails there
    known = np.isfinite(course.reference)
    if not known.any():
        return SignalVerdict(name, True, why="not judged: the reference has no number")
    wrong = np.flatnonzero(known & ~np.isfinite(course.values))
    if len(wrong):
        k = int(wrong[0])
        expected, low, high = (
            float(each[k]) for each in (course.reference, course.lower, course.upper)
        )
        return SignalVerdict(
            name,
            False,
            None,
            float(course.time[k]),
            None,
            expected,
            low,
            high,
            f"it is {course.values[k]}",
        )
    # elsewhere the worst point decides: the distance as a share of what is allowed
    open_ = known & ~(np.isfinite(course.lower) & np.isfinite(course.upper))
    judged = known & ~open_
    if not judged.any():
        return SignalVerdict(name, True, why="not judged: repeated runs have no number there")
    with np.errstate(invalid="ignore", over="ignore"):  # where nothing is judged
        over = (course.values - course.reference) / (course.upper - course.reference)
        under = (course.reference - course.values) / (course.reference - course.lower)
    share = np.where(judged, np.maximum(over, under), -np.inf)
    k = int(np.argmax(share))
    passed, worst = bool(share[k] <= 1.0), max(0.0, float(share[k]))
    value, expected, low, high = (
        float(each[k]) for each in (course.values, course.reference, course.lower, course.upper)
    )
    return SignalVerdict(name, passed, worst, float(course.time[k]), value, expected, low, high)


def judge_quantity(path: str, first: Judged, second: Judged | None) -> QuantityVerdict:
    """Judge a number of B against that of A; where it exists in one of them only, both differ."""
    value = None if second is None else second.value
    if not first.judged:
        return QuantityVerdict(path, first.unit, first.value, value, None, None, first.why)
    if second is None:
        return QuantityVerdict(
            path, first.unit, first.value, None, first.tolerance, False, "B has no such number"
        )
    if first.value is None or first.tolerance is None:
        why = first.why if value is None else f"A has none: {first.why}"
        return QuantityVerdict(
            path, first.unit, None, value, None, None if value is None else False, why
        )
    if value is None:
        return QuantityVerdict(
            path, first.unit, first.value, None, first.tolerance, False, f"B has none: {second.why}"
        )
    inside = abs(value - first.value) <= first.tolerance
    return QuantityVerdict(path, first.unit, first.value, value, first.tolerance, bool(inside))


# -- files -----------------------------------------------------------------------------------------


def write_comparison(comparison: RunComparison, out: Path) -> Path:
    """Write `out/compare.html` and `out/compare.json`; return the first."""
    from bristle.harness.baseline.comparison_page import render

    with output_folder(out):
        files = {
            "compare.html": render(comparison).encode(),
            "compare.json": comparison_json(comparison),
        }
        return replace_files(out, files, list(files))[0]
