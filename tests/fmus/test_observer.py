"""The observer as a unit on a bus: it sees u and y and nothing else, and its adaptive state can be
handed over.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from bristle.fmus import obtain
from bristle.fmus.host import Fmu, Slave
from bristle.harness.cosim.bus import Bus, BusUnit
from bristle.harness.cosim.loop import simulate
from bristle.observer import methods

HERE = Path(__file__).parent
H = 1e-3
SECONDS = 4.0


@lru_cache(maxsize=1)
def continued():
    """Import the neighbouring file, which also is the other process."""
    spec = importlib.util.spec_from_file_location(
        "bristle_tests_fmus_continued", HERE / "continued.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@lru_cache(maxsize=1)
def record():
    """Return u and the encoder's position and velocity of a servo under the reference controller, a
    row a sample.
    """
    instances = (
        BusUnit("plant", Fmu(obtain("plant")), {}),
        BusUnit("controller", Fmu(obtain("controller")), {}),
    )
    links = ((("controller", "u"), ("plant", "u")), (("plant", "v"), ("controller", "y_v")))
    taps = (("controller", "u"), ("plant", "theta_enc"), ("plant", "v_enc"))
    return simulate(Bus(instances, round(SECONDS / H), H, links, record=taps)).values


def replayed(method, others=()):
    """Run an observer on the record, with other units on the same bus that it is not connected
    to.
    """
    own, seen = BusUnit("observer", Fmu(obtain("observer", method=method)), {}), record()
    series = {
        ("observer", name): np.ascontiguousarray(seen[:-1, i])
        for i, name in enumerate(continued().SEEN)
    }
    for other in others:
        series[(other.name, "u")] = series["observer", "u"]
    taps = tuple(("observer", name) for name in continued().OUTPUTS)
    return simulate(Bus((*others, own), len(seen) - 1, H, series=series, record=taps)).values


def plants():
    """Return the plant, and the same one with each of its hidden states and parameters moved."""
    fmu = Fmu(obtain("plant"))
    base = BusUnit("plant", fmu, {"law": fmu.choices("law")["modified"]})
    moved = {
        "J": 0.002,
        "b": 0.01,
        "a2": 0.004,
        "theta_start": 1.0,
        "v_start": 3.0,
        "modified.sigma0": 900.0,
        "modified.sigma1": 100.0,
        "modified.sigma2": 0.0,
        "modified.c": 400.0,
        "modified.tau": 0.02,
    }
    return base, [
        replace(base, values=base.values | {name: value}) for name, value in moved.items()
    ]


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", sorted(methods()))
def test_no_path_leads_from_a_hidden_state_to_the_observer(method):
    """The plant moves otherwise, u and y stay: to the last bit, so do the estimates."""
    base, moved = plants()
    expected = replayed(method, (base,))
    assert np.isfinite(expected).any()
    for plant in moved:
        np.testing.assert_array_equal(replayed(method, (plant,)), expected)
    variables = Fmu(obtain("observer", method=method)).description.modelVariables
    assert [v.name for v in variables if v.causality == "input"] == [*continued().SEEN]


def test_the_moved_plants_do_move_otherwise():
    """The check above would pass for plants that are all the same: these are not."""
    base, moved = plants()
    series = {("plant", "u"): np.ascontiguousarray(record()[:-1, 0])}
    taps = (("plant", "theta"), ("plant", "v"), ("plant", "F"))
    runs = [
        simulate(Bus((plant,), len(record()) - 1, H, series=series, record=taps)).values
        for plant in (base, *moved)
    ]
    for other in runs[1:]:
        assert np.abs(other[1000:] - runs[0][1000:]).max() > 1e-3


@pytest.mark.slow
def test_an_adaptive_state_is_handed_over_to_another_process(tmp_path):
    """Every method is stopped in mid-run, serialised, restored in one other process, and goes on to
    the last bit.
    """
    fmu, seen = Fmu(obtain("observer")), record()
    half, jobs, expected = len(seen) // 2, {}, {}
    for method, choice in fmu.choices("method").items():
        with Slave(fmu, method) as slave:
            starts = (f"{method}.longest_wait", f"{method}.step2_start")  # step 2 is to run too
            slave.initialise(
                {"method": choice} | {start: H for start in starts if fmu.has(start, "parameter")}
            )
            continued().advance(slave, seen, 0, half)
            state = slave.instance.getFMUstate()
            jobs[method] = bytes(slave.instance.serializeFMUstate(state)).hex()
            slave.instance.freeFMUstate(state)
            expected[method] = continued().advance(slave, seen, half, len(seen) - 1)
    (tmp_path / "jobs.json").write_text(json.dumps(jobs), encoding="utf-8")
    np.save(tmp_path / "seen.npy", seen)
    done = subprocess.run(
        [sys.executable, str(HERE / "continued.py"), str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = np.load(tmp_path / "found.npz")
    for method in jobs:
        np.testing.assert_array_equal(found[method], expected[method], err_msg=method)
    # they are different methods
    assert len({table.tobytes() for table in expected.values()}) == len(jobs)
