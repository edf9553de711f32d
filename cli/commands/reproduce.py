"""`bristle reproduce`: the paper."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bristle.cli.app import FAIL, PASS, DebugOption, app, path_of
from bristle.cli.terminal import fraction

if TYPE_CHECKING:
    pass


@app.command(
    short_help="Make the figures and numbers of the paper.",
    epilog="Exit code 0: every run is as it is expected to be; 1: one is not; 2: an error.",
)
def reproduce(
    out: Annotated[
        Path,
        typer.Option(
            help="folder for report.html, its figures and reproduce.json",
            metavar="FOLDER",
            parser=path_of,
        ),
    ] = Path("out"),
    debug: DebugOption = False,
) -> None:
    """Make the figures and numbers of the paper: as printed, as repaired, and by the best observer,
    on one page.
    """
    from bristle.harness.paper.reproduce import reproduce as make

    with fraction("reproduce") as tell:
        content = make(out, tell)
    print(f"{content['verdict']}  {out / 'report.html'}", flush=True)
    raise typer.Exit(PASS if content["verdict"] == "pass" else FAIL)
