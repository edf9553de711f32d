"""What lies between two positions, of motor and load: named, and its size.

    python benchmarks/two_positions.py --cases 60 > benchmarks/results/two_positions.md

Each pair of records is of a direct drive of the blind test's simulator in its loop, with a load
behind a play of 5 to 200 steps, a compliance of 5 to 60 N.m/rad, an eccentric encoder of 3 to 100
steps, a play and an eccentric encoder, or nothing; both encoders have 4000 to 131072 counts. In the
simulator all friction acts on the motor, so that the load flies freely through its play.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parent / "blind"))

import numpy as np
import scene
import truth
from scene import Generator, log_uniform

from bristle.diagnosis import Model, records_from_arrays
from bristle.diagnosis.answer import BetweenSensors
from bristle.diagnosis.between.two_positions import between_sensors

KINDS = (
    ("backlash",),
    ("compliance",),
    ("eccentric_encoder",),
    ("backlash", "eccentric_encoder"),
    (),
)
SIZES = {"backlash": "play", "compliance": "frequency", "eccentric_encoder": "amplitude"}
DISTURBANCE = 0.03  # rms over Fc
NEAR = 0.05  # of a size: what counts as right


@dataclass(frozen=True)
class Case:
    """A case: what is between the positions, with sizes, what was found, and seconds."""

    true: Mapping[str, float]
    found: BetweenSensors
    seconds: float

    @property
    def placed(self) -> bool:
        """Whether exactly what is there was found."""
        return set(self.true) == set(self.found.parts)

    def error(self, name: str) -> float:
        """Return the relative error of a size."""
        return self.found.parts[name][SIZES[name]].value / self.true[name] - 1

    def covers(self, name: str) -> bool:
        """Whether the interval of a size covers the truth."""
        low, high = self.found.parts[name][SIZES[name]].ci95 or (math.nan, math.nan)
        return low <= self.true[name] <= high


def place_of_the_load() -> int:
    """Return where the simulator's states hold the position of the load."""
    text = (Path(__file__).resolve().parent / "blind" / "truth.c").read_text(encoding="utf-8")
    [names] = re.findall(r"enum \{ ([^}]*) \}", text)
    return [name.strip() for name in names.split(",")].index("THETA_LOAD")


def drawn(rng: Generator, kind: tuple[str, ...]) -> Case:
    """Return a case of a kind."""
    base = {"J": 0.01, "a2": 0.02, "Fc": 0.12}
    base = {name: x * log_uniform(rng, 0.7, 1.3) for name, x in base.items()}
    step = 2 * math.pi / round(log_uniform(rng, 4000, 131072))
    plant, true = base | truth.base_friction(base["J"], base["Fc"]), dict[str, float]()
    share = rng.uniform(0.3, 0.7)
    if "backlash" in kind:
        true["backlash"] = log_uniform(rng, 5 * step, min(200 * step, 0.04))
        contact = {"stiffness": log_uniform(rng, 100, 400), "dissipation": 0.3, "share": share}
        plant |= {f"backlash_{key}": x for key, x in contact.items()}
        plant["backlash_play"] = true["backlash"]
    if "compliance" in kind:
        stiffness = log_uniform(rng, 5, 60)
        own = {"share": share, "stiffness": stiffness, "damping": 0.01}
        plant |= {f"compliance_{key}": x for key, x in own.items()}
        true["compliance"] = math.sqrt(stiffness / (share * base["J"])) / (2 * math.pi)
    if "eccentric_encoder" in kind:
        true["eccentric_encoder"] = log_uniform(rng, 3 * step, min(100 * step, 0.02))
    truth.RESOLUTION, truth.CORNER = step, log_uniform(rng, 0.5, 30.0)
    loop, phase = scene.draw_loop(rng, base), rng.uniform(-3, 3)
    columns = []
    for k, start in enumerate(scene.STARTS):
        reference = scene.rich(rng)
        noise = truth.disturbance(rng, len(reference) + 1, DISTURBANCE * base["Fc"])
        record = truth.run(plant, loop, start, reference, noise)
        coupled = "backlash" in kind or "compliance" in kind
        load = record.states[:, place_of_the_load() if coupled else 0]
        load = load + true.get("eccentric_encoder", 0.0) * np.sin(load + phase)
        time_ = start + truth.PERIOD * np.arange(len(load))
        known = {"load": step * np.floor(load / step)}
        columns.append((f"run {k}", time_, record.u, record.theta, known))
    model = Model.from_dict(
        {
            "friction": "coulomb",
            "parameters": base,
            "time": {"column": "t", "unit": "s"},
            "input": {"column": "u", "kind": "torque", "unit": "N.m"},
            "output": {"column": "y", "kind": "position", "unit": "rad", "resolution": step}
            | {"load": {"column": "load", "unit": "rad"}},
        }
    )
    records = records_from_arrays(model, columns)
    begun = time.perf_counter()
    found = between_sensors(model, records)
    assert found is not None
    return Case(true, found, time.perf_counter() - begun)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    cases = []
    for k in range(given.cases):
        kind = KINDS[k % len(KINDS)]
        cases.append(drawn(np.random.default_rng([given.seed, k]), kind))
        print(f"{k + 1} of {given.cases}", file=sys.stderr, end="\r", flush=True)
    print("# What lies between two positions\n")
    print(
        f"`python benchmarks/two_positions.py --cases {given.cases} --seed {given.seed}`:", end=" "
    )
    print("\n\n".join(__doc__.split("\n\n")[2:]))
    report(cases)


def report(cases: list[Case]) -> None:
    """Print the tables."""
    print("| between the positions | cases | exactly that found |\n|---|---|---|")
    for kind in (*KINDS, None):
        own = [c for c in cases if kind is None or set(c.true) == set(kind)]
        name = "all" if kind is None else " and ".join(kind) or "nothing"
        print(f"| {name} | {len(own)} | {sum(c.placed for c in own)} |")
    print("\n| size, where found | cases | within 5 % | median error | intervals that cover |")
    print("|---|---|---|---|---|")
    for name, size in SIZES.items():
        own = [c for c in cases if name in c.true and name in c.found.parts]
        errors = np.abs([c.error(name) for c in own])
        row = [f"{size} of {name}", len(own), int(np.sum(errors < NEAR))]
        row += [f"{100 * np.median(errors):.1f} %", sum(c.covers(name) for c in own)]
        print("| " + " | ".join(map(str, row)) + " |")
    seconds = [c.seconds for c in cases]
    print(f"\nTime: {np.median(seconds):.1f} s in the median, {max(seconds):.1f} s at most.")


if __name__ == "__main__":
    main()
