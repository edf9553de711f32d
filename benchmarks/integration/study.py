"""Print the tables of README.md: accuracy and cost against the tolerance, and where explicit
Runge-Kutta fails.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from bristle.model.native import Native
from bristle.model.program import Program
from bristle.plant.servo import servo_program

sys.path.insert(0, str(Path(__file__).parent))
import reference
from reference import REFERENCE_PLANTS, Array, Feedback, Plant

RUN_STEPS = 20_000
TOLERANCES = (1e-6, 1e-7, 5e-8, 2e-8, 1e-8, 5e-9, 2e-9, 1e-9)
ERROR_LIMITS = np.array([1e-6, 1e-6, 1e-5])
PROGRAMS: dict[str, Program] = {
    law: servo_program(law) for law in {plant.law for plant in REFERENCE_PLANTS.values()}
}


def simulate(
    plant: Plant, feedback: Feedback, n: int, tolerance: float
) -> tuple[Array, float, float]:
    """Return (states at 0..n, internal steps a step, microseconds a step of the same voltages in
    one native run).
    """
    program = PROGRAMS[plant.law]
    native = Native(program, plant.parameters | {"solver.tolerance": tolerance})
    states = [
        program.index[name]
        for name in (f"{plant.law}.theta", f"{plant.law}.v", plant.friction_state)
    ]
    x, u, v = np.zeros((n + 1, 3)), np.empty(n), native.values
    for k in range(n):
        v[program.index["u"]] = u[k] = feedback(k, x[k, 0], x[k, 1])
        native.write(v)
        native.advance(reference.REFERENCE_STEP)
        v = native.values
        x[k + 1] = v[states]
    steps = native.steps / n
    best = np.inf
    for _ in range(3):
        native.reset()
        begin = time.perf_counter()
        native.run(reference.REFERENCE_STEP, {"u": u}, ["v"])
        best = min(best, time.perf_counter() - begin)
    return x, steps, 1e6 * best / n


def accuracy() -> None:
    """Print what each tolerance reaches and costs over all sets and scenarios, and the details of
    the default.
    """
    default = PROGRAMS["lugre"].starts[PROGRAMS["lugre"].index["solver.tolerance"]]
    rows: dict[float, list[tuple[float, str, float, float]]] = {
        tolerance: [] for tolerance in TOLERANCES
    }
    details = []
    for name, plant in REFERENCE_PLANTS.items():
        for scenario, make in reference.scenarios(name, RUN_STEPS).items():
            expected, _ = reference.solve(plant, make(), RUN_STEPS)
            looser, _ = reference.solve(plant, make(), RUN_STEPS, rtol=1e-11)
            size = np.ptp(expected, axis=0)
            sure = np.max(np.max(np.abs(looser - expected), axis=0) / size / ERROR_LIMITS)
            for tolerance in TOLERANCES:
                x, steps, cost = simulate(plant, make(), RUN_STEPS, tolerance)
                error = np.max(np.abs(x - expected), axis=0) / size
                margin = float(np.min(ERROR_LIMITS / error))
                rows[tolerance].append((margin, f"{name} {scenario}", steps, cost))
                if tolerance == default:
                    cells = " | ".join(f"{e:.1e}" for e in error)
                    details.append(
                        f"| {name} | {scenario} | {cells} | {margin:.1f} | {sure:.3f} | {steps:.1f}"
                        f" | {cost:.2f} |"
                    )
    print(
        "| tolerance | worst margin | where | steps a ms, mean (most) | us a ms, mean (most) | us a"
        " step |"
    )
    print("|---|---|---|---|---|---|")
    for tolerance, found in rows.items():
        margin, where, _, _ = min(found)
        each, micros = [row[2] for row in found], [row[3] for row in found]
        means = (
            f"{np.mean(each):.1f} ({max(each):.1f}) | {np.mean(micros):.2f} ({max(micros):.2f}) |"
            f" {sum(micros) / sum(each):.2f}"
        )
        print(f"| {tolerance:.0e} | {margin:.1f} | {where} | {means} |")
    print(f"\nAt the default, {default:.0e}:\n")
    print("| set | scenario | theta | v | z or w | margin | doubt | steps a ms | us a ms |")
    print("|---|---|---|---|---|---|---|---|---|")
    print("\n".join(details))


def explicit() -> None:
    """Print the speed after a constant voltage from rest: reference, ours, explicit Runge-Kutta of
    order 4 at 0.25 ms.
    """
    print("| set | voltage (force) | after, s | reference | ours | RK4 at 0.25 ms |")
    print("|---|---|---|---|---|---|")
    cases = [
        ("S", 24.0, 5.0),
        ("R", 24.0, 5.0),
        ("L0", 17.0, 5.0),
        ("L0", 18.0, 5.0),
        ("L1", 17.0, 5.0),
        ("L1", 18.0, 5.0),
    ]
    cases += [("L1", 20.0, 5.0), ("L1", 22.0, 5.0), ("T", 1.2, 20.0), ("T", 5.0, 20.0)]
    for name, volts, seconds in cases:
        plant, n = REFERENCE_PLANTS[name], round(seconds / reference.REFERENCE_STEP)
        tight, _ = reference.solve(plant, lambda *_, volts=volts: volts, n)
        program = PROGRAMS[plant.law]
        ours, _ = Native(program, plant.parameters).run(
            reference.REFERENCE_STEP, {"u": np.full(n, volts)}, ["v"]
        )
        rk4 = reference.rk4(plant, volts, seconds)[1]
        print(
            f"| {name} | {volts:g} | {seconds:g} | {tight[-1, 1]:.6g} | {ours[-1, 0]:.6g} |"
            f" {rk4:.6g} |"
        )


if __name__ == "__main__":
    accuracy()
    print()
    explicit()
