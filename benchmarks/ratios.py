"""Ratios of speeds against those that were measured before: `results/ratios.json`. All are such
that more is better.

`scripts/bench` prints them as a table and fails if one has fallen by more than a fifth;
`scripts/bench --accept` writes new ones.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from shared import write_json

RATIOS_FILE = Path(__file__).resolve().parent / "results" / "ratios.json"
LARGEST_FALL = 0.2


def judge(part: str, ratios: Mapping[str, float], accept: bool, path: Path = RATIOS_FILE) -> bool:
    """Print the ratios of a part beside the committed ones, and say whether none has fallen too
    far; `accept` commits these.
    """
    kept = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    before = kept.get(part, {})
    print(f"\n| {part}: ratio, more is better | measured | before | |\n|---|---|---|---|")
    good = True
    for name, value in ratios.items():
        known = before.get(name)
        fallen = known is not None and not value >= (1 - LARGEST_FALL) * known
        good = good and not fallen
        shown = "-" if known is None else f"{known:.3g}"
        print(f"| {name} | {value:.3g} | {shown} | {'**fallen**' if fallen else ''} |")
    missing = [name for name in before if name not in ratios]
    for name in missing:
        print(f"| {name} | - | {before[name]:.3g} | not measured |")
    if accept:
        write_json(
            path,
            kept | {part: {name: float(f"{value:.4g}") for name, value in ratios.items()}},
            indent=1,
        )
        return True
    return good
