"""What other thresholds could give: the rank of effects that were missed, and how many rejected
ones were right.

    refused.py --out out/blind/HASH

A rejected effect has four figures: its gain over the level of chance, its gain over that of the
first effect, the factor by which it lowers the mean squared error, and its gain on held-out
segments. All sets of four thresholds are tried with the answers known, so that no rule of this kind
can do better than the table. A threshold cannot find an effect that was not the best of a round. In
the same way: how many wrong names, for effects outside the catalogue, other thresholds of the
unexplained share could flag, and how many right names they would flag too. The tables are in
benchmarks/results/refused.md.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1]))

from forms import class_of
from run import answered
from score import SINGLE, Judged

from bristle.common.arguments import filled_path

REFUSED_TABLES = Path(__file__).resolve().parents[1] / "results" / "refused.md"
GROUPS = (*SINGLE, "pair")
STANDS = (
    "not looked for",
    "not beyond chance",
    "behind another",
    "led and refused",
    "in a tie",
    "no round left",
    "named, one too many",
)


def refused(pairs: Iterable[tuple[Any, Any]]) -> Iterator[tuple[bool, tuple[float, ...]]]:
    """Give of each refused further effect in (answer, result) whether it was missing, and its four
    figures.
    """
    for answer, result in pairs:
        judged, rounds = Judged(answer, result), result["rounds"]
        if (
            answer["group"] not in GROUPS
            or not judged.named
            or len(rounds) < 2
            or rounds[-1]["added"]
        ):
            continue
        last = rounds[-1]
        leader = next((c for c in last["candidates"] if c["name"] == last["rejected"]), None)
        if leader is not None and leader["kept"] is not None:
            figures = (
                last["gain"] / last["null_level"],
                last["gain"] / rounds[0]["gain"],
                last["size"],
                leader["kept"],
            )
            yield class_of(leader["name"]) in judged.missed, figures


def stood(judged: Judged) -> str:
    """Return where the best of the missing effects stood in the last round: one of `STANDS`."""
    missing = set(judged.missed)
    if not judged.result["rounds"]:
        return "not looked for"
    last = judged.result["rounds"][-1]
    if not missing:
        return "named, one too many"
    if judged.tied & missing:
        return "in a tie"
    if last["added"]:
        return "no round left"
    found = [
        c for c in last["candidates"] if class_of(c["name"]) in missing and c["gain"] is not None
    ]
    if last["rejected"] in {c["name"] for c in found}:
        return "led and refused"
    return "behind another" if any(c["gain"] > c["level"] for c in found) else "not beyond chance"


def standings(pairs: Iterable[tuple[Any, Any]]) -> dict[tuple[str, str], Counter[str]]:
    """Count by (group, form) how many cases there are (key "") and where the missing effect of
    those not right stood.
    """
    counts: dict[tuple[str, str], Counter[str]] = {}
    for answer, result in pairs:
        judged = Judged(answer, result)
        if answer["group"] in GROUPS and result["verdict"] != "error":
            count = counts.setdefault((answer["group"], answer["effects"][0]["form"]), Counter())
            count.update(["", *([] if judged.right else [stood(judged)])])
    return {
        key: counts[key]
        for key in sorted(counts, key=lambda key: (GROUPS.index(key[0]), key[1] == "other"))
    }


def label(group: str, form: str) -> str:
    """Return a group and a form in words."""
    return f"{group}, {'own' if form == 'same' else 'other'} form"


def unflagged(pairs: Iterable[tuple[Any, Any]]) -> Iterator[tuple[bool, tuple[float, float]]]:
    """Give of each record that is named without a flag whether its effect is of no catalogue, and
    two shares.

    Records with one effect that is named right are the others. The shares are those of the
    strongest view that is not chance: of what is left, and of the squared error that there was.
    """
    for answer, result in pairs:
        judged, outside = Judged(answer, result), answer["group"] == "outside"
        if (
            judged.named
            and not judged.flagged
            and (outside or (judged.group in SINGLE and judged.right))
        ):
            share = result["remains"]["share"] if result["remains"]["view"] else 0.0
            yield outside, (share, share * result["gap"]["after"] / result["gap"]["before"])


def prices(missing: np.ndarray, figures: np.ndarray) -> dict[int, int]:
    """Return for each number of wanted ones that least values of the figures (n, k) let pass the
    fewest others with them.
    """
    found: dict[int, int] = {}
    for least in itertools.product(
        *(np.unique(np.append(column, -np.inf)) for column in figures[missing].T)
    ):
        passed = (figures >= np.array(least)).all(axis=1)
        right, wrong = int((passed & missing).sum()), int((passed & ~missing).sum())
        found[right] = min(found.get(right, wrong), wrong)
    return dict(sorted(found.items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--out", type=filled_path, required=True, help="folder of a blind test that is diagnosed"
    )
    out = parser.parse_args().out
    pairs = answered(out)
    where = [
        f"| {label(*key)} | {count['']} | {' | '.join(str(count[s]) for s in STANDS)} |"
        for key, count in standings(pairs).items()
    ]
    missing, figures = (np.array(column) for column in zip(*refused(pairs), strict=True))
    rows = [f"| {right} | {wrong} |" for right, wrong in prices(missing, figures).items()]
    foreign, shares = (np.array(column) for column in zip(*unflagged(pairs), strict=True))
    flags = [f"| {wrong} | {right} |" for wrong, right in prices(foreign, shares).items()]
    text = f"""# Effects that were missed, and further ones that were refused

`python benchmarks/blind/refused.py --out out/blind/{out.name}`. Where the missing effect of a case
that is not right stood in the last round of the search; the own and the other form of a pair are
those of both its effects:

| group | n | {" | ".join(STANDS)} |
|---|---|{"---|" * len(STANDS)}
{chr(10).join(where)}

{len(missing)} further effects led the last round of a record with one effect or two and were
refused; {int(missing.sum())} of them were missing. The best that least values of gain over chance,
gain over that of the first effect, size and kept gain could do, chosen with the answers known:

| missing ones named | wrong ones named with them, at least |
|---|---|
{chr(10).join(rows)}

{int(foreign.sum())} records with an effect of no catalogue are named without a flag, and
{int((~foreign).sum())} with one effect are named right without. The best that least shares of what
is left, and of the squared error that there was, could do for a view that is not chance:

| wrong names flagged | right names flagged with them, at least |
|---|---|
{chr(10).join(flags)}
"""
    REFUSED_TABLES.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
