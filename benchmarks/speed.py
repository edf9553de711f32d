"""Speed of the co-simulation, as ratios measured side by side in one run (docs/results.md).

Run with scripts/bench. Four loops do the same 200 000 steps of controller, plant and observer:
  plain   the generated C in one C loop, no FMI
  native  the harness's compiled loop over three native FMUs
  fmpy    FMPy's Python calls over the same FMUs
  python  FMPy's Python calls over the pythonfmu FMUs
"""

from __future__ import annotations

import argparse
import ctypes
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from ratios import judge

from bristle.common.cache import cached, digest
from bristle.fmus import obtain
from bristle.fmus.controller.definition import program as controller_program
from bristle.fmus.host import Fmu
from bristle.harness.cosim.bus import Bus, BusUnit
from bristle.harness.cosim.loop import Session
from bristle.model.compiler import FLAGS, SUFFIX, compile_shared, compiler_identity
from bristle.model.native import Native
from bristle.model.program import Program
from bristle.model.sources import c_sources
from bristle.observer import methods, observer_program
from bristle.plant.servo import servo_program

COMMUNICATION_STEP = 1e-3
TIMED_METHOD = "two_step"
BEST_METHOD = "self_starting_ekf"
ENCODER_COUNT = 2 * np.pi / 40000  # rad
LINKS = (
    (("controller", "u"), ("plant", "u")),
    (("controller", "u"), ("observer", "u")),
    (("plant", "v"), ("controller", "y_v")),
    (("plant", "v"), ("observer", "y_v")),
    (("plant", "theta"), ("observer", "y_theta")),
)
RECORD = (
    ("plant", "theta"),
    ("plant", "v"),
    ("controller", "u"),
    ("observer", "alpha2_hat"),
    ("observer", "sigma0_hat"),
)
CORE_FUNCTIONS = (
    "defaults",
    "derive",
    "initialise",
    "advance",
    "outputs",
    "rates",
    "jacobian",
    "message",
)
Cores = dict[str, tuple[Program, ctypes.Array[ctypes.c_char]]]


def programs() -> dict[str, tuple[Program, str]]:
    """Return the same programs as in the FMUs, with the variant used here."""
    return {
        "plant": (servo_program(), "modified"),
        "controller": (controller_program(), ""),
        "observer": (observer_program(), TIMED_METHOD),
    }


def plain_library(parts: dict[str, tuple[Program, str]]) -> ctypes.CDLL:
    """Compile all three programs into one library, their symbols distinguished by a prefix."""
    sources = {"plain.c": Path(__file__).with_name("plain.c").read_text(encoding="utf-8")}
    for name, (program, _) in parts.items():
        text = c_sources(program)
        variants = [f"VARIANT_{variant.system.name}" for variant in program.variants]
        own = [*(f"core_{function}" for function in CORE_FUNCTIONS), "VARIANTS", "START", *variants]
        rename = "".join(f"#define {x} {name}_{x}\n" for x in own)
        for unit in (file for file in text if file.endswith(".c")):
            sources[f"{name}_{unit}"] = text[unit].replace(
                '#include "core.h"', f'{rename}#include "{name}_core.h"'
            )
        sources[f"{name}_core.h"] = text["core.h"].replace("model.h", f"{name}_model.h")
        sources[f"{name}_model.h"] = text["model.h"]
    key = digest(
        *FLAGS, compiler_identity(), *(text for pair in sorted(sources.items()) for text in pair)
    )
    library = ctypes.CDLL(
        str(cached(f"plain-{key[:24]}{SUFFIX}", lambda out: compile_shared(sources, out)))
    )
    library.plain_run.restype = ctypes.c_longlong
    return library


def start_cores(parts: dict[str, tuple[Program, str]]) -> Cores:
    """Initialise one core of each program and keep its bytes."""
    cores: Cores = {}
    for name, (program, variant) in parts.items():
        cores[name] = (program, Native(program, variant=variant or None).core)
    return cores


