"""What a diagnosis leaves behind, all or nothing: numbers, a report, the model and its FMUs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bristle.common.errors import BristleError, IncompleteError
from bristle.common.output import (
    check_no_folder,
    check_not_replaced,
    check_page,
    check_writable,
    replace_files,
    to_json,
)
from bristle.common.provenance import provenance
from bristle.common.work import TemporaryFolder
from bristle.diagnosis.answer import DesignedInput, Diagnosis, Estimate, UnnamedTorque
from bristle.diagnosis.modelfile import Model, model_text
from bristle.diagnosis.report.correction import correction_program, refusal
from bristle.diagnosis.report.figures.of_diagnosis import draw
from bristle.diagnosis.report.html import render
from bristle.diagnosis.report.text.designed import EXPERIMENT_FILE
from bristle.diagnosis.report.text.statement import not_offered
from bristle.fmus.build import build, program_files
from bristle.fmus.pack import write_archive
from bristle.fmus.related import related_files
from bristle.plant.effects import effect as find_effect
from bristle.plant.servo import ENCODER_COUNTS

Related = Callable[[Mapping[str, bytes]], Mapping[str, bytes]]  # gives files to add to an FMU

MOST_SAMPLES_INSIDE = 5000  # of a record, which an FMU holds as inputs of its experiment
WRITTEN_FILES = (
    "diagnosis.json",
    "report.html",
    "augmented.toml",
    "augmented.fmu",
    "correction.fmu",
    EXPERIMENT_FILE,
)


@dataclass(frozen=True)
class Augmented:
    """A model with what was found."""

    model: Model
    effects: tuple[str, ...]  # all of the model
    added: tuple[str, ...]  # those that were found
    parameters: dict[str, float]  # start values [SI] of the servo


def augment(
    diagnosis: Diagnosis, choose: str | None = None, fill: bool = False
) -> Augmented | None:
    """Return the model with what was found, or None where nothing may be added.

    `choose` is a member of a tie to take as if it had been named; `BristleError` if it is none, or
    its parameters are unknown. With `fill` the unexplained residual is added as an unnamed torque,
    where one is offered.
    """
    if fill and diagnosis.unnamed is not None and diagnosis.unnamed.offered:
        return _filled(diagnosis, diagnosis.unnamed, choose)
    if choose is not None:
        _check_choice(diagnosis, choose)
    elif diagnosis.verdict not in ("named", "none"):
        return None
    if diagnosis.proposals:
        return None
    # suspects were fitted together, and go together
    added = {effect.name: effect.parameters for effect in diagnosis.found}
    own = diagnosis.parameters
    if choose in diagnosis.choices:  # in the place of what stands for it, if that was named
        added = {
            name: each for name, each in added.items() if name not in _mates(diagnosis, choose)
        }
        # and what was named before, as it is beside that
        own = diagnosis.choice_parameters.get(choose, own)
        added = {
            name: {key: own.get(f"{name}.{key}", e) for key, e in each.items()}
            for name, each in added.items()
        }
        added |= {choose: diagnosis.choices[choose]}
    model = refitted_model(diagnosis.model, own or diagnosis.base, added)
    return Augmented(model, tuple(model.effects), tuple(added), _settings(model))


def _filled(diagnosis: Diagnosis, unnamed: UnnamedTorque, choose: str | None) -> Augmented:
    """Return the model with the named and the unnamed torque, parameters fitted beside that."""
    if choose is not None:
        raise BristleError(
            f"chosen effect '{choose}': the unnamed torque was fitted without it; choose an effect"
            " or fill, not both"
        )
    named = {e.name: e.parameters for e in diagnosis.found}
    own = {
        **(diagnosis.parameters or diagnosis.base),
        **{f"{e}.{key}": x for e, given in named.items() for key, x in given.items()},
    }
    beside = {name: replace(e, value=unnamed.values.get(name, e.value)) for name, e in own.items()}
    effects = {e: {key: beside[f"{e}.{key}"] for key in given} for e, given in named.items()}
    model = refitted_model(diagnosis.model, beside, effects)
    curves = {curve.effect: curve.parameters for curve in unnamed.curves}
    model = replace(model, effects={**model.effects, **curves})
    return Augmented(model, tuple(model.effects), (*named, *curves), _settings(model))


def _check_choice(diagnosis: Diagnosis, choose: str) -> None:
    names = [effect.name for effect in diagnosis.found]
    if choose in diagnosis.choices or choose in names:
        return
    members = ", ".join(diagnosis.choices) or ", ".join(
        name for tie in diagnosis.ties for name in tie
    )
    if named := [name for name in names if name in _mates(diagnosis, choose)]:
        raise BristleError(
            f"chosen effect '{choose}': '{named[0]}' stands for it, and other effects were added to"
            f" that; leave it out, or give the model '{choose}' in [effects] and diagnose again"
        )
    if not members:
        raise BristleError(
            f"chosen effect '{choose}': the verdict is '{diagnosis.verdict}', there is no tie;"
            " leave it out"
        )
    raise BristleError(
        f"chosen effect '{choose}': not a member of the tie; choose one of: {members}"
    )


def _mates(diagnosis: Diagnosis, name: str) -> tuple[str, ...]:
    """Return the tie that an effect is in."""
    return next((tie for tie in diagnosis.ties if name in tie), ())


def refitted_model(
    model: Model, own: Mapping[str, Estimate], added: Mapping[str, Mapping[str, Estimate]]
) -> Model:
    """Return the model with fitted values; its bounds give way where a value lies outside, so that
    the file reads back.
    """
    values = {
        **model.parameters,
        **{name: e.value for name, e in own.items() if name in model.parameters},
    }
    bounds = {
        name: (min(low, values[name]), max(high, values[name]))
        for name, (low, high) in model.bounds.items()
    }
    effects = {name: dict(given) for name, given in model.effects.items()}
    for name, e in own.items():  # an effect the model had already is refitted like the rest
        effect, _, parameter = name.partition(".")
        if effect in effects:
            effects[effect][parameter] = e.value
    for effect, estimates in added.items():
        declared = {
            p.name.removeprefix(f"{effect}."): p.default for p in find_effect(effect).parameters
        }
        effects[effect] = {**declared, **{name: e.value for name, e in estimates.items()}}
    return replace(model, parameters=values, bounds=bounds, effects=effects)


def _settings(model: Model) -> dict[str, float]:
    """Return the start values of the servo: the model's, and an encoder of its resolution."""
    values = model.settings()
    if model.resolution and model.output_kind == "position":
        values[ENCODER_COUNTS.name] = min(
            max(2 * math.pi / model.resolution, ENCODER_COUNTS.minimum), ENCODER_COUNTS.maximum
        )
    return values


