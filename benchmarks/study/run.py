"""The comparative study: every observer on every plant; tables and figures in docs/study (see
scripts/study).

python benchmarks/study/run.py                    # all of it; an interrupted run continues
python benchmarks/study/run.py --seeds 2          # a part
python benchmarks/study/run.py --pages            # only the pages, from the results so far
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

# before numpy: one thread a worker
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import jobs
from pages import publish
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from shared import write_json
from standard_records import TRUE_PARAMETERS

from bristle.common.arguments import filled_path
from bristle.model.sources import fingerprint
from bristle.observer import observer_program

ROOT = Path(__file__).resolve().parents[2]
STUDIED = ("S", "R", "L0", "L1", "GMS")
ORDERS = (1, 2)
STARTS_PER_RECORD = 5  # start values drawn on each record
WORK: dict[str, Callable[[str, int, int], Any]] = {
    "record": jobs.whole,
    "best": jobs.best_alone,
    "bound": jobs.against_the_bound,
    "bodies": jobs.two_bodies,
    "change": jobs.after_a_change,
    "starts": partial(jobs.from_spread_starts, runs=STARTS_PER_RECORD),
}


@dataclass(frozen=True)
class Job:
    """One file of results: the computation, plant, order and seed."""

    kind: str
    plant: str
    order: int
    seed: int

    @property
    def name(self) -> str:
        return f"{self.kind}_{self.plant}_{self.order}_{self.seed}.json"

    def run(self, out: Path) -> None:
        """Compute and write."""
        write_json(out / self.name, WORK[self.kind](self.plant, self.order, self.seed))


def plan(seeds: int) -> Iterator[Job]:
    """Yield all jobs, the longest first. The best method is also run on as many further records."""
    first, again = range(1, seeds + 1), range(seeds + 1, 2 * seeds + 1)
    known = tuple(TRUE_PARAMETERS)
    kinds = (
        ("record", STUDIED, first),
        ("best", STUDIED, again),
        ("starts", known, first),
        ("change", known, (*first, *again)),
        ("bound", known, (*first, *again)),
    )
    for kind, plants, numbers in kinds:
        yield from (
            Job(kind, plant, order, seed)
            for seed in numbers
            for plant in plants
            for order in ORDERS
        )
    yield from (Job("bodies", "Z", 1, seed) for seed in first)


def results_folder(root: Path) -> Path:
    """Return the folder for results of exactly these observers: results of other observers are kept
    apart.
    """
    digest = hashlib.sha256(repr(fingerprint(observer_program())).encode()).hexdigest()[:12]
    return root / digest


def compute(seeds: int, out: Path, workers: int) -> None:
    """Compute what is missing, with a bar of progress."""
    todo = [job for job in plan(seeds) if not (out / job.name).exists()]
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    pool = ProcessPoolExecutor(workers, get_context("spawn"))
    try:
        with Progress(*columns, console=Console(stderr=True)) as bar:
            task = bar.add_task("study", total=len(todo))
            for future in as_completed([pool.submit(job.run, out) for job in todo]):
                future.result()
                bar.advance(task)
    except BaseException:  # do not wait for the rest; each file of results is written in one piece
        pool.shutdown(wait=False, cancel_futures=True)
        for child in active_children():
            child.terminate()
        raise
    pool.shutdown()


def main() -> int:
    """Compute, and write the pages."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=12, help="seeds 1 to N")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="worker processes")
    parser.add_argument(
        "--out", type=filled_path, default=ROOT / "out" / "study", help="folder of the results"
    )
    parser.add_argument(
        "--docs", type=filled_path, default=ROOT / "docs" / "study", help="folder of the pages"
    )
    parser.add_argument("--pages", action="store_true", help="only write the pages")
    given = parser.parse_args()
    if given.seeds < 1 or given.jobs < 1:
        parser.error("--seeds and --jobs: at least 1")
    out = results_folder(given.out)
    if not given.pages:
        compute(given.seeds, out, given.jobs)
    names = {job: out / job.name for job in plan(given.seeds)}
    found = {job: path for job, path in names.items() if path.exists()}
    if not found:
        print(f"no results in {out}; run without --pages first", file=sys.stderr)
        return 2
    print(publish(found, given.docs))
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        print("stopped; finished results are kept, the same command continues", file=sys.stderr)
        sys.exit(130)
