"""Open-loop validation of Approach II on the original LuGre plant over seeds and both orders
(docs/results.md).

python benchmarks/validation.py            # prints the table; exit code 1 if a ratio to Coulomb
exceeds 1/3
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from pathlib import Path

from bristle.harness.run.checked import RunOptions
from bristle.harness.run.run import run

SCENARIO = Path(__file__).resolve().parent.parent / "scenarios" / "lugre_original.toml"
LARGEST_RATIO = 1 / 3


def main() -> int:
    """Run the scenario for each seed and order and print eq. (25) of the model, the baseline and
    the floor.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=12, help="seeds 1 to N")
    seeds = range(1, parser.parse_args().seeds + 1)
    print(
        "| order | seed | model, % | viscous + Coulomb, % | floor, % | model / Coulomb | model /"
        " floor |"
    )
    print("|---|---|---|---|---|---|---|")
    ratios: list[tuple[float, float]] = []
    with tempfile.TemporaryDirectory() as out:
        for order in (1, 2):
            for seed in seeds:
                overrides = (
                    f"controller.parameters.order={order}",
                    f"validation.seed={1000 + seed}",
                )
                found = run(SCENARIO, Path(out), RunOptions(overrides=overrides, seed=seed)).result[
                    "validation"
                ]
                values = [found[f"{name}mse_percent"] for name in ("", "coulomb_", "floor_")]
                ratios.append((found["mse_over_coulomb"], found["mse_over_floor"]))
                cells = " | ".join(f"{x:.4f}" for x in values)
                print(
                    f"| {order} | {seed} | {cells} | {ratios[-1][0]:.3f} | {ratios[-1][1]:.1f} |",
                    flush=True,
                )
    coulomb, floor = zip(*ratios, strict=True)
    print(
        f"\nmodel / Coulomb: median {statistics.median(coulomb):.3f}, worst {max(coulomb):.3f}"
        f" (limit {LARGEST_RATIO:.3f})"
    )
    print(f"model / floor: median {statistics.median(floor):.1f}, worst {max(floor):.1f}")
    return 0 if max(coulomb) <= LARGEST_RATIO else 1


if __name__ == "__main__":
    sys.exit(main())
