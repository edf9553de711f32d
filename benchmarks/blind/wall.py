"""How long a diagnosis takes on this machine: wall time on all its cores, over cases of the blind
generator.

    python benchmarks/blind/wall.py [--scale 0.02] [--out out/wall]

One case after the other, each twice: the first time compiles what it simulates. Run it on an idle
machine. The table goes to benchmarks/results/wall.md. An interrupted run continues with the cases
that are missing.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))

import numpy as np
import run
from cases import SELECTIONS
from shared import write_json

from bristle.common.arguments import filled_path
from bristle.diagnosis import diagnose, load_model, load_records

WALL_SEED = "wall"
WALL_GOALS = (5.0, 60.0)  # s: median, longest


def wall_seconds(folder: Path) -> tuple[float, float]:
    """Return how long the first and the second diagnosis of a case take [s]."""
    model = load_model(folder / "model.toml")
    records = load_records(model, [folder / "a.npz", folder / "b.npz"])
    times = []
    for _ in range(2):
        started = time.perf_counter()
        diagnose(model, records)
        times.append(time.perf_counter() - started)
    return times[0], times[1]


def wall_row(what: str, seconds: list[float]) -> str:
    """Return a line of the table."""
    median, most = float(np.median(seconds)), max(seconds)
    within = sum(each <= WALL_GOALS[1] for each in seconds)
    return (
        f"| {what} | {len(seconds)} | {median:.1f} | {np.quantile(seconds, 0.9):.1f} | {most:.1f} |"
        f" {within} |"
    )


def main() -> None:
    """Time the cases, and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--scale", type=float, default=0.02, help="of the number of cases of the blind test"
    )
    parser.add_argument("--out", type=filled_path, default=run.ROOT / "out" / "wall")
    given = parser.parse_args()
    run.generate(WALL_SEED, given.out, given.scale, os.cpu_count() or 1, list(SELECTIONS))
    done = given.out / "wall.json"
    found: dict[str, tuple[float, float]] = (
        json.loads(done.read_text(encoding="utf-8")) if done.exists() else {}
    )
    for folder in sorted((given.out / "cases").iterdir()):
        if folder.name not in found:
            found[folder.name] = wall_seconds(folder)
            write_json(done, found)
            print(folder.name, *(f"{each:.1f}" for each in found[folder.name]), flush=True)
    groups = {
        name: json.loads((given.out / "answers" / f"{name}.json").read_text(encoding="utf-8"))[
            "group"
        ]
        for name in found
    }
    kinds = {
        kind: [found[name][1] for name, group in groups.items() if group == kind]
        for kind in sorted(set(groups.values()))
    }
    rows = [
        wall_row("all", [second for _, second in found.values()]),
        *(wall_row(kind, times) for kind, times in kinds.items()),
    ]
    page = WALL_PAGE.format(
        cores=os.cpu_count(),
        rows="\n".join(rows),
        first=np.median([first for first, _ in found.values()]),
    )
    (run.ROOT / "benchmarks" / "results" / "wall.md").write_text(page, "utf-8")
    print("\n".join(rows))


WALL_PAGE = """# How long a diagnosis takes

`python benchmarks/blind/wall.py`: wall time of `diagnose` on a machine with {cores} cores, over
cases of the blind generator (two records of 20 s at 1 kHz each), one after the other. Goals: a
median of 5 s, and at most 60 s.

| cases | number | median [s] | 90 % within [s] | longest [s] | at most 60 s |
|---|---|---|---|---|---|
{rows}

All programs had been compiled: each case was diagnosed twice, and the second time counts. The first
time, in which each new combination of model and effects is compiled, the median was {first:.1f} s;
the first case of all took longest.
"""


if __name__ == "__main__":
    main()
