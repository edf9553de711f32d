"""`bristle check`: an FMU against the standard."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bristle.cli.app import FAIL, PASS, DebugOption, app, path_of
from bristle.cli.terminal import fraction


@app.command(
    short_help="Check an FMU of any maker: archive, description, behaviour.",
    epilog=(
        "The FMU runs in processes of its own, each point with a time limit. Exit code 0: no point"
        " of severity error or warning failed or could not be tested; 1: one did; 2: an error."
    ),
)
def check(
    fmu: Annotated[
        Path, typer.Argument(help="FMU of any maker", metavar="ANY.fmu", parser=path_of)
    ],
    json: Annotated[
        Path | None, typer.Option(help="file for the results", metavar="FILE", parser=path_of)
    ] = None,
    junit: Annotated[
        Path | None,
        typer.Option(help="file for the results as JUnit", metavar="FILE", parser=path_of),
    ] = None,
    sarif: Annotated[
        Path | None,
        typer.Option(help="file for the findings as SARIF", metavar="FILE", parser=path_of),
    ] = None,
    debug: DebugOption = False,
) -> int:
    """Say which points of the FMI standard and of good conduct an FMU breaks."""
    from bristle.common.output import (
        check_files_writable,
        check_not_replaced,
        replace_each,
        to_json,
    )
    from bristle.fmus import conformance

    files = [file for file in (json, junit, sarif) if file is not None]
    for file in files:
        check_not_replaced(file.parent, [file.name], [fmu])
    check_files_writable(files)
    with fraction("check") as tell:
        results = conformance.conformance(fmu, tell)
    failed = (conformance.Verdict.failed, conformance.Verdict.not_tested)
    print("\n".join(conformance.to_lines(results)))
    written = {
        json: to_json(conformance.to_tree(fmu, results)).encode(),
        junit: conformance.junit(fmu, results),
    }
    written[sarif] = to_json(conformance.sarif(fmu, results)).encode()
    replace_each({path: content for path, content in written.items() if path is not None})
    serious = [
        r
        for r in results
        if r.verdict in failed and r.point.severity is not conformance.Severity.note
    ]
    return FAIL if serious else PASS
