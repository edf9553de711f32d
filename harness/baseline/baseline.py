"""A reference of a scenario with the tolerances that repeated runs measure: made, stored, read."""

from __future__ import annotations

import io
import json
import math
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import BristleError
from bristle.common.files import check_regular
from bristle.common.output import output_folder, plain, replace_files, to_json
from bristle.common.provenance import provenance
from bristle.common.signals import Array
from bristle.harness.baseline.repeats import Repeat, RepeatedRun, repeats
from bristle.harness.baseline.tube import SAFETY, WRITTEN_SHARE, Spread
from bristle.harness.metrics.checks import look_up
from bristle.harness.run.checked import Checked
from bristle.harness.run.outcome import outcome
from bristle.harness.run.results import THINNED_ROWS, missing, rows_of, thinned

Told = Callable[[str, float], None]

BASELINE_FILES = ("baseline.json", "result.json", "scenario.toml", "signals.npz")
BASELINE_BYTES = 4_000_000  # of the signals of a baseline, before they are packed
BYTES_A_SAMPLE = 16  # a value and two margins
# numbers of each estimate that are judged
JUDGED_ESTIMATE = ("final", "error_percent", "settling_s")
SHOWN_VALUE = 30  # characters of a value that is no number, in a message
# steps by which a settling time may differ at least: it is one of the sampled times
SETTLING_STEPS = 1.0


@dataclass(frozen=True)
class Judged:
    """A number of result.json: how far another may be from it, why it does not exist, and whether
    it is judged at all.
    """

    unit: str
    value: float | None
    tolerance: float | None = None
    why: str = ""
    judged: bool = True


@dataclass(frozen=True)
class Signals:
    """Signals at some rows of a run: rows, shape (n,), and by name value, lower and upper bound,
    shape (n,) each.
    """

    rows: NDArray[np.int64]
    values: Mapping[str, Array]
    lower: Mapping[str, Array]
    upper: Mapping[str, Array]


@dataclass(frozen=True)
class Baseline:
    """A reference: its result.json, signals with their tubes, judged numbers, and the runs that
    measured them.
    """

    result: Mapping[str, Any]
    signals: Signals
    quantities: Mapping[str, Judged]
    runs: Sequence[Mapping[str, Any]]


# -- making ----------------------------------------------------------------------------------------


def make_baseline(
    checked: Checked, progress: Told | None = None, ways: Sequence[Repeat] | None = None
) -> Baseline:
    """Run a scenario, and again in all ways that change its rounding.

    Parameters
    ----------
    checked : Checked
        The scenario.
    progress : function, optional
        Called with what runs next and the share that is done.
    ways : sequence of Repeat, optional
        How it is run again; by default in all ways that this machine has.

    Raises
    ------
    BristleError
        If the scenario does not run to its end: it is then no reference.
    """
    tell = progress or (lambda name, share: None)
    ways = repeats(checked.setup) if ways is None else ways
    tell("reference", 0.0)
    first = outcome(checked)
    _check_end(checked, first.result)
    reference = first.view.columns()
    spread, results, runs = Spread(reference), [], []
    for k, way in enumerate(ways, 1):
        tell(way.name, k / (len(ways) + 1))
        again, why = _tried(way)
        runs.append({"name": way.name, "differs": _differing(reference, again), "why": why})
        if again is not None:
            spread.add(again.signals)
            results.append(again.result)
    if not results:
        raise BristleError(
            f"{checked.setup.loaded.path}: it cannot be run again,"
            f" {runs[0]['why'] if runs else 'in no way'}"
        )
    return Baseline(
        first.result, _stored(spread), measured_quantities(plain(first.result), results), runs
    )


def _check_end(checked: Checked, result: Mapping[str, Any]) -> None:
    """Refuse a run that ended early."""
    if "diverged" in result:
        stopped = result["diverged"]
        what = f"{stopped['fmu']}: {stopped['message']}"
        message = f"the run ends at {stopped['time_s']:g} s, {what}; a reference needs a run that"
        raise checked.setup.loaded.error("duration", None, f"{message} reaches its end")


def _tried(way: Repeat) -> tuple[RepeatedRun | None, str]:
    """Return a repeated run, or why it failed: a compiler's failure says nothing about it."""
    try:
        return way.run(), ""
    except BristleError as error:
        return None, str(error)


