"""What a sweep costs: threads, store and verdicts, a cluster, and other ways to make the same runs,
side by side in one run.

python benchmarks/sweep.py [--runs 1000] > benchmarks/results/sweep.md

All ways make runs of scenario `quick` (20 s at 1 ms: controller, plant, observer). They are timed
in turn, several times, and the median is taken, since the speed of a machine changes. Other
importers get the same FMUs; they record the same signals but judge nothing.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from ratios import judge

from bristle.fmus.calls import CONTROL_SIZE
from bristle.harness.cosim.bus import Bus
from bristle.harness.cosim.loop import simulate
from bristle.harness.cosim.node import Slaves
from bristle.harness.exchange.kit import export
from bristle.harness.run.checked import RunOptions
from bristle.harness.scenario.catalogue import find_scenario
from bristle.harness.scenario.parts import build_fmus
from bristle.harness.scenario.plan import identification, prepare
from bristle.harness.scenario.reading import load
from bristle.harness.sweep.chunk import run_chunk
from bristle.harness.sweep.design import Design, design
from bristle.harness.sweep.executor import Means
from bristle.harness.sweep.lanes import Together
from bristle.harness.sweep.spec import Sweep, load_point, prepare_sweep
from bristle.harness.sweep.store import Store
from bristle.harness.sweep.sweep import run_sweep

ROUNDS = 3
FEW = 24  # runs of the slow ways
STEPS = 20_000  # of a run
OWN_WAYS = 7  # of `measure`, with FMPy's, the last of them
LANES_SCENARIOS = (
    "quick",
    "disturbed",
    "encoder_two_step",
    "self_starting",
    "compensation",
    "load_change",
    "lugre_original",
)
LANES_LENGTH = ["duration=20 s"]
LANES_ROUNDS = 5
VARY = "plant.parameters.J=uniform(0.0008, 0.0012) kg.m2"


def timed(work: Callable[[], object]) -> float:
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def buses_of(sweep: Sweep, asked: Design) -> list[Bus]:
    fmus = next(iter(sweep.fmus.values()))
    return [identification(prepare(load_point(sweep, point), fmus)) for point in asked.points()]


def by_fmus(buses: Sequence[Bus]) -> None:
    """The compiled loop over FMUs, without store, verdicts and numbers."""
    with Slaves() as slaves:
        for bus in buses:
            simulate(bus, slaves=slaves)


def by_lanes(buses: Sequence[Bus], together: Together) -> None:
    """The same over their programs in lanes."""
    for begin in range(0, len(buses), together.width):
        together.run(buses[begin : begin + together.width], np.zeros(CONTROL_SIZE, dtype=np.int64))


def lanes_over_fmus(name: str) -> tuple[float, float, float]:
    """Return ms a run by FMUs and in lanes, and the median ratio, of one scenario with other
    inertias and seeds.
    """
    setups = []
    for k in range(8):
        loaded = load(
            find_scenario(Path(name)),
            [f"plant.parameters.J={8e-4 + 5e-5 * k} kg.m2", *LANES_LENGTH],
            k + 1,
        )
        setups.append(prepare(loaded, build_fmus(loaded)))
    buses, together = [identification(setup) for setup in setups], Together(setups[0])
    by_lanes(buses, together)
    both = [
        (timed(lambda: by_fmus(buses)), timed(lambda: by_lanes(buses, together)))
        for _ in range(LANES_ROUNDS)
    ]
    fmus, lanes = (1e3 * statistics.median(each) / len(buses) for each in zip(*both, strict=True))
    return fmus, lanes, statistics.median(one / other for one, other in both)


def swept(sweep: Sweep, asked: Design, means: Means) -> None:
    with tempfile.TemporaryDirectory() as folder:
        run_sweep(sweep, asked, Store(Path(folder) / "store"), means)


def by_fmpy(seed: int) -> None:
    """One run by FMPy's own calls: FMUs loaded, a loop in Python, all outputs read at each step."""
    loaded = load(find_scenario(Path("quick")), [], seed)
    simulate(identification(prepare(loaded, build_fmus(loaded))), engine="fmpy")


