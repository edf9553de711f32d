"""`bristle stiction`: what friction leaves in the rest positions of a slow axis."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bristle.cli.app import DebugOption, app, path_of


@app.command(
    short_help="Say how a valve, or another slow axis, sticks and slips.",
    epilog=(
        "For records at which the axis rests between samples, such as a historian's: once a second"
        " to once in ten. Exit code 0: it is said; 2: an error."
    ),
)
def stiction(
    data: Annotated[Path, typer.Argument(help="the measured file", metavar="FILE", parser=path_of)],
    input_: Annotated[
        str, typer.Option("--input", help="column of what the axis is told", metavar="COLUMN")
    ],
    output: Annotated[str, typer.Option(help="column of its position", metavar="COLUMN")],
    resolution: Annotated[
        float, typer.Option(help="step of the position's sensor", metavar="STEP", min=0.0)
    ] = 0.0,
    json: Annotated[
        Path | None, typer.Option(help="file for the numbers", metavar="FILE", parser=path_of)
    ] = None,
    debug: DebugOption = False,
) -> None:
    """Find the friction of an axis from where it stands between its moves."""
    from dataclasses import asdict

    from bristle.common.output import check_not_replaced, replace_file, to_json
    from bristle.diagnosis.report.text.rest_positions import described
    from bristle.diagnosis.slow.stick_slip import stick_slip_of_file

    if json is not None:
        check_not_replaced(json.parent, [json.name], [data])
    found = stick_slip_of_file(data, input_, output, resolution)
    print("\n".join(described(found, input_, output)))
    if json is not None:
        replace_file(json, to_json(asdict(found)).encode())
