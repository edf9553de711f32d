"""What a process of its own costs: scenario `quick` over 200 s, its FMUs ours or taken as foreign ones, side by side.

python benchmarks/isolation.py > benchmarks/results/isolation.md
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from bristle.harness.catalogue import find_scenario
from bristle.harness.isolate import simulate_isolated
from bristle.harness.loop import Trace, simulate
from bristle.harness.plan import find_fmus, identification, prepare
from bristle.harness.scenario import load

PAIRS = 9


def timed(work: Callable[[], Trace]) -> tuple[float, Trace]:
    begin = time.perf_counter()
    trace = work()
    return time.perf_counter() - begin, trace


def main() -> None:
    print("# What a process of its own costs\n")
    print("Simulation alone, without reading, metrics and report; median of")
    print(f"{PAIRS} pairs of runs in turn. `python benchmarks/isolation.py`\n")
    print("| scenario | time simulated, s | in this process, s | in its own, s | ratio of the medians | same digits |")
    print("|---|---|---|---|---|---|")
    for name, duration in (("quick", 20), ("quick", 200), ("self_starting", 200)):
        loaded = load(find_scenario(Path(name)), (f"duration={duration} s",))
        bus = identification(prepare(loaded, find_fmus(loaded)))
        pairs = [(timed(partial(simulate, bus)), timed(partial(simulate_isolated, bus))) for _ in range(PAIRS)]
        own, apart = (statistics.median(pair[k][0] for pair in pairs) for k in (0, 1))
        same = all(np.array_equal(a.values, b.values, equal_nan=True) for (_, a), (_, b) in pairs)
        print(f"| {name} | {duration} | {own:.2f} | {apart:.2f} | {apart / own:.2f} | {'yes' if same else 'no'} |", flush=True)


if __name__ == "__main__":
    main()
