"""Names on servos of several kinds, in loops of several speeds: with nothing hidden, or with one to
three effects.

    python benchmarks/servos.py --cases 60 --out out/servos > benchmarks/results/servos.md

Each pair of records is of a direct drive, a belt axis or a geared motor in which friction
dominates, in a PID loop of 4 to 40 Hz or driven in open loop, with a disturbance of 3 to 10 % of Fc
and a corner of 0.5 to 30 Hz, an encoder of 1000 to 131072 counts, sampled every 0.25 to 5 ms. An
effect's torque is 0.1 to 2 of Fc, which is from hardly visible to most of the torque. The cases are
seeded by the hash of the commit under test, so that nobody knows them before. An interrupted run
continues with the cases that are missing in its folder.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

# before numpy: one thread a worker
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")
sys.path.append(str(Path(__file__).resolve().parent / "blind"))

import numpy as np
from cases import seed_of
from estimates import draw, measured
from forms import class_of
from run import go_on, stamp
from scene import Generator, log_uniform
from shared import upper_bound, write_json

SERVOS = ("direct drive", "belt axis", "geared motor")
STRENGTH = (0.1, 2.0)  # of Fc
CLEAR = 0.4  # of Fc, from which on an effect is no longer hardly visible
COUNTS = {"controls": 0, "singles": 1, "pairs": 2, "triples": 3}

Fields = dict[str, float]
Json = dict[str, Any]


def _wave(rng: Generator) -> tuple[float, float]:
    return float(rng.integers(3, 41)), float(rng.uniform(-3, 3))


def _sign(rng: Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _cogging(rng: Generator, torque: float, true: Mapping[str, float], unit: float) -> Fields:
    periods, phase = _wave(rng)
    of = {"amplitude": torque, "periods": periods, "phase": phase}
    return {f"cogging_{key}": x for key, x in of.items()}


def _position_friction(
    rng: Generator, torque: float, true: Mapping[str, float], unit: float
) -> Fields:
    periods, phase = _wave(rng)
    of = {"amplitude": min(torque / true["Fc"], 0.8), "periods": periods, "phase": phase}
    return {f"position_friction_{key}": x for key, x in of.items()}


def _stribeck(rng: Generator, torque: float, true: Mapping[str, float], unit: float) -> Fields:
    return {
        "stribeck_excess": torque / true["Fc"],
        "stribeck_speed": log_uniform(rng, 0.1, 1.0) * unit,
    }


# by effect: fields of truth.c, of a torque [N.m], the servo and the unit of time [s]
EFFECTS: dict[str, Callable[[Generator, float, Mapping[str, float], float], Fields]] = {
    "bias": lambda rng, torque, true, unit: {
        "bias_torque": _sign(rng) * min(torque, 0.6 * true["Fc"])
    },
    "cogging": _cogging,
    "gravity": lambda rng, torque, true, unit: {
        "gravity_amplitude": torque,
        "gravity_phase": float(rng.uniform(-3, 3)),
    },
    "position_friction": _position_friction,
    "stribeck": _stribeck,
    "quadratic_drag": lambda rng, torque, true, unit: {
        "quadratic_drag_coefficient": torque / 5.0**2 / unit**2
    },
    "load_friction": lambda rng, torque, true, unit: {
        "load_friction_coefficient": 0.3 * min(torque / true["Fc"], 1.0)
    },
    "input_delay": lambda rng, torque, true, unit: {
        "input_delay_delay": 5e-3 * torque / true["Fc"] / unit
    },
    "gain_asymmetry": lambda rng, torque, true, unit: {
        "gain_asymmetry_share": _sign(rng) * 0.3 * min(torque / true["Fc"], 1.0)
    },
    "torque_ripple": lambda rng, torque, true, unit: {
        "torque_ripple_share": 0.3 * min(torque / true["Fc"], 1.0),
        "torque_ripple_periods": float(rng.integers(1, 13)),
        "torque_ripple_phase": float(rng.uniform(-3, 3)),
    },
}


def hidden(rng: Generator, count: int) -> tuple[str, ...]:
    """Return effects of different classes."""
    return tuple(str(name) for name in rng.choice(list(EFFECTS), count, replace=False))


def diagnose_one(what: str, commit: str, k: int, target: Path) -> None:
    """Draw and diagnose one case, and write what was found beside what is there."""
    from bristle.diagnosis import diagnose

    rng = np.random.default_rng(seed_of(commit, f"servos {what} {k}"))
    names, strengths = hidden(rng, COUNTS[what]), list[float]()

    def hide(true: Mapping[str, float], unit: float) -> Fields:
        fields: Fields = {}
        for name in names:
            strengths.append(log_uniform(rng, *STRENGTH))
            fields |= EFFECTS[name](rng, strengths[-1] * true["Fc"], true, unit)
        return fields

    drawn = draw(rng, SERVOS, hide)
    model, records = measured(rng, drawn)
    begun, cpu = time.perf_counter(), time.process_time()
    try:
        found = diagnose(model, records).to_dict()
    except Exception as error:
        found = {"verdict": "error", "error": repr(error), "effects": [], "ties": []}
    facts = {
        key: getattr(drawn, key) for key in ("kind", "loop", "disturbance", "corner", "counts", "h")
    }
    spent = {"wall": time.perf_counter() - begun, "cpu": time.process_time() - cpu}
    there = {"hidden": names, "strengths": strengths, "true": drawn.true}
    write_json(target, {**there, "drawn": facts, **spent, "found": found})


def judged(case: Json) -> str:
    """Return how right an answer is."""
    found, true = case["found"], classes_of(case["hidden"])
    named = classes_of(effect["name"] for effect in found["effects"])
    tied = [classes_of(tie) for tie in found["ties"]]
    if found["verdict"] == "error":
        return "error"
    if named - true and not any(named - true <= tie and tie & true for tie in tied):
        return "wrong"
    if true and named == true:
        return "right"
    if len(true - named) == 1 and any(true - named <= tie for tie in tied):
        return "tied with the truth"
    return "in part" if named else _unnamed(found, true)


def _unnamed(found: Json, true: set[str]) -> str:
    suspected = classes_of(effect["name"] for effect in found.get("suspects", []))
    if suspected:
        return "suspected" if suspected <= true else "suspected, not there"
    return "nothing named" if found["verdict"] == "none" else "withheld"


def classes_of(names: Iterable[str]) -> set[str]:
    """Return the classes of effects."""
    return {class_of(name) for name in names}


def flagged(case: Json) -> bool:
    """Return whether an answer says that something is missing."""
    found = case["found"]
    return bool(found.get("remains", {}).get("flag")) or found["verdict"] in (
        "tie",
        "not_identifiable",
    )


def _rows(what: str, cases: list[Json]) -> None:
    """Print the answers by kind of servo, loop, strength and effect."""

    def strength(case: Json) -> str:
        weakest = min(case["strengths"], default=math.inf)
        return f"{'below' if weakest < CLEAR else 'above'} {CLEAR} Fc"

    groups: list[tuple[str, Callable[[Json], str]]] = [
        ("", lambda c: c["drawn"]["kind"]),
        ("loop:", lambda c: c["drawn"]["loop"]),
        ("weakest:", strength),
        ("", lambda c: c["hidden"][0] if what == "singles" else ""),
        ("", lambda c: "all"),
    ]
    print("| | cases | answers | flagged |\n|---|---|---|---|")
    for title, of in groups if what != "controls" else (*groups[:2], groups[-1]):
        for value in sorted({of(case) for case in cases} - {""}):
            rows = [case for case in cases if of(case) == value]
            answers = Counter(map(judged, rows)).most_common()
            said = ", ".join(f"{name} {n}" for name, n in answers)
            print(f"| {title} {value} | {len(rows)} | {said} | {sum(map(flagged, rows))} |")


def _found_most(case: Json) -> bool:
    """Return whether all effects but one, or more, were named."""
    named = classes_of(effect["name"] for effect in case["found"]["effects"])
    true = classes_of(case["hidden"])
    return len(named & true) >= len(true) - 1


def report(what: str, cases: list[Json]) -> None:
    """Print the table of one number of hidden effects."""
    print(f"\n## {what.capitalize()}\n")
    _rows(what, cases)
    n, wrong = len(cases), sum(judged(case) == "wrong" for case in cases)
    print(f"\nA name that is not there: {wrong} of {n},", end=" ")
    print(f"at most {100 * upper_bound(wrong, n):.1f} % (95 %).", end=" ")
    if COUNTS[what] > 1:
        most = sum(map(_found_most, cases))
        print(f"All but one, or all, named in {most} of {n}.", end=" ")
    seconds = [case["wall"] for case in cases]
    print(f"Wall time: {np.median(seconds):.1f} s in the median, {max(seconds):.0f} s at most.")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", nargs="*", default=list(COUNTS), help=", ".join(COUNTS))
    parser.add_argument("--cases", type=int, default=60, help="of each")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    if unknown := [what for what in given.what if what not in COUNTS]:
        parser.error(f"{', '.join(unknown)}: choose from {', '.join(COUNTS)}")
    commit = stamp(given.out)
    paths = {w: [given.out / f"{w}_{k:03d}.json" for k in range(given.cases)] for w in given.what}
    # of each in turn, so that an interrupted run has some of all
    calls = [(w, commit, k, paths[w][k]) for k in range(given.cases) for w in given.what]
    go_on(diagnose_one, calls, given.jobs, "servos")
    print("# Names on servos of several kinds\n\n`python benchmarks/servos.py", end=" ")
    print(*given.what, end=" ")
    print(f"--cases {given.cases}`, seeded by the commit {commit}.")
    for what in given.what:
        report(what, [json.loads(path.read_text(encoding="utf-8")) for path in paths[what]])


if __name__ == "__main__":
    main()