def _differing(reference: Mapping[str, Array], again: RepeatedRun | None) -> int:
    """Return how many signals are not the same to the last digit."""
    if again is None:
        return 0
    return sum(
        name not in again.signals or not np.array_equal(values, again.signals[name], equal_nan=True)
        for name, values in reference.items()
    )


def _stored(spread: Spread) -> Signals:
    """Return the tubes at the rows that are stored: those that `bristle run` writes, and as many
    others as there is room for.
    """
    reference = spread.reference
    total = len(next(iter(reference.values())))
    # what is constant packs into nothing
    moving = max(1, sum(bool(np.ptp(values)) for values in reference.values()))
    room = BASELINE_BYTES // (BYTES_A_SAMPLE * moving) - THINNED_ROWS
    rows = np.union1d(thinned(total), thinned(total, max(THINNED_ROWS, room)))
    values, lower, upper = {}, {}, {}
    for name, expected in reference.items():
        tube = spread.tube(name)
        values[name], lower[name], upper[name] = expected[rows], tube.lower[rows], tube.upper[rows]
    return Signals(rows.astype(np.int64), values, lower, upper)


def quantities_of(result: Mapping[str, Any]) -> dict[str, Judged]:
    """Return the judged numbers of result.json: of each estimate, and what the servo did."""
    quantities = {}
    for name, estimate in result["estimates"].items():
        for key in JUDGED_ESTIMATE:
            unit = {"final": estimate["unit"], "error_percent": "%", "settling_s": "s"}[key]
            value = _number(estimate[key])
            quantities[f"estimates.{name}.{key}"] = Judged(
                unit, value, why="" if value is not None else _absent(estimate, key)
            )
    for name, each in result.get("behaviour", {}).items():
        value = _number(each["value"])
        why = each.get("why") or _unreadable(each["value"])
        quantities[f"behaviour.{name}"] = Judged(
            each["unit"], value, why="" if value is not None else why
        )
    return quantities


def _absent(estimate: Mapping[str, Any], key: str) -> str:
    """Return why a number of an estimate does not exist."""
    if estimate[key] is not None:
        return _unreadable(estimate[key])
    if not estimate["valid"] and key != "settling_s":
        return "the observer calls the estimate not valid at the end"
    if key != "final" and estimate["true"] is None:
        return "there is no true value"
    if key != "final" and estimate["true"] == 0:
        return "the true value is 0"
    return "it is not settled at the end" if key == "settling_s" else _unreadable(None)


def _unreadable(value: object) -> str:
    """Return why a value of result.json is no number."""
    return f"result.json has {json.dumps(value)[:SHOWN_VALUE]} there, no number"


