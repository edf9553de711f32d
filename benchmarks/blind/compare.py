"""Two versions of the rules on the same blind cases: figures side by side, and the cases whose
answers differ.

    compare.py OLD NEW          folders of `run.py diagnose`, from copies of one generated folder

Only cases with a result in both folders count. The tables are printed;
benchmarks/results/criterion.md has those of the criterion.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))

from run import answered
from score import Figure, Judged, figures

from bristle.common.arguments import filled_path


def said(case: Judged) -> str:
    """Return names or verdict of a case, and whether it is flagged."""
    words = " + ".join(e["name"] for e in case.result["effects"]) or str(case.result["verdict"])
    return words + (", flagged" if case.flagged else "")


def truth(case: Judged) -> str:
    """Return what a case hides."""
    return " + ".join(e["name"] for e in case.answer["effects"]) or str(case.answer["variant"])


def value(figure: Figure) -> str:
    """Return a figure as text."""
    return f"{figure.value:.3g}" if figure.count is None else f"{figure.count} of {figure.n}"


def table(old: Sequence[Judged], new: Sequence[Judged]) -> str:
    """Return the figures of both and the cases that differ as markdown."""
    lines = ["| figure | old | new |", "|---|---|---|"]
    lines += [
        f"| {a.name} | {value(a)} | {value(b)} |"
        for a, b in zip(figures(list(old)), figures(list(new)), strict=True)
        if a.n
    ]
    lines += ["", "| case | group | gap ratio | hidden | old | new |", "|---|---|---|---|---|---|"]
    for a, b in zip(old, new, strict=True):
        if said(a) != said(b):
            lines.append(
                f"| {a.answer['case']} | {a.group} | {a.ratio:.1f} | {truth(a)} | {said(a)} |"
                f" {said(b)} |"
            )
    return "\n".join(lines)


def main() -> None:
    """Read the command line and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "folders",
        nargs=2,
        type=filled_path,
        metavar="FOLDER",
        help="that of the old rules, and that of the new ones",
    )
    folders: list[Path] = parser.parse_args().folders
    cases = [
        {answer["case"]: Judged(answer, result) for answer, result in answered(folder)}
        for folder in folders
    ]
    both = sorted(cases[0].keys() & cases[1].keys())
    print(f"{len(both)} cases\n\n" + table(*([each[index] for index in both] for each in cases)))


if __name__ == "__main__":
    main()
