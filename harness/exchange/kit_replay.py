"""The replay of a package: run as it says, and compared with the references that came with it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bristle.common import pages
from bristle.common.errors import suggest
from bristle.common.output import output_folder, to_json
from bristle.common.provenance import provenance
from bristle.common.work import TemporaryFolder
from bristle.fmus.host import Fmu
from bristle.harness.cosim.bus import Bus, BusTrace, BusUnit, Port
from bristle.harness.cosim.isolate import simulate_isolated
from bristle.harness.exchange.kit import REFERENCE_SIGNALS, REPLAY_TOLERANCE, VERDICT, signals_csv
from bristle.harness.exchange.replay import (
    STEPS_BY_DEFAULT,
    SignalAgreement,
    agreement,
    held,
    number_of_steps,
    rows_of,
    verdict_of,
)
from bristle.harness.exchange.ssp import (
    CSV_TYPE,
    Component,
    SystemPackage,
)
from bristle.harness.run import results


@dataclass(frozen=True)
class ReplayedPackage:
    """A replayed package: its signals against the reference, if any, and where the results are."""

    folder: Path
    agreement: tuple[SignalAgreement, ...]
    failure: str = ""
    compared: bool = True

    @property
    def verdict(self) -> str:
        """As of `verdict_of`."""
        return verdict_of(self.failure, self.compared, self.agreement)

    @property
    def passed(self) -> bool:
        """Whether nothing failed."""
        return self.verdict != "fail"


def replay(
    path: Path,
    out: Path,
    timeout: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ReplayedPackage:
    """Run a package of any maker, compare it with the reference that it holds, and write `out/<its
    name>`.

    Parameters
    ----------
    path : Path
        The .ssp file.
    out : Path
        Folder of the results.
    timeout : float, optional
        Seconds that the simulation may take.
    progress : function, optional
        Called with the steps done and their number.

    Raises
    ------
    BristleError
        One line, if it cannot be run.
    """
    package = SystemPackage(path)
    with output_folder(out), TemporaryFolder("kit") as folder:
        results.refuse_strange(out / path.stem)
        bus = _replay_bus(package, Path(folder))
        trace = simulate_isolated(
            bus,
            None if progress is None else lambda done: progress(done, bus.steps),
            timeout=timeout,
        )
        compared = REFERENCE_SIGNALS in package.names
        agreement = _agreement(package, trace) if compared else ()
        failure = (
            ""
            if trace.failure is None
            else (
                f"{trace.failure.unit} stopped at {trace.failure.time:g} s: {trace.failure.message}"
            )
        )
        replayed = ReplayedPackage(out / path.stem, agreement, failure, compared)
        results.write(out, path.stem, _replay_files(package, replayed, trace))
    return replayed


def _replay_bus(package: SystemPackage, folder: Path) -> Bus:
    system = package.system
    fmus = {
        each.name: _unpacked(package, each, folder)
        for each in system.components
        if each.type != CSV_TYPE
    }
    if not fmus:
        raise package.mistake("has no FMU")
    # when the outputs are read
    step, stop = _times(package, fmus)
    with package.named():
        steps = number_of_steps(system.start, stop, step)
    at = np.asarray(system.start + step * np.arange(steps), dtype=np.float64)
    # connections lead from one FMU to another, or from a table to an FMU
    links, series = [], {}
    tables = {
        each.name: package.columns(each.source)
        for each in system.components
        if each.type == CSV_TYPE
    }
    for source, target in system.connections:
        _check_port(package, fmus, target, "input")
        if source[0] in tables:
            time, columns = tables[source[0]]
            if source[1] not in columns:
                raise package.mistake(
                    f"{source[0]} has no column '{source[1]}'{suggest(source[1], list(columns))}"
                )
            series[target] = held(time, columns[source[1]], at, step)
        else:
            _check_port(package, fmus, source, "output")
            links.append((source, target))
    # all FMUs with their start values; every Real output is recorded
    instances = tuple(
        BusUnit(each.name, fmus[each.name], dict(each.values))
        for each in system.components
        if each.name in fmus
    )
    record = tuple(
        (name, each)
        for name, fmu in fmus.items()
        for each in fmu.names("output")
        if fmu.is_real(each)
    )
    return Bus(
        instances, steps, step, links=tuple(links), series=series, record=record, start=system.start
    )


def _unpacked(package: SystemPackage, component: Component, folder: Path) -> Fmu:
    own = folder / component.name.replace("/", "_").replace("\\", "_")
    own.mkdir()
    fmu = Fmu(package.unpack(component.source, own), True)
    for name in component.values:
        if not fmu.has(name, "parameter"):
            known = fmu.names("parameter")
            raise package.mistake(
                f"component '{component.name}' has no parameter '{name}'{suggest(name, known)}"
            )
    return fmu


def _times(package: SystemPackage, fmus: Mapping[str, Fmu]) -> tuple[float, float]:
    """Return step and stop time: what the package says, else what the FMUs say."""
    experiments = [each.description.defaultExperiment for each in fmus.values()]
    steps = [float(each.stepSize) for each in experiments if each is not None and each.stepSize]
    stops = [float(each.stopTime) for each in experiments if each is not None and each.stopTime]
    stop = package.system.stop if package.system.stop is not None else max(stops, default=None)
    if stop is None:
        raise package.mistake(
            "says no stop time, and nor do its FMUs; add a DefaultExperiment with stopTime"
        )
    usual = min(steps, default=(stop - package.system.start) / STEPS_BY_DEFAULT)
    step = usual if package.system.step is None else package.system.step
    return step, stop


def _check_port(
    package: SystemPackage, fmus: Mapping[str, Fmu], port: Port, causality: str
) -> None:
    unit, name = port
    if unit not in fmus or not fmus[unit].has(name, causality) or not fmus[unit].is_real(name):
        known = suggest(name, fmus[unit].names(causality)) if unit in fmus else ""
        raise package.mistake(
            f"a connection needs the Real {causality} {unit}.{name}, which does not exist{known}"
        )


def _agreement(package: SystemPackage, trace: BusTrace) -> tuple[SignalAgreement, ...]:
    """Compare the signals with the reference."""
    signals = {f"{unit}.{name}": trace[unit, name] for unit, name in trace.record}
    return agreement(package.columns(REFERENCE_SIGNALS), trace.time, signals, REPLAY_TOLERANCE)


def _replay_files(
    package: SystemPackage, replayed: ReplayedPackage, trace: BusTrace
) -> dict[str, str | bytes]:
    recorded = _recorded(package)
    tree = {
        "package": package.path.name,
        "verdict": replayed.verdict,
        "failure": replayed.failure,
        "signals": rows_of(replayed.agreement),
    }
    made = provenance()
    content = to_json({**tree, "recorded": recorded, "provenance": made})
    return {
        "result.json": content,
        "signals.csv": signals_csv(trace),
        "report.html": pages.render(
            "bristle.harness.exchange/replay.html",
            package=package.path.name,
            replayed=replayed,
            made=made,
        ),
    }


def _recorded(package: SystemPackage) -> Any:
    """Return the verdict that a package holds, None if it holds none."""
    if VERDICT not in package.names:
        return None
    try:
        return json.loads(package.read(VERDICT))
    except ValueError as error:
        raise package.mistake(f"{VERDICT}: no JSON ({error}); export it again") from None
