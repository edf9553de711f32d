"""What the coupling of a scenario's FMUs costs: orders of execution and communication steps against a refined one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import BristleError
from bristle.common.html import identifier, number, page, table
from bristle.common.output import output_folder, plain, replace_files, to_json
from bristle.common.provenance import provenance
from bristle.harness.isolate import simulate_isolated
from bristle.harness.loop import Bus, Port, Session, Trace, simulate
from bristle.harness.run import Options, check

Array = NDArray[np.float64]
Told = Callable[[str, float], None]

REFINED = 16  # of the scenario's step: size of the steps of the reference
DIVISIONS = (1, 2, 4)  # of the step, with all FMUs at once
ORDERS = (("plant", "controller", "observer"), ("controller", "plant", "observer"))  # one FMU after the other
SHIFT_ROUNDS = 8  # Newton steps of a delay
ESTIMATED_STATES = ("theta", "v", "w", "F")  # which an observer estimates beside parameters
LEAST_ERROR = 1e-12  # of the size of a signal: errors below it are rounding, and show no order


@dataclass(frozen=True)
class Error:
    """How far a signal is from the refined run: rms and largest error in its unit, rms over its rms, and delay [s]."""

    rms: float
    largest: float
    relative: float
    delay: float | None


@dataclass(frozen=True)
class Scheme:
    """A way to couple the FMUs, and what it gives: errors and final estimates by name."""

    name: str
    errors: Mapping[str, Error]
    estimates: Mapping[str, float]


@dataclass(frozen=True)
class Coupling:
    """All schemes, the estimates of the refined run, and by signal the order at which its error falls with the step."""

    scenario: str
    step: float
    schemes: tuple[Scheme, ...]
    refined: Mapping[str, float]
    orders: Mapping[str, float | None]
    notes: tuple[str, ...] = ()


def coupling(path: Path, out: Path, options: Options | None = None, progress: Told | None = None) -> Coupling:
    """Run a scenario in several couplings, and write `out/coupling.json` and `out/report.html`.

    Parameters
    ----------
    path : Path
        The scenario file, with a [plant].
    out : Path
        The folder.
    options : Options, optional
        As of `bristle.run`.
    progress : function, optional
        Called with what runs next and the share that is done.

    Raises
    ------
    BristleError
        One line; nothing is written then.
    """
    with output_folder(out):
        checked = check(path, out, options)
        setup = checked.setup
        if setup.samples is not None:
            raise setup.loaded.error("record", None, "a measured record couples nothing; give a scenario with a [plant]")
        found = compare(checked.bus, setup.loaded.name, progress or (lambda name, share: None))
        files = {"coupling.json": _json(found), "report.html": _page(found)}
        replace_files(out, files, list(files))
    return found


def compare(bus: Bus, scenario: str, progress: Told) -> Coupling:
    """Run a bus in all couplings."""
    bus = replace(bus, flags=())
    units = [each.name for each in bus.instances]
    orders = [] if bus.risky else [tuple(u for u in order if u in units) for order in ORDERS]
    notes = ("FMUs from elsewhere are run all at once only.",) if bus.risky else ()
    ways: dict[str, Callable[[], Trace]] = {}
    for parts in (REFINED, *DIVISIONS):
        ways[f"all at once, step {bus.h / parts:g} s"] = partial(divided, bus, parts)
    for order in dict.fromkeys(orders):
        ways[f"{' - '.join(order)}, step {bus.h:g} s"] = partial(sequential, bus, order)
    traces: dict[str, Trace] = {}
    for k, (name, run) in enumerate(ways.items()):
        progress(name, k / len(ways))
        traces[name] = run()
        if traces[name].failure is not None and k == 0:
            raise BristleError(
                f"{scenario}: with a step of {bus.h / REFINED:g} s the run ends early, so nothing can be compared with it"
            )
        if traces[name].failure is not None:
            notes = (*notes, f"{name}: the run ended early, at {traces[name].steps * bus.h:g} s; it is left out")
            del traces[name]
    best, *others = traces
    rows = min(len(trace.values) for trace in traces.values())
    schemes = tuple(_scheme(name, traces[name], traces[best], rows) for name in others)
    return Coupling(scenario, bus.h, schemes, _estimates(traces[best], rows), _orders(schemes), notes)


def divided(bus: Bus, parts: int) -> Trace:
    """Run a bus with its step divided into parts (Jacobi), and return every such row; sampled FMUs keep their sample time."""
    fine = replace(
        bus, steps=bus.steps * parts, h=bus.h / parts, events=tuple((step * parts, to, value) for step, to, value in bus.events),
        series={port: np.repeat(values, parts) for port, values in bus.series.items()},
    )  # fmt: skip
    trace = simulate_isolated(fine) if fine.risky else simulate(fine)
    return Trace(trace.record, trace.values[::parts], bus.h, trace.flags, trace.failure)


def sequential(bus: Bus, order: Sequence[str]) -> Trace:
    """Run a bus one FMU after the other, each with what those before it have published in this step (Gauss-Seidel)."""
    with Session(bus) as session:
        nodes, events = session.nodes, list(bus.events)
        values = np.full((bus.steps + 1, len(bus.record)), np.nan)
        links = {unit: [(a, b) for a, b in bus.links if b[0] == unit] for unit in order}
        for node in nodes.values():
            node.read()

        def write(port: Port, value: float) -> None:
            array, place = nodes[port[0]].place(port[1])
            array[place] = value

        def read(port: Port) -> float:
            array, place = nodes[port[0]].place(port[1])
            return float(array[place])

        values[0] = [read(port) for port in bus.record]
        for k in range(bus.steps):
            while events and events[0][0] <= k:
                write(*events.pop(0)[1:])
            for port, series in bus.series.items():
                write(port, float(series[k]))
            for unit in order:
                for source, target in links[unit]:
                    write(target, read(source))
                nodes[unit].step(k * bus.h, bus.h)
            values[k + 1] = [read(port) for port in bus.record]
    return Trace(bus.record, values, bus.h, [])


def delay(signal: Array, reference: Array, h: float) -> float | None:
    """Return by how much a signal lags behind a reference [s], both at equal steps h; None where that says nothing."""
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


def _scheme(name: str, trace: Trace, best: Trace, rows: int) -> Scheme:
    errors = {}
    for unit, variable in trace.record:
        exact, got = best[unit, variable][:rows], trace[unit, variable][:rows]
        if unit == "observer" or not np.ptp(exact):  # what an observer says of itself is no signal of the loop
            continue
        difference, size = got - exact, float(np.sqrt(np.mean(exact**2)))
        rms = float(np.sqrt(np.mean(difference**2)))
        errors[f"{unit}.{variable}"] = Error(rms, float(np.abs(difference).max()), rms / size, delay(got, exact, trace.h))
    return Scheme(name, errors, _estimates(trace, rows))


def _estimates(trace: Trace, rows: int) -> dict[str, float]:
    """Return the estimates of parameters at the end; those that the method does not give are 0, and left out."""
    hats = {name.removesuffix("_hat"): float(trace[unit, name][rows - 1]) for unit, name in trace.record if name.endswith("_hat")}
    return {name: value for name, value in hats.items() if value and name not in ESTIMATED_STATES}


def _orders(schemes: Sequence[Scheme]) -> dict[str, float | None]:
    """Return by signal the power of the step with which its error falls, from the whole step to the smallest."""
    divisions = schemes[: len(DIVISIONS)]
    found: dict[str, float | None] = {}
    for name in divisions[0].errors if len(divisions) == len(DIVISIONS) else ():
        ends = [each.errors[name].rms for each in (divisions[0], divisions[-1])]
        small = divisions[-1].errors[name].relative < LEAST_ERROR
        found[name] = None if small else math.log(ends[0] / ends[1]) / math.log(DIVISIONS[-1] / DIVISIONS[0])
    return found


def _json(found: Coupling) -> bytes:
    schemes = [
        {"name": s.name, "signals": {k: vars(e) for k, e in s.errors.items()}, "estimates": dict(s.estimates)}
        for s in found.schemes
    ]
    content: dict[str, Any] = {
        "scenario": found.scenario, "step_s": found.step, "schemes": schemes, "orders": dict(found.orders),
        "refined": {"step_s": found.step / REFINED, "estimates": dict(found.refined)}, "notes": list(found.notes),
        "provenance": provenance(),
    }  # fmt: skip
    return to_json(plain(content)).encode()


def _page(found: Coupling) -> bytes:
    parts = [
        f"<header><h1>Coupling of {identifier(found.scenario)}</h1><p class='lead'>What the order of the FMUs and the"
        f" communication step change, against all at once with a step of {found.step / REFINED:g} s.</p></header>"
    ]
    parts += [f'<p class="alarm">{note}</p>' for note in found.notes]
    for each in found.schemes:
        rows = [
            (
                identifier(name), number(100 * e.relative, 3), number(e.rms, 3), number(e.largest, 3),
                "–" if e.delay is None else number(1e3 * e.delay, 3),
            )
            for name, e in each.errors.items()
        ]  # fmt: skip
        head = ("signal", "rms error, % of its rms", "rms error, SI unit", "largest error, SI unit", "delay, ms")
        parts.append(f"<h2>{each.name}</h2>" + table(head, rows, (1, 2, 3, 4)))
    names = [each.name for each in found.schemes]
    estimates = []
    for name, value in found.refined.items():
        others = [number(100 * (each.estimates.get(name, 0.0) / value - 1), 3) for each in found.schemes]
        estimates.append([identifier(name), number(value, 5), *others])
    parts.append("<h2>Estimates at the end</h2><p>In the refined run, and how far the others are from it, in %.</p>")
    parts.append(table(("estimate", "refined", *names), estimates, tuple(range(1, len(names) + 2))))
    orders = [(identifier(name), "–" if order is None else number(order, 3)) for name, order in found.orders.items()]
    text = "The error falls with this power of the communication step (all at once)."
    parts.append(f"<h2>Order</h2><p>{text}</p>" + table(("signal", "order"), orders, (1,)))
    return page(f"coupling of {found.scenario}", "\n".join(parts)).encode()
