"""Many runs of one scenario, in chunks, into a store: by threads over the compiled loop, or by the
workers of a Dask cluster.

A chunk is computed by one function, `run_chunk`, wherever that is, so its digits do not depend on
where or beside what it ran.
"""

from __future__ import annotations

import itertools
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from typing import Any

from bristle.common.errors import BristleError
from bristle.common.output import plain
from bristle.common.provenance import provenance
from bristle.harness.sweep.chunk import Rows, Watcher
from bristle.harness.sweep.design import Design, SweepPoint
from bristle.harness.sweep.executor import Means, executor
from bristle.harness.sweep.lanes import MOST_LANES
from bristle.harness.sweep.spec import Sweep
from bristle.harness.sweep.store import ERROR_VERDICT, Store

Tell = Callable[[int, int], None]  # runs that are done, of how many

CHUNK_RUNS = 1000  # of a large sweep: what a kill loses at most
CHUNKS_A_JOB = 8  # at least, of a small one, so that all jobs end at about the same time
VERDICTS = ("pass", "fail", ERROR_VERDICT)  # of a run
WAIT = 0.2  # s between two looks at what is done


@dataclass
class Summary:
    """How a sweep ended: runs by verdict, the same of earlier runs, and the seconds it took."""

    verdicts: dict[str, int]
    there: dict[str, int]
    seconds: float

    @property
    def kept(self) -> int:
        """Runs that were there before."""
        return sum(self.there.values())

    @property
    def worst(self) -> str:
        """The worst verdict of all runs that were asked for."""
        return next(
            (
                word
                for word in (ERROR_VERDICT, "fail")
                if self.verdicts.get(word) or self.there.get(word)
            ),
            "pass",
        )

    @property
    def runs(self) -> int:
        """Runs that were made."""
        return sum(self.verdicts.values())


def run_sweep(
    sweep: Sweep,
    design: Design,
    store: Store,
    means: Means | None = None,
    progress: Tell | None = None,
) -> Summary:
    """Make the runs of a sweep that the store does not have, chunk by chunk.

    Parameters
    ----------
    sweep, design : Sweep, Design
        What to run, of `prepare_sweep`.
    store : Store
        Where the rows go.
    means : Means, optional
        How.
    progress : function, optional
        Called now and then.

    Raises
    ------
    BristleError
        If the store cannot be written, has runs and `resume` is not given, or the cluster cannot be
        reached.
    """
    means = means or Means()
    _check_means(store, means)
    begun, watcher = time.perf_counter(), Watcher()
    # what the store has already is not made again
    done = store.done() if means.resume else {}
    kept = (done[key] for key in map(sweep.key, design.points()) if key in done) if done else ()
    there = Counter(kept)
    todo = (point for point in design.points() if sweep.key(point) not in done)
    total, verdicts = design.runs - there.total(), dict.fromkeys(VERDICTS, 0)
    tell = progress or (lambda _done, _total: None)
    with executor(sweep, means, watcher) as (submit, workers):
        described = _described(sweep, design, means.command)
        store.describe(sweep.name, {**described, "finished": False})
        chunks = _batches(todo, _chunk_size(total, workers, sweep.lanes))
        for rows in _finished(submit, chunks, 2 * workers, lambda: tell(watcher.done, total)):
            store.add(rows)
            for row in rows:
                verdicts[row["verdict"]] += 1
            watcher.done = max(watcher.done, sum(verdicts.values()))
        store.describe(sweep.name, {**described, "finished": True})
    tell(total, total)
    counted = {word: there[word] for word in verdicts if word in there}
    return Summary(verdicts, counted, time.perf_counter() - begun)


def _check_means(store: Store, means: Means) -> None:
    """Refuse to mix runs with those of a store unasked, and to run on no thread."""
    if store.files() and not means.resume:
        raise BristleError(
            f"{store.path}: has runs already; resume it to make those that are missing, or give"
            " another folder"
        )
    if means.jobs < 1:
        raise BristleError(f"jobs {means.jobs}: give at least 1")


def _chunk_size(runs: int, workers: int, lanes: bool) -> int:
    """Return how many runs make a chunk; with lanes, so that none is left over."""
    size = max(1, min(CHUNK_RUNS, math.ceil(runs / (workers * CHUNKS_A_JOB))))
    return math.ceil(size / MOST_LANES) * MOST_LANES if lanes else size


def _batches(points: Iterator[SweepPoint], size: int) -> Iterator[list[SweepPoint]]:
    """Give the points in lists of a size, the last one shorter."""
    while batch := list(itertools.islice(points, size)):
        yield batch


def _finished(
    submit: Callable[[list[SweepPoint]], Future[Rows]],
    chunks: Iterator[list[SweepPoint]],
    most: int,
    look: Callable[[], None],
) -> Iterator[Rows]:
    """Give the rows of each chunk when it is done, with a bounded number of them under way."""
    waiting = {submit(chunk) for _, chunk in zip(range(most), chunks, strict=False)}
    while waiting:
        done, waiting = wait(waiting, WAIT, FIRST_COMPLETED)
        look()
        for future in done:
            yield future.result()
            waiting |= {submit(chunk) for _, chunk in zip(range(1), chunks, strict=False)}


def _described(sweep: Sweep, design: Design, command: str) -> dict[str, Any]:
    fmus = dict.fromkeys(f"{fmu.path.name} {fmu.sha256}" for fmu in sweep.all_fmus)
    return {
        "scenario": sweep.path.stem,
        "scenario_sha256": sweep.sha256,
        "text": sweep.text,
        "vary": {axis.path: axis.meaning for axis in sweep.axes},
        "runs": design.runs,
        "seeds": list(design.seeds),
        "samples": design.samples,
        "sampling": design.sampling,
        "sampling_seed": design.sampling_seed,
        "options": plain(vars(sweep.options)),
        "fmus": list(fmus),
        "provenance": {**provenance(), "command": command},
    }
