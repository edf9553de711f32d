"""Co-simulation in its own process, for FMUs from elsewhere: a crash ends only that process."""

from __future__ import annotations

from dataclasses import astuple
from functools import partial
from typing import Any

import numpy as np

from bristle.fmus.calls import Control
from bristle.fmus.isolate import isolated
from bristle.harness.cosim.bus import Bus, BusTrace, Failure, Progress, Readings
from bristle.harness.cosim.loop import default_engine, simulate


def simulate_isolated(
    bus: Bus,
    progress: Progress | None = None,
    *,
    engine: str | None = None,
    timeout: float | None = None,
) -> BusTrace:
    """Run a bus in a child process, which may take `timeout` seconds.

    Raises
    ------
    BristleError
        If the child dies, takes too long or refuses the bus; the FMU whose call was under way is
        named.
    """
    engine = engine or default_engine()
    return isolated(
        _simulate,
        (bus, engine),
        [each.fmu.path for each in bus.instances],
        partial(_trace, bus),
        progress,
        timeout,
    )


def run_bus(bus: Bus, progress: Progress | None = None, timeout: float | None = None) -> BusTrace:
    """Run a bus: in a child process if an FMU may harm its own, which may then take `timeout`
    seconds; errors as above.
    """
    return (
        simulate_isolated(bus, progress, timeout=timeout) if bus.risky else simulate(bus, progress)
    )


def _simulate(asked: tuple[Bus, str], control: Control) -> dict[str, Any]:
    bus, engine = asked
    trace = simulate(bus, engine=engine, control=control)
    return {
        "values": trace.values,
        "rows": trace.flags.rows.tolist(),
        "flags": trace.flags.values,
        "failure": None if trace.failure is None else astuple(trace.failure),
    }


def _trace(bus: Bus, answer: Any) -> BusTrace:
    """Return the trace of which `_simulate` answered the parts."""
    values, rows = (
        np.asarray(answer["values"], dtype=float),
        np.array(answer["rows"], dtype=np.int64),
    )
    flags = np.asarray(answer["flags"], dtype=float).reshape(len(rows), len(bus.flags))
    if (
        values.ndim != 2
        or values.shape[1] != len(bus.record)
        or not 1 <= len(values) <= bus.steps + 1
    ):
        raise ValueError(values.shape)
    failure = answer["failure"]
    if failure is not None:
        failure = Failure(str(failure[0]), float(failure[1]), str(failure[2]))
    return BusTrace(bus.record, values, bus.h, Readings(bus.flags, rows, flags), failure, bus.start)
