"""`bristle coupling`: what the order of FMUs and the communication step change."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bristle.cli.app import (
    FAIL,
    PASS,
    DebugOption,
    Fmi,
    FmiOption,
    ScenarioArgument,
    SeedOption,
    SetOption,
    app,
    path_of,
)
from bristle.cli.terminal import fraction


@app.command(
    short_help="Say what the order of the FMUs and the communication step change.",
    epilog=(
        "Exit code 0: the verdict of the scenario is pass in every coupling; 1: in one it is fail;"
        " 2: an error."
    ),
)
def coupling(
    scenario: ScenarioArgument,
    out: Annotated[
        Path, typer.Option(help="folder for the results", metavar="FOLDER", parser=path_of)
    ] = Path("out/coupling"),
    fmi: FmiOption = Fmi.two,
    set_: SetOption = None,
    seed: SeedOption = None,
    debug: DebugOption = False,
) -> int:
    """Run a scenario with all FMUs at once and one after the other, and with smaller steps; compare
    signals and estimates.
    """
    from bristle.harness.coupling import coupling as library
    from bristle.harness.run.checked import RunOptions
    from bristle.harness.scenario.catalogue import find_scenario

    with fraction("coupling") as tell:
        found = library.coupling(
            find_scenario(scenario),
            out,
            RunOptions(fmi=int(fmi.value), overrides=tuple(set_ or ()), seed=seed),
            tell,
        )
    errors = found.schemes[0].errors
    signal = "plant.v" if "plant.v" in errors else next(iter(errors))
    for each in found.schemes:
        error = each.errors[signal]
        lag = "" if error.delay is None else f", {round(1e3 * error.delay, 3) + 0.0:+.3f} ms late"
        print(f"{each.name:<48} {signal}: {100 * error.relative:.3g} % off{lag}, {each.verdict}")
    print(out / "report.html")
    return PASS if {found.verdict, *(each.verdict for each in found.schemes)} == {"pass"} else FAIL