def by_libcosim(package: str) -> None:
    """One run by libcosim over a package of the same FMUs; no signal is recorded."""
    execution: Any = import_module("libcosimpy.CosimExecution").CosimExecution
    logging: Any = import_module("libcosimpy.CosimLogging")
    logging.log_output_level(logging.CosimLogLevel.ERROR)
    execution.from_ssp_file(ssp_path=package, step_size=1_000_000).step(STEPS)


def by_ecos(package: str) -> None:
    """The same by Ecos."""
    simulation: Any = import_module("ecospy").EcosSimulation(ssp_path=package, step_size=1e-3)
    simulation.init()
    simulation.step(STEPS)


def pooled(pool: ProcessPoolExecutor, work: Callable[[Any], None], given: Sequence[object]) -> None:
    """Do work for all that is given, in the processes of a pool."""
    list(pool.map(work, given))


def other_importers(
    pool: ProcessPoolExecutor, package: str
) -> dict[str, tuple[int, Callable[[], Any]]]:
    """Return those importers that can be loaded on this machine."""
    found: dict[str, tuple[int, Callable[[], Any]]] = {}
    for module, name, work in (
        ("libcosimpy", "libcosim", by_libcosim),
        ("ecospy", "Ecos", by_ecos),
    ):
        try:
            import_module(module)
        except (ImportError, OSError) as error:
            print(f"{name} cannot be loaded: {error}", file=sys.stderr)
            continue
        found[f"{name}, pool of 2 processes"] = (FEW, partial(pooled, pool, work, [package] * FEW))
    return found


def rate_of(runs: int, seconds: list[float]) -> str:
    return (
        f"{runs / statistics.median(seconds):.1f} ({runs / max(seconds):.1f} to"
        f" {runs / min(seconds):.1f})"
    )


def main() -> int:
    """Print the tables; exit 1 if a ratio has fallen."""
    with (
        ProcessPoolExecutor(2, get_context("spawn")) as pool,
        tempfile.TemporaryDirectory() as folder,
    ):
        return measure(pool, Path(folder))


def measure(pool: ProcessPoolExecutor, kit: Path) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument(
        "--accept", action="store_true", help="commit the ratios as those to compare with"
    )
    given = parser.parse_args()
    runs = given.runs
    few = max(FEW, runs // 10)
    path, options = find_scenario(Path("quick")), RunOptions()
    asked, some = (design([VARY], samples=count) for count in (runs, few))
    sweep = replace(prepare_sweep(path, asked, options), lanes=True)
    loaded = load_point(sweep, next(some.points()))
    buses, together = buses_of(sweep, some), Together(prepare(loaded, build_fmus(loaded)))
    plain, points, seeds = replace(sweep, lanes=False), list(some.points()), range(1, FEW + 1)
    ways: dict[str, tuple[int, Callable[[], Any]]] = {
        "loop over FMUs alone, one thread": (few, lambda: by_fmus(buses)),
        "loop in lanes alone, one thread": (few, lambda: by_lanes(buses, together)),
        "chunk without store, FMUs, one thread": (few, lambda: run_chunk(plain, points)),
        "chunk without store, lanes, one thread": (few, lambda: run_chunk(sweep, points)),
        "`bristle sweep -j 1`": (few, lambda: swept(sweep, some, Means(1))),
        "`bristle sweep -j 2`": (runs, lambda: swept(sweep, asked, Means(2))),
        "FMPy's calls, pool of 2 processes": (FEW, partial(pooled, pool, by_fmpy, seeds)),
    }
    ways |= other_importers(pool, str(export(path, kit)))
    for name in list(ways)[OWN_WAYS - 1 :]:
        ways[name][1]()  # the processes have imported then
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(ROUNDS):
        for name, (_, work) in ways.items():
            seconds[name].append(timed(work))
    cluster_rate = rate_of_cluster(sweep, some, asked)
    lanes = {name: lanes_over_fmus(name) for name in LANES_SCENARIOS}
    ratios = report(ways, seconds, runs, cluster_rate, size_of(sweep, asked), lanes)
    return 0 if judge("sweep", ratios, given.accept) else 1


def rate_of_cluster(sweep: Sweep, some: Design, asked: Design) -> float | None:
    """Return the speed of a cluster of two workers over that of two threads; None without Dask."""
    try:
        local_cluster: Any = import_module("distributed").LocalCluster
    except ImportError:
        return None
    with local_cluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        # its workers have imported then
        swept(sweep, some, Means(1, cluster.scheduler_address))
        both: list[tuple[float, float]] = []
        for _ in range(ROUNDS):
            there = timed(lambda: swept(sweep, asked, Means(1, cluster.scheduler_address)))
            both.append((there, timed(lambda: swept(sweep, asked, Means(2)))))
        return statistics.median(here / there for there, here in both)


def size_of(sweep: Sweep, asked: Design) -> tuple[int, int]:
    """Return the bytes of a store with these runs in chunks of their usual size, and its files."""
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder) / "store")
        run_sweep(sweep, asked, store, Means(2))
        return sum(path.stat().st_size for path in store.files()), len(store.files())


