"""A scenario that is checked against its FMUs and its record, ready to run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from bristle.common.errors import suggest
from bristle.fmus.host import Fmu
from bristle.harness.cosim.bus import Bus, BusTrace
from bristle.harness.cosim.isolate import run_bus
from bristle.harness.metrics.batch import Batch
from bristle.harness.metrics.checks import STATES, check_quantities
from bristle.harness.metrics.validation import (
    BASELINES,
    lean_fmus,
)
from bristle.harness.scenario.parts import Kind
from bristle.harness.scenario.plan import RunSetup, identification, prepare
from bristle.harness.scenario.plan import validation as validation_bus
from bristle.harness.scenario.reading import Loaded

Progress = Callable[[str, int, int], None]  # stage, done, total (0: not known)
Simulate = Callable[[Bus, Callable[[int], None] | None, float | None], BusTrace]  # as `run_bus`
ESTIMATED = ("estimates", "states")  # parts that depend on what the observer estimates


@dataclass(frozen=True)
class RunOptions:
    """How to run a scenario."""

    fmi: int = 2
    kind: Kind = "native"
    overrides: Sequence[str] = ()
    seed: int | None = None
    full: bool = False
    timeout: float | None = None  # s that a simulation may take where an FMU comes from elsewhere
    batch: Batch | None = None  # estimate from a whole record that stands beside the observer's


@dataclass
class Clock:
    """Seconds spent in each stage of a run."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin


@dataclass
class Checked:
    """A scenario that is read and checked against its FMUs and its record, and the output folder it
    is run into.
    """

    setup: RunSetup
    out: Path
    options: RunOptions
    bus: Bus
    lean: Mapping[str, Fmu]
    clock: Clock
    simulate: Simulate = run_bus


def check_loaded(
    loaded: Loaded, fmus: dict[str, Fmu], out: Path, options: RunOptions, clock: Clock | None = None
) -> Checked:
    """Check a scenario against its FMUs; errors as of `check`."""
    setup = replace(prepare(loaded, fmus), timeout=options.timeout)
    lean = {}
    if setup.scenario.validation is not None:
        lean = lean_fmus()
        validation_bus(setup)
    _check_quantities(setup)
    return Checked(setup, out, options, identification(setup), lean, clock or Clock())


def _check_quantities(setup: RunSetup) -> None:
    """Refuse a check of a number that no result has, or not that of this scenario."""
    observer, scenario = setup.fmus["observer"], setup.scenario
    hats = [name.removesuffix("_hat") for name in observer.names("output") if name.endswith("_hat")]
    known = check_quantities(
        [name for name in hats if observer.has(f"{name}_valid", "output")], list(BASELINES)
    )
    absent = [
        f"[{part}]" for part in ("validation", "record", "plant") if getattr(scenario, part) is None
    ]
    absent += ["compensation"] if scenario.controller.compensation == "none" else []
    for i, demand in enumerate(scenario.checks):
        part, key = demand.quantity.partition(".")[0], f"checks[{i}].quantity"
        needed = {"tracking": "compensation", "behaviour": "[plant]"}.get(part, f"[{part}]")
        if needed in absent:
            raise setup.loaded.error(
                key, demand.quantity, f"the scenario has no {needed}; add it or remove the check"
            )
        if demand.quantity not in known:
            what = f"no number of the result{suggest(demand.quantity, known)}"
            raise setup.loaded.error(
                key,
                demand.quantity,
                f"{what}; choose one of the check quantities in the scenario reference",
            )


def check_estimated(setup: RunSetup) -> None:
    """Refuse a check of what the method does not estimate; an FMU from elsewhere shows it later."""
    from bristle.fmus.build import estimated

    observer, method = setup.fmus["observer"], setup.scenario.observer.method
    if observer.foreign or method is None:
        return
    # the checks that name an estimate, and what the method gives
    named = {
        i: each.quantity
        for i, each in enumerate(setup.scenario.checks)
        if each.quantity.split(".")[0] in ESTIMATED
    }
    known = estimated(method) if named else []
    for i, quantity in named.items():
        part, name, _ = quantity.split(".")
        if name not in known:
            kind = (
                STATES
                if part == "states"
                else [each for each in known if observer.has(f"{each}_valid", "output")]
            )
            others = [each for each in known if each in kind]
            advice = (
                f"it estimates {', '.join(others) or 'none'}: check one of these, or choose another"
                " method"
            )
            raise setup.loaded.error(
                f"checks[{i}].quantity",
                quantity,
                f"the method {method} does not estimate {name}; {advice}",
            )


def no_progress(_stage: str, _done: int, _total: int) -> None:
    """Tell nobody how far a run is."""
