"""A scenario as one file for another lab: SSP with its FMUs, reference signals and verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bristle.common import pages
from bristle.common.errors import BristleError
from bristle.common.output import output_folder, replace_files, to_json
from bristle.common.signals import table_text
from bristle.common.work import TemporaryFolder
from bristle.fmus.host import Fmu, Value
from bristle.fmus.pack import archive_bytes
from bristle.fmus.related import Experiment, related_files
from bristle.harness.cosim.bus import Bus, BusTrace, BusUnit
from bristle.harness.exchange.archive import Archive
from bristle.harness.exchange.replay import signals_text
from bristle.harness.exchange.ssp import (
    CSV_TYPE,
    FMU_TYPE,
    Component,
    SystemStructure,
    package_files,
)
from bristle.harness.run.checked import Checked, RunOptions
from bristle.harness.run.outcome import Outcome, outcome
from bristle.harness.run.run import build_and_check
from bristle.harness.scenario.plan import RunSetup

REFERENCE_SIGNALS = "resources/reference/signals.csv"
VERDICT = "resources/reference/verdict.json"
STIMULI = "stimuli"
OWN_REFERENCES = (Path(REFERENCE_SIGNALS).name, Path(VERDICT).name)
# of a run that an FMU holds: inputs at each step, outputs at some
MOST_STEPS_INSIDE, MOST_ROWS_INSIDE = 5000, 250
# of the range of a signal: most that a replay may differ from the reference
REPLAY_TOLERANCE = 1e-9


def export(
    path: Path, out: Path, options: RunOptions | None = None, platforms: str = "host"
) -> Path:
    """Write a scenario as `out/<scenario>.ssp`, with fmus/, reference/ and README.md beside it;
    return the package.

    Parameters
    ----------
    path : Path
        The scenario file.
    out : Path
        The folder.
    options : RunOptions, optional
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
            reference = _reference(replace(checked, bus=bus))
            files = {
                f"{unit}.fmu": _with_experiments(file, unit, bus, setup, reference)
                for unit, file in fmus.items()
            }
        # the package, and the same files beside it
        system, content = _system(setup, bus), _content(setup, reference)
        resources = {f"resources/{file}": data for file, data in files.items()} | content
        written = {
            f"{name}.ssp": archive_bytes(package_files(system) | resources),
            "README.md": _readme(system).encode(),
        }
        written |= {f"fmus/{file}": data for file, data in files.items()}
        written |= {file.removeprefix("resources/"): data for file, data in content.items()}
        replace_files(out, written, list(written))
    return out / f"{name}.ssp"


def _check_exportable(setup: RunSetup) -> None:
    """Refuse what no importer could repeat from the package."""
    if setup.samples is not None:
        message = "a measured record is no co-simulation; export a scenario with a [plant]"
        raise setup.loaded.error("record", None, message)
    if setup.scenario.controller.compensation != "none":
        message = "estimates that reach the controller are not exported; write none"
        raise setup.loaded.error("controller.compensation", None, message)


def _reference(checked: Checked) -> Outcome:
    """Run a scenario as the reference of its package, for which it must reach its end."""
    reference = outcome(checked)
    if (failure := reference.view.trace.failure) is not None:
        raise BristleError(
            f"{checked.setup.loaded.path}: the run ends at {failure.time:g} s: {failure.message};"
            " export one that ends well"
        )
    return reference


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


def _own_fmu(setup: RunSetup, name: str, folder: Path, platforms: str) -> Path:
    """Return the FMU of a unit with the scenario's start values; one from elsewhere as it is."""
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


def _with_experiments(
    file: Path, name: str, bus: Bus, setup: RunSetup, reference: Outcome
) -> bytes:
    """Return an FMU of ours with its part of the run inside; one from elsewhere as it is."""
    if name in setup.fmus and setup.fmus[name].foreign:
        return file.read_bytes()
    archive = Archive(file)
    content = {each: archive.read(each) for each in archive.names}
    experiments = (
        [_part_of_run(name, bus, setup, reference.view.trace)] if name in setup.fmus else []
    )
    about = {key: reference.result[key] for key in ("scenario", "verdict", "checks", "estimates")}
    return archive_bytes(
        {
            **content,
            **related_files(content, experiments, report={"verdict.json": to_json(about).encode()}),
        }
    )


def _part_of_run(name: str, bus: Bus, setup: RunSetup, trace: BusTrace) -> Experiment:
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


def _tabulated(setup: RunSetup) -> bool:
    """True if an input is noise, which only a table gives; few tools take one for a component."""
    return any(each.noise is not None for each in setup.stimuli)


def _source_fmu(setup: RunSetup, folder: Path, platforms: str) -> Path:
    """Return an FMU of the stimuli."""
    from bristle.fmus.source import Source, build_source

    sources = []
    for each in setup.stimuli:
        points = tuple((step * setup.h, value) for step, value in each.points)
        sine = (
            None
            if each.sine is None
            else (each.sine[1], each.sine[0].frequency, each.sine[0].phase)
        )
        sources.append(
            Source(
                each.variable, setup.fmus[each.unit].unit(each.variable), each.start, points, sine
            )
        )
    return build_source(sources, setup.h, folder / f"{STIMULI}.fmu", platforms=platforms)


def _numbers(setup: RunSetup, name: str) -> dict[str, float]:
    """Return the values of a unit's parameters."""
    return {key: float(value) for key, value in setup.values[name].items()}


def _bus_of(bus: Bus, fmus: Mapping[str, Path]) -> Bus:
    """Return the bus with the FMUs of the kit; our own need no values."""
    instances = (
        BusUnit(
            each.name,
            Fmu(fmus[each.name], each.fmu.foreign),
            each.values if each.fmu.foreign else {},
        )
        for each in bus.instances
    )
    return replace(bus, instances=tuple(instances))


def _system(setup: RunSetup, bus: Bus) -> SystemStructure:
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


def _content(setup: RunSetup, reference: Outcome) -> dict[str, bytes]:
    """Return reference signals, verdict and stimuli."""
    about = {key: reference.result[key] for key in ("scenario", "verdict", "checks", "estimates")}
    # command and folder name folders of this machine
    made = {
        key: each
        for key, each in reference.result["provenance"].items()
        if key not in {"command", "folder"}
    }
    about |= {"provenance": made}
    files = {
        REFERENCE_SIGNALS: signals_csv(reference.view.trace).encode(),
        VERDICT: to_json(about).encode(),
    }
    if _tabulated(setup):
        time = np.asarray(setup.h * np.arange(setup.steps), dtype=np.float64)
        columns = {each.variable: each.values(setup.steps, setup.h) for each in setup.stimuli}
        files[f"resources/{STIMULI}.csv"] = table_text({"time": time, **columns}).encode()
    return files


def signals_csv(trace: BusTrace) -> str:
    """Return all that was recorded as text, by unit and variable."""
    return signals_text(trace, [f"{unit}.{name}" for unit, name in trace.record])
