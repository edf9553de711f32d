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


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=10_000)
    runs = parser.parse_args().runs
    asked = design([VARY], samples=runs)
    sweep = prepare_sweep(find_scenario(Path("quick")), asked, RunOptions(overrides=(DURATION,)))
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder) / "store")
        found = run_sweep(sweep, asked, store, Means(2))
        size = sum(path.stat().st_size for path in store.files())
        begun = time.perf_counter()
        kept = len(store.done())
        scan = time.perf_counter() - begun
        begun = time.perf_counter()
        store.query(
            'SELECT verdict, count(*), avg(abs("estimates.alpha2.error_percent")) FROM runs GROUP'
            " BY 1"
        )
        query = time.perf_counter() - begun
    points = list(asked.points())[:CHUNK_RUNS]
    rows = run_chunk(sweep, points)
    # a whole chunk, if fewer runs were asked for
    rows = (rows * (CHUNK_RUNS // len(rows) + 1))[:CHUNK_RUNS]
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder) / "store")
        store.describe("one", {})
        spent = []
        for _ in range(REPEATS):
            begun = time.perf_counter()
            store.add(pickle.loads(pickle.dumps(rows)))
            spent.append(time.perf_counter() - begun)
        chunk_bytes = store.files()[0].stat().st_size
    write, message = statistics.median(spent), len(pickle.dumps(rows))
    rate = found.runs / found.seconds / 2  # runs a second of a core
    print("# What ten thousand runs cost\n")
    print("`python benchmarks/sweep_large.py > benchmarks/results/sweep_large.md`:")
    print(
        f"{runs} runs of scenario `quick`, shortened to 10 s, on 2 cores.\n\n| measured |"
        " |\n|---|---|"
    )
    for name, value in (
        ("seconds, both cores", f"{found.seconds:.0f}"),
        ("runs a second of a core", f"{rate:.1f}"),
        ("cost of a run, ms of a core", f"{1e3 / rate:.1f}"),
        ("bytes of a run in the store", f"{size / found.runs:.0f}"),
        (f"a chunk of {CHUNK_RUNS} runs: seconds of a core", f"{CHUNK_RUNS / rate:.0f}"),
        ("its rows between processes, MB", f"{message / 1e6:.2f}"),
        ("its file, MB", f"{chunk_bytes / 1e6:.3f}"),
        ("writing it, through to the disk, ms", f"{1e3 * write:.0f}"),
        (f"looking through the store for --resume ({kept} runs), s", f"{scan:.2f}"),
        ("a query over all runs, s", f"{query:.2f}"),
        (
            "largest memory of the process, MiB",
            f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f}",
        ),
        (
            "the FMUs and the scenario, sent once a worker, MB",
            f"{len(pickle.dumps(packed(sweep))) / 1e6:.2f}",
        ),
    ):
        print(f"| {name} | {value} |")
    chunks, tasks = MANY / CHUNK_RUNS, WORKERS * rate / CHUNK_RUNS
    first = "it is enough" if tasks < 1 / write else "this breaks first"
    for line in (
        f"\n## A million runs on {WORKERS} workers of one core, on paper\n",
        (
            f"- {MANY / rate / 3600:.1f} hours of a core: {MANY / rate / WORKERS / 60:.1f} minutes"
            " if all workers are always busy."
        ),
        (
            f"- {chunks:.0f} chunks, one a worker, so the slowest decides when it ends; smaller"
            " ones would even that out."
        ),
        (
            f"- {size / found.runs * MANY / 1e6:.0f} MB in the store, in {chunks:.0f} files;"
            f" looking through it for --resume takes {scan / kept * MANY:.0f} s."
        ),
        (
            f"- {tasks:.1f} tasks a second, of about {SCHEDULER:.0f} that a scheduler can hand out,"
            f" with {tasks * message / 1e6:.1f} MB of rows a second."
        ),
        (
            f"- One process takes the rows and writes them, {1 / write:.0f} chunks a second:"
            f" {first} ({100 * tasks * write:.0f} % busy; the limit would be"
            f" {WORKERS / (tasks * write):.0f} workers)."
        ),
        (
            "- That process keeps the drawn values of all runs in memory, and with --resume the"
            " keys of those that are there: about"
        ),
        "  0.3 kB a run, 0.3 GB for a million.",
    ):
        print(line)


if __name__ == "__main__":
    main()
