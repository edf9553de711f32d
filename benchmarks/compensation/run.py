"""Tracking error with friction compensation by every observer on every friction law;
docs/study/compensation.md.

python benchmarks/compensation/run.py              # all observers, laws and seeds; resumes
python benchmarks/compensation/run.py --pages      # only the page, from the results so far
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from inspect import getsource
from multiprocessing import get_context
from pathlib import Path
from typing import Any

# before numpy: one thread a worker
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
from compensation_page import WAYS, publish
from rich.progress import track
from shared import write_json

from bristle.common.cache import cache_folder, digest
from bristle.fmus import obtain
from bristle.fmus.build import program_of
from bristle.fmus.host import Fmu
from bristle.harness.cosim.bus import Bus, BusUnit, Port
from bristle.harness.cosim.loop import simulate
from bristle.model.normalised import OBSERVED
from bristle.model.sources import fingerprint
from bristle.observer import methods, observer_program
from bristle.observer.method import observer
from bristle.plant.friction import laws
from bristle.plant.servo import servo_program

Json = dict[str, Any]
COMPENSATION_STEP = 1e-3  # s
IDENTIFICATION = 100.0  # s at full speed before
PHASE = 20.0  # s at each of the speeds
SETTLED_AFTER = 5.0  # s of a phase that do not count
FULL_SPEED = 120.0  # deg/s rms, the controller's default
SPEEDS = (60.0, 15.0)  # deg/s rms, one phase each
SEEDS = 1  # references
ORDER = 2.0  # of the reference, whose acceleration is then finite
WRONG_PARAMETERS = {  # factors on the true alpha2, b and Fc, or a load that is not there [rad/s2]
    "b / 3": {"b": 1 / 3},
    "b x 3": {"b": 3.0},
    "Fc x 4": {"Fc": 4.0},
    "Fc x -1": {"Fc": -1.0},
    "alpha2 x 20": {"alpha2": 20.0},
    "load of 5 rad/s2": {"load": 5.0},
}
ALONE, LINEAR, TRUE = "controller alone", "true b and alpha2", "all true parameters"
"""What the observers are compared with: nothing, what a linear model needs, and all that the law
has of what is compensated.
"""


@cache
def fmu(name: str) -> Fmu:
    """Return a built FMU."""
    return Fmu(obtain(name))


def studied() -> list[str]:
    """Return the methods that estimate the drive gain, without which nothing is compensated, and
    get no true values.
    """
    found = []
    for name, method in methods().items():
        outputs = {
            variable.name: expression for variable, expression in observer(method).outputs.values()
        }
        if not outputs["b_hat"].is_constant() and not any(
            p.description.endswith("known") for p in method.parameters
        ):
            found.append(name)
    return found


def truth(law: str) -> dict[str, float]:
    """Return the true normalised parameters that a law has, at its defaults."""
    plant = fmu("plant")
    bus = Bus(
        (BusUnit("plant", plant, {"law": plant.choices("law")[law]}),),
        1,
        COMPENSATION_STEP,
        flags=tuple(("plant", name) for name in plant.variables if name.startswith("true.")),
    )
    flags = simulate(bus).flags.last
    return {
        name: flags["plant", f"true.{name}"]
        for name in OBSERVED
        if flags.get(("plant", f"true.{name}_valid"), 0.0)
    }


def given(
    who: str, way: str, law: str
) -> tuple[list[tuple[int, Port, float]], list[tuple[Port, Port]]]:
    """Return what brings estimates to the controller: constants, or links from the observer."""
    names = [name for name in OBSERVED if fmu("controller").has(f"{name}_hat", "input")]
    if who in (LINEAR, TRUE, *WRONG_PARAMETERS):
        chosen = {LINEAR: ("b", "alpha2"), TRUE: tuple(names)}.get(who, ("b", "alpha2", "Fc"))
        wrong = WRONG_PARAMETERS.get(who, {})
        known = {
            name: value * wrong.get(name, 1.0)
            for name, value in truth(law).items()
            if name in chosen
        }
        known |= {"load": wrong["load"]} if "load" in wrong else {}
        return [
            (0, ("controller", f"{name}_{what}"), x)
            for name, value in known.items()
            for what, x in (("hat", value), ("valid", 1.0))
        ], []
    if who == ALONE:
        return [], []
    links = [(("observer", f"{name}_hat"), ("controller", f"{name}_hat")) for name in names]
    counts = {name: f"{name}_valid" if way == "valid" else way for name in names}
    return [], links + [
        (("observer", counts[name]), ("controller", f"{name}_valid")) for name in names
    ]


def follow(who: str, way: str, law: str, seed: int) -> Json:
    """Return the rms tracking error at each speed [deg/s], and which estimates were valid at the
    end.
    """
    steps = [
        round(seconds / COMPENSATION_STEP) for seconds in (IDENTIFICATION, *(PHASE for _ in SPEEDS))
    ]
    begins = np.cumsum(steps)[:-1]
    plant, controller, h = fmu("plant"), fmu("controller"), COMPENSATION_STEP
    instances = [
        BusUnit("controller", controller, {"seed": float(seed), "order": ORDER}),
        BusUnit("plant", plant, {"law": plant.choices("law")[law]}),
    ]
    events, links = given(who, way, law)
    links += [(("plant", "v_enc"), ("controller", "y_v")), (("controller", "u"), ("plant", "u"))]
    flags = []
    if who in methods():
        watching = fmu("observer")
        instances.append(BusUnit("observer", watching, {"method": watching.choices("method")[who]}))
        sensor = "encoder" if methods()[who].reads == "y_theta" else "clean"
        theta, v = {"encoder": ("theta_enc", "v_enc"), "clean": ("theta", "v")}[sensor]
        links += [
            (("controller", "u"), ("observer", "u")),
            (("plant", theta), ("observer", "y_theta")),
            (("plant", v), ("observer", "y_v")),
        ]
        flags = [("observer", f"{name}_valid") for name in OBSERVED]
    events += [
        (int(k), ("controller", "reference_scale"), speed / FULL_SPEED)
        for k, speed in zip(begins, SPEEDS, strict=True)
    ]
    record = (("controller", "reference"), ("plant", "v"))
    trace = simulate(
        Bus(
            tuple(instances),
            sum(steps),
            h,
            tuple(links),
            tuple(events),
            record=record,
            flags=tuple(flags),
        )
    )
    if trace.failure is not None:
        return {"failure": trace.failure.message}
    error = np.degrees(trace.values[:, 0] - trace.values[:, 1])
    rms = {}
    for k, speed in zip(begins, SPEEDS, strict=True):
        part = error[k + round(SETTLED_AFTER / h) : k + round(PHASE / h)]
        rms[f"{speed:g}"] = float(np.sqrt(np.mean(part**2)))
    return {"rms": rms, "valid": [name for (_, name), value in trace.flags.last.items() if value]}


@cache
def _texts(kind: str, name: str) -> tuple[str, ...]:
    """Return what the results of a law, a method or the controller depend on."""
    make = {"law": servo_program, "method": observer_program, "controller": program_of}[kind]
    return fingerprint(make(name))


def _path(who: str, way: str, law: str, seed: int) -> Path:
    texts = [
        *_texts("controller", "controller"),
        *_texts("law", law),
        *(_texts("method", who) if who in methods() else ()),
    ]
    settings = repr((IDENTIFICATION, PHASE, SPEEDS, ORDER, WRONG_PARAMETERS, who, way, law, seed))
    key = digest(getsource(given), getsource(follow), settings, *texts)
    return cache_folder() / "compensation" / key[:2] / f"{key[:40]}.json"


def compute(job: tuple[str, str, str, int]) -> None:
    """Compute one result, unless it is there."""
    path = _path(*job)
    if not path.exists():
        write_json(path, follow(*job))


def plan(seeds: int) -> Iterator[tuple[str, str, str, int]]:
    """Yield all jobs."""
    who = [
        *((name, "") for name in (ALONE, LINEAR, TRUE, *WRONG_PARAMETERS)),
        *((name, way) for way in WAYS for name in studied()),
    ]
    yield from (
        (*each, law, seed) for each in who for law in laws() for seed in range(1, seeds + 1)
    )


def main() -> None:
    """Compute what is missing, and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="references")
    parser.add_argument("--pages", action="store_true", help="only write the page")
    chosen = parser.parse_args()
    work = list(plan(chosen.seeds))
    if not chosen.pages:
        for name in ("plant", "controller", "observer"):
            fmu(name)
        with ProcessPoolExecutor(chosen.jobs, mp_context=get_context("spawn")) as pool:
            for _ in track(
                pool.map(compute, work, chunksize=4), total=len(work), description="runs"
            ):
                pass
    found = {
        job: json.loads(_path(*job).read_text(encoding="utf-8"))
        for job in work
        if _path(*job).exists()
    }
    publish(found, [f"{speed:g}" for speed in SPEEDS], (ALONE, LINEAR, TRUE, *WRONG_PARAMETERS))


if __name__ == "__main__":
    main()
