"""`bristle init`: a model file from measured records."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bristle.cli.app import DebugOption, app, path_of
from bristle.cli.files import files_of

if TYPE_CHECKING:
    pass


@app.command(
    short_help="Propose a model file from measured records.",
    epilog="Exit code 0: the model file is written; 2: an error.",
)
def init(
    data: Annotated[
        list[Path],
        typer.Argument(help="measured files or patterns", metavar="FILE", parser=path_of),
    ],
    out: Annotated[
        Path, typer.Option(help="model file to write", metavar="MODEL.toml", parser=path_of)
    ] = Path("model.toml"),
    time: Annotated[str | None, typer.Option(help="column of the time", metavar="COLUMN")] = None,
    input_: Annotated[
        str | None, typer.Option("--input", help="column of the input", metavar="COLUMN")
    ] = None,
    output: Annotated[
        str | None, typer.Option(help="column of the output", metavar="COLUMN")
    ] = None,
    unit: Annotated[
        list[str] | None, typer.Option(help="unit of a column", metavar="COLUMN=UNIT")
    ] = None,
    rate: Annotated[
        str | None,
        typer.Option(
            help="sampling rate, or interval, of files without a time", metavar="'200 Hz'"
        ),
    ] = None,
    list_: Annotated[
        bool, typer.Option("--list", help="print what the files hold, and write nothing")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="replace MODEL.toml if it exists")] = False,
    debug: DebugOption = False,
) -> None:
    """Find time, input and output in measured files, estimate rough parameters, and write a
    commented model file.
    """
    from bristle.cli.files import pairs
    from bristle.diagnosis.init.proposal import propose
    from bristle.diagnosis.report.proposed_model import next_command, summary, write_model
    from bristle.diagnosis.report.text.columns import listed

    files = files_of(data)
    if list_:
        print("\n".join(listed(files)))
        return
    found = propose(
        files,
        {"time": time, "input": input_, "output": output},
        pairs("--unit", unit or []),
        rate,
    )
    write_model(found, out, force)
    for line in summary(found):
        print(line)
    print(f"{out}  next: {next_command(found, out)}")
