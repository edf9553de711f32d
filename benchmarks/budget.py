"""How well a diagnosis keeps its time budget: wall time over the budget, on cases of
scenarios/hidden.

python benchmarks/budget.py                # prints; run it on an idle machine
python benchmarks/budget.py --publish      # the table goes to benchmarks/results/budget.md too
"""

from __future__ import annotations

import argparse
import re
import time
from pathlib import Path

from bristle.diagnosis import Model, Record, SearchOptions, diagnose, load_model, load_records

ROOT = Path(__file__).resolve().parents[1]
UNTRIED = re.compile(r"effects not tried to the end in the last round: ([^;]*)")
BUDGET_TABLE = ROOT / "benchmarks" / "results" / "budget.md"
BUDGETS = (5.0, 10.0, 20.0)  # s
BUDGETED = ("01", "03", "06", "09", "12", "15")  # cases; 15 is backlash, the costliest effect


def case(name: str) -> tuple[Model, list[Record]]:
    """Return model and records of a hidden case."""
    folder = ROOT / "scenarios" / "hidden" / name
    model = load_model(folder / "model.toml")
    return model, load_records(model, [folder / "a.npz", folder / "b.npz"])


def timed(name: str, budget: float) -> tuple[float, str]:
    """Return the wall time of a diagnosis [s] and what it says it left out."""
    model, records = case(name)
    started = time.perf_counter()
    found = diagnose(model, records, options=SearchOptions(budget=budget))
    seconds = time.perf_counter() - started
    said = next(
        (line.split("used up: ")[1] for line in found.findings if "time budget" in line), "-"
    )
    return seconds, UNTRIED.sub(
        lambda found: f"{len(found[1].split(','))} effects not tried to the end in the last round",
        said,
    )


def budget_table() -> str:
    """Return a row a case: time without a budget, and with each."""
    head = [
        "case",
        "without [s]",
        *(f"{each:g} s" for each in BUDGETS),
        "left out with the smallest",
    ]
    rows, worst = [head, ["---"] * len(head)], 0.0
    for name in BUDGETED:
        timed(name, 1.0)  # programs compiled once
        free, _ = timed(name, float("inf"))
        kept = [timed(name, budget) for budget in BUDGETS]
        shares = [seconds / budget for (seconds, _), budget in zip(kept, BUDGETS, strict=True)]
        worst = max(worst, *shares)
        rows.append([name, f"{free:.1f}", *(f"{share:.2f}" for share in shares), kept[0][1]])
        print(*rows[-1], sep=" | ", flush=True)
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    return f"{table}\n\nLargest wall time over the budget: {worst:.2f} (goal 1.2)."


def main() -> None:
    """Print the table, and publish it if asked."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--publish", action="store_true")
    publish, table = parser.parse_args().publish, budget_table()
    print(table)
    if publish:
        BUDGET_TABLE.write_text(
            f"# Time budgets that are kept\n\n{__doc__}\nColumns: wall time over the"
            f" budget.\n\n{table}\n",
            encoding="utf-8",
        )


if __name__ == "__main__":
    main()
