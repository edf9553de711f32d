"""Every observer under many conditions: how far off, how soon right, and whether it says so;
docs/study/conditions.md.

python benchmarks/conditions/run.py                                   # all methods, 3 records a
plant and condition; resumes python benchmarks/conditions/run.py --methods self_starting_ekf --seeds
24     # more records of one method python benchmarks/conditions/run.py --pages
# only the page, from the results so far
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from inspect import getsource
from multiprocessing import get_context
from pathlib import Path
from typing import Any

# before numpy: one thread a worker
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import moving_horizon
import numpy as np
from condition_records import CONDITIONS, SOURCE, Array, Condition, Record, record
from conditions_page import publish
from rich.progress import track
from shared import write_json

from bristle.common.cache import cache_folder, digest
from bristle.common.errors import SimulationError
from bristle.harness.metrics.estimates import settling
from bristle.model.native import Native
from bristle.model.normalised import OBSERVED
from bristle.model.sources import fingerprint
from bristle.observer import methods, observer_program
from bristle.observer.method import observer

Json = dict[str, Any]
BEST = "self_starting_ekf"
SEEDS = 3  # records of each plant and condition
JUDGED = ("alpha2", "b", "Fc", "sigma0", "sigma1", "sigma2", "c")  # what the truth is compared with


@cache
def estimated(method: str) -> tuple[str, ...]:
    """Return what a method estimates, in the order of the tables."""
    outputs = {
        variable.name: expression
        for variable, expression in observer(methods()[method]).outputs.values()
    }
    return tuple(name for name in OBSERVED if not outputs[f"{name}_hat"].is_constant())


def studied() -> list[str]:
    """Return the methods that estimate something of which the truth is known, without help by true
    values.
    """
    given = {
        name
        for name, method in methods().items()
        if any(p.description.endswith("known") for p in method.parameters)
    }
    return [
        *(name for name in methods() if name not in given and set(estimated(name)) & set(JUDGED)),
        moving_horizon.NAME,
    ]


def observe(method: str, condition: Condition, data: Record) -> Json:
    """Return what a method makes of a record, at its end and on the way."""
    if method == moving_horizon.NAME:
        return moving_horizon.observe(condition, data, JUDGED)
    program = observer_program(method)
    values = {"sample_time": condition.period}
    if f"{method}.resolution" in program.index:
        values[f"{method}.resolution"] = 2 * math.pi / condition.counts
    names = [name for name in estimated(method) if name in data.true]
    restarting = f"{method}.starts" in program.index
    also = [f"{method}.starts", f"{method}.resumes"] if restarting else []
    columns = [f"{name}_{what}" for what in ("hat", "sd", "valid") for name in names] + [
        "innovation",
        *also,
    ]
    try:
        inputs = {"u": data.u, "y_theta": data.y_theta, "y_v": data.y_v}
        rows = Native(program, values).run(condition.period, inputs, columns)[0][1:]
    except SimulationError as error:
        return {"failure": str(error)}
    n = len(names)
    hats, valid = rows[:, :n], rows[:, 2 * n : 3 * n] > 0
    judged = [i for i, name in enumerate(names) if name in JUDGED]
    true = np.array([data.true[names[i]] for i in judged])
    errors = np.abs(hats[:, judged] / true - 1) * 100
    second = partial(
        _settled, np.asarray(condition.period * np.arange(1, len(errors) + 1), dtype=np.float64)
    )
    return {
        "true": {name: data.true[name] for name in names},
        "final": dict(zip(names, hats[-1].tolist(), strict=True)),
        "sd": dict(zip(names, rows[-1, n : 2 * n].tolist(), strict=True)),
        "valid": dict(zip(names, valid[-1].tolist(), strict=True)),
        "settled_s": second(np.where(valid[:, judged], errors, np.inf)),
        "settled_valid_or_not_s": second(errors),
        "innovation": float(rows[-1, 3 * n]),
        "changes": _changes(rows[:, -2], rows[:, -1]) if restarting else 0,
    }


def _settled(time: Array, errors: Array) -> float | None:
    """Return when the largest of the errors [%] at each time is within the band for good; none if
    never, or without an error.
    """
    second = settling(time, errors.max(axis=1)) if errors.size else math.nan
    return second if math.isfinite(second) else None


def _changes(starts: Array, resumes: Array) -> int:
    """Return how many starts follow a change that was found; the others begin anew because the
    filter did not converge.
    """
    return int(np.count_nonzero((np.diff(starts) > 0) & (resumes[1:] > 0)))


@cache
def _identity(method: str) -> str:
    """Return what identifies the equations of a method and what is made of its outputs."""
    if method == moving_horizon.NAME:
        return digest(getsource(moving_horizon))
    return digest(
        *fingerprint(observer_program(method)),
        *(getsource(each) for each in (observe, _settled, _changes)),
    )


def _path(method: str, condition: Condition, plant: str, seed: int) -> Path:
    key = digest(_identity(method), SOURCE, repr(condition), plant, str(seed))
    return cache_folder() / "conditions" / "results" / key[:2] / f"{key[:40]}.json"


def compute(job: tuple[str, str, str, int]) -> None:
    """Compute one result, unless it is there."""
    method, name, plant, seed = job
    path = _path(method, CONDITIONS[name], plant, seed)
    if not path.exists():
        try:
            found = observe(method, CONDITIONS[name], record(CONDITIONS[name], plant, seed))
        except np.linalg.LinAlgError as error:
            found = {"failure": f"{method} on {name}, {plant}, {seed}: {error}"}
        write_json(path, found)


def plan(seeds: Mapping[str, int]) -> Iterator[tuple[str, str, str, int]]:
    """Yield all jobs for the seeds of each method; those on the same record follow each other."""
    for name, condition in CONDITIONS.items():
        for plant in condition.plants:
            for seed in range(1, max(seeds.values()) + 1):
                yield from (
                    (method, name, plant, seed) for method, most in seeds.items() if seed <= most
                )


def results(seeds: Mapping[str, int]) -> dict[str, dict[str, list[Json]]]:
    """Return what there is, by method and condition."""
    found: dict[str, dict[str, list[Json]]] = {method: {} for method in seeds}
    for method, name, plant, seed in plan(seeds):
        path = _path(method, CONDITIONS[name], plant, seed)
        if path.exists():
            found[method].setdefault(name, []).append(json.loads(path.read_text(encoding="utf-8")))
    return found


def main() -> None:
    """Compute what is missing, and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--methods", default=",".join(studied()), help="names with commas between")
    parser.add_argument(
        "--seeds", type=int, default=SEEDS, help="records of each plant and condition"
    )
    parser.add_argument("--best-seeds", type=int, default=8 * SEEDS, help=f"the same for {BEST}")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--pages", action="store_true", help="only write the page")
    chosen = parser.parse_args()
    special = {BEST: chosen.best_seeds, moving_horizon.NAME: 1}
    seeds = {method: special.get(method, chosen.seeds) for method in studied()}
    if not chosen.pages:
        wanted = chosen.methods.split(",")
        for method in wanted:
            if method != moving_horizon.NAME:
                observer_program(method)
        work = list(plan({method: seeds[method] for method in wanted}))
        with ProcessPoolExecutor(chosen.jobs, mp_context=get_context("spawn")) as pool:
            for _ in track(
                pool.map(compute, work, chunksize=8), total=len(work), description="records"
            ):
                pass
    publish(results(seeds), BEST)


if __name__ == "__main__":
    main()