def time_plain(parts: dict[str, tuple[Program, str]], steps: int) -> tuple[float, np.ndarray]:
    """Return (seconds, record) of the plain loop."""
    library, cores = plain_library(parts), start_cores(parts)

    def address(port: tuple[str, str]) -> int:
        program, core = cores[port[0]]
        return ctypes.addressof(core) + 8 * program.index[port[1]]

    ends = [np.array([address(link[i]) for link in LINKS], dtype=np.uintp) for i in (0, 1)]
    taps = np.array([address(port) for port in RECORD], dtype=np.uintp)
    record = np.zeros((steps + 1, len(RECORD)))

    def pointer(array: np.ndarray) -> ctypes.c_void_p:
        return ctypes.c_void_p(array.ctypes.data)

    begin = time.perf_counter()
    done = library.plain_run(
        *(cores[name][1] for name in ("plant", "controller", "observer")),
        ctypes.c_longlong(steps),
        ctypes.c_double(COMMUNICATION_STEP),
        len(LINKS),
        pointer(ends[0]),
        pointer(ends[1]),
        len(RECORD),
        pointer(taps),
        pointer(record),
    )
    assert done == steps, f"the plain loop ended at step {done}"
    return time.perf_counter() - begin, record


def bus(kind: str, steps: int) -> Bus:
    """Return the bus of three FMUs."""
    fmus = {
        name: Fmu(obtain(name, fmi=2, kind=kind)) for name in ("plant", "controller", "observer")
    }
    chosen = {
        "plant": {"law": fmus["plant"].choices("law")["modified"]},
        "controller": {},
        "observer": {"method": fmus["observer"].choices("method")[TIMED_METHOD]},
    }
    return Bus(
        tuple(BusUnit(n, fmu, chosen[n]) for n, fmu in fmus.items()),
        steps,
        COMMUNICATION_STEP,
        LINKS,
        record=RECORD,
    )


def time_native(steps: int) -> tuple[float, np.ndarray]:
    """Return (seconds, record) of the compiled loop over native FMUs."""
    with Session(bus("native", steps)) as session:
        begin = time.perf_counter()
        trace = session.run()
        return time.perf_counter() - begin, trace.values


Place = tuple[int, int]  # number of the FMU, number of its output


def _wiring(nodes: list[tuple[str, Any]]) -> tuple[list[list[Place]], list[Place]]:
    """Return the places that each FMU reads its inputs from, and those that are recorded."""
    places = {}
    for i, (name, node) in enumerate(nodes):
        for j, port in enumerate(node.outputs):
            places[name, port] = (i, j)
    sources = {to: places[source] for source, to in LINKS}
    wiring = [[sources[(name, port)] for port in node.inputs] for name, node in nodes]
    return wiring, [places[port] for port in RECORD]


def time_calls(kind: str, steps: int) -> tuple[float, np.ndarray]:
    """Return (seconds, record) of a tight loop of FMPy's own calls: set, step and get for each FMU,
    links by list index.
    """
    with Session(bus(kind, steps)) as session:
        nodes = list(session.nodes.items())
        for _, node in nodes:
            node.read()
        units = [(n.slave.instance, n.in_vr.tolist(), n.out_vr.tolist()) for _, n in nodes]
        outputs = [n.output.tolist() for _, n in nodes]
        wiring, taps = _wiring(nodes)
        record = [[outputs[i][j] for i, j in taps]]
        begin = time.perf_counter()
        for k in range(steps):
            values = [[outputs[i][j] for i, j in wires] for wires in wiring]
            for i, (fmu, in_vr, out_vr) in enumerate(units):
                fmu.setReal(in_vr, values[i])
                fmu.doStep(k * COMMUNICATION_STEP, COMMUNICATION_STEP)
                outputs[i] = fmu.getReal(out_vr)
            record.append([outputs[i][j] for i, j in taps])
        return time.perf_counter() - begin, np.array(record)


def arithmetic(
    parts: dict[str, tuple[Program, str]], record: np.ndarray
) -> list[tuple[str, float, float]]:
    """Return (name, us a step, internal steps a step) of each program alone on the recorded
    signals.
    """
    theta, v, u = record[:-1, 0], record[:-1, 1], record[:-1, 2]
    inputs = {
        "plant": {"u": u},
        "controller": {"y_v": v},
        "observer": {"u": u, "y_v": v, "y_theta": theta},
    }
    rows = []
    for name, (program, variant) in parts.items():
        instance = Native(program, variant=variant or None)
        rows.append((name, cost(instance, inputs[name]), instance.steps / len(u)))
    return rows


