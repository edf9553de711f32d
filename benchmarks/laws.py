"""Errors of the other adaptation laws (docs/mathematics.md): parameters on S and R, prediction on
L0 and L1, cost a step.

python benchmarks/laws.py            # prints the tables of docs/mathematics.md; --seeds N for fewer
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np
from identification import KNOWN_SERVO, STEP1, STEP2, Case, row
from standard_records import RECORD_STEP, SERVO, record

from bristle.model.native import Native
from bristle.observer import methods, observer_program
from bristle.plant.servo import servo_program

KNOWN_NAMES = ("alpha2", "b")
ADAPTATION_CASES = (
    Case("`luders_narendra`", "luders_narendra", 200.0, STEP1, None, None),
    Case("`kreisselmeier`", "kreisselmeier", 200.0, STEP1, None, None),
    Case(
        "`luders_narendra_position`",
        "luders_narendra_position",
        200.0,
        STEP1,
        None,
        None,
        encoder=True,
    ),
    Case(
        "`kreisselmeier_position`", "kreisselmeier_position", 200.0, STEP1, None, None, encoder=True
    ),
    Case("`marino`", "marino", 200.0, STEP1, None, None, encoder=True),
    Case("`martinez_poznyak`", "martinez_poznyak", 100.0, STEP2, None, None, known=KNOWN_NAMES),
    Case("`drem`", "drem", 100.0, STEP2, None, None, known=KNOWN_NAMES),
    Case(
        "`martinez_poznyak_position`",
        "martinez_poznyak_position",
        100.0,
        STEP2,
        None,
        None,
        encoder=True,
        known=KNOWN_NAMES,
    ),
    Case(
        "`drem_position`",
        "drem_position",
        100.0,
        STEP2,
        None,
        None,
        encoder=True,
        known=KNOWN_NAMES,
    ),
    Case(
        "`two_step_martinez`", "two_step_martinez", 200.0, STEP1 + STEP2, None, None, encoder=True
    ),
    Case("`two_step_drem`", "two_step_drem", 200.0, STEP1 + STEP2, None, None, encoder=True),
)
PREDICTED_METHODS = (
    "martinez_poznyak",
    "drem",
    "besancon",
    "two_step_martinez",
    "two_step_drem",
    "two_step_position",
)
VALIDATION_SEED = 1001  # seed of the record that is predicted


def identified(method: str, plant: str, order: int, seed: int) -> dict[str, float]:
    """Return the last estimates of a method on a record of 100 s (200 s in two steps), with alpha2
    and b given if it needs them.
    """
    data = record(plant, order, seed, 200.0 if method.startswith("two_step") else 100.0)
    inputs = {"u": data["u"], "y_v": data["y_v"], "y_theta": data["encoder"]}
    given = {
        p.name: KNOWN_SERVO[p.symbol]
        for p in methods()[method].parameters
        if "known" in p.description
    }
    names = STEP2 if given else (*KNOWN_NAMES, *STEP2)
    out, _ = Native(observer_program(method), given).run(
        RECORD_STEP, inputs, [f"{name}_hat" for name in names]
    )
    return KNOWN_SERVO | dict(zip(names, out[-1].tolist(), strict=True))


def error_percent(found: dict[str, float], plant: str, order: int) -> float:
    """Return eq. (25) of the modified law with these parameters on the validation record, in open
    loop.
    """
    data = record(plant, order, VALIDATION_SEED, 100.0)
    law = {f"modified.{name}": found[name] for name in STEP2}
    servo = SERVO | {"b": found["b"] * SERVO["J"], "a2": found["alpha2"] * SERVO["J"]} | law
    v = Native(servo_program("modified", encoder=False), servo).run(
        RECORD_STEP, {"u": data["u"]}, ["v"]
    )[0][: len(data["y_v"]), 0]
    return float(100.0 * np.var(data["y_v"][: len(v)] - v) / np.var(data["y_v"]))


def predict(seeds: Sequence[int]) -> None:
    """Print the prediction errors on the original LuGre plant, without and with sigma1."""
    print(
        "\n| eq. (25) in %, median (worst) | L0, order 1 | L0, order 2 | L1, order 1 | L1, order 2"
        " |\n|---|---|---|---|---|"
    )
    for method in PREDICTED_METHODS:
        cells = []
        for plant in ("L0", "L1"):
            for order in (1, 2):
                errors = [
                    error_percent(identified(method, plant, order, seed), plant, order)
                    for seed in seeds
                ]
                cells.append(f"{np.median(errors):.3g} ({np.max(errors):.3g})")
        print(f"| `{method}` | {' | '.join(cells)} |", flush=True)


def cost() -> None:
    """Print the time of a step of each method alone, the shortest of five runs of 200 s."""
    data = record("S", 1, 1, 200.0)
    inputs = {"u": data["u"], "y_v": data["y_v"], "y_theta": data["encoder"]}
    print("\n| method | us/step |\n|---|---|")
    for case in ADAPTATION_CASES:
        instance, times = Native(observer_program(case.method)), []
        for _ in range(5):
            instance.reset()
            begin = time.process_time()
            instance.run(RECORD_STEP, inputs, [])
            times.append(time.process_time() - begin)
        print(f"| {case.name} | {1e6 * min(times) / len(data['u']):.2f} |", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=12, help="seeds 1 to N")
    seeds = range(1, parser.parse_args().seeds + 1)
    print("| | S, order 1 | S, order 2 | R, order 1 | R, order 2 |\n|---|---|---|---|---|")
    for case in ADAPTATION_CASES:
        print(" | ".join(row(case, seeds)[0].split(" | ")[:5]) + " |", flush=True)
    predict(seeds[:6])
    cost()


if __name__ == "__main__":
    main()