def report(
    ways: dict[str, tuple[int, Callable[[], Any]]],
    seconds: dict[str, list[float]],
    runs: int,
    cluster_rate: float | None,
    size: tuple[int, int],
    lanes: dict[str, tuple[float, float, float]],
) -> dict[str, float]:
    per_run = {name: statistics.median(seconds[name]) / ways[name][0] for name in ways}
    loop, _, chunk_fmus, chunk, one, two, fmpy = list(per_run.values())[:OWN_WAYS]
    print(f"""# What a sweep costs

`python benchmarks/sweep.py > benchmarks/results/sweep.md`: runs of scenario `quick` (20 s at 1 ms)
on this machine's 2 cores, {ROUNDS} rounds in turn; the median, and the range, of the rounds.
""")
    print("| way | runs a round | runs a second |\n|---|---|---|")
    for name, (count, _) in ways.items():
        print(f"| {name} | {count} | {rate_of(count, seconds[name])} |")
    print("\n| figure | value | goal |\n|---|---|---|")
    print(f"| parallel efficiency of 2 threads over {runs} runs | {one / (2 * two):.2f} | >= 0.9 |")
    numbers, stored = 100 * (chunk_fmus / loop - 1), 100 * ((chunk_fmus + one - chunk) / loop - 1)
    print(f"| verdicts and numbers over the loop over FMUs, one thread | {numbers:.0f} % | |")
    print(f"| with the store | {stored:.0f} % | <= 15 % |")
    what = "a sweep's time, one thread, over that of the loop over FMUs alone"
    print(f"| {what} | {one / loop:.2f} | |")
    what = "sweep over FMPy's calls in a pool of as many processes"
    print(f"| {what} | {fmpy / two:.0f} times | >= 10 times |")
    if cluster_rate is not None:
        what = "Dask LocalCluster of 2 workers over 2 threads, runs a second"
        print(f"| {what} | {cluster_rate:.2f} | >= 0.85 |")
    print(f"| bytes a run in the store, {size[1]} files | {size[0] / runs:.0f} | |")
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"| largest memory of the process | {memory:.0f} MiB | bounded |")
    report_lanes(lanes)
    found = {
        "2 threads / 1 thread, runs a second": one / two,
        "loop over FMUs / sweep, one thread, time": loop / one,
    }
    found |= {f"FMUs / lanes, {name}, time": ratio for name, (_, _, ratio) in lanes.items()}
    for name, spent in list(per_run.items())[OWN_WAYS - 1 :]:
        found[f"{name} / sweep of 2 threads, time"] = spent / two
    if cluster_rate is not None:
        found["cluster / 2 threads, runs a second"] = cluster_rate
    return found


def report_lanes(lanes: dict[str, tuple[float, float, float]]) -> None:
    print("""
Lanes step several runs at once, with the digits of the FMUs. Of 8 runs, the loop alone, one thread:

| scenario | FMUs, ms a run | lanes, ms a run | ratio (goal >= 3) |
|---|---|---|---|""")
    for name, (fmus, wide, ratio) in lanes.items():
        print(f"| {name} | {fmus:.1f} | {wide:.1f} | {ratio:.2f} |")


if __name__ == "__main__":
    sys.exit(main())
