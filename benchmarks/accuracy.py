"""Speed against error of the plant FMU, for values of its parameter solver.tolerance: python
benchmarks/accuracy.py

Prints the table of docs/fmus.md: 20 s under the reference controller, the recorded voltage given
again to the lean FMU of each law. The error is the largest difference of the position from a run
with a tolerance of `FINEST`; the time is that of the processor, the best of `REPEATS` runs.
"""

from __future__ import annotations

import time

import numpy as np
from standard_records import RECORD_PLANTS, RECORD_STEP, record

from bristle.fmus import obtain
from bristle.fmus.host import Fmu
from bristle.harness.cosim.drive import Drive

TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 2e-8, 1e-8, 1e-9)
FINEST = 1e-12
SHOWN_PLANTS = ("S", "L0", "L1", "GMS")
RECORD_SECONDS, REPEATS = 20.0, 7


def measured(plant: str) -> list[tuple[float, float]]:
    """Return (largest error of the position [rad], us a step of 1 ms) for each tolerance."""
    law, parameters = RECORD_PLANTS[plant]
    names = [*parameters, "solver.tolerance"]
    u = record(plant, 1, 1, RECORD_SECONDS)["u"][:-1, None]
    drive = Drive(Fmu(obtain("plant", law=law, encoder=False)), ["u"], ["theta"], names)

    def run(tolerance: float) -> tuple[np.ndarray, float]:
        begin = time.process_time()
        [found] = drive.run(u, np.array([[*parameters.values(), tolerance]]), RECORD_STEP)
        return found[:, 0], 1e6 * (time.process_time() - begin) / len(u)

    try:
        exact, _ = run(FINEST)
        rows = []
        for tolerance in TOLERANCES:
            runs = [run(tolerance) for _ in range(REPEATS)]
            rows.append((float(np.max(np.abs(runs[0][0] - exact))), min(cost for _, cost in runs)))
    finally:
        drive.close()
    return rows


def main() -> None:
    """Print the table."""
    found = {plant: measured(plant) for plant in SHOWN_PLANTS}
    print(
        "| solver.tolerance | "
        + " | ".join(f"{plant}, rad | us/step" for plant in SHOWN_PLANTS)
        + " |"
    )
    print("|---" * (1 + 2 * len(SHOWN_PLANTS)) + "|")
    for i, tolerance in enumerate(TOLERANCES):
        cells = [
            f"{error:.0e} | {cost:.2f}"
            for error, cost in (found[plant][i] for plant in SHOWN_PLANTS)
        ]
        print(f"| {tolerance:.0e} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
