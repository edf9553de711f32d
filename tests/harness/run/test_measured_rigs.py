"""Observers on measured rigs, in the units of each: what they call valid is possible, and near what
least squares finds.

Each test is skipped where its data are absent.
"""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bristle.harness.run.run import FinishedRun, run

_PATH = Path(__file__).parents[3] / "benchmarks" / "measured" / "measured_data.py"
_spec = importlib.util.spec_from_file_location("measured", _PATH)
assert _spec is not None
assert _spec.loader is not None
measured = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(measured)

METHODS = ("rls", "self_starting_ekf")
# that no servo whose input drives it forward has below 0
POSITIVE = ("alpha2", "b", "Fc", "sigma0", "c")


@pytest.fixture
def data() -> ModuleType:
    if not measured.MEASURED_FOLDER.is_dir():
        pytest.skip(f"no measured data: {measured.MEASURED_FOLDER} is not there (set BRISTLE_DATA)")
    return measured


def observed(
    folder: Path, entry: tuple[str, Any, Any, Any, Any], rig: tuple[str, str, str], method: str
) -> FinishedRun:
    """Run a method on a measured record; `rig` are kind and unit of the input, and unit of the
    position.
    """
    name, t, u, y, _ = entry
    kind, drive, position = rig
    np.savez(folder / f"{name}.npz", t=t, u=u, y=y)
    path = folder / f"{name}_{method}.toml"
    path.write_text(f"""
[record]
file = "{name}.npz"
time = {{ column = "t", unit = "s" }}
input = {{ column = "u", kind = "{kind}", unit = "{drive}" }}
output = {{ column = "y", kind = "position", unit = "{position}" }}
[observer]
method = "{method}"
""")
    return run(path, folder / "out")


def must_be_possible(done: FinishedRun) -> None:
    """No estimate that is called valid is one that no servo has, and without valid ones the verdict
    is fail.
    """
    found = done.result["estimates"]
    for name, each in found.items():
        if each["valid"]:
            assert math.isfinite(each["final"])
            assert each["adapted"]
            assert name not in POSITIVE or each["final"] > 0, (
                f"{name} = {each['final']:.3g} {each['unit']} is called valid"
            )
    if done.passed:
        assert found["alpha2"]["valid"]
        assert found["b"]["valid"]
    else:
        assert done.findings


def least_squares(
    t: NDArray[np.float64], force: NDArray[np.float64], x: NDArray[np.float64], window: float = 0.01
) -> list[float]:
    """Return mass [kg], alpha2 [1/s], Fc [N] and offset [N] of a' M = F - Fv v - Fc sgn v - offset.

    Speed and acceleration are means over a window [s]; samples near rest are left out. Independent
    of the observers: no recursion, no filter of theirs, and the offset is fitted too.
    """
    n = round(window / (t[1] - t[0]))
    v = (x[2 * n :] - x[: -2 * n]) / (2 * n * (t[1] - t[0]))
    a = (x[2 * n :] - 2 * x[n:-n] + x[: -2 * n]) / (n * (t[1] - t[0])) ** 2
    f = np.convolve(force, np.ones(2 * n + 1) / (2 * n + 1), "valid")
    used = np.abs(v) > 0.2 * np.max(np.abs(v))
    rows = np.column_stack([a, v, np.sign(v), np.ones(len(v))])[used]
    mass, viscous, coulomb, offset = np.linalg.lstsq(rows, f[used], rcond=None)[0].tolist()
    return [mass, viscous / mass, coulomb, offset]


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("method", METHODS)
def test_emps_in_newton_and_metres(method: str, data: ModuleType, tmp_path: Path) -> None:
    """Near least squares where it is called valid, with the offset of 3 N in the force and without
    it.
    """
    [(name, t, voltage, x, extra)] = data.emps()
    force = voltage * extra["gain"]
    mass, alpha2, coulomb, offset = least_squares(t, force, x)
    assert (mass, alpha2, coulomb) == (
        pytest.approx(95.1, rel=0.03),
        pytest.approx(2.1, rel=0.05),
        pytest.approx(20.4, rel=0.1),
    )
    for shift in (0.0, offset):
        done = observed(
            tmp_path, (f"{name}{shift:.0f}", t, force - shift, x, {}), ("force", "N", "m"), method
        )
        must_be_possible(done)
        assert done.result["steps"] == len(t)
        found = done.result["estimates"]
        assert {n: found[n]["unit"] for n in ("alpha2", "b", "Fc")} == {
            "alpha2": "1/s",
            "b": "m/(s2.N)",
            "Fc": "m/s2",
        }
        near = {"alpha2": alpha2, "b": 1 / mass, "Fc": coulomb / mass}
        for parameter, value in near.items():
            if found[parameter]["valid"]:
                assert found[parameter]["final"] == pytest.approx(value, rel=0.15), parameter


@pytest.mark.usefixtures("undrawn")
@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("records", "rig"),
    [("xl330", ("voltage", "V", "rad")), ("go1", ("torque", "N.m", "rad"))],
    ids=["xl330", "go1"],
)
def test_pendulums_that_no_model_of_an_observer_contains(
    records: str, rig: tuple[str, str, str], method: str, data: ModuleType, tmp_path: Path
) -> None:
    """Gravity acts on both, at 5 and at 16 ms: an observer may find nothing valid there, but
    nothing impossible.
    """
    entries = getattr(data, records)()
    assert len(entries) >= 12
    for entry in entries[::3]:
        must_be_possible(observed(tmp_path, entry, rig, method))
