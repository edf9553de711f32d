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
    from bristle.harness.run import Options
    from bristle.harness.suite import Case, CaseResult

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
    from bristle.harness.run import Options
    from bristle.harness.suite import find_cases
    from bristle.harness.suite_report import junit as to_junit
    from bristle.harness.suite_report import render, to_tree
    from bristle.harness.values import seeds_of, values_of

    wanted = () if seeds is None else seeds_of(seeds)
    cases = find_cases(scenarios, wanted, [values_of(each) for each in vary or ()], set_ or ())
    check_files_writable(file for file in (junit, json) if file is not None)
    options = Options(int(fmi.value), kind.value, tuple(set_ or ()), timeout=timeout)
    with output_folder(out):
        try:
            tested = _tested(cases, out, options, jobs or os.cpu_count() or 1)
        except BristleError as error:
            complain_each(error, debug)
            raise typer.Exit(ERROR) from None
        origin = {**provenance(), "command": command_line()}
        tree = to_json(to_tree(tested, origin)).encode()
        content = {"suite.json": tree, "index.html": render(tested, origin).encode()}
        replace_files(out, content, list(content))
    _print(tested, quiet, out)
    reports = {json: tree, junit: to_junit(tested)}
    replace_each({path: text for path, text in reports.items() if path is not None})
    return _exit_code(tested)


def _tested(cases: Sequence[Case], out: Path, options: Options, jobs: int) -> list[CaseResult]:
    """Run all cases, and show how far it is."""
    from bristle.harness.suite import run_suite

    with fraction("test") as tell:
        return run_suite(cases, out, options, jobs, lambda name, done, of: tell(name, done / of))


def _exit_code(tested: Sequence[CaseResult]) -> int:
    verdicts = {each.verdict for each in tested}
    return ERROR if "error" in verdicts else FAIL if "fail" in verdicts else PASS


def _print(tested: Sequence[CaseResult], quiet: bool, out: Path) -> None:
    """Print a line a scenario, and what does not hold; with `quiet` only that, and the sum."""
    from bristle.harness.suite import by_scenario
    from bristle.harness.suite_report import failures

    for path, runs in by_scenario(tested).items():
        passed = sum(each.verdict == "pass" for each in runs)
        if not quiet or passed < len(runs):
            print(f"{path.stem:<24} {passed} of {len(runs)} pass")
        for each in runs:
            if each.verdict != "pass":
                print(f"  {each.case.name or path.stem}: {'; '.join(failures(each))}")
    passed = sum(each.verdict == "pass" for each in tested)
    print(f"{passed} of {len(tested)} runs pass  {out / 'index.html'}", flush=True)
