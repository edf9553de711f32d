"""`bristle validate`: a model or an FMU over whole records."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bristle.cli.app import DebugOption, TimeoutOption, app, path_of
from bristle.cli.files import DataCommand, files_of
from bristle.cli.terminal import command_line, fraction
from bristle.common.errors import BristleError

ModelArgument = Annotated[
    Path,
    typer.Argument(help="model file or plant FMU", metavar="MODEL.toml|PLANT.fmu", parser=path_of),
]
DataOption = Annotated[
    list[Path],
    typer.Option(help="measured files or patterns", metavar="FILE...", parser=path_of),
]
OutOption = Annotated[
    Path,
    typer.Option(
        help="folder for validation.json and report.html", metavar="FOLDER", parser=path_of
    ),
]
FmuOption = Annotated[
    Path | None,
    typer.Option(
        help="plant FMU to validate; MODEL.toml then gives the columns",
        metavar="PLANT.fmu",
        parser=path_of,
    ),
]

StartOption = Annotated[
    int | None,
    typer.Option(
        help="also simulate from a start fitted to the first N samples alone, and give the errors"
        " after them",
        metavar="N",
    ),
]


@app.command(
    cls=DataCommand,
    short_help="Compare a model or a plant FMU with records, in open loop.",
    epilog=(
        "The columns are those of MODEL.toml (a model file, or the augmented.toml of a diagnosis)."
        " With an FMU alone, which must have the parameters J, a2 and b, they are t [s], u and"
        " theta or, of an FMU without it, v, in the units of the FMU. Exit code 0: it completed,"
        " however large the error; 2: an error."
    ),
)
def validate(
    model: ModelArgument,
    data: DataOption,
    out: OutOption = Path("out/validation"),
    fmu: FmuOption = None,
    start_samples: StartOption = None,
    timeout: TimeoutOption = None,
    debug: DebugOption = False,
) -> None:
    """Simulate a model or a plant FMU over whole records in open loop, and say how far it is from
    what was measured.
    """
    from bristle import diagnosis
    from bristle.common.output import output_folder
    from bristle.common.provenance import provenance_of
    from bristle.diagnosis.report.validation_page import (
        check_validation_places,
        sentences,
        write_validation,
    )

    data = files_of(data)
    if model.suffix.lower() == ".fmu":
        if fmu is not None:
            raise BristleError(
                f"{model} and {fmu} are both FMUs; give one, and MODEL.toml for the columns"
            )
        fmu = model
    check_validation_places(out, [model, *data, *([] if fmu is None else [fmu])])
    with output_folder(out, "validation.json"), fraction("validate") as tell:
        tell("reading", 0.0)
        known = diagnosis.fmu_model(model) if model == fmu else diagnosis.load_model(model)
        records = diagnosis.load_records(known, data)
        tell("simulating", 0.2)
        found = (
            diagnosis.validate(known, records, start_samples)
            if fmu is None
            else diagnosis.validate_fmu(fmu, known, records, timeout, start_samples)
        )
        tell("writing", 0.9)
        write_validation(found, out, provenance_of(model, data, command_line(), fmu))
    for line in (
        *sentences(found),
        *(f"  - {finding}" for finding in found.findings),
        out / "report.html",
    ):
        print(line)