def _number(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return None
    return float(value)


def measured_quantities(
    result: Mapping[str, Any], others: Sequence[Mapping[str, Any]]
) -> dict[str, Judged]:
    """Return the judged numbers of a result, with tolerances from other results of the scenario."""
    quantities = {}
    for path, each in quantities_of(result).items():
        known = [value for other in others if (value := _number(_value(other, path))) is not None]
        if len(known) != (0 if each.value is None else len(others)):
            why = f"not judged: it exists in {len(known)} of {len(others)} repeated runs"
            quantities[path] = Judged(each.unit, each.value, None, why, judged=False)
        elif each.value is None:
            quantities[path] = each
        else:
            spread = max(abs(value - each.value) for value in known)
            quantities[path] = Judged(
                each.unit,
                each.value,
                SAFETY * spread + least_tolerance(path, each.value, result["step_s"]),
            )
    return quantities


def _value(result: Mapping[str, Any], path: str) -> object:
    return look_up(result, f"{path}.value" if path.startswith("behaviour.") else path)


def least_tolerance(path: str, value: float, step: float) -> float:
    """Return how far a number may be off where repeated runs do not differ: by its written digits,
    a time by one step.
    """
    return WRITTEN_SHARE * abs(value) + (
        SETTLING_STEPS * step if path.endswith("settling_s") else 0.0
    )


# -- files -----------------------------------------------------------------------------------------


def write_baseline(
    out: Path, name: str, baseline: Baseline, scenario: str, command: str = ""
) -> Path:
    """Write a baseline into `out/name`, in the place of an older one: all files or none; `command`
    repeats it.
    """
    target = out / name
    refuse_other(target)
    quantities = {path: vars(each) for path, each in baseline.quantities.items()}
    stored = baseline.signals
    tree = {
        "scenario": name,
        "safety": SAFETY,
        "rows": len(stored.rows),
        "steps": baseline.result["steps"],
        "step_s": baseline.result["step_s"],
        "runs": list(baseline.runs),
        "quantities": quantities,
        "provenance": {**baseline.result["provenance"], **provenance(), "command": command},
    }
    files = {
        "baseline.json": to_json(tree).encode(),
        "result.json": to_json(plain(baseline.result)).encode(),
        "scenario.toml": scenario.encode(),
        "signals.npz": _packed(stored),
    }
    placed = {f"{name}/{file}": files[file] for file in BASELINE_FILES}
    with output_folder(out):
        replace_files(out, placed, list(placed))
    return target


def refuse_other(target: Path) -> None:
    """Refuse to write into a folder that holds anything but a baseline."""
    inside = {path.name for path in target.iterdir()} if target.is_dir() else set()
    if (target.exists() and not target.is_dir()) or inside - set(BASELINE_FILES):
        raise BristleError(
            f"{target}: exists and is no baseline of bristle; write elsewhere or rename the"
            " scenario"
        )


def _packed(stored: Signals) -> bytes:
    """Return signals.npz: margins as single precision, rounded outwards."""
    out, names = io.BytesIO(), list(stored.values)
    values = np.array([stored.values[name] for name in names])
    below = np.array([stored.values[name] - stored.lower[name] for name in names])
    above = np.array([stored.upper[name] - stored.values[name] for name in names])
    np.savez_compressed(
        out,
        names=np.array(names),
        rows=stored.rows,
        values=values,
        below=_outwards(below),
        above=_outwards(above),
    )
    return out.getvalue()


def _outwards(margin: Array) -> NDArray[np.float32]:
    known = np.where(np.isnan(margin), 0.0, margin)
    with np.errstate(over="ignore", under="ignore"):
        return np.nextafter(known.astype(np.float32), np.float32(np.inf))


def read_baseline(folder: Path) -> Baseline:
    """Read a baseline.

    Raises
    ------
    BristleError
        One line, if a file is missing or damaged.
    """
    tree, result = (read_json(folder / name) for name in ("baseline.json", "result.json"))
    try:
        # rows, values and tolerances of the signals, which must have one shape
        with np.load(
            io.BytesIO((folder / "signals.npz").read_bytes()), allow_pickle=False
        ) as content:
            names = [str(name) for name in content["names"]]
            rows, values = content["rows"].astype(np.int64), content["values"]
            below, above = content["below"].astype(float), content["above"].astype(float)
        shape = (len(names), len(rows))
        if {values.shape, below.shape, above.shape} != {shape}:
            raise ValueError(shape)
        quantities = {path: Judged(**each) for path, each in tree["quantities"].items()}
        runs = tree["runs"]
        # no row may lack that every baseline of so many steps has
        if missing(rows, thinned(rows_of(result))):
            raise ValueError(rows)
    except (OSError, EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile):
        raise BristleError(
            f"{folder}: is no complete baseline; make it again with bristle accept"
        ) from None
    # tolerances are stored as distances from the values
    signals = Signals(
        rows,
        dict(zip(names, values, strict=True)),
        dict(zip(names, values - below, strict=True)),
        dict(zip(names, values + above, strict=True)),
    )
    return Baseline(result, signals, quantities, runs)


def read_json(path: Path) -> dict[str, Any]:
    """Return the content of a JSON file with an object; raise `BristleError` if it has none."""
    check_regular(path)
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BristleError(
            f"{path}: {error.strerror}; give a baseline, or a result folder of bristle run"
        ) from None
    except (ValueError, RecursionError) as error:
        raise BristleError(f"{path}: no JSON ({error}); make the folder again") from None
    if not isinstance(tree, dict):
        raise BristleError(f"{path}: holds no object; make the folder again")
    return tree