# -- the content of the files ----------------------------------------------------------------------
@dataclass
class _Package:
    """Files by name, what each is, what could not be made, and what there is not to be made."""

    content: dict[str, bytes] = field(default_factory=dict)
    meaning: dict[str, str] = field(default_factory=dict)
    absent: dict[str, str] = field(default_factory=dict)
    problems: list[BristleError] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, name: str, meaning: str, make: Callable[[], bytes]) -> None:
        """Add a file, or remember why it could not be made."""
        try:
            self.content[name] = make()
            self.meaning[name] = meaning
        except BristleError as error:
            self.problems.append(error)
            self.notes.append(f"{name} was not written: {error}")


def _package(
    diagnosis: Diagnosis, choose: str | None, fmi: int, made: Mapping[str, Any], fill: bool
) -> _Package:
    package = _Package()
    if fill and not (diagnosis.unnamed is not None and diagnosis.unnamed.offered):
        package.notes.append(nothing_filled(diagnosis))
    package.meaning = {"diagnosis.json": "the answer in numbers", "report.html": "this page"}
    augmented = None
    try:
        augmented = augment(diagnosis, choose, fill)
    except BristleError as error:
        package.problems.append(error)
        package.notes.append(str(error))
        choose = None
    # what the augmented model has in place of what stands for it
    chosen = {} if choose is None else {"chosen": choose}
    told = diagnosis.to_dict() | chosen
    package.content["diagnosis.json"] = to_json(told | {"provenance": made}).encode()
    if augmented is not None:
        report = {
            "diagnosis.json": (
                to_json({key: each for key, each in told.items() if key != "seconds"}).encode()
            )
        }  # each time alike
        _add_models(
            package,
            augmented,
            fmi,
            partial(related_files, report=report, **_first_record(diagnosis)),
        )
    if diagnosis.designed is not None and diagnosis.designed.written:
        package.content[EXPERIMENT_FILE] = _table(diagnosis.designed).encode()
        package.meaning[EXPERIMENT_FILE] = (
            "input to play back in open loop: a record that tells apart what these do not"
        )
    page = render(
        diagnosis, draw(diagnosis), package.meaning, package.notes, choose, package.absent
    )
    package.content["report.html"] = page.encode()
    return package


def nothing_filled(diagnosis: Diagnosis) -> str:
    """Return why no unnamed torque was put into the augmented model."""
    if diagnosis.unnamed is not None and diagnosis.unnamed.refused is not None:
        why = not_offered(diagnosis.unnamed.refused)
    else:
        why = "it was not looked for" if diagnosis.remains.flag else "nothing much is unexplained"
    return f"No unnamed {diagnosis.model.wording.torque} was added: {why}."


def _table(designed: DesignedInput) -> str:
    """Return a designed input as the content of a CSV file."""
    lines = [
        ",".join(designed.columns),
        *(f"{t:.9g},{u:.9g}" for t, u in zip(designed.time, designed.u, strict=True)),
    ]
    return "\n".join(lines) + "\n"


