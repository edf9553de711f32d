"""`bristle report`: what the runs of a sweep say together."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bristle.cli.app import PASS, DebugOption, app, path_of
from bristle.cli.commands.query import StoreArgument


@app.command(short_help="Make the report of a store of a sweep.")
def report(
    store: StoreArgument,
    out: Annotated[
        Path, typer.Option(help="folder for report.html", metavar="FOLDER", parser=path_of)
    ] = Path("out/report"),
    debug: DebugOption = False,
) -> int:
    """Write FOLDER/report.html and report.json: verdicts, errors of the estimates, coverage of
    intervals, where runs fail.
    """
    from bristle.common.output import output_folder, replace_files, to_json
    from bristle.harness.sweep.store import Store
    from bristle.harness.sweep.sweep_page import Runs, render, summary

    with output_folder(out, "report.json"):
        runs = Runs(Store(store))
        content = {
            "report.html": render(runs).encode(),
            "report.json": to_json(summary(runs)).encode(),
        }
        replace_files(out, content, list(content))
    for line in runs.unfinished:
        print(line)
    share = runs.share()
    print(f"{share.count} of {share.total} runs pass  {out / 'report.html'}", flush=True)
    return PASS
