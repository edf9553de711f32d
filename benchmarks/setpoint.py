"""Servos that are given a goal, by a controller of which nothing is known: names, and ratios.

    python benchmarks/setpoint.py --cases 120 --out out/setpoint > benchmarks/results/setpoint.md

Each pair of records is of a direct drive or a geared motor that follows a goal by a P, PI, PD or
PID controller or a cascade of a position and a velocity loop, with a velocity that is filtered, a
period of 1 ms and, in a third of the cases, a limit of the drive's torque. Goal and position are
logged at 50 to 1000 Hz, by an encoder of 1000 to 131072 counts; no torque is. The damping acts on
the error at 500 and 1000 Hz, else on the position alone. A third of the cases hide nothing, the
others one effect of 0.2 to 2 of Fc. The cases are seeded by the hash of the commit under test. An
interrupted run continues with the cases that are missing in its folder.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

# before numpy: one thread a worker
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")
sys.path.append(str(Path(__file__).resolve().parent / "blind"))

import numpy as np
import scene
import truth
from cases import seed_of
from estimates import KINDS, OFF
from run import go_on, stamp
from scene import Generator, log_uniform
from servos import EFFECTS, Json, judged
from shared import upper_bound, write_json

SERVOS = ("direct drive", "geared motor")
LOOPS = ("P", "PI", "PD", "PID", "cascade")
RATES = (50, 100, 200, 500, 1000)  # Hz, of the log
STRENGTH = (0.2, 2.0)  # of Fc
HIDDEN = tuple(name for name in EFFECTS if name != "input_delay")
RATIOS = ("J", "Fc", "ki", "damping")  # to kp

Fields = dict[str, float]


def controller(rng: Generator, loop: str, plant: Mapping[str, float]) -> Fields:
    """Return a controller as truth.c has it, with what a cascade adds; `damping`: of the servo
    that needs more for this loop.
    """
    omega = 2 * math.pi * log_uniform(rng, 2.0, 10.0)
    damping = 2 * rng.uniform(0.5, 1.1) * plant["J"] * omega
    kp = plant["J"] * omega**2
    gains = {"kp": kp, "ki": 0.0, "kd": 0.0, "filter": rng.uniform(0.5e-3, 2e-3), "back": 0.0}
    if loop in ("PI", "PID"):
        gains["ki"] = kp * rng.uniform(0.5, 3.0)
    if loop in ("PD", "PID", "cascade"):
        gains["kd"] = damping
    else:
        gains["damping"] = damping
    if loop == "cascade":
        outer, inner = kp / damping, damping * rng.uniform(1.0, 5.0)
        gains |= {"kp": kp + inner, "ki": inner * outer, "back": inner}
    return gains


def measured_by(
    rng: Generator, servo: Mapping[str, float], gains: Fields, every: int, rate: bool
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return goal and position of two records; `rate`: the controller uses the goal's rate."""
    records, fc = [], servo["Fc"]
    loop = {key: gains[key] for key in ("kp", "ki", "kd", "filter", "limit")} | {"forward_J": 1.0}
    for start in scene.STARTS:
        reference = scene.rich(rng)
        held = (np.arange(len(reference)) // every) * every
        goal = reference[held, 0]
        speed = np.diff(goal, prepend=goal[0]) / truth.PERIOD if rate else np.zeros(len(goal))
        ahead = -gains["back"] * (goal - goal[0])
        noise = truth.disturbance(rng, len(goal) + 1, gains["disturbance"] * fc)
        asked = np.ascontiguousarray(np.column_stack([goal, speed, ahead]))
        record = truth.run(servo, loop, start, asked, noise)
        records.append((goal[::every], record.theta[::every]))
    return records


def diagnose_one(commit: str, k: int, target: Path) -> None:
    """Draw and diagnose one case, and write what was found beside what is there."""
    from bristle.diagnosis import Model, diagnose, records_from_arrays

    rng = np.random.default_rng(seed_of(commit, f"setpoint {k}"))
    kind, loop, every = str(rng.choice(SERVOS)), LOOPS[k % 5], 1000 // int(rng.choice(RATES))
    true = {name: x * log_uniform(rng, 0.7, 1.3) for name, x in KINDS[kind].parameters.items()}
    gains = controller(rng, loop, true)
    true["a2"] += gains.pop("damping", 0.0)
    limited = rng.random() < 1 / 3
    gains["limit"] = KINDS[kind].limit if limited else math.inf
    gains["disturbance"] = log_uniform(rng, 0.02, 0.06)
    counts = round(log_uniform(rng, 1000, 131072))
    truth.RESOLUTION, truth.CORNER = 2 * math.pi / counts, log_uniform(rng, 0.5, 30.0)
    plant, names = dict(true) | truth.base_friction(true["J"], true["Fc"]), list[str]()
    strength = log_uniform(rng, *STRENGTH)
    if k % 3:
        possible = [name for name in HIDDEN if not (name == "bias" and gains["ki"])]
        names.append(str(rng.choice(possible)))
        plant |= EFFECTS[names[0]](rng, strength * true["Fc"], true, 1.0)
    records = measured_by(rng, plant, gains, every, rate=loop in ("PD", "PID") and every <= 2)
    off = {name: log_uniform(rng, 1 / OFF, OFF) for name in ("a2", "Fc")}
    nominal = {"J": true["J"]} | {name: true[name] * x for name, x in off.items()}
    model = Model.from_dict(
        {
            "friction": "coulomb",
            "parameters": nominal,
            "bounds": {"J": [nominal["J"] / 5, nominal["J"] * 5]}
            | {name: [0.0, 10 * nominal[name]] for name in off},
            "time": {"column": "t", "unit": "s"},
            "input": {"column": "goal", "kind": "setpoint", "unit": "rad"},
            "output": {"column": "y", "kind": "position", "unit": "rad"}
            | {"resolution": truth.RESOLUTION},
        }
    )
    h = every * truth.PERIOD
    columns = [
        (f"run {i}", start + h * np.arange(len(goal)), goal, y)
        for i, (start, (goal, y)) in enumerate(zip(scene.STARTS, records, strict=True))
    ]
    begun = time.perf_counter()
    try:
        found = diagnose(model, records_from_arrays(model, columns)).to_dict()
    except Exception as error:
        found = {"verdict": "error", "error": repr(error), "effects": [], "ties": []}
    own = {"kp": gains["kp"], "ki": gains["ki"], "kd": gains["kd"]}
    drawn = {"kind": kind, "loop": loop, "rate": 1000 // every, "limited": limited}
    facts = {"hidden": names, "strengths": [strength] if names else [], "true": true | own}
    wall = time.perf_counter() - begun
    write_json(target, {**facts, "drawn": drawn | {"counts": counts}, "wall": wall, "found": found})


def ratios(case: Json) -> dict[str, tuple[float, bool]]:
    """Return of each ratio to kp its relative error, and whether its interval covers the truth; a
    damping that controller and servo share is compared as their sum.
    """
    found, true = case["found"].get("parameters", {}), case["true"]
    if "controller.kp" not in found:
        return {}
    kp, told = found["controller.kp"]["value"], {}
    for name, full in (("J", "J"), ("Fc", "coulomb.Fc"), ("ki", "controller.ki")):
        if full in found and true[name]:
            target = true[name] / true["kp"] * kp
            low, high = found[full]["ci95"]
            told[name] = found[full]["value"] / target - 1, low <= target <= high
    damping = (true["a2"] + true["kd"]) / true["kp"] * kp
    both = sum(found[full]["value"] for full in ("a2", "controller.kd") if full in found)
    return told | {"damping": (both / damping - 1, True)}


def rows(cases: Sequence[Json]) -> None:
    """Print the answers by loop, rate, servo and effect."""
    groups: list[tuple[str, Callable[[Json], Any]]] = [
        ("loop:", lambda c: c["drawn"]["loop"]),
        ("rate [Hz]:", lambda c: c["drawn"]["rate"]),
        ("", lambda c: c["drawn"]["kind"]),
        ("limit:", lambda c: "there" if c["drawn"]["limited"] else "none"),
        ("hidden:", lambda c: (c["hidden"] or ["nothing"])[0]),
        ("", lambda c: "all"),
    ]
    print("| | cases | answers |\n|---|---|---|")
    for title, of in groups:
        for value in sorted({of(case) for case in cases}):
            own = [judged(case) for case in cases if of(case) == value]
            kinds = sorted(set(own), key=lambda x: (-own.count(x), x))
            said = "; ".join(f"{x} {own.count(x)}" for x in kinds)
            print(f"| {title} {value} | {len(own)} | {said} |")


def _named(case: Json) -> set[str]:
    return {effect["name"] for effect in case["found"]["effects"]}


def report(cases: Sequence[Json]) -> None:
    """Print the tables."""
    rows(cases)
    hide, nothing = ([c for c in cases if bool(c["hidden"]) is each] for each in (True, False))
    wrong = [case for case in hide if judged(case) == "wrong"]
    bristles = sum("bristle_damping" in _named(case) for case in wrong)
    named = sum(bool(case["found"]["effects"]) for case in nothing)
    print(f"\nA name that is not there: {len(wrong)} of {len(hide)}, at most", end=" ")
    print(
        f"{100 * upper_bound(len(wrong), len(hide)):.1f} % (95 %); {bristles} of them is the",
        end=" ",
    )
    print("damping of bristles, which the friction of this generator has.", end=" ")
    print(f"Controls named: {named} of", end=" ")
    print(
        f"{len(nothing)}.\n\nRatios to the controller's kp, where the answer is right and of",
        end=" ",
    )
    print("controls:\n\n| ratio | cases | within 5 % | median error | intervals that cover |")
    print("|---|---|---|---|---|")
    _ratio_rows(cases)
    seconds = [case["wall"] for case in cases]
    print(f"\nWall time: {np.median(seconds):.0f} s in the median, {max(seconds):.0f} s at most.")


def _ratio_rows(cases: Sequence[Json]) -> None:
    """Print how far the ratios are off, and how often their intervals cover."""
    right = [
        c
        for c in cases
        if judged(c) == "right" or (judged(c) == "nothing named" and not c["hidden"])
    ]
    told = [ratios(case) for case in right]
    for name in RATIOS:
        own = [each[name] for each in told if name in each]
        errors = np.abs([error for error, _ in own])
        covered = "-" if name == "damping" else str(sum(inside for _, inside in own))
        within, median = int(np.sum(errors < 0.05)), 100 * float(np.median(errors))
        print(f"| {name}/kp | {len(own)} | {within} | {median:.1f} % | {covered} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--cases", type=int, default=120)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    commit = stamp(given.out)
    paths = [given.out / f"{k:03d}.json" for k in range(given.cases)]
    go_on(diagnose_one, [(commit, k, path) for k, path in enumerate(paths)], given.jobs, "setpoint")
    print("# Servos that are given a goal\n\n`python benchmarks/setpoint.py", end=" ")
    print(f"--cases {given.cases}`, seeded by the commit {commit}.\n")
    report([json.loads(path.read_text(encoding="utf-8")) for path in paths])


if __name__ == "__main__":
    main()
