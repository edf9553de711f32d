"""The result folder: everything or nothing."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import BristleError
from bristle.common.output import check_page, complain, plain, replace_files, to_json
from bristle.common.signals import table_text
from bristle.harness.run.checked import Clock
from bristle.harness.run.outcome import Outcome
from bristle.harness.run.pictures import pictures_of
from bristle.harness.scenario.plan import RunSetup

RESULT_SUFFIXES = {".json", ".csv", ".html", ".svg"}  # of the files in a result folder
THINNED_ROWS = 2000  # rows of signals.csv unless it is written at full rate


def to_csv(columns: Mapping[str, NDArray[np.float64]], full: bool) -> str:
    """Return signals.csv: time, then numbers (nan where there is none), thinned unless `full`."""
    rows = len(next(iter(columns.values())))
    kept = np.arange(rows) if full else thinned(rows)
    return table_text({name: column[kept] for name, column in columns.items()}, 10)


def thinned(rows: int, kept: int = THINNED_ROWS) -> NDArray[np.intp]:
    """Return which rows of a run are kept where not all are, evenly spread."""
    return np.unique(np.linspace(0, rows - 1, min(rows, kept)).round().astype(np.intp))


@dataclass(frozen=True)
class Missing:
    """Rows that a table of signals lacks: how many of how many, and the first."""

    count: int
    total: int
    first: int


def rows_of(result: Mapping[str, Any]) -> int:
    """Return how many rows a run has at full rate: one a step and the start, if it has one."""
    steps = int(result["steps"])
    return max(steps, 1) if "record" in result else steps + 1


def missing(rows: NDArray[np.int64], needed: NDArray[np.int64]) -> Missing | None:
    """Return what rows lack of those that are needed, shape (n,), both rising; None if nothing."""
    lost = np.setdiff1d(needed, rows, assume_unique=True)
    return Missing(len(lost), len(needed), int(lost[0])) if len(lost) else None


def refuse_strange(target: Path) -> None:
    """Refuse to replace anything but a result folder: one that is empty or holds a result.json and
    only files of such kinds.
    """
    if not target.exists() and not target.is_symlink():
        return
    ours = target.is_dir() and not target.is_symlink()
    if ours and (inside := list(target.iterdir())):
        ours = (target / "result.json").is_file() and all(
            p.is_file() and p.suffix in RESULT_SUFFIXES for p in inside
        )
    if not ours:
        check_page(target, "result.json")
        raise BristleError(
            f"{target}: exists and is no result folder of bristle; write elsewhere or rename the"
            " scenario"
        )


def write(out: Path, name: str, files: Mapping[str, str | bytes]) -> Path:
    """Write all files into `out/name`, replacing what was there only when all of them are written.

    Raises
    ------
    BristleError
        If the folder cannot be written or the disk is full; what was there before is then still
        there.
    """
    target = out / name
    refuse_strange(target)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise complain(out, error) from None
    content = {
        f"{name}/{file}": each.encode() if isinstance(each, str) else each
        for file, each in files.items()
    }
    replace_files(out, content, [name])
    return target


def files_of(
    run_outcome: Outcome, setup: RunSetup, clock: Clock, full: bool
) -> dict[str, str | bytes]:
    from bristle.harness.run.figures import draw
    from bristle.harness.run.run_page import render

    begin = time.perf_counter()
    result, view = run_outcome.result, run_outcome.view
    figures = draw(pictures_of(run_outcome))
    csv = to_csv({"time": view.time, **view.columns()}, full)
    scenario = setup.scenario
    about = {
        "title": scenario.title,
        "shows": scenario.shows,
        "source": scenario.source,
        "limits": scenario.limits,
    }
    # the times go into the report, so they end before it is written
    clock.seconds["report"] = time.perf_counter() - begin
    result["timing"] = {name: round(seconds, 4) for name, seconds in clock.seconds.items()}
    result["wall_s"] = round(math.fsum(clock.seconds.values()), 4)
    files: dict[str, str | bytes] = {f"{name}.svg": svg for name, svg in figures.items()}
    observer = setup.fmus["observer"]
    meanings = {
        name.removesuffix("_hat"): observer.meaning(name)
        for name in observer.names("output")
        if name.endswith("_hat")
    }
    page = render(plain(result), figures, about, meanings, setup.loaded.text)
    return {"result.json": to_json(result), "signals.csv": csv, "report.html": page, **files}
