"""A scenario run again as another machine would: start values rounded otherwise, other compilers,
other internal steps.
"""

from __future__ import annotations

import os
import platform
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bristle.common.errors import BristleError
from bristle.common.signals import Array
from bristle.fmus.host import Fmu, Value
from bristle.harness.cosim.bus import Bus
from bristle.harness.cosim.isolate import run_bus
from bristle.harness.cosim.ports import PORTS
from bristle.harness.run.outcome import measured
from bristle.harness.run.view import RunView
from bristle.harness.scenario.plan import RunSetup, identification, prepare
from bristle.model.compiler import Toolchain, compiled_with, find_compiler, known_compilers

ROUNDED_RUNS = 8  # runs in which start values are moved by one unit in the last place
STEP_FACTORS = (0.5, 2.0)  # of the tolerances and steps of the plant's integrator
STEP_PARAMETERS = ("solver.tolerance", "solver.friction_step")
# beginnings of names that are not moved: what they change is no rounding
UNMOVED = ("sample_time", "solver.")
# flag with which a compiler may reorder sums and multiply by reciprocals
REORDERED = ("-funsafe-math-optimizations",)
CPU_FLAGS = Path("/proc/cpuinfo")


@dataclass(frozen=True)
class RepeatedRun:
    """A repeated run: signals at full rate by name, and its result."""

    signals: Mapping[str, Array]
    result: Mapping[str, Any]


@dataclass(frozen=True)
class Repeat:
    """A way to run a scenario again: what changes, in words, and the run itself."""

    name: str
    run: Callable[[], RepeatedRun]


def repeats(setup: RunSetup) -> list[Repeat]:
    """Return all ways to run a scenario again that this machine has."""
    rounded = [
        Repeat(f"start values rounded otherwise, {k}", partial(run_rounded, setup, k))
        for k in range(1, ROUNDED_RUNS + 1)
    ]
    built = (
        [Repeat(each.name, partial(run_built, setup, each)) for each in toolchains()]
        if _compiled(setup)
        else []
    )
    return [*rounded, *built, *_other_steps(setup)]


def run_again(setup: RunSetup, bus: Bus | None = None) -> RepeatedRun:
    """Run a scenario, or a bus of it, to its end.

    Raises
    ------
    BristleError
        If it ends early.
    """
    trace = run_bus(bus or identification(setup), timeout=setup.timeout)
    if trace.failure is not None:
        failure = trace.failure
        raise BristleError(
            f"{setup.loaded.path}: the run ends at {failure.time:g} s: {failure.unit}:"
            f" {failure.message}"
        )
    view = RunView(setup, trace)
    return RepeatedRun(view.columns(), measured(setup, trace, view))


# -- rounding --------------------------------------------------------------------------------------


def run_rounded(setup: RunSetup, seed: int) -> RepeatedRun:
    """Run with all start values, and the samples of a record, one unit in the last place up or
    down, as `seed` chooses.
    """
    random = np.random.default_rng(seed)
    values = {
        unit: {**given, **_moved(setup, unit, random)} for unit, given in setup.values.items()
    }
    bus = identification(replace(setup, values=values))
    if setup.samples is not None:
        series = {
            port: np.nextafter(x, random.choice([-np.inf, np.inf], len(x)))
            for port, x in bus.series.items()
        }
        bus = replace(bus, series=series)
    return run_again(setup, bus)


def _moved(setup: RunSetup, unit: str, random: np.random.Generator) -> dict[str, Value]:
    """Return the start values of a unit that are not 0, moved by one unit in the last place where
    their interval has room.
    """
    fmu, given = setup.fmus[unit], setup.values[unit]
    starts: dict[str, Value] = {}
    for name in fmu.names("parameter"):
        if not _is_moved(setup, unit, name):
            continue
        value = float(given.get(name, fmu.start(name)))
        low, high = fmu.interval(name)
        moved = float(np.nextafter(value, random.choice([-np.inf, np.inf])))
        if value and low <= moved <= high:
            starts[name] = moved
    return starts


