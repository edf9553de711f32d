"""`bristle compare`: a run against a reference."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from bristle.cli.app import FAIL, PASS, DebugOption, app, path_of
from bristle.cli.terminal import command_line

FirstArgument = Annotated[
    Path,
    typer.Argument(
        help="baseline, or result folder of bristle run --full", metavar="A", parser=path_of
    ),
]
SecondArgument = Annotated[
    Path,
    typer.Argument(help="result folder of bristle run, or baseline", metavar="B", parser=path_of),
]
OutOption = Annotated[
    Path, typer.Option(help="folder for the report", metavar="FOLDER", parser=path_of)
]
JsonOption = Annotated[
    Path | None,
    typer.Option(help="file for the verdicts as JSON", metavar="FILE", parser=path_of),
]


@app.command(
    short_help="Judge a run against a reference.",
    epilog=(
        "A is a baseline of bristle accept, with measured tolerances, or a result folder of bristle"
        " run, of which only the written digits are open. Exit code 0: B is where A allows it to"
        " be; 1: it differs; 2: an error."
    ),
)
def compare(
    first: FirstArgument,
    second: SecondArgument,
    out: OutOption = Path("out/compare"),
    json: JsonOption = None,
    debug: DebugOption = False,
) -> int:
    """Say whether run B is the same as reference A, signal by signal and in what the servo did;
    write FOLDER/compare.html.
    """
    from bristle.common.output import check_not_replaced, replace_file
    from bristle.harness.baseline.comparison import compare_folders, write_comparison
    from bristle.harness.baseline.verdicts import comparison_json, counts, differences

    if json is not None:
        check_not_replaced(
            json.parent,
            [json.name],
            [path for folder in (first, second) for path in folder.glob("*")],
        )
    found = replace(compare_folders(first, second), command=command_line())
    report = write_comparison(found, out)
    if json is not None:
        replace_file(json, comparison_json(found))
    inside, judged = counts(found.signals)
    same = [each.passed for each in found.quantities if each.passed is not None]
    verdict = "pass" if found.passed else "differs"
    instants = f"at {found.rows} of {found.instants} instants"
    print(
        f"{found.scenario:<24} {verdict}  {inside} of {judged} signals {instants}, {sum(same)} of"
        f" {len(same)} numbers  {report}"
    )
    for line in differences(found):
        print(f"  {line}")
    for line in found.notes:
        print(f"  - {line}")
    return PASS if found.passed else FAIL
