"""Experiments that come with an FMU: run, and compared with the references that came with them.

An FMU holds them by FMI-LS-REF; files of the same format (.exp) may also lie beside it.

Source: lsref2026, experiments2026.
"""

from __future__ import annotations

import hashlib
import posixpath
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote, urlsplit
from xml.etree import ElementTree as ET

import numpy as np

from bristle.common import pages
from bristle.common.errors import BristleError, suggest
from bristle.common.files import check_regular
from bristle.common.output import output_folder, to_json
from bristle.common.parameter_set import Value, finite_number, parameter_values
from bristle.common.provenance import provenance
from bristle.common.signals import Array, signals_of
from bristle.fmus.host import Fmu
from bristle.fmus.related import FOLDER, MANIFEST, OWN_ANNOTATION, SUMS
from bristle.harness.cosim.bus import Bus, BusTrace, BusUnit, Port
from bristle.harness.cosim.isolate import simulate_isolated
from bristle.harness.exchange.archive import Archive, tree_of
from bristle.harness.exchange.replay import (
    STEPS_BY_DEFAULT,
    SignalAgreement,
    agreement,
    held,
    number_of_steps,
    rows_of,
    signals_text,
    verdict_of,
)
from bristle.harness.run import results

USUAL_TOLERANCE = 2e-3  # of the size of a signal, where an experiment says none (as csv-compare)
USUAL_SLACK = 1  # rows that a signal may be early or late where an experiment says no tolerance
NUMBERS = ("Real", "Float64", "Float32", "Boolean")  # types that can be compared
RESULTING = ("output", "local", "calculatedParameter")  # causalities of what a run gives

Read = Callable[[str], bytes]


@dataclass(frozen=True)
class FmuExperiment:
    """What a file says of an experiment; times in s, None: not said."""

    name: str
    source: str  # of the file
    start: float | None = None
    stop: float | None = None
    step: float | None = None
    values: Mapping[str, Value] = field(default_factory=dict)
    stimuli: tuple[Array, Mapping[str, Array]] | None = None
    reference: tuple[Array, Mapping[str, Array]] | None = None
    tolerance: float | None = None  # of this library's own annotation


@dataclass(frozen=True)
class RepeatedExperiment:
    """A repeated experiment."""

    experiment: FmuExperiment
    agreement: tuple[SignalAgreement, ...]
    trace: BusTrace
    # signals of the reference that are no numbers, or nothing that a run gives
    not_compared: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """As of `verdict_of`."""
        return verdict_of(self.trace.failure, self.experiment.reference is not None, self.agreement)

    @property
    def passed(self) -> bool:
        """Whether nothing failed."""
        return self.verdict != "fail"

    @property
    def summary(self) -> str:
        """What came out, in a few words."""
        if (failure := self.trace.failure) is not None:
            return f"stopped at {failure.time:g} s: {failure.message}"
        if self.experiment.reference is None:
            return "ran; there is no reference"
        held = sum(each.holds for each in self.agreement)
        rest = f", {len(self.not_compared)} not compared" if self.not_compared else ""
        if not self.agreement:
            return f"the reference holds nothing that a run gives{rest}"
        return f"{held} of {len(self.agreement)} signals agree with the reference{rest}"


