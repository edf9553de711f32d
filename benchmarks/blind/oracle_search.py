"""What the search names when the answer is known to it: whether a case that is not right was a
failure of search or of evidence.

    oracle_search.py --out out/blind/HASH [--jobs 2]

Each case with an effect of the catalogue that is not named right is diagnosed again. The effects
that are there are followed from all their starts to the ends, and of an effect in its own form the
true parameters are one more start. All rules stay. What is right now was there to be found, and the
search went past it; what is not, the rules refuse at the truth itself. No search, however good,
names more than this under the same rules. The table is in benchmarks/results/oracle_search.md;
cases go on where they were stopped.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import run  # sets the threads, before numpy
from refused import GROUPS, STANDS, label, standings, stood
from score import Judged

from bristle.common.arguments import filled_path

TARGET = Path(__file__).resolve().parents[1] / "results" / "oracle_search.md"
# beyond this a parameter of an answer means that there is none, such as a stop on one side only
NOWHERE = 1e5


def known_answer(answer: Any) -> dict[str, Any]:
    """Return the search options with which the answer of a case is among the start values, and its
    effects are tried longest.
    """
    truth = {
        effect["name"]: {
            name: value
            for name, value in effect["parameters"].items()
            if value is not None and abs(value) < NOWHERE
        }
        for effect in answer["effects"]
    }
    return {
        "start_values": {name: [values] for name, values in truth.items() if values},
        "exhaustive": tuple(truth),
    }


def diagnose_with_answer(folder: Path, answer: Any, target: Path) -> None:
    """Diagnose one case with its answer known."""
    run.diagnose_one(folder, target, known_answer(answer))


def missed(out: Path) -> list[tuple[Any, Any]]:
    """Return (answer, result) of each case with an effect of the catalogue that is not named
    right.
    """
    return [
        (a, r)
        for a, r in run.answered(out)
        if a["group"] in GROUPS and r["verdict"] != "error" and not Judged(a, r).right
    ]


def table(pairs: Iterable[tuple[Any, Any]], found: Callable[[Any], Any]) -> str:
    """Return the counts by group and form, and a line for each case, of (answer, result) and what
    is `found` knowing the answer.
    """
    judged = [(Judged(answer, found(answer)), result) for answer, result in pairs]
    rows = []
    for key, count in standings((j.answer, j.result) for j, _ in judged).items():
        stands = [count[stand] for stand in STANDS]
        rows.append(
            f"| {label(*key)} | {count['']} | {count[''] - sum(stands)} |"
            f" {' | '.join(map(str, stands))} |"
        )
    lines = []
    for j, result in judged:
        names = [
            ", ".join(each["name"] for each in what["effects"]) or "nothing"
            for what in (j.answer, result, j.result)
        ]
        form = label(j.group, j.answer["effects"][0]["form"])
        lines.append(
            f"| {j.answer['case']} | {form} | {' | '.join(names)} |"
            f" {'right' if j.right else stood(j)} |"
        )
    return "\n".join(
        [
            f"| group | not right | right with the answer known | {' | '.join(STANDS)} |",
            f"|{'---|' * (len(STANDS) + 3)}",
            *rows,
            "",
            (
                "| case | group, form | truth | named | named with the answer known | the missing"
                " one stood |"
            ),
            "|---|---|---|---|---|---|",
            *lines,
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out", type=filled_path, required=True, help="folder of a blind test that is diagnosed"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    a = parser.parse_args()
    pairs = missed(a.out)

    def target(answer: Any) -> Path:
        return Path(a.out) / "answer_known" / f"{answer['case']:05d}.json"

    calls = [(a.out / "cases" / target(answer).stem, answer, target(answer)) for answer, _ in pairs]
    run.go_on(diagnose_with_answer, calls, a.jobs, "answer_known")
    text = f"""# What the search names when the answer is known to it

`python benchmarks/blind/oracle_search.py --out out/blind/{a.out.name}`. Cases that are not named
right, diagnosed again with all starts of the effects that are there followed to their ends and,
where the form is their own, started from the truth as well; and where the missing effect stands
where that does not help:

{table(pairs, lambda answer: json.loads(target(answer).read_text(encoding="utf-8")))}
"""
    TARGET.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
