"""`bristle test`: scenarios as regression tests."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
    SetOption,
    TimeoutOption,
    app,
    path_of,
    scenario_argument,
)
from bristle.cli.terminal import command_line, complain_each, fraction
from bristle.common.errors import BristleError

if TYPE_CHECKING:
    from bristle.harness.run.checked import RunOptions
    from bristle.harness.suite.suite import CaseResult, SuiteCase

ScenariosArgument = Annotated[
    list[Path], scenario_argument("files, names from bristle list, or folders of them")
]
OutOption = Annotated[
    Path, typer.Option(help="folder for the results", metavar="FOLDER", parser=path_of)
]
SeedsOption = Annotated[
    str | None, typer.Option(help="seeds of the reference: 1-12 or 1,4,7-9", metavar="SEEDS")
]
VaryOption = Annotated[
    list[str] | None,
    typer.Option(help="values of a key of the file: a:b:n or [v1, v2]", metavar="PATH=SPEC"),
]
JobsOption = Annotated[
    int | None,
    typer.Option("--jobs", "-j", help="processes; else one a core", min=1, metavar="N"),
]
JunitOption = Annotated[
    Path | None,
    typer.Option(help="file for the verdicts as JUnit", metavar="FILE", parser=path_of),
]
JsonOption = Annotated[
    Path | None,
    typer.Option(help="file for the verdicts as JSON", metavar="FILE", parser=path_of),
]
QuietOption = Annotated[
    bool, typer.Option("--quiet", "-q", help="print only what fails, and the sum")
]


@app.command(
    name="test",
    short_help="Run many scenarios, seeds and values, and say what passes.",
    epilog=(
        "Exit code 0: all runs pass; 1: a check does not hold; 2: a scenario cannot be run, and"
        " then none runs."
    ),
)
def suite(
    scenarios: ScenariosArgument,
    out: OutOption = Path("out/test"),
    seeds: SeedsOption = None,
    vary: VaryOption = None,
    set_: SetOption = None,
    jobs: JobsOption = None,
    kind: KindOption = Kind.native,
    fmi: FmiOption = Fmi.two,
    junit: JunitOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    timeout: TimeoutOption = None,
    debug: DebugOption = False,
) -> int:
    """Run scenarios with all seeds and values; FOLDER/index.html links to the report of each
    run.
    """
    from bristle.common.output import (
        check_files_writable,
        output_folder,
        replace_each,
        replace_files,
        to_json,
    )
    from bristle.common.provenance import provenance
    from bristle.harness.run.checked import RunOptions
    from bristle.harness.scenario.vary import seeds_of, values_of
    from bristle.harness.suite.suite import find_cases
    from bristle.harness.suite.suite_page import junit as to_junit
    from bristle.harness.suite.suite_page import render, to_tree

    asked = () if seeds is None else seeds_of(seeds)
    varied = [values_of(each) for each in vary or ()]
    check_files_writable(file for file in (junit, json) if file is not None)
    try:
        cases = find_cases(scenarios, asked, varied, set_ or ())
    except BristleError as error:
        raise _not_run(error, junit, debug) from None
    options = RunOptions(int(fmi.value), kind.value, tuple(set_ or ()), timeout=timeout)
    with output_folder(out):
        try:
            tested = _tested(cases, out, options, jobs or os.cpu_count() or 1)
        except BristleError as error:
            raise _not_run(error, junit, debug) from None
        origin = {**provenance(), "command": command_line()}
        tree = to_json(to_tree(tested, origin)).encode()
        content = {"suite.json": tree, "index.html": render(tested, origin).encode()}
        replace_files(out, content, list(content))
    _print(tested, quiet, out)
    reports = {json: tree, junit: to_junit(tested)}
    replace_each({path: text for path, text in reports.items() if path is not None})
    return _exit_code(tested)


def _tested(
    cases: Sequence[SuiteCase], out: Path, options: RunOptions, jobs: int
) -> list[CaseResult]:
    """Run all cases, and show how far it is."""
    from bristle.harness.suite.suite import run_suite

    with fraction("test") as tell:
        return run_suite(cases, out, options, jobs, lambda name, done, of: tell(name, done / of))


def _exit_code(tested: Sequence[CaseResult]) -> int:
    verdicts = {each.verdict for each in tested}
    return ERROR if "error" in verdicts else FAIL if "fail" in verdicts else PASS


def _not_run(error: BristleError, junit: Path | None, debug: bool) -> typer.Exit:
    """Print why nothing is run, also into the JUnit file; return what ends the command."""
    from bristle.common.output import replace_each
    from bristle.harness.suite.suite import CaseResult, CasesError, SuiteCase
    from bristle.harness.suite.suite_page import junit as to_junit

    complain_each(error, debug)
    if isinstance(error, CasesError):
        tested, waiting = error.tested, error.waiting
    else:
        tested, waiting = [CaseResult(SuiteCase(Path("suite")), "error", message=str(error))], []
    if junit is not None:
        replace_each({junit: to_junit(tested, waiting)})
    return typer.Exit(ERROR)


def _print(tested: Sequence[CaseResult], quiet: bool, out: Path) -> None:
    """Print a line a scenario, and what does not hold; with `quiet` only that, and the sum."""
    from bristle.harness.suite.suite import by_scenario
    from bristle.harness.suite.suite_page import failures

    for path, runs in by_scenario(tested).items():
        passed = sum(each.verdict == "pass" for each in runs)
        if not quiet or passed < len(runs):
            print(f"{path.stem:<24} {passed} of {len(runs)} pass")
        for each in runs:
            if each.verdict != "pass":
                print(f"  {each.case.name or path.stem}: {'; '.join(failures(each))}")
    passed = sum(each.verdict == "pass" for each in tested)
    print(f"{passed} of {len(tested)} runs pass  {out / 'index.html'}", flush=True)
