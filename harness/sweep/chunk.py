"""One chunk of a sweep: runs made one after the other or in step, and a row for each."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from bristle.common.errors import BristleError
from bristle.fmus.calls import CONTROL_SIZE, Control
from bristle.fmus.isolate import isolated
from bristle.harness.cosim.bus import Bus, BusTrace
from bristle.harness.cosim.loop import simulate
from bristle.harness.cosim.node import Slaves
from bristle.harness.run.checked import Checked, Simulate, check_loaded
from bristle.harness.run.outcome import outcome
from bristle.harness.scenario.parts import build_fmus
from bristle.harness.sweep.design import SweepPoint
from bristle.harness.sweep.lanes import Together, alike
from bristle.harness.sweep.ship import unpacked
from bristle.harness.sweep.spec import Sweep, load_point, parts_key
from bristle.harness.sweep.store import ERROR_VERDICT

Rows = list[dict[str, Any]]
# of result.json
KEPT_NUMBERS = (
    "adapted",
    "innovation",
    "tracking_rms",
    "estimates",
    "states",
    "tracking",
    "validation",
)
WINDOW = 64  # runs that are read and checked before they are simulated


class Watcher:
    """What the threads of a sweep share: how many runs are done, and whether to stop."""

    def __init__(self) -> None:
        self.done, self.stopped = 0, False
        self._controls: list[Control] = []

    def control(self) -> Control:
        """Return memory by which a run can be stopped."""
        made = np.zeros(CONTROL_SIZE, dtype=np.int64)
        self._controls.append(made)
        return made

    def stop(self) -> None:
        """End all runs at their next step."""
        self.stopped = True
        for each in self._controls:
            each[1] = 1


def run_chunk(sweep: Sweep, points: Sequence[SweepPoint], watcher: Watcher | None = None) -> Rows:
    """Make some runs, one after the other, and return a row for each; fewer if it is stopped.

    Runs with FMUs that may harm their process are made in a child process; if that dies, the runs
    are halved until the one that kills it is found, which is an error.
    """
    watcher = watcher or Watcher()
    here = unpacked(sweep)
    if not any(fmu.risky for fmu in here.all_fmus):
        return _rows(here, points, watcher.control(), watcher)
    return _isolated_rows(here, points, watcher)


def _isolated_rows(sweep: Sweep, points: Sequence[SweepPoint], watcher: Watcher) -> Rows:
    def look(_done: int) -> None:
        if watcher.stopped:
            raise BristleError("stopped")

    paths = sorted({fmu.path for fmu in sweep.all_fmus})
    limit = None if sweep.options.timeout is None else sweep.options.timeout * len(points)
    try:
        rows: Rows = isolated(_rows_in_child, (sweep, list(points)), paths, list, look, limit)
        watcher.done += len(rows)
        return rows
    except BristleError as error:
        if watcher.stopped:
            return []
        if len(points) > 1:
            half = len(points) // 2
            return [
                *_isolated_rows(sweep, points[:half], watcher),
                *_isolated_rows(sweep, points[half:], watcher),
            ]
        watcher.done += 1
        return [_row(sweep, points[0]) | _error(error)]


def _rows_in_child(asked: tuple[Sweep, list[SweepPoint]], control: Control) -> Rows:
    return _rows(*asked, control, Watcher())


def _rows(sweep: Sweep, points: Sequence[SweepPoint], control: Control, watcher: Watcher) -> Rows:
    rows: dict[int, dict[str, Any]] = {}
    with Slaves() as slaves:
        for run, simulate_run in _Simulation(sweep, control, slaves).each(points):
            row = _judged(run, simulate_run)
            if watcher.stopped:
                break
            rows[run.point.index] = row
            watcher.done += 1
    return [rows[index] for index in sorted(rows)]


@dataclass
class _Prepared:
    """What is known of a run, the seconds it took so far, and, unless it cannot be made, the run as
    checked and its `parts_key`.
    """

    point: SweepPoint
    row: dict[str, Any]
    seconds: float
    checked: Checked | None = None
    parts: str = ""


def _prepared(sweep: Sweep, point: SweepPoint) -> _Prepared:
    row, begun = _row(sweep, point), time.perf_counter()
    try:
        loaded = load_point(sweep, point)
        parts = parts_key(loaded)
        fmus = sweep.fmus.get(parts) or build_fmus(loaded, sweep.options.fmi, sweep.options.kind)
        checked = check_loaded(loaded, fmus, sweep.path.parent, sweep.options)
    except BristleError as error:
        return _Prepared(point, row | _error(error), time.perf_counter() - begun)
    return _Prepared(point, row, time.perf_counter() - begun, checked, parts)


def _error(error: BristleError) -> dict[str, Any]:
    return {"verdict": ERROR_VERDICT, "message": str(error)}


class _Simulation:
    """Simulates the runs of a chunk, in one thread: in lanes where that can be, each alone with its
    FMUs otherwise.
    """

    def __init__(self, sweep: Sweep, control: Control, slaves: Slaves) -> None:
        self._sweep, self._control, self._slaves = sweep, control, slaves
        self._together: dict[str, Together | None] = {}

    def each(self, points: Sequence[SweepPoint]) -> Iterator[tuple[_Prepared, Simulate]]:
        """Yield each run with the function that simulates it, which is to be used before the next
        one is asked for.
        """
        for begin in range(0, len(points), WINDOW):
            groups: dict[object, list[_Prepared]] = {}
            for point in points[begin : begin + WINDOW]:
                run = _prepared(self._sweep, point)
                groups.setdefault(self._key(run), []).append(run)
            for group in groups.values():
                yield from self._simulated(group)

    def _key(self, run: _Prepared) -> object:
        """Return what runs that can be in step have in common."""
        if run.checked is None or self._of(run) is None:
            return run.point.index
        return run.parts, alike(run.checked.bus)

    def _of(self, run: _Prepared) -> Together | None:
        """Return what makes such runs in lanes, None if nothing can."""
        if run.checked is None or not self._sweep.lanes:
            return None
        if run.parts not in self._together:
            try:
                self._together[run.parts] = Together(run.checked.setup)
            except BristleError:
                self._together[run.parts] = None
        return self._together[run.parts]

    def _simulated(self, group: Sequence[_Prepared]) -> Iterator[tuple[_Prepared, Simulate]]:
        together = self._of(group[0]) if len(group) > 1 else None
        width = 1 if together is None else together.width
        for begin in range(0, len(group), width):
            runs = group[begin : begin + width]
            traces = [None] * len(runs) if together is None else self._in_step(runs, together)
            for run, trace in zip(runs, traces, strict=True):
                yield run, partial(self._alone, run, trace)

    def _in_step(self, runs: Sequence[_Prepared], together: Together) -> Sequence[BusTrace | None]:
        begun = time.perf_counter()
        traces = together.run(
            [run.checked.bus for run in runs if run.checked is not None], self._control
        )
        spent = time.perf_counter() - begun
        for run in runs:
            run.seconds += spent / len(runs)
        return traces

    def _alone(
        self,
        run: _Prepared,
        trace: BusTrace | None,
        bus: Bus,
        _progress: object = None,
        _timeout: object = None,
    ) -> BusTrace:
        """Return the trace that is there, for the bus that it is of; simulate any other."""
        if trace is not None and run.checked is not None and bus is run.checked.bus:
            return trace
        return simulate(bus, control=self._control, slaves=self._slaves)


def _judged(run: _Prepared, simulate_run: Simulate) -> dict[str, Any]:
    """Make one run."""
    row, begun = run.row, time.perf_counter() - run.seconds
    if run.checked is None:
        return row | {"wall_s": run.seconds}
    try:
        result = outcome(replace(run.checked, simulate=simulate_run)).result
    except BristleError as error:
        return row | _error(error) | {"wall_s": time.perf_counter() - begun}
    failed = [check["name"] for check in result["checks"] if not check["pass"]]
    verdict = {
        "verdict": result["verdict"],
        "message": result["diverged"]["message"] if "diverged" in result else "",
        "failed": "; ".join(failed),
        "checks": len(result["checks"]),
        "checks_passed": len(result["checks"]) - len(failed),
        "steps": result["steps"],
        "wall_s": time.perf_counter() - begun,
    }
    hashes = {f"sha256.{name}": fmu["sha256"] for name, fmu in result["fmus"].items()}
    numbers = _numbers({name: result[name] for name in KEPT_NUMBERS if name in result})
    # as given, if it varies
    return (
        row | verdict | hashes | {name: value for name, value in numbers.items() if name not in row}
    )


def _row(sweep: Sweep, point: SweepPoint) -> dict[str, Any]:
    """Return what is known of a run before it is made."""
    return {
        "key": sweep.key(point),
        "sweep": sweep.name,
        "run": point.index,
        "scenario": sweep.path.stem,
        "scenario_sha256": sweep.sha256,
        "seed": point.seed,
        "command": sweep.command(point),
    } | {
        axis.path: axis.value(each) for axis, each in zip(sweep.axes, point.overrides, strict=True)
    }


def _numbers(tree: Mapping[str, Any], before: str = "") -> dict[str, float | bool | None]:
    """Return the numbers of a tree by their dotted paths; what is not finite is null."""
    numbers: dict[str, float | bool | None] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            numbers |= _numbers(value, f"{before}{name}.")
        elif isinstance(value, bool | np.bool_):
            numbers[before + name] = bool(value)
        elif isinstance(value, int | float | np.number):
            numbers[before + name] = float(value) if math.isfinite(value) else None
        elif value is None:
            numbers[before + name] = None
    return numbers