@dataclass(frozen=True)
class ReplayedExperiments:
    """The experiments of an FMU, the files of it that do not have their checksum any more, and
    where the results are.
    """

    folder: Path
    experiments: tuple[RepeatedExperiment, ...]
    changed: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether all passed, and the FMU is as it was made."""
        return not self.changed and all(each.passed for each in self.experiments)


def repeat(
    fmu: Path,
    out: Path,
    source: Path | None = None,
    timeout: float | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> ReplayedExperiments:
    """Run the experiments of an FMU, and write `out/<name of the FMU or of the file>`.

    Parameters
    ----------
    fmu : Path
        The FMU, of any maker; it runs in a process of its own.
    out : Path
        Folder of the results.
    source : Path, optional
        A file of experiments; by default those inside the FMU.
    timeout : float, optional
        Seconds that each may take.
    progress : function, optional
        Called with the name of an experiment, the steps done and their number.

    Raises
    ------
    BristleError
        One line, if there are none, or one cannot be run.
    """
    target = out / (source or fmu).stem
    with output_folder(out):
        results.refuse_strange(target)
        archive, described = _Fmu(fmu), Fmu(fmu, foreign=True)
        experiments = list(_inside(archive) if source is None else _beside(source))
        done = [_repeated(described, each, timeout, progress) for each in experiments]
        replayed = ReplayedExperiments(target, tuple(done), _changed(archive))
        results.write(out, target.name, _files(fmu, replayed))
    return replayed


# -- reading ---------------------------------------------------------------------------------------
class _Fmu(Archive):
    suffix = ".fmu"


def _inside(archive: Archive) -> Iterator[FmuExperiment]:
    """Give the experiments that an FMU holds."""
    if MANIFEST not in archive.names:
        raise archive.mistake(
            f"holds no experiments ({MANIFEST}); give a file of experiments: bristle run FILE.exp"
            " --fmu FMU"
        )
    sources = [
        each.get("source", "")
        for each in archive.tree(MANIFEST).iter("Related")
        if each.get("role", "").split("/")[0] == "experiment"
    ]
    if not sources:
        raise archive.mistake(f"{MANIFEST} names no experiment")
    with archive.named():
        for source in sources:
            yield from _read(_resolved(MANIFEST, source), archive.read)


def _beside(path: Path) -> Iterator[FmuExperiment]:
    """Give the experiments of a file."""

    def read(name: str) -> bytes:
        try:
            if name.startswith("../"):
                raise BristleError(
                    f"{path}: '{name}' lies elsewhere; only files beside it are read"
                )
            check_regular(path.parent / name)
            return (path.parent / name).read_bytes()
        except OSError as error:
            raise BristleError(f"{path.parent / name}: {error.strerror}; check the path") from None

    yield from _read(path.name, read)


def _resolved(base: str, source: str) -> str:
    """Return the name of a file from what another one calls it."""
    if not source:
        raise BristleError(f"{base}: the source of a file is missing")
    if urlsplit(source).scheme or source.startswith("/"):
        raise BristleError(f"{base}: '{source}' lies elsewhere; only files beside it are read")
    return posixpath.normpath(posixpath.join(posixpath.dirname(base), unquote(source)))


def _read(name: str, read: Read) -> Iterator[FmuExperiment]:
    """Give the experiments of a file of an FMU or a folder."""
    root = tree_of(read(name), name)
    if root.tag != "Experiments" or root.find("Experiment") is None:
        raise BristleError(f"{name}: is no file of experiments (MA-HS-Experiments)")
    for element in root.findall("Experiment"):
        yield _experiment(element, name, read)


def _experiment(element: ET.Element, name: str, read: Read) -> FmuExperiment:
    about = element.find("TransientSimulation")
    kinds = [
        each.tag
        for each in element
        if each.tag not in ("Parameters", "Stimuli", "References", "Annotations")
    ]
    if about is None and kinds:
        raise BristleError(
            f"{name}: experiment '{element.get('name')}' is a {kinds[0]}; only TransientSimulation"
            " can be run"
        )
    # older files have the times on the experiment itself
    times = element if about is None else about
    given = {
        key: _number(times, key, name)
        for key in ("startTime", "stopTime", "stepSize")
        if times.get(key) is not None
    }
    sources = {
        key: _resolved(name, element.find(key).get("source", ""))  # type: ignore[union-attr]  # found just before
        for key in ("Parameters", "Stimuli", "References")
        if element.find(key) is not None
    }
    values = {}
    if (source := sources.get("Parameters")) is not None:
        values = dict(parameter_values(tree_of(read(source), source)))
    tables = {
        key: signals_of(read(source), source)
        for key, source in sources.items()
        if key != "Parameters"
    }
    own = element.find(f"Annotations/Annotation[@type='{OWN_ANNOTATION}']/Comparison")
    return FmuExperiment(
        element.get("name") or name,
        name,
        given.get("startTime"),
        given.get("stopTime"),
        given.get("stepSize"),
        values,
        tables.get("Stimuli"),
        tables.get("References"),
        None if own is None else _number(own, "tolerance", name),
    )


def _number(element: ET.Element, key: str, name: str) -> float:
    """Return an attribute as a number: `tolerance` above 0."""
    try:
        value = finite_number(element.get(key))
    except BristleError as error:
        raise BristleError(f"{name}: {key}: {error}") from None
    if key == "tolerance" and value <= 0:
        raise BristleError(f"{name}: {key} = {value:g} must be above 0")
    return value


def _changed(archive: Archive) -> tuple[str, ...]:
    """Return the files that the manifest names and are gone, and those without the checksum which
    the FMU holds of them.
    """
    if MANIFEST not in archive.names:
        return ()
    with archive.named():
        related = [
            _resolved(MANIFEST, each.get("source", ""))
            for each in archive.tree(MANIFEST).iter("Related")
            if not urlsplit(each.get("source", "")).scheme
        ]
    gone = [name for name in related if name not in archive.names]
    sums = (
        archive.read(f"{FOLDER}/{SUMS}").decode("utf-8", "replace")
        if f"{FOLDER}/{SUMS}" in archive.names
        else ""
    )
    listed = {
        name: digest
        for digest, _, name in (line.partition("  ") for line in sums.splitlines())
        if name
    }
    other = [
        name
        for name, digest in listed.items()
        if name not in archive.names or hashlib.sha256(archive.read(name)).hexdigest() != digest
    ]
    return tuple(dict.fromkeys([*gone, *other]))


# -- running ---------------------------------------------------------------------------------------
def _repeated(
    fmu: Fmu,
    experiment: FmuExperiment,
    timeout: float | None,
    progress: Callable[[str, int, int], None] | None,
) -> RepeatedExperiment:
    bus = _bus(fmu, experiment)
    tell = None if progress is None else lambda done: progress(experiment.name, done, bus.steps)
    trace = simulate_isolated(bus, tell, timeout=timeout)
    if experiment.reference is None or trace.failure is not None:
        return RepeatedExperiment(experiment, (), trace)
    time, columns = experiment.reference
    outside = tuple(
        name for name in columns if name in fmu.variables and not _comparable(fmu, name)
    )
    compared = {name: values for name, values in columns.items() if name not in outside}
    signals = {name: trace[unit, name] for unit, name in trace.record}
    limit, slack = (
        (USUAL_TOLERANCE, USUAL_SLACK)
        if experiment.tolerance is None
        else (experiment.tolerance, 0)
    )
    return RepeatedExperiment(
        experiment, agreement((time, compared), trace.time, signals, limit, slack), trace, outside
    )


def _comparable(fmu: Fmu, name: str) -> bool:
    variable = fmu.variables[name]
    return variable.type in NUMBERS and variable.causality in RESULTING


def _bus(fmu: Fmu, experiment: FmuExperiment) -> Bus:
    """Return the FMU alone with the inputs of an experiment."""
    start, step, steps = _times(fmu, experiment)
    for name in experiment.values:
        if not fmu.has(name, "parameter"):
            known = suggest(name, fmu.names("parameter"))
            raise BristleError(
                f"{experiment.source}: the FMU {fmu.path} has no parameter '{name}'{known}"
            )
    # the stimuli as they are held over each step
    unit, series = fmu.path.stem, {}
    time, columns = experiment.stimuli or (np.zeros(1), {})
    for name, values in columns.items():
        if not (fmu.has(name, "input") and fmu.variables[name].type in NUMBERS):
            known = suggest(name, fmu.names("input"))
            raise BristleError(
                f"{experiment.source}: the FMU {fmu.path} has no Real or Boolean input"
                f" '{name}'{known}"
            )
        series[unit, name] = _driven(
            fmu,
            name,
            time,
            values,
            np.asarray(start + step * np.arange(steps), dtype=np.float64),
            step,
        )
    # what the reference has, or all outputs
    recorded = experiment.reference[1] if experiment.reference else fmu.names("output")
    record: tuple[Port, ...] = tuple(
        (unit, name) for name in recorded if name in fmu.variables and _comparable(fmu, name)
    )
    return Bus(
        (BusUnit(unit, fmu, dict(experiment.values)),),
        steps,
        step,
        series=series,
        record=record,
        start=start,
    )


def _driven(fmu: Fmu, name: str, time: Array, values: Array, at: Array, step: float) -> Array:
    """Return an input at the start of each step: between two rows a line, of a discrete input the
    row before.
    """
    if fmu.variables[name].variability == "continuous" and fmu.is_real(name):
        return np.asarray(np.interp(at, time, values))
    return held(time, values, at, step)


def _times(fmu: Fmu, experiment: FmuExperiment) -> tuple[float, float, int]:
    """Return start, step and number of steps: the experiment's, the FMU's or the reference's."""
    usual, reference = fmu.description.defaultExperiment, experiment.reference
    said = {name: getattr(usual, name, None) for name in ("startTime", "stopTime", "stepSize")}
    start, stop, step = (
        given if given is not None else float(usual) if usual else None
        for given, usual in zip(
            (experiment.start, experiment.stop, experiment.step), said.values(), strict=True
        )
    )
    start = 0.0 if start is None else start
    if stop is None and reference is not None:
        stop = float(reference[0][-1])
    if stop is None:
        raise BristleError(
            f"{experiment.source}: experiment '{experiment.name}' says no stopTime, and nor does"
            " the FMU"
        )
    step = (stop - start) / STEPS_BY_DEFAULT if step is None else step
    try:
        return start, step, number_of_steps(start, stop, step)
    except BristleError as error:
        raise BristleError(f"{experiment.source}: experiment '{experiment.name}' {error}") from None


