"""A scenario as one file for another lab (SSP with its FMUs, reference signals and verdict), and
the replay of such files.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bristle.common import pages
from bristle.common.errors import BristleError, suggest
from bristle.common.output import output_folder, replace_files, to_json
from bristle.common.provenance import provenance
from bristle.common.signals import table_text
from bristle.common.work import TemporaryFolder
from bristle.fmus.host import Fmu, Value
from bristle.fmus.pack import archive_bytes
from bristle.fmus.related import Experiment, related_files
from bristle.harness.cosim.bus import Bus, Instance, Port, Trace
from bristle.harness.cosim.isolate import simulate_isolated
from bristle.harness.exchange.archive import Archive
from bristle.harness.exchange.replay import (
    STEPS_BY_DEFAULT,
    Agreement,
    agreement,
    held,
    number_of_steps,
    rows_of,
    signals_text,
    verdict_of,
)
from bristle.harness.exchange.ssp import (
    CSV_TYPE,
    FMU_TYPE,
    Component,
    Package,
    SystemStructure,
    package_files,
)
from bristle.harness.run import results
from bristle.harness.run.checked import Checked, Options
from bristle.harness.run.outcome import Outcome, outcome
from bristle.harness.run.run import build_and_check
from bristle.harness.scenario.plan import Setup

REFERENCE_SIGNALS = "resources/reference/signals.csv"
VERDICT = "resources/reference/verdict.json"
STIMULI = "stimuli"
OWN_REFERENCES = (Path(REFERENCE_SIGNALS).name, Path(VERDICT).name)
# of a run that an FMU holds: inputs at each step, outputs at some
MOST_STEPS_INSIDE, MOST_ROWS_INSIDE = 5000, 250
# of the range of a signal: most that a replay may differ from the reference
REPLAY_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Replayed:
    """A replayed package: its signals against the reference, if it has one, and where the results
    are.
    """

    folder: Path
    agreement: tuple[Agreement, ...]
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


# -- export ----------------------------------------------------------------------------------------
def export(path: Path, out: Path, options: Options | None = None, platforms: str = "host") -> Path:
    """Write a scenario as `out/<scenario>.ssp`, with fmus/, reference/ and README.md beside it;
    return the package.

    Parameters
    ----------
    path : Path
        The scenario file.
    out : Path
        The folder.
    options : Options, optional
        As of `bristle.run`.
    platforms : str
        What the FMUs are compiled for, as of `bristle.build`.

    Raises
    ------
    BristleError
        One line; nothing is written then.
    """
    with output_folder(out):
        checked = build_and_check(path, out, options)
        setup, name = checked.setup, checked.setup.loaded.name
        _refuse_other(out, name)
        _check_exportable(setup)
        with TemporaryFolder("kit") as folder:
            # the FMUs as they are exported, the run of exactly these, and its references in them
            fmus = {unit: _own_fmu(setup, unit, Path(folder), platforms) for unit in setup.fmus}
            if setup.stimuli and not _tabulated(setup):
                fmus[STIMULI] = _source_fmu(setup, Path(folder), platforms)
            bus = _bus_of(checked.bus, fmus)
            found = _reference(replace(checked, bus=bus))
            files = {
                f"{unit}.fmu": _with_experiments(file, unit, bus, setup, found)
                for unit, file in fmus.items()
            }
        # the package, and the same files beside it
        system, content = _system(setup, bus), _content(setup, found)
        resources = {f"resources/{file}": data for file, data in files.items()} | content
        written = {
            f"{name}.ssp": archive_bytes(package_files(system) | resources),
            "README.md": _readme(system).encode(),
        }
        written |= {f"fmus/{file}": data for file, data in files.items()}
        written |= {file.removeprefix("resources/"): data for file, data in content.items()}
        replace_files(out, written, list(written))
    return out / f"{name}.ssp"


def _check_exportable(setup: Setup) -> None:
    """Refuse what no importer could repeat from the package."""
    if setup.samples is not None:
        message = "a measured record is no co-simulation; export a scenario with a [plant]"
        raise setup.loaded.error("record", None, message)
    if setup.scenario.controller.compensation != "none":
        message = "estimates that reach the controller are not exported; write none"
        raise setup.loaded.error("controller.compensation", None, message)


def _reference(checked: Checked) -> Outcome:
    """Run a scenario as the reference of its package, for which it must reach its end."""
    found = outcome(checked)
    if (failure := found.view.trace.failure) is not None:
        raise BristleError(
            f"{checked.setup.loaded.path}: the run ends at {failure.time:g} s: {failure.message};"
            " export one that ends well"
        )
    return found


def _refuse_other(out: Path, name: str) -> None:
    """Refuse a folder that holds anything but an earlier export of the same scenario, all files of
    which are replaced.
    """
    inside = list(out.iterdir()) if out.is_dir() else []
    kinds = {
        f"{name}.ssp": Path.is_file,
        "README.md": Path.is_file,
        "fmus": Path.is_dir,
        "reference": Path.is_dir,
    }
    known = {*kinds, f"{STIMULI}.csv"}
    files = [
        each
        for folder in ("fmus", "reference")
        if (out / folder).is_dir()
        for each in (out / folder).iterdir()
    ]
    ours = all(each.name in known for each in inside) and all(
        right(out / each) for each, right in kinds.items()
    )
    ours = ours and all(
        each.is_file() and (each.suffix == ".fmu" or each.name in OWN_REFERENCES) for each in files
    )
    if inside and not ours:
        raise BristleError(
            f"{out}: holds other files than an export of '{name}'; choose an empty folder"
        )


def _own_fmu(setup: Setup, name: str, folder: Path, platforms: str) -> Path:
    """Return the FMU of a unit with the scenario's parameters as start values; one from elsewhere
    as it is.
    """
    from bristle.fmus.build import build, nothing

    fmu, target = setup.fmus[name], folder / f"{name}.fmu"
    if fmu.foreign:
        target.write_bytes(fmu.path.read_bytes())
        return target
    scenario = setup.scenario
    plant, method = scenario.plant, scenario.observer.method
    chosen: dict[str, Any] = (
        {"law": plant.law, "effects": plant.effects} if name == "plant" and plant else {}
    )
    chosen |= {"method": method} if name == "observer" else {}
    version = int(str(fmu.description.fmiVersion)[0])
    return build(
        name,
        target,
        fmi=version,
        kind=fmu.kind,
        parameters=_numbers(setup, name),
        platforms=platforms,
        related=nothing,
        **chosen,
    )


def _with_experiments(file: Path, name: str, bus: Bus, setup: Setup, found: Outcome) -> bytes:
    """Return an FMU of ours with its part of the run as an experiment inside; one from elsewhere as
    it is.
    """
    if name in setup.fmus and setup.fmus[name].foreign:
        return file.read_bytes()
    archive = Archive(file)
    content = {each: archive.read(each) for each in archive.names}
    experiments = [_part_of_run(name, bus, setup, found.view.trace)] if name in setup.fmus else []
    about = {key: found.result[key] for key in ("scenario", "verdict", "checks", "estimates")}
    return archive_bytes(
        {
            **content,
            **related_files(content, experiments, report={"verdict.json": to_json(about).encode()}),
        }
    )


def _part_of_run(name: str, bus: Bus, setup: Setup, trace: Trace) -> Experiment:
    """Return what a unit got and gave in the first steps of the run."""
    steps = min(bus.steps, MOST_STEPS_INSIDE)
    given = {port: each.values(bus.steps, bus.h) for each in setup.stimuli for port in each.ports}
    given |= {target: trace[source] for source, target in bus.links}
    rows = np.arange(0, steps + 1, max(1, steps // MOST_ROWS_INSIDE))
    outputs = {
        variable: trace[unit, variable][rows] for unit, variable in trace.record if unit == name
    }
    about = (
        f"the first {steps * bus.h:g} s of scenario {setup.loaded.name}, with the inputs that it"
        " got there"
    )
    stimuli = {
        variable: values[:steps] for (unit, variable), values in given.items() if unit == name
    }
    return Experiment(
        "validation",
        about,
        bus.h,
        steps,
        stimuli,
        {"time": np.asarray(bus.h * rows, dtype=np.float64), **outputs},
    )


def _tabulated(setup: Setup) -> bool:
    """True if an input is noise, which only a table gives; many tools take no table for a
    component.
    """
    return any(each.noise is not None for each in setup.stimuli)


def _source_fmu(setup: Setup, folder: Path, platforms: str) -> Path:
    """Return an FMU of the stimuli."""
    from bristle.fmus.source import Source, build_source

    sources = []
    for each in setup.stimuli:
        levels = tuple((step * setup.h, level) for step, level in each.levels)
        sine = (
            None
            if each.sine is None
            else (each.sine[1], each.sine[0].frequency, each.sine[0].phase)
        )
        sources.append(
            Source(
                each.variable, setup.fmus[each.unit].unit(each.variable), each.start, levels, sine
            )
        )
    return build_source(sources, setup.h, folder / f"{STIMULI}.fmu", platforms=platforms)


def _numbers(setup: Setup, name: str) -> dict[str, float]:
    """Return the values of a unit's parameters."""
    return {key: float(value) for key, value in setup.values[name].items()}


