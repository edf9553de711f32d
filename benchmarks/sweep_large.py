"""What ten thousand runs cost, and what that says of a million runs on a thousand workers.

python benchmarks/sweep_large.py [--runs 10000] > benchmarks/results/sweep_large.md
"""

from __future__ import annotations

import argparse
import pickle
import resource
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from bristle.harness.run.checked import RunOptions
from bristle.harness.scenario.catalogue import find_scenario
from bristle.harness.sweep.chunk import run_chunk
from bristle.harness.sweep.design import design
from bristle.harness.sweep.executor import Means
from bristle.harness.sweep.ship import packed
from bristle.harness.sweep.spec import prepare_sweep
from bristle.harness.sweep.store import Store
from bristle.harness.sweep.sweep import CHUNK_RUNS, run_sweep

VARY = "plant.parameters.J=uniform(0.0008, 0.0012) kg.m2"
DURATION = "duration=10 s"
MANY, WORKERS = 1_000_000, 1000  # what is worked out on paper
# tasks a second that one Dask scheduler hands out (its documentation: about 200 us to 1 ms a task)
SCHEDULER = 2000.0
REPEATS = 5
QUERY = (
    """SELECT verdict, count(*), avg(abs("estimates.alpha2.error_percent")) FROM runs GROUP BY 1"""
)


@dataclass(frozen=True)
class Measured:
    """What a sweep costs; times in s, sizes in bytes."""

    runs: int
    kept: int  # runs that looking through the store finds
    rate: float  # runs a second of a core
    size: int  # of the store
    scan: float  # of looking through the store for --resume
    query: float  # over all runs
    write: float  # of a chunk
    message: int  # the rows of a chunk between processes
    chunk: int  # file of a chunk
    sent: int  # the FMUs and the scenario


def seconds_of(work: Callable[[], object]) -> float:
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def measured(runs: int) -> Measured:
    """Sweep, and write one chunk several times."""
    asked = design([VARY], samples=runs)
    sweep = prepare_sweep(find_scenario(Path("quick")), asked, RunOptions(overrides=(DURATION,)))
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder) / "store")
        found = run_sweep(sweep, asked, store, Means(2))
        size = sum(path.stat().st_size for path in store.files())
        scan = seconds_of(store.done)
        kept = len(store.done())
        query = seconds_of(lambda: store.query(QUERY))
    rows = run_chunk(sweep, list(asked.points())[:CHUNK_RUNS])
    # a whole chunk, if fewer runs were asked for
    rows = (rows * (CHUNK_RUNS // len(rows) + 1))[:CHUNK_RUNS]
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder) / "store")
        store.describe("one", {})
        spent = [
            seconds_of(lambda: store.add(pickle.loads(pickle.dumps(rows)))) for _ in range(REPEATS)
        ]
        chunk = store.files()[0].stat().st_size
    rate, write = found.runs / found.seconds / 2, statistics.median(spent)
    message, sent = len(pickle.dumps(rows)), len(pickle.dumps(packed(sweep)))
    return Measured(found.runs, kept, rate, size, scan, query, write, message, chunk, sent)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=10_000)
    runs = parser.parse_args().runs
    m = measured(runs)
    print(f"""# What ten thousand runs cost

`python benchmarks/sweep_large.py > benchmarks/results/sweep_large.md`:
{runs} runs of scenario `quick`, shortened to 10 s, on 2 cores.

| measured | |
|---|---|""")
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    for name, value in (
        ("seconds, both cores", f"{m.runs / m.rate / 2:.0f}"),
        ("runs a second of a core", f"{m.rate:.1f}"),
        ("cost of a run, ms of a core", f"{1e3 / m.rate:.1f}"),
        ("bytes of a run in the store", f"{m.size / m.runs:.0f}"),
        (f"a chunk of {CHUNK_RUNS} runs: seconds of a core", f"{CHUNK_RUNS / m.rate:.0f}"),
        ("its rows between processes, MB", f"{m.message / 1e6:.2f}"),
        ("its file, MB", f"{m.chunk / 1e6:.3f}"),
        ("writing it, through to the disk, ms", f"{1e3 * m.write:.0f}"),
        (f"looking through the store for --resume ({m.kept} runs), s", f"{m.scan:.2f}"),
        ("a query over all runs, s", f"{m.query:.2f}"),
        ("largest memory of the process, MiB", f"{memory:.0f}"),
        ("the FMUs and the scenario, sent once a worker, MB", f"{m.sent / 1e6:.2f}"),
    ):
        print(f"| {name} | {value} |")
    print(on_paper(m))


def on_paper(m: Measured) -> str:
    """Return what a million runs on many workers would cost."""
    chunks, tasks = MANY / CHUNK_RUNS, WORKERS * m.rate / CHUNK_RUNS
    first = "it is enough" if tasks < 1 / m.write else "this breaks first"
    hours, minutes = MANY / m.rate / 3600, MANY / m.rate / WORKERS / 60
    rows, looking, busy = tasks * m.message / 1e6, m.scan / m.kept * MANY, tasks * m.write
    return f"""
## A million runs on {WORKERS} workers of one core, on paper

- {hours:.1f} hours of a core: {minutes:.1f} minutes if all workers are always busy.
- {chunks:.0f} chunks, one a worker, so the slowest decides when it ends; smaller ones would even
  that out.
- {m.size / m.runs * MANY / 1e6:.0f} MB in the store, in {chunks:.0f} files; looking through it for
  --resume takes {looking:.0f} s.
- {tasks:.1f} tasks a second, of about {SCHEDULER:.0f} that a scheduler can hand out, with
  {rows:.1f} MB of rows a second.
- One process takes the rows and writes them, {1 / m.write:.0f} chunks a second: {first}
  ({100 * busy:.0f} % busy; the limit would be {WORKERS / busy:.0f} workers).
- That process keeps the drawn values of all runs in memory, and with --resume the keys of those
  that are there: about 0.3 kB a run, 0.3 GB for a million."""


if __name__ == "__main__":
    main()
