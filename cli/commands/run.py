"""`bristle run`: scenarios, and what others packed to be run again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bristle.cli.app import (
    ERROR,
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
from bristle.cli.terminal import complain, progress
from bristle.common.errors import BristleError

REPLAYED = (".ssp", ".fmu", ".exp")

if TYPE_CHECKING:
    from bristle.harness.run.checked import Checked, RunOptions
    from bristle.harness.run.run import FinishedRun


@app.command(short_help="Run scenarios, and compare estimates with true values.")
def run(
    scenarios: Annotated[
        list[Path],
        scenario_argument(
            "scenario files, names from bristle list, .ssp packages, FMUs with experiments, or .exp"
            " files of them"
        ),
    ],
    out: Annotated[
        Path, typer.Option(help="folder for the results", metavar="FOLDER", parser=path_of)
    ] = Path("out"),
    kind: KindOption = Kind.native,
    fmi: FmiOption = Fmi.two,
    set_: SetOption = None,
    seed: SeedOption = None,
    full: Annotated[bool, typer.Option("--full", help="signals.csv at full rate")] = False,
    fmu: Annotated[
        Path | None, typer.Option(help="the FMU of .exp files", metavar="FILE", parser=path_of)
    ] = None,
    timeout: TimeoutOption = None,
    debug: DebugOption = False,
) -> None:
    """Run scenarios and write a result folder for each; no scenario runs before all are checked."""
    from bristle.common.output import output_folder
    from bristle.harness.run.checked import RunOptions

    replays = [path for path in scenarios if path.suffix.lower() in REPLAYED]
    if fmu is not None and not any(path.suffix.lower() == ".exp" for path in replays):
        raise BristleError("--fmu goes with .exp files, of which none is given; leave it out")
    refuse_duplicates(scenarios)
    if replays:
        _refuse_changes(len(replays) < len(scenarios) or bool(set_) or seed is not None)
        raise typer.Exit(max(_replayed(path, fmu, out, timeout, debug) for path in replays))
    changes = tuple(set_ or ())
    options = RunOptions(int(fmi.value), kind.value, changes, seed, full, timeout, batch)
    with output_folder(out):
        checked = [_checked(path, out, options, debug) for path in scenarios]
        worst = (
            ERROR if None in checked else max(_executed(each, debug) for each in checked if each)
        )
        raise typer.Exit(worst)  # in the context, which removes a folder that stays empty


def batch(*record: Any) -> Any:
    """Estimate from a whole record; what that takes is imported where a scenario has one."""
    from bristle.diagnosis.sliding.batch import batch_estimates

    return batch_estimates(*record)


def _refuse_changes(asked: bool) -> None:
    """Raise BristleError if more is asked of what others packed than to run it as it is."""
    if asked:
        raise BristleError(
            "packages and experiments run as they are: without scenario files beside them,"
            " --set and --seed"
        )


def _replayed(path: Path, fmu: Path | None, out: Path, timeout: float | None, debug: bool) -> int:
    """Run a package or experiments, print verdicts or the error, and return the exit code."""
    try:
        return (
            _package(path, out, timeout)
            if path.suffix.lower() == ".ssp"
            else _experiments(path, fmu, out, timeout)
        )
    except BristleError as error:
        complain(error, debug)
        return ERROR


def _package(path: Path, out: Path, timeout: float | None) -> int:
    from bristle.harness.exchange.kit_replay import replay

    with progress(path.stem) as tell:
        done = replay(path, out, timeout, lambda step, of: tell("co-simulation", step, of))
    held = sum(each.holds for each in done.agreement)
    what = (
        f"{held} of {len(done.agreement)} signals agree with the reference"
        if done.compared
        else "holds no reference"
    )
    print(f"{path.stem:<24} {done.verdict}  {done.folder / 'report.html'}  {done.failure or what}")
    return PASS if done.passed else FAIL


def _experiments(path: Path, fmu: Path | None, out: Path, timeout: float | None) -> int:
    from bristle.harness.exchange.experiment import repeat

    if path.suffix.lower() == ".fmu":
        fmu, source = path, None
    elif fmu is None:
        raise BristleError(f"{path}: experiments do not say of which FMU they are; add --fmu FILE")
    else:
        source = path
    with progress(path.stem) as tell:
        done = repeat(fmu, out, source, timeout, tell)
    for each in done.experiments:
        print(
            f"{path.stem:<24} {each.verdict:<4}  {done.folder / 'report.html'} "
            f" {each.experiment.name}: {each.summary}"
        )
    if done.changed:
        names = ", ".join(done.changed[:3]) + (", ..." if len(done.changed) > 3 else "")
        print(f"{path.stem:<24} fail  not as when it was made: {names}")
    return PASS if done.passed else FAIL


def _checked(path: Path, out: Path, options: RunOptions, debug: bool) -> Checked | None:
    """Check a scenario; of one that cannot be run, print the error and return None."""
    from bristle.harness.run.run import build_and_check
    from bristle.harness.scenario.catalogue import find_scenario

    try:
        with progress(path.stem) as tell:
            return build_and_check(find_scenario(path), out, options, tell)
    except BristleError as error:
        complain(error, debug)
        return None


def _executed(checked: Checked, debug: bool) -> int:
    """Run a scenario, print its verdict or its error, and return the exit code."""
    from bristle.harness.run.run import execute

    try:
        with progress(checked.setup.loaded.name) as tell:
            done = execute(checked, tell)
    except BristleError as error:
        complain(error, debug)
        return ERROR
    _report(done)
    return PASS if done.passed else FAIL


def _report(done: FinishedRun) -> None:
    """Print the verdict of a run, why it failed, and findings on its record."""
    result = done.result
    failed = [check["name"] for check in result["checks"] if not check["pass"]]
    why = ""
    if "diverged" in result:
        why = (
            f"  {result['diverged']['fmu']} stopped at {result['diverged']['time_s']:g} s:"
            f" {result['diverged']['message']}"
        )
    elif failed:
        why = f"  failed: {', '.join(failed)}"
    head = f"{result['scenario']:<24} {result['verdict']:<4} {result['wall_s']:7.1f} s"
    print(f"{head}  {done.folder / 'report.html'}{why}", flush=True)
    for line in done.findings:
        print(f"  - {line}", flush=True)
