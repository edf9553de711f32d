"""`bristle export`: a scenario as one file for another lab."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from bristle.cli.app import (
    PASS,
    DebugOption,
    Fmi,
    FmiOption,
    Kind,
    KindOption,
    ScenarioArgument,
    SeedOption,
    SetOption,
    app,
    path_of,
)
from bristle.cli.terminal import progress


@app.command(
    short_help="Write a scenario as one file for another lab (SSP).",
    epilog="bristle run KIT.ssp runs such a file again, also one of another maker.",
)
def export(
    scenario: ScenarioArgument,
    out: Annotated[
        Path, typer.Option(help="folder for the package", metavar="FOLDER", parser=path_of)
    ] = Path("kit"),
    kind: KindOption = Kind.native,
    fmi: FmiOption = Fmi.two,
    set_: SetOption = None,
    seed: SeedOption = None,
    platforms: Annotated[
        str, typer.Option(help="host, all, or names such as win64,linux64", metavar="PLATFORMS")
    ] = "host",
    debug: DebugOption = False,
) -> int:
    """Write FOLDER/SCENARIO.ssp with its FMUs, reference signals, verdict, and a page for who
    receives it.
    """
    from bristle.harness.exchange.kit import export as write
    from bristle.harness.run.checked import RunOptions
    from bristle.harness.scenario.catalogue import find_scenario

    options = RunOptions(int(fmi.value), kind.value, tuple(set_ or ()), seed)
    with progress(scenario.stem) as tell:
        tell("building FMUs and running them once", 0, 0)
        package = write(find_scenario(scenario), out, options, platforms)
    verdict = json.loads((out / "reference" / "verdict.json").read_text(encoding="utf-8"))[
        "verdict"
    ]
    print(f"{package}  verdict {verdict}; for who receives it: {out / 'README.md'}")
    return PASS
