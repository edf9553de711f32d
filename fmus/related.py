"""Files inside an FMU that let somebody else repeat what it was seen to do: FMI-LS-REF, with
experiments.

The layered standard is young, as is the format of experiments; both are written here and nowhere
else.

Source: lsref2026, experiments2026.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import BristleError
from bristle.common.pages import render
from bristle.common.parameter_set import Value, parameter_set
from bristle.common.signals import table_text
from bristle.common.work import TemporaryFolder
from bristle.common.xml import document
from bristle.fmus.host import Fmu
from bristle.fmus.pack import archive_bytes
from bristle.fmus.reference import (
    REFERENCE_RUN_STEP,
    REFERENCE_RUN_STEPS,
    STEPS_PER_ROW,
    TUBE_HALF_WIDTH,
    waves,
)
from bristle.fmus.response import respond

Array = NDArray[np.float64]

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST = f"{FOLDER}/fmi-ls-manifest.xml"
MANIFEST_SPACE = "http://fmi-standard.org/fmi-ls-manifest"
STANDARD = {
    "name": "org.fmi-standard.fmi-ls-ref",
    "version": "1.0.0-alpha.1",
    "description": "Layered Standard providing information on related files included in an FMU.",
}
SET_TYPE, EXPERIMENT_TYPE = "application/x-ssp-parameter-set", "application/x-ma-hs-experiments"
PARAMETERS, SUMS = "parameters.ssv", "checksums.sha256"
OWN_ANNOTATION = "bristle"  # type of the annotation that says how close the reference is met
REFERENCE_DIGITS = 12
Related = tuple[str, str, str, str]  # of a file: name, type, role, description


@dataclass(frozen=True)
class Experiment:
    """A simulation of an FMU from 0 s with its start values, and what it gives.

    Attributes
    ----------
    purpose : str
        ``smoke-test`` or ``validation``; also the name of its files.
    description : str
        One line.
    step : float
        Communication step [s].
    stimuli : mapping of str to ndarray, shape (steps,)
        Inputs from the start of each step.
    reference : mapping of str to ndarray, shape (rows,)
        First the times [s], then outputs.
    """

    purpose: str
    description: str
    step: float
    steps: int
    stimuli: Mapping[str, Array]
    reference: Mapping[str, Array]


def related_files(
    content: Mapping[str, bytes],
    experiments: Sequence[Experiment] = (),
    *,
    step: float = REFERENCE_RUN_STEP,
    stimuli: Mapping[str, Array] | None = None,
    report: Mapping[str, bytes] | None = None,
) -> dict[str, bytes]:
    """Return the files to add to an FMU: manifest, parameter set, experiments with references,
    checksums.

    Parameters
    ----------
    content : mapping of str to bytes
        The FMU, file name -> bytes. It is run once, for the smoke test.
    experiments : sequence of Experiment
        More experiments.
    step, stimuli : float, mapping of str to ndarray, shape (steps,)
        Of the smoke test; by default two seconds of sines.
    report : mapping of str to bytes, optional
        Reports to add, file name -> bytes.
    """
    with TemporaryFolder("related") as folder:
        path = Path(folder) / "made.fmu"
        path.write_bytes(archive_bytes(content))
        fmu = Fmu(path)
        tried = [] if (found := _smoke_test(fmu, step, stimuli)) is None else [found]
    files: dict[str, bytes] = {}
    related: list[Related] = []

    def add(entry: Related, data: bytes) -> None:
        files[entry[0]] = data
        related.append(entry)

    if values := _start_values(fmu):
        what = "start values of all parameters"
        add((PARAMETERS, SET_TYPE, "parameter", what), parameter_set("start values", values))
    for each in (*tried, *experiments):
        files |= _experiment_files(each)
        name, reference = f"{each.purpose}.exp", f"{each.purpose}-reference.csv"
        related.append((name, EXPERIMENT_TYPE, f"experiment/{each.purpose}", each.description))
        related.append((reference, "text/csv", "result", f"outputs of {name}"))
    for name, data in (report or {}).items():
        kind = "application/json" if name.endswith(".json") else "text/html"
        add((name, kind, "report", "how it was made"), data)
    what = "SHA-256 of the other files; finds damage, proves no origin"
    related.append((SUMS, "text/plain", "signature", what))
    page = {"documentation/fmi-ls-ref.html": _page(related).encode()}
    added = (
        page
        | {f"{FOLDER}/{name}": data for name, data in files.items()}
        | {MANIFEST: _manifest(related)}
    )
    return added | {f"{FOLDER}/{SUMS}": _sums({**content, **added})}


def _start_values(fmu: Fmu) -> dict[str, Value]:
    """Return the start values of the parameters that are numbers."""
    return {name: fmu.start(name) for name in fmu.names("parameter") if fmu.is_real(name)}


def _smoke_test(fmu: Fmu, step: float, stimuli: Mapping[str, Array] | None) -> Experiment | None:
    """Run an FMU; None for one that does not run on this machine."""
    steps = REFERENCE_RUN_STEPS if stimuli is None else len(next(iter(stimuli.values())))
    known = waves(step * np.arange(steps)) if stimuli is None else stimuli
    inputs = {name: known[name] for name in fmu.names("input") if name in known}
    outputs = [name for name in fmu.names("output") if fmu.is_real(name)]
    try:
        shown = respond(fmu, step, steps, inputs, outputs)
    except BristleError:  # it was compiled for other machines only, or takes no such inputs
        return None
    rows = np.arange(0, steps + 1, STEPS_PER_ROW)
    kept = {
        name: column[rows]
        for name, column in zip(outputs, shown.T, strict=True)
        if np.isfinite(column).all()
    }
    given = "sines" if stimuli is None else "measured inputs"
    about = (
        f"short run with {given if inputs else 'no inputs'}, to see that an importer steps this FMU"
        " as it should"
    )
    return Experiment(
        "smoke-test",
        about,
        step,
        steps,
        inputs,
        {"time": np.asarray(step * rows, dtype=np.float64), **kept},
    )


# -- files -----------------------------------------------------------------------------------------
def _experiment_files(experiment: Experiment) -> dict[str, bytes]:
    name, step = experiment.purpose, experiment.step
    files = {f"{name}.exp": _experiment_document(experiment)}
    if experiment.stimuli:
        columns = {
            "time": step * np.arange(experiment.steps, dtype=np.float64),
            **experiment.stimuli,
        }
        files[f"{name}-stimuli.csv"] = table_text(columns).encode()
    return files | {
        f"{name}-reference.csv": table_text(experiment.reference, REFERENCE_DIGITS).encode()
    }


def _experiment_document(experiment: Experiment) -> bytes:
    name = experiment.purpose
    root = ET.Element("Experiments", name=name, description=experiment.description)
    one = ET.SubElement(root, "Experiment", name=name, description=experiment.description)
    stop = experiment.step * experiment.steps
    ET.SubElement(
        one,
        "TransientSimulation",
        startTime="0.0",
        stopTime=f"{stop:.12g}",
        stepSize=f"{experiment.step:.12g}",
    )
    if experiment.stimuli:
        ET.SubElement(one, "Stimuli", source=f"{name}-stimuli.csv")
    ET.SubElement(one, "References", source=f"{name}-reference.csv")
    annotation = ET.SubElement(ET.SubElement(one, "Annotations"), "Annotation", type=OWN_ANNOTATION)
    ET.SubElement(annotation, "Comparison", tolerance=f"{TUBE_HALF_WIDTH:g}")
    return document(root)


def _manifest(related: Sequence[Related]) -> bytes:
    ET.register_namespace("fmi-ls", MANIFEST_SPACE)
    root = ET.Element(
        "fmiReferences",
        {f"{{{MANIFEST_SPACE}}}fmi-ls-{key}": value for key, value in STANDARD.items()},
    )
    for source, kind, role, description in related:
        ET.SubElement(root, "Related", type=kind, source=source, role=role, description=description)
    return document(root)


def _sums(content: Mapping[str, bytes]) -> bytes:
    """Return the checksums of all files, as `sha256sum --check` reads them in its folder."""
    return "".join(
        f"{hashlib.sha256(content[name]).hexdigest()}  {name}\n" for name in sorted(content)
    ).encode()


def _page(related: Sequence[Related]) -> str:
    return render(
        "bristle.fmus/related.html", folder=FOLDER, half_width=TUBE_HALF_WIDTH, related=related
    )
