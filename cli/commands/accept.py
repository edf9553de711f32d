"""`bristle accept`: runs as references."""

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
    Kind,
    KindOption,
    SeedOption,
    SetOption,
    TimeoutOption,
    app,
    path_of,
    scenario_argument,
)
from bristle.cli.files import refuse_duplicates
from bristle.cli.terminal import command_line, fraction


@app.command(
    short_help="Store runs as references, with measured tolerances.",
    epilog=(
        "Each scenario runs about a dozen times: with start values rounded otherwise, compiled"
        " otherwise, and with other internal steps. What differs between these runs is what bristle"
        " compare allows. Exit code 0: all verdicts pass; 1: a verdict failed, and the run is"
        " stored nevertheless; 2: an error."
    ),
)
def accept(
    scenarios: Annotated[
        list[Path], scenario_argument("scenario files, or names from bristle list")
    ],
    out: Annotated[
        Path, typer.Option(help="folder for the baselines", metavar="FOLDER", parser=path_of)
    ] = Path("baselines"),
    kind: KindOption = Kind.native,
    fmi: FmiOption = Fmi.two,
    set_: SetOption = None,
    seed: SeedOption = None,
    timeout: TimeoutOption = None,
    debug: DebugOption = False,
) -> int:
    """Run scenarios and store each as FOLDER/SCENARIO: its file, signals, result.json, and measured
    tolerances.
    """
    from bristle.common.output import output_folder
    from bristle.harness.baseline.baseline import make_baseline, refuse_other, write_baseline
    from bristle.harness.run.checked import RunOptions
    from bristle.harness.run.run import build_and_check
    from bristle.harness.scenario.catalogue import find_scenario

    refuse_duplicates(scenarios)
    options = RunOptions(
        int(fmi.value), kind.value, tuple(set_ or ()), seed, full=True, timeout=timeout
    )
    passed = True
    with output_folder(out):
        checked = []
        for path in scenarios:
            refuse_other(out / path.stem)
            checked.append(build_and_check(find_scenario(path), out, options, refuse=refuse_other))
        for each in checked:
            loaded = each.setup.loaded
            with fraction(loaded.name) as tell:
                found = make_baseline(each, tell)
            folder = write_baseline(out, loaded.name, found, loaded.text, command_line())
            size = sum(path.stat().st_size for path in folder.iterdir())
            done = [run for run in found.runs if not run["why"]]
            verdict = found.result["verdict"]
            print(
                f"{loaded.name:<24} {verdict:<4}  {folder}  {len(done)} repeated runs,"
                f" {size / 1e6:.1f} MB",
                flush=True,
            )
            for run in found.runs:
                if run["why"]:
                    print(f"  - left out, {run['name']}: {run['why']}", flush=True)
            passed = passed and verdict == "pass"
    return PASS if passed else FAIL