def _bus_of(bus: Bus, fmus: Mapping[str, Path]) -> Bus:
    """Return the bus with the FMUs of the kit; our own need no values."""
    instances = (
        Instance(
            each.name,
            Fmu(fmus[each.name], each.fmu.foreign),
            each.values if each.fmu.foreign else {},
        )
        for each in bus.instances
    )
    return replace(bus, instances=tuple(instances))


def _system(setup: Setup, bus: Bus) -> SystemStructure:
    links = list(bus.links)
    components = []
    for each in bus.instances:
        values: dict[str, Value] = {**(each.values or _numbers(setup, each.name))}
        connectors = {name: "input" for name in each.fmu.names("input") if each.fmu.is_real(name)}
        connectors |= {
            name: "output" for name in each.fmu.names("output") if each.fmu.is_real(name)
        }
        connectors |= dict.fromkeys(values, "parameter")
        components.append(Component(each.name, f"resources/{each.name}.fmu", connectors, values))
    if setup.stimuli:
        names = {each.variable: "output" for each in setup.stimuli}
        suffix, kind = ("csv", CSV_TYPE) if _tabulated(setup) else ("fmu", FMU_TYPE)
        components.append(Component(STIMULI, f"resources/{STIMULI}.{suffix}", names, type=kind))
        links += [((STIMULI, each.variable), port) for each in setup.stimuli for port in each.ports]
    return SystemStructure(
        setup.loaded.name, tuple(components), tuple(links), setup.steps * setup.h, setup.h
    )