def cost(instance: Native, inputs: dict[str, np.ndarray]) -> float:
    """Return the median time of a step in us, of five runs."""
    times = []
    for _ in range(5):
        instance.reset()
        begin = time.perf_counter()
        instance.run(COMMUNICATION_STEP, inputs, [])
        times.append(time.perf_counter() - begin)
    return 1e6 * statistics.median(times) / len(next(iter(inputs.values())))


def observer_costs(record: np.ndarray) -> dict[str, float]:
    """Return the us a step of each observer alone, with all its parameters at their defaults, on
    the first 20 000 steps.
    """
    theta, v, u = record[:20_000, 0], record[:20_000, 1], record[:20_000, 2]
    inputs = {"u": u, "y_v": v, "y_theta": np.floor(theta / ENCODER_COUNT) * ENCODER_COUNT}
    return {method: cost(Native(observer_program(method)), inputs) for method in methods()}


def paired(runs: int, *loops: Callable[[], tuple[float, np.ndarray]]) -> list[float]:
    """Run the loops in turn and return the median time of each, so that a drift of the machine hits
    all alike.
    """
    times: list[list[float]] = [[] for _ in loops]
    for _ in range(runs):
        for loop, seen in zip(loops, times, strict=True):
            seen.append(loop()[0])
    return [statistics.median(seen) for seen in times]


def main() -> int:
    """Print the tables; exit 1 if a required ratio is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument(
        "--accept", action="store_true", help="commit the ratios as those to compare with"
    )
    given = parser.parse_args()
    n, parts = given.steps, programs()
    reference, fast = time_plain(parts, n)[1], time_native(n)[1]
    plain, native = paired(given.runs, lambda: time_plain(parts, n), lambda: time_native(n))
    calls, by_call = time_calls("native", n)
    # pythonfmu now and then harms its host's memory
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        python, by_python = pool.submit(time_calls, "python", n).result()
    seconds = {"plain": plain, "native": native, "fmpy": calls, "python": python}
    us = {name: 1e6 * t / n for name, t in seconds.items()}
    print(
        f"{n} steps of 1 ms, controller + plant (modified) + observer ({TIMED_METHOD}); medians of"
        f" {given.runs} runs in turn\n"
    )
    print("| loop | us/step | ratio to plain |\n|---|---|---|")
    for name, value in us.items():
        print(f"| {name} | {value:.3f} | {value / us['plain']:.2f} |")
    costs = observer_costs(reference)
    same = [float(np.max(np.abs(other - reference))) for other in (fast, by_call, by_python)]
    good = report_checks(us, same, costs[BEST_METHOD])
    print("\n| arithmetic alone | us/step | internal steps/step |\n|---|---|---|")
    for name, spent, internal in arithmetic(parts, reference):
        print(f"| {name} | {spent:.3f} | {internal:.2f} |")
    print("\n| observer alone | us/step |\n|---|---|")
    for name, value in sorted(costs.items(), key=lambda item: item[1]):
        print(f"| {name} | {value:.2f} |")
    ratios = {
        f"{name} / native loop, time": us[name] / us["native"]
        for name in ("plain", "fmpy", "python")
    }
    return 0 if judge("loop", ratios, given.accept) and good else 1


def report_checks(us: dict[str, float], same: Sequence[float], best: float) -> bool:
    """Print what is required, and return whether all of it holds; `best`: us of the best method."""
    overhead, other = us["native"] - us["plain"], us["fmpy"] - us["plain"]
    over = other / max(overhead, 1e-9)
    checks = [
        ("overhead of our loop / plain loop, %", 100 * overhead / us["plain"], "<=", 20.0),
        ("overhead of FMPy's calls / overhead of our loop", over, ">=", 50.0),
        ("pythonfmu FMUs with FMPy / our loop", us["python"] / us["native"], ">=", 30.0),
        ("largest difference of native and fmpy from plain", max(same[:2]), "<=", 0.0),
        ("largest difference of python from plain", same[2], "<=", 1e-9),
        (f"one step of {BEST_METHOD} alone, us", best, "<=", 2.5),
    ]
    print("\n| requirement | measured | limit |\n|---|---|---|")
    for name, value, sign, limit in checks:
        print(f"| {name} | {value:.3g} | {sign} {limit:g} |")
    return all(
        value <= limit if sign == "<=" else value >= limit for _, value, sign, limit in checks
    )


if __name__ == "__main__":
    sys.exit(main())
