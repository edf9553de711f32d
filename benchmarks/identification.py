"""Errors and settling times of the observers over seeds 1-12 and both orders of the reference, on
sets S and R (docs/results.md).

python benchmarks/identification.py            # prints the tables; exit code 1 if a limit is missed
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from standard_records import RECORD_STEP, TRUE_PARAMETERS, observe, record

from bristle.model.native import Native
from bristle.observer import observer_program

STEP1 = ("alpha2", "b", "Fc")
STEP2 = ("sigma0", "sigma1", "sigma2", "c")
KNOWN_SERVO = {"alpha2": 2.0, "b": 6.5}


@dataclass(frozen=True)
class Case:
    """One row of the table: an observer, its record, the duration [s], limits of error [%] and
    settling [s] (None: no limit).
    """

    name: str
    method: str
    seconds: float
    names: tuple[str, ...]
    error: float | None
    settling: float | None
    encoder: bool = False
    known: tuple[str, ...] = field(default=())


PAPER_CASES = (
    Case("repaired_step1", "bastin_gevers", 200.0, STEP1, 0.5, 100.0),
    Case("repaired_step2", "besancon", 100.0, STEP2, 3.0, 90.0, known=("alpha2", "b")),
    Case("encoder_rls", "rls", 200.0, STEP1, 1.0, None, encoder=True),
    Case("repaired_two_step, step 1", "two_step", 200.0, STEP1, None, None),
    Case("repaired_two_step, step 2", "two_step", 200.0, STEP2, None, None),
    Case(
        "position, n = 3, known alpha2, b",
        "besancon_position",
        200.0,
        STEP2,
        None,
        None,
        encoder=True,
        known=("alpha2", "b"),
    ),
    Case("encoder_two_step", "two_step_position", 200.0, STEP1 + STEP2, None, None, encoder=True),
)


def run_case(
    case: Case, plant: str, order: int, seed: int, known: dict[str, float] = KNOWN_SERVO
) -> tuple[np.ndarray, np.ndarray]:
    """Return (error at the end in %, last time the error exceeds 5 %) of each parameter."""
    data = record(plant, order, seed, case.seconds)
    if case.encoder:
        data = data | {"y_theta": data["encoder"]}
    return observe(case.method, case.names, data, plant, {name: known[name] for name in case.known})


def row(case: Case, seeds: Sequence[int]) -> tuple[str, bool]:
    """Return the table row of a case and whether it is within the limits."""
    cells, good = [], True
    for plant in TRUE_PARAMETERS:
        for order in (1, 2):
            found = [run_case(case, plant, order, seed) for seed in seeds]
            worst = max(float(np.max(np.abs(error))) for error, _ in found)
            settled = max(float(np.max(times)) for _, times in found)
            good &= bool(worst <= (case.error or np.inf) and settled <= (case.settling or np.inf))
            cells.append(f"{worst:.2f} / {settled:.0f}")
    limit = f"{case.error:g} / {case.settling or '-'}" if case.error else "stated"
    return f"| {case.name} | {' | '.join(cells)} | {limit} | {'yes' if good else 'NO'} |", good


def amplification(seeds: Sequence[int]) -> None:
    """Print the effect of 1 % of error in alpha2 or b on step 2: mean over the seeds (largest), in
    %.
    """
    step2 = next(case for case in PAPER_CASES if case.name == "repaired_step2")
    print(f"\n| wrong by +1 % | {' | '.join(step2.names)} |\n|---|{'---|' * len(step2.names)}")
    for wrong in KNOWN_SERVO:
        for plant in TRUE_PARAMETERS:
            for order in (1, 2):
                disturbed = KNOWN_SERVO | {wrong: 1.01 * KNOWN_SERVO[wrong]}
                moved = [
                    run_case(step2, plant, order, seed, disturbed)[0]
                    - run_case(step2, plant, order, seed)[0]
                    for seed in seeds
                ]
                cells = (
                    f"{m:+.1f} ({w:.0f})"
                    for m, w in zip(np.mean(moved, 0), np.max(np.abs(moved), 0), strict=True)
                )
                print(f"| {wrong}, {plant}, order {order} | {' | '.join(cells)} |", flush=True)


def error_of_b(seeds: Sequence[int]) -> None:
    """Print the error of the b of step 1 while step 2 runs (set S, order 1, after 100 s)."""
    program = observer_program("two_step")
    rms, largest = [], []
    for seed in seeds:
        data = {name: record("S", 1, seed, 200.0)[name] for name in ("u", "y_theta", "y_v")}
        out, _ = Native(program).run(RECORD_STEP, data, ["b_hat"])
        error = 100.0 * (out[round(100.0 / RECORD_STEP) :, 0] / TRUE_PARAMETERS["S"]["b"] - 1.0)
        rms.append(float(np.sqrt(np.mean(error**2))))
        largest.append(float(np.max(np.abs(error))))
    spread = (
        f"rms {min(rms):.3f} to {max(rms):.3f} %, largest {min(largest):.2f} to"
        f" {max(largest):.2f} %"
    )
    print(f"\nerror of b after 100 s, set S, order 1: {spread}")


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=12, help="seeds 1 to N")
    seeds = range(1, parser.parse_args().seeds + 1)
    print(
        "Largest error of any parameter at the end in % / last time an error exceeds 5 % in s,"
        f" worst of seeds 1-{len(seeds)}:\n"
    )
    print(
        "| | S, order 1 | S, order 2 | R, order 1 | R, order 2 | limit | holds"
        " |\n|---|---|---|---|---|---|---|"
    )
    results = []
    for case in PAPER_CASES:
        text, good = row(case, seeds)
        print(text, flush=True)
        results.append(good)
    amplification(seeds)
    error_of_b(seeds)
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
