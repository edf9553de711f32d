"""`bristle diagnose`: the effect that a model lacks."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeGuard

import typer

from bristle.cli.app import DebugOption, Fmi, TimeoutOption, app, path_of
from bristle.cli.completion import complete_effect
from bristle.cli.files import DataCommand, files_of
from bristle.cli.terminal import command_line, fraction
from bristle.common.errors import BristleError, IncompleteError

if TYPE_CHECKING:
    from bristle.diagnosis.answer import Diagnosis
    from bristle.diagnosis.selection.start_values import SearchOptions

DataOption = Annotated[
    list[Path],
    typer.Option(
        help="measured files or patterns (two files or more are best)",
        metavar="FILE...",
        parser=path_of,
    ),
]
OutOption = Annotated[
    Path,
    typer.Option(
        help="folder for diagnosis.json, report.html and the augmented model",
        metavar="FOLDER",
        parser=path_of,
    ),
]
ModelArgument = Annotated[
    Path | None, typer.Argument(help="model file", metavar="MODEL.toml", parser=path_of)
]
FmuOption = Annotated[
    Path | None, typer.Option(help="plant FMU to diagnose", metavar="PLANT.fmu", parser=path_of)
]
ChooseOption = Annotated[
    str | None,
    typer.Option(
        help="effect of a tie to add to the model",
        metavar="NAME",
        autocompletion=complete_effect,
    ),
]
FillOption = Annotated[
    bool,
    typer.Option(
        "--fill", help="put what is left unexplained into the model, as an unnamed torque"
    ),
]
JobsOption = Annotated[
    int, typer.Option(help="effects tried at a time; 0: one on each core", min=0, metavar="N")
]
BudgetOption = Annotated[
    str | None, typer.Option(help="time for the whole diagnosis, such as 60s", metavar="TIME")
]


@app.command(
    cls=DataCommand,
    short_help="Name the effect that a model lacks, from measured records.",
    epilog=(
        "With both MODEL.toml and --fmu, the FMU is diagnosed, and the file gives the columns and"
        " the nominal J and friction. With --fmu alone, it must have the parameters J, a2 and b,"
        " and the columns are t [s], u and theta or, of an FMU without it, v, in the units of the"
        " FMU. Exit code 0: it completed, whatever it found; 2: an error."
    ),
)
def diagnose(
    data: DataOption,
    out: OutOption = Path("out"),
    model: ModelArgument = None,
    fmu: FmuOption = None,
    choose: ChooseOption = None,
    fill: FillOption = False,
    jobs: JobsOption = 0,
    budget: BudgetOption = None,
    fmi: Annotated[Fmi, typer.Option(help="version of FMI of what is written")] = Fmi.two,
    timeout: TimeoutOption = None,
    debug: DebugOption = False,
) -> None:
    """Find where a model and measured records disagree, name the missing effect, and write the
    model with it.
    """
    if model is None and fmu is None:
        raise BristleError("nothing to diagnose; give MODEL.toml or --fmu PLANT.fmu")
    _check_effect(choose)
    data = files_of(data)
    from bristle.common.output import output_folder
    from bristle.common.provenance import provenance_of
    from bristle.diagnosis.report.export import check_places, nothing_filled, write

    options = search_options(jobs, budget)
    check_places(out, [path for path in (model, fmu, *data) if path is not None])
    if fmu is None and _is_arm(model):
        _diagnose_arm(model, data, out, options, int(fmi.value))
        return
    with output_folder(out, "diagnosis.json"), fraction("diagnose") as tell:
        found = _diagnosed(model, fmu, data, tell, options, timeout)
        tell("writing", 1.0)
        problem = None
        try:
            write(
                found,
                out,
                choose,
                fmi=int(fmi.value),
                made=provenance_of(model or fmu, data, command_line(), fmu),
                fill=fill,
            )
        except BristleError as error:
            problem = error
    # the answer is printed even if it cannot be written
    _summary(found, choose if problem is None else None)
    if fill and not (found.unnamed is not None and found.unnamed.offered):
        print(nothing_filled(found))
    _end(found, out, problem)


def _end(found: Diagnosis, out: Path, problem: BristleError | None) -> None:
    """Print where the report is, or raise what kept it from being written."""
    if problem is None or isinstance(problem, IncompleteError):
        print(f"{found.verdict}  {out / 'report.html'}", flush=True)
    if problem is not None:
        raise problem


def _is_arm(path: Path | None) -> TypeGuard[Path]:
    from bristle.diagnosis.robot.arm import is_arm

    return path is not None and is_arm(path)


def _diagnose_arm(
    path: Path, data: Sequence[Path], out: Path, options: SearchOptions, fmi: int
) -> None:
    """Diagnose the joints of an arm, one after the other, each into a folder of its name."""
    from bristle.common.output import output_folder
    from bristle.common.provenance import provenance_of
    from bristle.diagnosis import diagnose, write
    from bristle.diagnosis.report.arm_page import write_arm
    from bristle.diagnosis.report.headline import headline
    from bristle.diagnosis.robot.arm import joints_of, load_arm

    made = provenance_of(path, data, command_line(), None)
    joints, found = joints_of(load_arm(path), data), {}
    with output_folder(out, "diagnosis.json"):
        for name, (model, records) in joints.items():
            with fraction(f"diagnose {name}") as tell:
                found[name] = diagnose(model, records, progress=tell, options=options)
                write(found[name], out / name, fmi=fmi, made=made)
        write_arm(path.stem, found, out, made)
    width = max(map(len, found))
    for name, each in found.items():
        print(f"{name:<{width}}  {headline(each)}")
    print(f"{len(found)} joints  {out / 'report.html'}", flush=True)


def _check_effect(name: str | None) -> None:
    """Raise BristleError for an unknown effect, before a long computation."""
    if name is not None:
        from bristle.plant.effects import effect

        effect(name)


def search_options(jobs: int, budget: str | None) -> SearchOptions:
    """Return the options of a search; raise BristleError for a budget that is no time above 0."""
    from bristle.common.units import quantity
    from bristle.diagnosis.selection.start_values import SearchOptions

    if budget is None:
        return SearchOptions(jobs=jobs)
    try:
        seconds = quantity(re.sub(r"(?<=[\d.])(?=[a-z]+$)", " ", budget), "s")
    except BristleError as error:
        raise BristleError(f"--budget: {error}") from None
    if not seconds > 0:
        raise BristleError(f"--budget is {budget}; give a time above 0, such as 60s")
    return SearchOptions(jobs=jobs, budget=seconds)


def _diagnosed(
    model: Path | None,
    fmu: Path | None,
    data: Sequence[Path],
    tell: Callable[[str, float], None],
    options: SearchOptions,
    timeout: float | None,
) -> Diagnosis:
    """Read and diagnose a model or an FMU."""
    from bristle import diagnosis

    tell("reading", 0.0)
    if fmu is not None:
        known = diagnosis.load_model(model) if model is not None else diagnosis.fmu_model(fmu)
        records = diagnosis.load_records(known, data)
        return diagnosis.diagnose_fmu(
            fmu, known, records, progress=tell, options=options, timeout=timeout
        )
    assert model is not None
    known = diagnosis.load_model(model)
    return diagnosis.diagnose(
        known, diagnosis.load_records(known, data), progress=tell, options=options
    )


def _summary(found: Diagnosis, chosen: str | None = None) -> None:
    """Print the answer in one line and in sentences, what to measure next, findings, and the
    parameters of the effects.
    """
    from bristle.diagnosis.report.headline import headline
    from bristle.diagnosis.report.text.names import effect_name

    print(headline(found))
    text = "\n".join(found.statement)
    proposed = [line for line in found.proposals if line.rstrip("?.") not in text]
    for line in (*found.statement, *proposed):
        print(line)
    if found.experiment:
        print(f"What to measure next: {found.experiment}")
    if chosen is not None:
        print(f"The augmented model has {effect_name(chosen)}, as chosen.")
    elif found.choices:
        print(f"For a model with one of these effects, give --choose: {', '.join(found.choices)}")
    for line in found.findings:
        print(f"  - {line}")
    if any(effect.parameters for effect in found.effects):
        _print_parameters(found)


def _print_parameters(found: Diagnosis) -> None:
    """Print a table of the parameters of the effects."""
    from bristle.diagnosis.report.text.names import plain_texts

    rows = [("effect", "parameter", "value", "95 % interval", "unit")]
    for effect in found.effects:
        for name, e in effect.parameters.items():
            value, low, high = plain_texts(e)
            interval = f"{low} ... {high}" if low else "-"
            value += " (at its bound)" if e.at_bound else ""
            rows.append((effect.name, name, value, interval, e.unit))
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    for row in rows:
        cells = (f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True))
        print("  " + "  ".join(cells).rstrip())
