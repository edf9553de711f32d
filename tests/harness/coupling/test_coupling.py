"""What coupling costs: delays that are put in are found, and errors fall as they must."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.harness.cosim.bus import Failure
from bristle.harness.cosim.loop import simulate
from bristle.harness.coupling.coupling import APPLIED, ORDERS, coupled, coupling, delay
from bristle.harness.run.checked import RunOptions
from bristle.harness.run.run import build_and_check

MONOLITHIC = ORDERS[0]
SCENARIO = """
duration = "4 s"
[plant]
law = "viscous"
[controller.parameters]
order = 1
[observer]
method = "rls"
[[checks]]
quantity = "states.v.rms"
max = 1e9
"""


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    path = tmp_path_factory.mktemp("coupling") / "smooth.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    return path


@pytest.mark.parametrize("shift", [0.0, 1.0, -1.0, 0.37, 6.2])
def test_a_delay_is_found_in_fractions_of_a_sample(shift):
    h = 1e-3
    t = h * np.arange(8000)

    def signal(t):
        return np.sin(3 * t) + 0.4 * np.sin(11 * t + 1)

    assert delay(signal(t - shift * h), signal(t), h) == pytest.approx(shift * h, abs=1e-3 * h)
    assert delay(np.ones(9), np.ones(9), h) is None


def test_one_after_the_other_takes_away_the_step_by_which_the_voltage_is_late(scenario, tmp_path):
    """What acts on the plant from t_k is of the velocity at t_k, and of that at t_k-1 with all at
    once.
    """
    bus = build_and_check(scenario, tmp_path / "out").bus
    bus = replace(bus, record=(*bus.record, APPLIED, ("controller", "y_v")))
    jacobi, seidel = coupled(bus), coupled(bus, 1, MONOLITHIC)
    v, u = seidel["plant", "v"], seidel[APPLIED]
    assert np.array_equal(seidel["controller", "y_v"][1:], v[:-1])
    assert np.array_equal(u[1:], seidel["controller", "u"][1:])
    assert np.array_equal(jacobi[APPLIED][1:], jacobi["controller", "u"][:-1])
    assert delay(jacobi[APPLIED][1:], u[1:], bus.h) == pytest.approx(bus.h, rel=0.03)


@pytest.mark.parametrize("order", [(), MONOLITHIC])
def test_both_loops_give_the_same_digits(scenario, tmp_path, order):
    bus = build_and_check(scenario, tmp_path / "out").bus
    bus = replace(bus, steps=40, record=(*bus.record, APPLIED), split=4, sequential=bool(order))
    compiled, plain = (simulate(bus, engine=engine) for engine in ("native", "fmpy"))
    np.testing.assert_allclose(plain.values, compiled.values, rtol=1e-14, atol=1e-300)


def test_errors_fall_with_the_step_and_the_report_holds_them(scenario, tmp_path):
    found = coupling(scenario, tmp_path / "out", RunOptions())
    whole, half, quarter, monolithic, controller_first, plant_first = found.schemes
    for name in ("plant.v", "plant.u"):
        assert found.orders[name] == pytest.approx(1.0, abs=0.02)
        assert monolithic.errors[name].relative < 1e-9 < quarter.errors[name].relative
    for each, late in (
        (whole, 1.0),
        (half, 0.5),
        (quarter, 0.25),
        (monolithic, 0.0),
        (plant_first, 1.0),
    ):
        assert each.errors["plant.u"].delay == pytest.approx(late * found.step, rel=0.03, abs=1e-9)
    assert controller_first.errors["plant.v"] == monolithic.errors["plant.v"]
    # the observer sees the plant a step ahead of its voltage in one order only
    for name in ("alpha2", "b"):
        value = pytest.approx(found.refined[name], rel=1e-9)
        assert monolithic.estimates[name] == value
        assert plant_first.estimates[name] == value
        assert controller_first.estimates[name] != value
    assert {each.verdict for each in found.schemes} == {"pass"} == {found.verdict}
    content = json.loads((tmp_path / "out" / "coupling.json").read_text(encoding="utf-8"))
    assert content["schemes"][0]["signals"]["plant.v"]["rms"] == whole.errors["plant.v"].rms
    assert "estimates at the end" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_a_check_that_fails_in_a_coupling_is_its_verdict(scenario, tmp_path):
    options = RunOptions(overrides=("checks.0.max=0",))
    assert {each.verdict for each in coupling(scenario, tmp_path / "out", options).schemes} == {
        "fail"
    }


def test_no_order_is_said_where_a_run_with_one_of_the_steps_ends_early(
    scenario, tmp_path, monkeypatch
):
    """The schemes that are left are not taken for others."""

    def halved_fails(bus, parts=1, order=()):
        trace = coupled(bus, parts, order)
        return replace(trace, failure=Failure("plant", 0.1, "it diverged")) if parts == 2 else trace

    monkeypatch.setattr("bristle.harness.coupling.coupling.coupled", halved_fails)
    found = coupling(scenario, tmp_path / "out", RunOptions())
    assert len(found.schemes) == 5
    assert found.orders == {}
    assert "it is left out" in found.notes[0]


def test_a_record_has_no_coupling(tmp_path):
    rows = "\n".join(f"{0.001 * k},{np.sin(0.02 * k)},{np.cos(0.01 * k)}" for k in range(500))
    (tmp_path / "r.csv").write_text(f"t,u,y\n{rows}\n", encoding="utf-8")
    (tmp_path / "rig.toml").write_text(
        '[record]\nfile = "r.csv"\ntime = { column = "t", unit = "s" }\ninput = { column = "u",'
        ' unit = "V", kind = "voltage" }\noutput = { column = "y", unit = "rad", kind = "position"'
        ' }\n[observer]\nmethod = "rls"\n',
        encoding="utf-8",
    )
    with pytest.raises(BristleError, match="couples nothing"):
        coupling(tmp_path / "rig.toml", tmp_path / "out")
    assert not (tmp_path / "out").exists()