# -- results ---------------------------------------------------------------------------------------
def _files(fmu: Path, replayed: ReplayedExperiments) -> dict[str, str | bytes]:
    rows = [
        {
            "name": each.experiment.name,
            "verdict": each.verdict,
            "summary": each.summary,
            "signals": rows_of(each.agreement),
            "not_compared": list(each.not_compared),
        }
        for each in replayed.experiments
    ]
    verdict = "pass" if replayed.passed else "fail"
    about = {
        "fmu": fmu.name,
        "sha256": Fmu(fmu).sha256,
        "verdict": verdict,
        "experiments": rows,
        "changed": list(replayed.changed),
    }
    # the numbers, the signals of each experiment, and a page of both
    made = provenance()
    files: dict[str, str | bytes] = {"result.json": to_json({**about, "provenance": made})}
    for k, each in enumerate(replayed.experiments, 1):
        files[f"signals_{k}.csv"] = signals_text(
            each.trace, [name for _, name in each.trace.record]
        )
    page = pages.render(
        "bristle.harness.exchange/experiments.html",
        fmu=fmu.name,
        replayed=replayed,
        signals=[signal for each in replayed.experiments for signal in each.agreement],
        files=list(files),
        made=made | {"fmu_sha256": about["sha256"]},
    )
    return files | {"report.html": page}
