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
    from bristle.harness.suite.suite import CaseResult


@app.command(
    name="test",
    short_help="Run many scenarios, seeds and values, and say what passes.",
    epilog=(
        "Exit code 0: all runs pass; 1: a check does not hold; 2: a scenario cannot be run, and"
        " then none runs."
    ),
)
def suite(
    scenarios: Annotated[
        list[Path], scenario_argument("files, names from bristle list, or folders of them")
    ],
    out: Annotated[
        Path, typer.Option(help="folder for the results", metavar="FOLDER", parser=path_of)
    ] = Path("out/test"),
    seeds: Annotated[
        str | None, typer.Option(help="seeds of the reference: 1-12 or 1,4,7-9", metavar="SEEDS")
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(help="values of a key of the file: a:b:n or [v1, v2]", metavar="PATH=SPEC"),
    ] = None,
    set_: SetOption = None,
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", "-j", help="processes; else one a core", min=1, metavar="N"),
    ] = None,
    kind: KindOption = Kind.native,
    fmi: FmiOption = Fmi.two,
    junit: Annotated[
        Path | None,
        typer.Option(help="file for the verdicts as JUnit", metavar="FILE", parser=path_of),
    ] = None,
    json: Annotated[
        Path | None,
        typer.Option(help="file for the verdicts as JSON", metavar="FILE", parser=path_of),
    ] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="print only what fails, and the sum")
    ] = False,
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
    from bristle.harness.suite.suite import find_cases, run_suite
    from bristle.harness.suite.suite_page import junit as to_junit
    from bristle.harness.suite.suite_page import render, to_tree

    cases = find_cases(
        scenarios,
        () if seeds is None else seeds_of(seeds),
        [values_of(each) for each in vary or ()],
        set_ or (),
    )
    check_files_writable(file for file in (junit, json) if file is not None)
    options = RunOptions(int(fmi.value), kind.value, tuple(set_ or ()), timeout=timeout)
    with output_folder(out):
        try:
            with fraction("test") as tell:
                tested = run_suite(
                    cases,
                    out,
                    options,
                    jobs or os.cpu_count() or 1,
                    lambda name, done, of: tell(name, done / of),
                )
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
    verdicts = {each.verdict for each in tested}
    return ERROR if "error" in verdicts else FAIL if "fail" in verdicts else PASS


def _print(tested: Sequence[CaseResult], quiet: bool, out: Path) -> None:
    """Print a line a scenario, and what does not hold; with `quiet` only the latter, and the
    sum.
    """
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