def _readme(system: SystemStructure) -> str:
    """Return one page for who receives the package."""
    stop, step = system.stop or 0.0, system.step or 0.0
    return pages.render(
        "bristle.harness.exchange/README.md",
        name=system.name,
        parts=[each.name for each in system.components if each.type != CSV_TYPE],
        tables=[Path(each.source).name for each in system.components if each.type == CSV_TYPE],
        connections=system.connections,
        tolerance=f"{REPLAY_TOLERANCE:g}",
        stop=f"{stop:g}",
        step=f"{step:g}",
        step_ns=round(step * 1e9),
        short=f"{min(stop, MOST_STEPS_INSIDE * step):g}",
        inside="UNPACKED/extra/org.fmi-standard.fmi-ls-ref/validation-stimuli.csv",
    )


def _content(setup: Setup, found: Outcome) -> dict[str, bytes]:
    """Return reference signals, verdict and stimuli."""
    about = {key: found.result[key] for key in ("scenario", "verdict", "checks", "estimates")}
    # command and folder name folders of this machine
    made = {
        key: each
        for key, each in found.result["provenance"].items()
        if key not in {"command", "folder"}
    }
    about |= {"provenance": made}
    files = {
        REFERENCE_SIGNALS: _signals(found.view.trace).encode(),
        VERDICT: to_json(about).encode(),
    }
    if _tabulated(setup):
        time = np.asarray(setup.h * np.arange(setup.steps), dtype=np.float64)
        columns = {each.variable: each.values(setup.steps, setup.h) for each in setup.stimuli}
        files[f"resources/{STIMULI}.csv"] = table_text({"time": time, **columns}).encode()
    return files


# -- replay ----------------------------------------------------------------------------------------
def replay(
    path: Path,
    out: Path,
    timeout: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Replayed:
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
    package = Package(path)
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
        found = Replayed(out / path.stem, agreement, failure, compared)
        results.write(out, path.stem, _replay_files(package, found, trace))
    return found


def _replay_bus(package: Package, folder: Path) -> Bus:
    system = package.system
    fmus = {
        each.name: _unpacked(package, each, folder)
        for each in system.components
        if each.type != CSV_TYPE
    }
    if not fmus:
        raise package.mistake("has no FMU")
    step, stop = _times(package, fmus)
    with package.named():
        steps = number_of_steps(system.start, stop, step)
    at = np.asarray(system.start + step * np.arange(steps), dtype=np.float64)
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
    instances = tuple(
        Instance(each.name, fmus[each.name], dict(each.values))
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


def _unpacked(package: Package, component: Component, folder: Path) -> Fmu:
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


def _times(package: Package, fmus: Mapping[str, Fmu]) -> tuple[float, float]:
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


def _check_port(package: Package, fmus: Mapping[str, Fmu], port: Port, causality: str) -> None:
    unit, name = port
    if unit not in fmus or not fmus[unit].has(name, causality) or not fmus[unit].is_real(name):
        known = suggest(name, fmus[unit].names(causality)) if unit in fmus else ""
        raise package.mistake(
            f"a connection needs the Real {causality} {unit}.{name}, which does not exist{known}"
        )


def _agreement(package: Package, trace: Trace) -> tuple[Agreement, ...]:
    """Compare the signals with the reference."""
    signals = {f"{unit}.{name}": trace[unit, name] for unit, name in trace.record}
    return agreement(package.columns(REFERENCE_SIGNALS), trace.time, signals, REPLAY_TOLERANCE)


def _signals(trace: Trace) -> str:
    return signals_text(trace, [f"{unit}.{name}" for unit, name in trace.record])


def _replay_files(package: Package, found: Replayed, trace: Trace) -> dict[str, str | bytes]:
    recorded = _recorded(package)
    tree = {
        "package": package.path.name,
        "verdict": found.verdict,
        "failure": found.failure,
        "signals": rows_of(found.agreement),
    }
    made = provenance()
    content = to_json({**tree, "recorded": recorded, "provenance": made})
    return {
        "result.json": content,
        "signals.csv": _signals(trace),
        "report.html": pages.render(
            "bristle.harness.exchange/replay.html",
            package=package.path.name,
            found=found,
            made=made,
        ),
    }


def _recorded(package: Package) -> Any:
    """Return the verdict that a package holds, None if it holds none."""
    if VERDICT not in package.names:
        return None
    try:
        return json.loads(package.read(VERDICT))
    except ValueError as error:
        raise package.mistake(f"{VERDICT}: no JSON ({error}); export it again") from None
