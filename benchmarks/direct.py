"""Errors of the methods without a first step: on sets S and R, on ramps, and on original LuGre
plants (see docs/mathematics.md).

python benchmarks/direct.py --seeds 3          # prints the tables; exit code 1 if a limit is missed
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from standard_records import RECORD_PLANTS, RECORD_STEP, SERVO, TRUE_PARAMETERS, record

from bristle.model.native import Native
from bristle.observer import observer_program
from bristle.plant.servo import servo_program

MODIFIED_PARAMETERS = ("alpha2", "b", "sigma0", "sigma1", "sigma2", "c")
LUGRE_PARAMETERS = ("sigma0", "a0", "a1", "v0", "Fc")
DIRECT_SECONDS = 60.0
EXACT = {"alpha2": 2.0, "b": 6.5}
Data = Mapping[str, NDArray[np.float64]]


def lugre(name: str, sigma0: float, coulomb: float, static: float, v0: float) -> dict[str, float]:
    """Add an original LuGre plant without bristle damping (1/s2, rad/s2, rad/s2, deg/s), and return
    its true parameters.
    """
    values = {
        "sigma0": sigma0 / 1e3,
        "sigma1": 0.0,
        "Fc": coulomb / 1e3,
        "Fs": static / 1e3,
        "vs": math.radians(v0),
    }
    RECORD_PLANTS[name] = (
        "lugre",
        SERVO | {f"lugre.{key}": value for key, value in values.items()},
    )
    falls = {"a0": coulomb / sigma0, "a1": (static - coulomb) / sigma0}
    return EXACT | {"sigma0": sigma0, "Fc": coulomb, "v0": math.radians(v0)} | falls


TRUTH = TRUE_PARAMETERS | {
    "L0": lugre("L0", 800.0, 4.0, 7.2, 25.0),
    "soft": lugre("soft", 300.0, 6.0, 9.0, 10.0),
    "stiff": lugre("stiff", 5000.0, 3.0, 4.0, 50.0),
    "rigid": lugre("rigid", 20000.0, 3.0, 6.0, 20.0),
}


def ramps(plant: str, seed: int) -> dict[str, NDArray[np.float64]]:
    """Drive a plant with a voltage linear between knots 50 ms apart, held over a twentieth of a
    sample only.
    """
    law, parameters = RECORD_PLANTS[plant]
    n, fine = round(DIRECT_SECONDS / RECORD_STEP), 20
    knots = 3.0 * np.random.default_rng(seed).standard_normal(round(DIRECT_SECONDS / 0.05) + 1)
    knots[0] = 0.0

    def voltage(t: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        return np.asarray(np.interp(t, 0.05 * np.arange(len(knots)), knots))

    out, _ = Native(servo_program(law), parameters).run(
        RECORD_STEP / fine,
        {"u": voltage((np.arange(n * fine) + 0.5) * RECORD_STEP / fine)},
        ["theta", "v"],
    )
    theta, v = np.ascontiguousarray(out[:-1:fine].T)
    return {"u": voltage(np.arange(n) * RECORD_STEP), "y_theta": theta, "y_v": v}


@dataclass(frozen=True)
class Case:
    """One row: a method, its record, given parameters (without its name), and the limit of the
    error [%] (None: no limit).
    """

    name: str
    method: str
    plants: tuple[str, ...]
    names: tuple[str, ...] = MODIFIED_PARAMETERS
    given: Mapping[str, float] = field(default_factory=dict)
    source: str = "velocity"  # or encoder, ramps
    error: float | None = None


S_AND_R = ("S", "R")
DIRECT_CASES = (
    Case("swapped", "swapped", S_AND_R, error=1.0),
    Case("swapped_position, encoder", "swapped_position", S_AND_R, source="encoder", error=6.0),
    Case("swapped on L0 (alpha2, b, Fc)", "swapped", ("L0",), ("alpha2", "b", "Fc"), error=1.0),
    Case(
        "swapped_position on L0, encoder",
        "swapped_position",
        ("L0",),
        ("alpha2", "b", "Fc"),
        source="encoder",
        error=2.0,
    ),
    Case("approach_one", "approach_one", S_AND_R),
    Case("approach_one, ramps", "approach_one", S_AND_R, source="ramps"),
    Case("approach_one_smooth", "approach_one_smooth", S_AND_R),
    Case("approach_one_smooth, ramps", "approach_one_smooth", S_AND_R, source="ramps", error=6.0),
    Case("cao", "cao", ("L0", "stiff", "rigid"), LUGRE_PARAMETERS, EXACT, error=3.0),
    Case("cao", "cao", ("soft",), LUGRE_PARAMETERS, EXACT),
    Case("cao, b + 0.3 %", "cao", ("L0",), LUGRE_PARAMETERS, EXACT | {"b": 6.5195}),
    Case("cao, b + 1 %", "cao", ("L0",), LUGRE_PARAMETERS, EXACT | {"b": 6.565}),
    Case("cao, alpha2 + 1 %", "cao", ("L0",), LUGRE_PARAMETERS, EXACT | {"alpha2": 2.02}),
    Case("cao, lower level alone", "cao", ("L0",), LUGRE_PARAMETERS, EXACT | {"narrowing": 0.0}),
)


@dataclass(frozen=True)
class Reached:
    """Largest error at the end, last time an error exceeds 5 %, worst error while valid, share of
    time all are valid.
    """

    error: float
    settling: float
    valid_error: float
    valid_share: float
    microseconds: float


observer = lru_cache(observer_program)


def reach(case: Case, data: Data, plant: str) -> Reached:
    """Run a method over a record."""
    truth = np.array([TRUTH[plant][name] for name in case.names])
    given = {f"{case.method}.{name}": value for name, value in case.given.items()}
    instance = Native(observer(case.method), given)
    wanted = [f"{name}_{what}" for what in ("hat", "valid") for name in case.names]
    begin = time.perf_counter()
    out, _ = instance.run(RECORD_STEP, {key: data[key] for key in ("u", "y_theta", "y_v")}, wanted)
    spent = 1e6 * (time.perf_counter() - begin) / (len(out) - 1)
    error = np.abs(100.0 * (out[1:, : len(truth)] / truth - 1.0))
    valid = out[1:, len(truth) :] > 0
    late = np.flatnonzero(~(error <= 5.0).all(axis=1))
    worst = float(error[valid].max()) if valid.any() else math.nan
    settling = float((late[-1] + 1) * RECORD_STEP) if len(late) else 0.0
    return Reached(float(error[-1].max()), settling, worst, float(valid.all(axis=1).mean()), spent)


def seen(case: Case, plant: str, order: int, seed: int) -> Data:
    """Return the record of a case."""
    if case.source == "ramps":
        return ramps(plant, seed + 100 * (order - 1))
    data = record(plant, order, seed, DIRECT_SECONDS)
    return data | {"y_theta": data["encoder"]} if case.source == "encoder" else data


def row(case: Case, seeds: Sequence[int]) -> tuple[str, bool]:
    """Return the table rows of a case, one a plant, and whether it is within the limit."""
    lines, good = [], True
    for plant in case.plants:
        found = {
            order: [reach(case, seen(case, plant, order, seed), plant) for seed in seeds]
            for order in (1, 2)
        }
        cells = []
        for each in found.values():
            worst, settled = max(r.error for r in each), max(r.settling for r in each)
            good &= worst <= (case.error or math.inf)
            cells.append(f"{worst:.3g} / {settled:.1f}")
        cells += both_orders([r for each in found.values() for r in each])
        limit = "stated" if case.error is None else f"{case.error:g}"
        lines.append(f"| {case.name} | {plant} | {' | '.join(cells)} | {limit} |")
    return "\n".join(lines), good


def both_orders(reached: Sequence[Reached]) -> list[str]:
    """Return the cells of both orders: error of what is valid, how much is valid, cost."""
    valid = "-"
    if any(r.valid_share for r in reached):
        valid = f"{np.nanmax([r.valid_error for r in reached]):.3g}"
    share = f"{100 * min(r.valid_share for r in reached):.0f}"
    return [valid, share, f"{min(r.microseconds for r in reached):.2f}"]


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=12, help="seeds 1 to N")
    seeds = range(1, parser.parse_args().seeds + 1)
    print(
        f"{DIRECT_SECONDS:g} s. Largest error of any parameter at the end in % / last time an error"
        " exceeds 5 %, in s;"
    )
    print(
        f"worst of seeds 1-{len(seeds)}. Valid: worst error while valid in %, least share of the"
        " time in which all are, in %.\n"
    )
    print(
        "| | plant | order 1 | order 2 | valid error | valid share | us/step | limit"
        " |\n|---|---|---|---|---|---|---|---|"
    )
    results = []
    for case in DIRECT_CASES:
        text, good = row(case, seeds)
        print(text, flush=True)
        results.append(good)
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
