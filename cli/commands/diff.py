"""`bristle diff`: two FMUs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bristle.cli.app import FAIL, PASS, DebugOption, app, path_of


@app.command(
    short_help="Compare two FMUs: interface, start values, behaviour.",
    epilog=(
        "Behaviour: both run over the default experiment of the first one, with inputs that move"
        " within their ranges. Exit code 0: what uses A.fmu may use B.fmu and sees no difference;"
        " 1: it may not, or sees one; 2: an error."
    ),
)
def diff(
    first: Annotated[
        Path, typer.Argument(help="the FMU that is used", metavar="A.fmu", parser=path_of)
    ],
    second: Annotated[
        Path,
        typer.Argument(help="the one that is to take its place", metavar="B.fmu", parser=path_of),
    ],
    json: Annotated[
        Path | None, typer.Option(help="file for the differences", metavar="FILE", parser=path_of)
    ] = None,
    debug: DebugOption = False,
) -> int:
    """Say what differs between two FMUs, and whether that matters to who uses the first one."""
    from bristle.common.output import check_not_replaced, replace_file, to_json
    from bristle.fmus.difference import HARMLESS, fmu_differences
    from bristle.fmus.host import Fmu

    if json is not None:
        check_not_replaced(json.parent, [json.name], [first, second])
    found = fmu_differences(*(Fmu(path, foreign=True) for path in (first, second)))
    for each in found:
        print(f"{each.change:<9}  {each.place}: {each.text}")
    serious = sum(each.change not in HARMLESS for each in found)
    print(
        f"{len(found)} differences, {serious} that a user of {first.name} may notice"
        if found
        else "no difference"
    )
    if json is not None:
        rows = [
            {"kind": str(each.change), "place": each.place, "text": each.text} for each in found
        ]
        content = to_json(
            {"first": str(first), "second": str(second), "differences": rows}
        ).encode()
        replace_file(json, content)
    return FAIL if serious else PASS