def _first_record(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return step and inputs of a short run of the FMUs: as in the first simulated record."""
    if diagnosis.whole is None or not diagnosis.whole.traces:
        return {}
    trace = diagnosis.whole.traces[0]
    time, u, y = (
        column[:MOST_SAMPLES_INSIDE] for column in (trace.time, trace.input, trace.measured)
    )
    step = float(time[-1] - time[0]) / (len(time) - 1)
    moved = (
        {"theta": y, "v": np.gradient(y, step)}
        if diagnosis.model.output_kind == "position"
        else {"v": y}
    )
    return {"step": step, "stimuli": {"u": u, **moved}}


def _add_models(package: _Package, augmented: Augmented, fmi: int, related: Related) -> None:
    extra = (
        f" with {', '.join(augmented.added)} added"
        if augmented.added
        else " refitted; no effect was added"
    )
    package.add("augmented.toml", f"the model{extra}", lambda: model_text(augmented.model).encode())
    unit = augmented.model.input_unit.replace(".", "·")
    about = (
        f"the plant{extra}, FMI {fmi}.0; what was identified are its start values; u is in {unit}"
    )
    package.add(
        "augmented.fmu",
        about,
        lambda: _made(lambda out: _build_plant(augmented, out, fmi, related)),
    )
    reasons = {name: refusal(name, augmented.effects, augmented.added) for name in augmented.added}
    possible = [name for name, reason in reasons.items() if reason is None]
    refused = [reason for reason in reasons.values() if reason is not None]
    if possible:
        about = _about_correction(possible, refused)
        package.add(
            "correction.fmu",
            about,
            lambda: _made(lambda out: _build_correction(possible, augmented, out, fmi, related)),
        )
    elif refused:
        package.absent["correction.fmu"] = "; ".join(refused)


def _about_correction(possible: list[str], refused: list[str]) -> str:
    text = (
        f"what to feed a plant that lacks {', '.join(possible)}, so that it behaves as if it had it"
    )
    text += "; pass u_corrected on within the step, else it comes a sample late"
    return f"{text}. Not in it: {'; '.join(refused)}" if refused else text


def _build_plant(augmented: Augmented, out: Path, fmi: int, related: Related) -> None:
    build(
        "plant",
        out,
        fmi=fmi,
        law=augmented.model.friction,
        effects=augmented.effects,
        parameters=augmented.parameters,
        units=augmented.model.unit_in_fmu,
        related=related,
    )


def _build_correction(
    names: list[str], augmented: Augmented, out: Path, fmi: int, related: Related
) -> None:
    program = correction_program(names, augmented.parameters).in_units(augmented.model.unit_in_fmu)
    content = program_files(program, fmi)
    write_archive(out, {**content, **related(content)})


def _made(make: Callable[[Path], None]) -> bytes:
    with TemporaryFolder("made") as folder:
        out = Path(folder) / "made.fmu"
        make(out)
        return out.read_bytes()


# -- writing ---------------------------------------------------------------------------------------
def write(
    diagnosis: Diagnosis,
    out: Path,
    choose: str | None = None,
    *,
    fmi: int = 2,
    made: Mapping[str, Any] | None = None,
    fill: bool = False,
) -> list[Path]:
    """Write a diagnosis into the folder `out`: the files of `WRITTEN_FILES` that there are; older
    ones of these names go.

    diagnosis.json and report.html always; augmented.toml and augmented.fmu if an effect was named
    (or none is missing: then the model is the refitted one); correction.fmu if an effect can act
    through the input.

    Parameters
    ----------
    diagnosis : Diagnosis
        From `diagnose` or `diagnose_fmu`.
    out : Path
        The folder; created if it is missing.
    choose : str, optional
        Member of a tie to add by hand.
    fmi : int
        Version of the FMUs, 2 or 3.
    made : mapping, optional
        Where it comes from, for the key `provenance` of diagnosis.json.
    fill : bool
        Put the unexplained residual into the augmented model, as an unnamed torque, where one is
        offered.

    Returns
    -------
    list of Path
        The files, in the order of `WRITTEN_FILES`.

    Raises
    ------
    IncompleteError
        If `choose` is no member of a tie or an FMU cannot be made; all the rest is written, and the
        report says why.
    BristleError
        If the folder cannot be written; it is then as it was.
    """
    if not isinstance(diagnosis, Diagnosis):
        raise BristleError(
            f"the diagnosis is a {type(diagnosis).__name__}; give what diagnose or diagnose_fmu"
            " returns"
        )
    out = Path(out)
    check_writable(out)
    check_page(out, "diagnosis.json")
    check_places(out)
    package = _package(diagnosis, choose, fmi, provenance() if made is None else made, fill)
    written = replace_files(out, package.content, WRITTEN_FILES)
    if package.problems:
        raise IncompleteError(f"{package.problems[0]} (all else is in {out})")
    return written


def check_places(out: Path, inputs: Iterable[Path] = ()) -> None:
    """Raise `BristleError` if writing into `out` would replace an input or a folder."""
    check_not_replaced(Path(out), WRITTEN_FILES, map(Path, inputs))
    check_no_folder(Path(out), WRITTEN_FILES)