def _is_moved(setup: RunSetup, unit: str, name: str) -> bool:
    """Say whether a parameter is a number that the chosen law, effects or method read."""
    fmu, whole = setup.fmus[unit], PORTS[unit].whole
    if (
        not fmu.is_real(name)
        or name in whole
        or name.startswith(UNMOVED)
        or fmu.variables[name].start is None
    ):
        return False
    part = getattr(setup.scenario, unit)
    selector = PORTS[unit].selector
    others = set(fmu.choices(selector)) - {getattr(part, selector, None)}
    return name.partition(".")[0] not in others


# -- compilers -------------------------------------------------------------------------------------


def _compiled(setup: RunSetup) -> bool:
    """Say whether an FMU takes part that this machine compiles."""
    return any(not fmu.risky for fmu in setup.fmus.values())


def toolchains() -> list[Toolchain]:
    """Return other flags for the machine's compiler, and the other compilers that it has, with and
    without these flags.
    """
    default = find_compiler()
    same = os.path.realpath(shutil.which(default[0]) or default[0])
    others = [
        Toolchain("without optimisation", default, ("-O0",)),
        *_rounding_otherwise("", default),
    ]
    for name, command in known_compilers().items():
        if command != default and os.path.realpath(command[0]) != same:
            others += [Toolchain(name, command), *_rounding_otherwise(f"{name}, ", command)]
    return others


def _rounding_otherwise(name: str, command: tuple[str, ...]) -> list[Toolchain]:
    """Return toolchains that keep the equations and round otherwise: sums in another order,
    products fused with sums.
    """
    others = [Toolchain(f"{name}sums in another order", command, REORDERED)]
    if flags := fused_flags():
        others.append(Toolchain(f"{name}fused multiplication and addition", command, flags))
    return others


def fused_flags() -> tuple[str, ...]:
    """Return the flags that fuse multiplications and additions; none if the processor cannot."""
    if platform.machine().lower() in ("aarch64", "arm64"):
        return ("-ffp-contract=fast",)
    known = CPU_FLAGS.exists() and " fma " in CPU_FLAGS.read_text(encoding="utf-8")
    return ("-ffp-contract=fast", "-mfma") if known else ()


def run_built(setup: RunSetup, toolchain: Toolchain) -> RepeatedRun:
    """Run with FMUs that a toolchain compiles, each of the chosen law or method alone: the same
    equations, sooner compiled.
    """
    return run_again(built(setup, toolchain))


def built(setup: RunSetup, toolchain: Toolchain) -> RunSetup:
    """Return a scenario on FMUs that a toolchain compiles."""
    from bristle.fmus import obtain

    fmus = dict(setup.fmus)
    with compiled_with(toolchain):
        for unit, fmu in setup.fmus.items():
            if not fmu.risky:
                part = getattr(setup.scenario, unit)
                selector = PORTS[unit].selector
                choice = {selector: getattr(part, selector)} if selector else {}
                effects = {"effects": part.effects} if unit == "plant" else {}
                fmus[unit] = Fmu(obtain(unit, fmi=fmu.fmi, **choice, **effects))
    return replace(prepare(setup.loaded, fmus), timeout=setup.timeout)


# -- internal steps --------------------------------------------------------------------------------


def _other_steps(setup: RunSetup) -> list[Repeat]:
    """Return the runs with other internal steps of the plant, where it has such parameters."""
    plant = setup.fmus.get("plant")
    known = [name for name in STEP_PARAMETERS if plant is not None and plant.has(name, "parameter")]
    if plant is None or not known:
        return []
    repeated = []
    for factor in STEP_FACTORS:
        steps = {
            name: float(np.clip(factor * _given(setup, name), *plant.interval(name)))
            for name in known
        }
        other = replace(setup, values={**setup.values, "plant": {**setup.values["plant"], **steps}})
        repeated.append(
            Repeat(
                f"internal steps and their tolerance times {factor:g}", partial(run_again, other)
            )
        )
    return repeated


def _given(setup: RunSetup, name: str) -> float:
    return float(setup.values["plant"].get(name, setup.fmus["plant"].start(name)))
