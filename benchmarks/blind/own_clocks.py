"""Two files that each start at t = 0: steps, drifts and play before the encoder, as the blind
generator draws them.

    python benchmarks/blind/own_clocks.py [--cases 40] [--jobs 2] [--out out/own_clocks]

Half of the cases have the form of the catalogue and half another one; gap ratios are 2 to 30. The
table goes to benchmarks/results/own_clocks.md. An interrupted run continues with the cases that are
missing.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import run  # sets the threads, before numpy
from cases import STRONG, Spec, draw, write
from score import Judged, judged_cases

from bristle.common.arguments import filled_path

CLOCKS_SEED = "own clocks"
CLOCKS_NAMES = ("disturbance_step", "friction_drift", "encoder_play")
INTRODUCTION = """# Records with clocks of their own

`python benchmarks/blind/own_clocks.py`: two records of 20 s at 1 kHz from the generator of the
blind test, written with times that both begin at 0. What is hidden acts on the time of the session:
a step in the first record stays on in the second, a drift goes on. Half of the cases have another
form than the catalogue. Named right: that effect, or one of its class, and no other.
"""


def specs(count: int) -> list[Spec]:
    """Return so many cases of each effect."""
    kinds = [
        (name, form)
        for k in range(count)
        for name in CLOCKS_NAMES
        for form in (("same", "other")[k % 2],)
    ]
    return [
        Spec(i, form, "single", (name,), form, STRONG) for i, (name, form) in enumerate(kinds, 1)
    ]


def make(spec: Spec, out: Path, target: Path) -> None:
    """Draw a case, and write it with times from 0."""
    import numpy as np  # after the threads are set

    write(draw(CLOCKS_SEED, spec), out)
    for name in ("a.npz", "b.npz"):
        path = out / "cases" / f"{spec.index:05d}" / name
        with np.load(path) as record:
            columns = {key: record[key] for key in record.files}
        np.savez_compressed(path, **columns | {"t": columns["t"] - columns["t"][0]})
    target.touch()


def row(judged: list[Judged], name: str, form: str) -> str:
    """Return a line of the table."""
    mine = [
        j for j in judged if j.answer["effects"][0]["name"] == name and j.answer["group"] == form
    ]
    right, tied = sum(bool(j.right) for j in mine), sum(j.result["verdict"] == "tie" for j in mine)
    wrong, flagged = (
        sum(bool(j.extra) for j in mine),
        sum(j.result.get("remains", {}).get("flag", False) for j in mine),
    )
    return f"| {name} | {form} | {len(mine)} | {right} | {wrong} | {tied} | {flagged} |"


def main() -> None:
    """Make the cases, diagnose them, and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=40, help="cases of each effect")
    parser.add_argument("--out", type=filled_path, default=run.ROOT / "out" / "own_clocks")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    plan = specs(given.cases)
    (given.out / "drawn").mkdir(parents=True, exist_ok=True)
    run.go_on(
        make,
        [(spec, given.out, given.out / "drawn" / f"{spec.index:05d}") for spec in plan],
        given.jobs,
        "draw",
    )
    calls = [
        (given.out / "cases" / f"{s.index:05d}", given.out / "results" / f"{s.index:05d}.json")
        for s in plan
    ]
    run.go_on(run.diagnose_one, calls, given.jobs, "diagnose")
    judged = judged_cases(given.out, [s.index for s in plan])
    head = [
        "| effect | form | cases | named right | a wrong name | tie | residual flagged |",
        "|---|---|---|---|---|---|---|",
    ]
    rows = [row(judged, name, form) for name in CLOCKS_NAMES for form in ("same", "other")]
    table = "\n".join([INTRODUCTION, *head, *rows])
    (run.ROOT / "benchmarks" / "results" / "own_clocks.md").write_text(
        f"{table}\n", encoding="utf-8"
    )
    print("\n".join([*head, *rows]))


if __name__ == "__main__":
    main()
