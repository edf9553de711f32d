"""The search for one setting of both steps that suits sets S and R without values of either
(docs/gains.md).

python benchmarks/gains.py            # prints the tables of docs/gains.md
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence

import numpy as np
from standard_records import TRUE_PARAMETERS, observe, record

STEP1 = ("alpha2", "b", "Fc")
STEP2 = ("sigma0", "sigma1", "sigma2", "c")
GATE_SPEEDS = (75.0, 85.0, 100.0)  # deg/s
STEP1_GAINS = (
    (100.0, 100.0, 200.0),
    (200.0, 200.0, 400.0),
    (400.0, 400.0, 800.0),
    (1000.0, 1000.0, 2000.0),
)
STEP2_SCALES = {
    "600, 800, 300, 150 (S's truth)": (600.0, 800.0, 300.0, 150.0),
    "300, 300, 300, 100": (300.0, 300.0, 300.0, 100.0),
    "500, 500, 500, 50": (500.0, 500.0, 500.0, 50.0),
    "1000, 1000, 1000, 150": (1000.0, 1000.0, 1000.0, 150.0),
    "**1000, 1000, 1000, 100**": (1000.0, 1000.0, 1000.0, 100.0),
    "1000, 1000, 1000, 75": (1000.0, 1000.0, 1000.0, 75.0),
    "2000, 2000, 2000, 200": (2000.0, 2000.0, 2000.0, 200.0),
}
STEP2_GAINS = (1e5, 1e6, 1e7)
STEP2_STARTS = {
    "**300, 300, 300, 100**": (300.0, 300.0, 300.0, 100.0),
    "0, 0, 0, 0": (0.0, 0.0, 0.0, 0.0),
    "100, 100, 100, 30": (100.0, 100.0, 100.0, 30.0),
    "3000, 0, 0, 300": (3000.0, 0.0, 0.0, 300.0),
    "1000, 0, 0, 1000": (1000.0, 0.0, 0.0, 1000.0),
}


def worst(
    method: str,
    names: Sequence[str],
    seconds: float,
    given: Mapping[str, float],
    seeds: Sequence[int],
) -> str:
    """Return "largest error at the end in % / last time an error exceeds 5 %" over S, R, both
    orders and all seeds.
    """
    error, settling = 0.0, 0.0
    for plant in TRUE_PARAMETERS:
        for order in (1, 2):
            for seed in seeds:
                final, late = observe(
                    method, names, record(plant, order, seed, seconds), plant, given
                )
                error, settling = (
                    max(error, float(np.abs(final).max())),
                    max(settling, float(late.max())),
                )
    return f"{error:.2f} / {settling:.0f}"


def cell(given: Mapping[str, float], seeds: Sequence[int]) -> str:
    """Return a cell of the tables of step 2, with alpha2 and b known."""
    return worst("besancon", STEP2, 100.0, {"alpha2": 2.0, "b": 6.5} | dict(given), seeds)


def step1(gate: float, gamma: Sequence[float], seeds: Sequence[int]) -> str:
    """Return a cell of the table of step 1."""
    gains = {f"gamma{i}": value for i, value in enumerate(gamma, start=1)}
    return worst("bastin_gevers", STEP1, 200.0, {"vc": np.deg2rad(gate)} | gains, seeds)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=12, help="seeds 1 to N")
    seeds = range(1, parser.parse_args().seeds + 1)
    print("Scales of S (sigma0, sigma1, sigma2, c) against the overall gain:\n")
    print(
        f"| scales | {' | '.join(f'{gain:.0e}' for gain in STEP2_GAINS)}"
        f" |\n|---|{'---|' * len(STEP2_GAINS)}"
    )
    for name, scales in STEP2_SCALES.items():
        scale = {f"{n}_scale": value for n, value in zip(STEP2, scales, strict=True)}
        print(
            f"| {name} |"
            f" {' | '.join(cell(scale | {'gain': gain}, seeds) for gain in STEP2_GAINS)} |",
            flush=True,
        )
    print("\n| lambda, 1/s | |\n|---|---|")
    for lam in (20.0, 35.0, 50.0, 70.0, 100.0):
        print(f"| {lam:g} | {cell({'lam': lam}, seeds)} |", flush=True)
    print("\n| starts (sigma0, sigma1, sigma2, c) | |\n|---|---|")
    for name, starts in STEP2_STARTS.items():
        start = {f"{n}_start": value for n, value in zip(STEP2, starts, strict=True)}
        print(f"| {name} | {cell(start, seeds)} |", flush=True)
    print(
        f"\n| Gamma of step 1 | {' | '.join(f'gate {gate:g} deg/s' for gate in GATE_SPEEDS)}"
        f" |\n|---|{'---|' * len(GATE_SPEEDS)}"
    )
    for gamma in STEP1_GAINS:
        name = ", ".join(f"{value:g}" for value in gamma)
        print(
            f"| {name} | {' | '.join(step1(gate, gamma, seeds) for gate in GATE_SPEEDS)} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
