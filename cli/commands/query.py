"""`bristle query`: SQL on the runs of a sweep."""

from __future__ import annotations

import csv
import math
import sys
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any

import typer

from bristle.cli.app import PASS, DebugOption, app, path_of

StoreArgument = Annotated[
    Path, typer.Argument(help="folder of bristle sweep", metavar="STORE", parser=path_of)
]


@app.command(
    short_help="Ask a store of a sweep in SQL.",
    epilog=(
        'Columns: what varies, and paths of result.json, such as "estimates.alpha2.error_percent",'
        " quoted for their dots."
    ),
)
def query(
    store: StoreArgument,
    sql: Annotated[
        str,
        typer.Argument(
            help=(
                'a query on the table runs, such as "SELECT verdict, count(*) FROM runs GROUP BY 1"'
            )
        ),
    ],
    csv_: Annotated[bool, typer.Option("--csv", help="print as CSV")] = False,
    debug: DebugOption = False,
) -> int:
    """Print what an SQL query (of DuckDB) on the table `runs` gives: one row a run."""
    from bristle.harness.sweep.store import Store

    names, rows = Store(store).query(sql)
    if csv_:
        kept = ([None if _nothing(value) else value for value in row] for row in rows)
        csv.writer(sys.stdout, lineterminator="\n").writerows([names, *kept])
    else:
        print(_table(names, rows), flush=True)
    return PASS


def _table(names: list[str], rows: list[tuple[Any, ...]]) -> str:
    """Return a table of text: numbers on the right."""
    cells = [names, *([_cell(value) for value in row] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    numeric = [
        all(isinstance(row[place], int | float | Decimal | None) for row in rows)
        for place in range(len(names))
    ]
    lines = []
    for line in cells:
        padded = zip(line, widths, numeric, strict=True)
        lines.append(
            "  ".join(
                cell.rjust(width) if right else cell.ljust(width) for cell, width, right in padded
            ).rstrip()
        )
    return "\n".join(lines)


def _nothing(value: object) -> bool:
    return value is None or (isinstance(value, float) and not math.isfinite(value))


def _cell(value: object) -> str:
    if _nothing(value):
        return "-"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
