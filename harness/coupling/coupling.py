"""What the coupling of a scenario's FMUs costs: orders of execution and communication steps against
a refined one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bristle.common import pages
from bristle.common.errors import BristleError
from bristle.common.output import output_folder, replace_files, to_json
from bristle.common.provenance import provenance
from bristle.common.signals import Array
from bristle.harness.cosim.bus import Bus, BusTrace
from bristle.harness.cosim.isolate import run_bus
from bristle.harness.run.checked import RunOptions
from bristle.harness.run.outcome import verdict
from bristle.harness.run.run import build_and_check
from bristle.harness.scenario.plan import RunSetup

Told = Callable[[str, float], None]

REFINED = 16  # steps of the reference in one of the scenario
DIVISIONS = (1, 2, 4)  # of the step, with all FMUs at once
# One FMU after the other. In the first order both that are sampled read the bus at t_k, then the
# plant moves on: with small steps it is plant and sampled controller in one model.
ORDERS = (
    ("controller", "observer", "plant"),
    ("controller", "plant", "observer"),
    ("plant", "controller", "observer"),
)
APPLIED = ("plant", "u")  # the input that acts on the plant, recorded beside the outputs
SHIFT_ROUNDS = 8  # Newton steps of a delay
ESTIMATED_STATES = ("theta", "v", "w", "F")  # which an observer estimates beside parameters
LEAST_ERROR = 1e-12  # of the size of a signal: errors below it are rounding, and show no order


@dataclass(frozen=True)
class Error:
    """How far a signal is from the refined run: rms and largest error in its unit, rms over its
    rms, and delay [s].
    """

    rms: float
    largest: float
    relative: float
    delay: float | None


@dataclass(frozen=True)
class Scheme:
    """A way to couple the FMUs, and what it gives: verdict, errors and final estimates by name."""

    name: str
    verdict: str
    errors: Mapping[str, Error]
    estimates: Mapping[str, float]


@dataclass(frozen=True)
class CouplingCost:
    """All schemes, verdict and estimates of the refined run, and by signal the order at which its
    error falls with the step.
    """

    scenario: str
    step: float
    verdict: str
    schemes: tuple[Scheme, ...]
    refined: Mapping[str, float]
    orders: Mapping[str, float | None]
    notes: tuple[str, ...] = ()


def coupling(
    path: Path, out: Path, options: RunOptions | None = None, progress: Told | None = None
) -> CouplingCost:
    """Run a scenario in several couplings, and write `out/coupling.json` and `out/report.html`.

    Parameters
    ----------
    path : Path
        The scenario file, with a [plant].
    out : Path
        The folder.
    options : RunOptions, optional
        As of `bristle.run`.
    progress : function, optional
        Called with what runs next and the share that is done.

    Raises
    ------
    BristleError
        One line; nothing is written then.
    """
    with output_folder(out, "coupling.json"):
        checked = build_and_check(path, out, options)
        setup = checked.setup
        if setup.samples is not None:
            raise setup.loaded.error(
                "record", None, "a measured record couples nothing; give a scenario with a [plant]"
            )
        cost = compare(setup, checked.bus, progress or (lambda name, share: None))
        made = provenance()
        files = {"coupling.json": _json(cost, made), "report.html": _page(cost, made)}
        replace_files(out, files, list(files))
    return cost


def compare(setup: RunSetup, bus: Bus, progress: Told) -> CouplingCost:
    """Run a bus in all couplings."""
    bus = replace(bus, record=(*bus.record, APPLIED))
    divided = {parts: f"all at once, step {bus.h / parts:g} s" for parts in DIVISIONS}
    traces, notes = _traces(setup.loaded.name, bus, _ways(bus, divided), progress)
    best, *others = traces
    # all are compared over the rows that all have
    rows = min(len(trace.values) for trace in traces.values())
    schemes = {
        name: _scheme(name, _judged(setup, traces[name]), traces[name], traces[best], rows)
        for name in others
    }
    return CouplingCost(
        setup.loaded.name,
        bus.h,
        _judged(setup, traces[best]),
        tuple(schemes.values()),
        _estimates(traces[best], rows),
        _orders([schemes[name] for name in divided.values() if name in schemes]),
        notes,
    )


def _ways(bus: Bus, divided: Mapping[int, str]) -> Mapping[str, Callable[[], BusTrace]]:
    """Return how the bus is run, by name, the refined way first; `divided`: all FMUs at once."""
    units = [each.name for each in bus.instances]
    orders = list(dict.fromkeys(tuple(u for u in order if u in units) for order in ORDERS))
    refined = f"{' - '.join(orders[0])}, step {bus.h / REFINED:g} s"
    ways = {refined: partial(coupled, bus, REFINED, orders[0])}
    ways |= {name: partial(coupled, bus, parts) for parts, name in divided.items()}
    return ways | {
        f"{' - '.join(order)}, step {bus.h:g} s": partial(coupled, bus, 1, order)
        for order in orders
    }


def _traces(
    scenario: str, bus: Bus, ways: Mapping[str, Callable[[], BusTrace]], progress: Told
) -> tuple[dict[str, BusTrace], tuple[str, ...]]:
    """Run a bus in all ways; return the runs that came to their end, and a note on each other."""
    traces: dict[str, BusTrace] = {}
    notes: list[str] = []
    for k, (name, run) in enumerate(ways.items()):
        progress(name, k / len(ways))
        trace = run()
        if trace.failure is None:
            traces[name] = trace
        elif k == 0:
            raise BristleError(
                f"{scenario}: with a step of {bus.h / REFINED:g} s the run ends early, so nothing"
                " can be compared with it"
            )
        else:
            end = trace.steps * bus.h
            notes.append(f"{name}: the run ended early, at {end:g} s; it is left out")
    return traces, tuple(notes)


def coupled(bus: Bus, parts: int = 1, order: Sequence[str] = ()) -> BusTrace:
    """Run a bus with its step divided into parts; sampled FMUs keep their sample time.

    All FMUs at once (Jacobi), or in an order of their names, each with what those before it have
    just published (Gauss-Seidel).
    """
    units = {each.name: each for each in bus.instances}
    instances = tuple(units[name] for name in order) or bus.instances
    return run_bus(replace(bus, instances=instances, split=parts, sequential=bool(order)))


def delay(signal: Array, reference: Array, h: float) -> float | None:
    """Return by how much a signal lags behind a reference [s], both at equal steps h; None where
    that says nothing.
    """
    t, shift = h * np.arange(len(reference)), 0.0
    if np.ptp(reference) == 0:
        return None
    for _ in range(SHIFT_ROUNDS):
        moved = np.interp(t - shift, t, reference)
        slope = np.gradient(moved, h)
        step = -float((signal - moved) @ slope) / float(slope @ slope)
        shift += step
        if abs(shift) > 0.1 * t[-1]:
            return None
        if abs(step) < 1e-9 * h:
            break
    return shift


def _judged(setup: RunSetup, trace: BusTrace) -> str:
    """Return the verdict; the input that acts on the plant is no signal of a result."""
    return verdict(
        setup,
        BusTrace(trace.record[:-1], trace.values[:, :-1], trace.h, trace.flags, trace.failure),
    )


def _scheme(name: str, verdict: str, trace: BusTrace, best: BusTrace, rows: int) -> Scheme:
    errors = {}
    for unit, variable in trace.record:
        exact, got = best[unit, variable][:rows], trace[unit, variable][:rows]
        # row k + 1 is what acts from t_k to t_k+1, the others are the bus at t_k
        if (unit, variable) == APPLIED:
            exact, got = exact[1:], got[1:]
        # what an observer says of itself is no signal of the loop
        if unit == "observer" or not np.ptp(exact):
            continue
        difference, size = got - exact, float(np.sqrt(np.mean(exact**2)))
        rms = float(np.sqrt(np.mean(difference**2)))
        errors[f"{unit}.{variable}"] = Error(
            rms, float(np.abs(difference).max()), rms / size, delay(got, exact, trace.h)
        )
    return Scheme(name, verdict, errors, _estimates(trace, rows))


def _estimates(trace: BusTrace, rows: int) -> dict[str, float]:
    """Return the estimates at the end; those that the method does not give are 0, and left out."""
    hats = {
        name.removesuffix("_hat"): float(trace[unit, name][rows - 1])
        for unit, name in trace.record
        if name.endswith("_hat")
    }
    return {name: value for name, value in hats.items() if value and name not in ESTIMATED_STATES}


def _orders(divisions: Sequence[Scheme]) -> dict[str, float | None]:
    """Return by signal the power of the step with which its error falls, from the whole step to the
    smallest.

    Nothing is said where a run with one of these steps was left out.
    """
    orders: dict[str, float | None] = {}
    for name in divisions[0].errors if len(divisions) == len(DIVISIONS) else ():
        ends = [each.errors[name].rms for each in (divisions[0], divisions[-1])]
        small = divisions[-1].errors[name].relative < LEAST_ERROR
        orders[name] = (
            None if small else math.log(ends[0] / ends[1]) / math.log(DIVISIONS[-1] / DIVISIONS[0])
        )
    return orders


def _json(cost: CouplingCost, made: Mapping[str, Any]) -> bytes:
    schemes = [
        {
            "name": s.name,
            "verdict": s.verdict,
            "signals": {k: vars(e) for k, e in s.errors.items()},
            "estimates": dict(s.estimates),
        }
        for s in cost.schemes
    ]
    content: dict[str, Any] = {
        "scenario": cost.scenario,
        "step_s": cost.step,
        "schemes": schemes,
        "orders": dict(cost.orders),
        "refined": {
            "step_s": cost.step / REFINED,
            "verdict": cost.verdict,
            "estimates": dict(cost.refined),
        },
        "notes": list(cost.notes),
        "provenance": made,
    }
    return to_json(content).encode()


def _page(cost: CouplingCost, made: Mapping[str, Any]) -> bytes:
    known = list(cost.refined)
    ways = [
        ("refined", cost.verdict, cost.refined),
        *((each.name, each.verdict, each.estimates) for each in cost.schemes),
    ]
    return pages.render(
        "bristle.harness.coupling/report.html",
        cost=cost,
        made=made,
        refined_step=cost.step / REFINED,
        known=known,
        ends=[(name, judged, [values.get(e) for e in known]) for name, judged, values in ways],
    ).encode()
