"""What each part of the diagnosis is needed for: the same cases without one of them at a time.

    python benchmarks/ablation.py --cases 4 --out out/ablation > benchmarks/results/ablation.md

The cases are those of `servos.py` of a fixed seed, sampled every 1 or 2 ms: nothing hidden, one
effect and three. A part is
left out by giving a constant or a function the value at which it does nothing, so that all else
stays as it is. What makes a suspect of a name is counted in the answers with all parts. An
interrupted run continues with the cases that are missing in its folder.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parent / "blind"))

import estimates
import numpy as np
from run import go_on, stamp
from servos import COUNTS, Json, classes_of, diagnose_one, flagged, judged

SEED = "ablation"
WHOLE = "nothing"
WHAT = ("controls", "singles", "triples")
Results = Mapping[str, Mapping[str, Sequence[Json]]]  # by part and what is hidden
PERIODS = (1e-3, 2e-3)  # s: of these cases; faster records take minutes
LONGEST = 40.0  # s of a core: longest diagnosis that is repeated without each part

# by part: names of constants or functions anywhere in the diagnosis, and what takes their place
PARTS: Mapping[str, Mapping[str, Any]] = {
    WHOLE: {},
    "lengths of segments in proportion to J/a2 (all 0.4 s)": {"SEGMENT_FACTOR": 1e12},
    "t distribution of a segment's misfit (normal)": {"T_DEGREES_OF_FREEDOM": 1e9},
    "coloured disturbance in segments (white sensor noise alone)": {"RATIOS": np.array([1e-4])},
    "noise and parameters in turn (once)": {"NOISE_PASSES": 1, "FAST_NOISE_PASSES": 0},
    "contenders compared under the noise of the best (of each alone)": {"NOISE_ROUNDS": 1},
    "likelihood of sliding motion (segments alone)": {"sliding_fit": lambda *given: None},
    "sliding motion has the last word": {"by_sliding": lambda context, latest: latest},
    "level of chance (a quarter of it)": {"REFIT_FACTOR": 1.0},
    "gain of four standard errors": {"LEAST_ERRORS": -1e9},
    "error falls by 1.2 where the effect acts": {"LEAST_FALL": 0.0},
    "fewer parameters within one standard error": {"SIMPLER_ERRORS": 0.0},
    "ties": {"TIE_NATS": 1e-9, "RIVAL_ERRORS": 0.0},
    "refused at the end of its interval": {"NATS_PER_PARAMETER": math.inf},
    "refused where faint": {"FAINT": 0.0},
    "other forms of an effect": {"retry_with_shape": lambda context, latest: latest},
    "removal of effects beside those after them": {
        "backward_elimination": lambda context, base, level, certain=(): (context.fitted, [])
    },
}


@contextmanager
def without(part: str) -> Iterator[None]:
    """Leave a part out, in all modules of the diagnosis that use it."""
    modules = [m for name, m in sys.modules.items() if name.startswith("bristle.diagnosis")]
    before = []
    for name, value in PARTS[part].items():
        using = [m for m in modules if name in vars(m)]
        if not using:
            raise LookupError(f"the diagnosis has no {name}: mend PARTS")
        before += [(m, name, vars(m)[name]) for m in using]
        for module in using:
            setattr(module, name, value)
    try:
        yield
    finally:
        for module, name, value in before:
            setattr(module, name, value)


def diagnose_without(part: str, what: str, k: int, target: Path) -> None:
    """Diagnose one case without a part, and write what was found."""
    estimates.PERIODS = PERIODS
    with without(part):
        diagnose_one(what, SEED, k, target)


def _read(path: Path) -> Json:
    found: Json = json.loads(path.read_text(encoding="utf-8"))
    return found


def _row(part: str, cases: Mapping[str, Sequence[Json]], base: float) -> str:
    hidden = [judged(case) for what in WHAT[1:] for case in cases[what]]
    answers = Counter(hidden)
    right = answers["right"] + answers["tied with the truth"]
    named = sum(
        len(classes_of(e["name"] for e in c["found"]["effects"]) & classes_of(c["hidden"]))
        for what in WHAT[1:]
        for c in cases[what]
    )
    controls = cases["controls"]
    alarms = sum(bool(c["found"]["effects"]) for c in controls)
    noticed = sum(flagged(c) or bool(c["found"].get("suspects")) for c in controls)
    seconds = sum(c["cpu"] for each in cases.values() for c in each)
    cells = (part, right, answers["wrong"], named, alarms, noticed, f"{seconds / base:.2f}")
    return "| " + " | ".join(map(str, cells)) + " |"


def doubts(cases: Sequence[Json], tell: Callable[[str], None] = print) -> None:
    """Print what the reasons to doubt a name did in the answers with all parts."""
    alone: dict[str, Counter[str]] = {}
    for case in cases:
        codes = {each["code"] for each in case["found"].get("codes", {}).get("doubts", [])}
        suspected = classes_of(e["name"] for e in case["found"].get("suspects", []))
        if not suspected:
            continue
        kind = "wrong" if suspected - classes_of(case["hidden"]) else "true"
        for code in codes:
            alone.setdefault(code, Counter())[kind] += 1
            alone[code][f"{kind} alone"] += len(codes) == 1
    tell("| reason | of a wrong name | alone | of true names | alone |\n|---|---|---|---|---|")
    for code, counts in sorted(alone.items()):
        cells = [counts[key] for key in ("wrong", "wrong alone", "true", "true alone")]
        tell(f"| {code} | " + " | ".join(map(str, cells)) + " |")


def report(results: Results) -> None:
    """Print the table of all parts, and that of the reasons to doubt a name."""
    base = sum(case["cpu"] for each in results[WHOLE].values() for case in each)
    print("| left out | right or tied | a wrong name | effects named | controls named |", end="")
    print(" flagged or suspected | CPU |\n|---|---|---|---|---|---|---|")
    for part, cases in results.items():
        print(_row(part, cases, base))
    print("\nReasons to doubt a name, in the answers with all parts; `alone` where it is the only")
    print("one. Without it, a wrong name would be one in green, and a true one too.\n")
    doubts([case for each in results[WHOLE].values() for case in each])


def _introduce(results: Results, left: int, asked: str) -> None:
    """Print which cases these are, and how many were `left` out."""
    counts = [len(results[WHOLE][what]) for what in WHAT]
    effects = sum(n * COUNTS[what] for n, what in zip(counts, WHAT, strict=True))
    print(f"# What each part of the diagnosis is needed for\n\n{asked}: {counts[0]} cases")
    print(f"without anything hidden, {counts[1]} with one effect and {counts[2]} with three")
    print(f"({effects} effects); {left} others, which take more than {LONGEST:g} s of a core,")
    print("were left out.\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--cases", type=int, default=4, help="of each: " + ", ".join(WHAT))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    commit, folder = stamp(given.out), Path(given.out)

    def path(number: int, what: str, k: int) -> Path:
        return folder / f"{number:02d}_{what}_{k:03d}.json"

    drawn = [(what, k) for k in range(given.cases) for what in WHAT]
    go_on(diagnose_without, [(WHOLE, *each, path(0, *each)) for each in drawn], given.jobs, "whole")
    quick = [each for each in drawn if _read(path(0, *each))["cpu"] <= LONGEST]
    calls = [
        (part, *each, path(number, *each)) for each in quick for number, part in enumerate(PARTS)
    ]
    go_on(diagnose_without, calls, given.jobs, "ablation")
    results: Results = {
        part: {
            what: [_read(path(number, *each)) for each in quick if each[0] == what] for what in WHAT
        }
        for number, part in enumerate(PARTS)
    }
    asked = f"`python benchmarks/ablation.py --cases {given.cases}`, commit {commit}"
    _introduce(results, len(drawn) - len(quick), asked)
    report(results)


if __name__ == "__main__":
    main()
