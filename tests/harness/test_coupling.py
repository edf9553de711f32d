"""What coupling costs: delays that are put in are found, and errors fall as they must."""

import json

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.harness.coupling import coupling, delay, divided, sequential
from bristle.harness.loop import simulate
from bristle.harness.run import Options, check

SCENARIO = """
duration = "4 s"
[plant]
law = "viscous"
[controller.parameters]
order = 2
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


def test_all_at_once_and_in_the_order_of_the_loop_differ_by_the_delay_of_a_step(scenario, tmp_path):
    """Controller before plant: the voltage acts a step earlier than with all at once."""
    bus = check(scenario, tmp_path / "out").bus
    jacobi, seidel = simulate(bus), sequential(bus, ("controller", "plant", "observer"))
    assert delay(jacobi["controller", "u"][:-1], seidel["controller", "u"][:-1], bus.h) == pytest.approx(0.0, abs=2 * bus.h)
    again = divided(bus, 1)
    assert np.array_equal(again.values, jacobi.values)  # undivided, it is the run itself
    one = sequential(bus, ("observer",))  # nothing else moves: the same inputs as at the start
    assert np.ptp(one["plant", "v"]) == 0


def test_errors_fall_with_the_step_and_the_report_holds_them(scenario, tmp_path):
    found = coupling(scenario, tmp_path / "out", Options())
    whole, half, quarter, *orders = found.schemes
    for name in ("plant.v", "controller.u"):
        errors = [each.errors[name].rms for each in (whole, half, quarter)]
        assert errors[0] > 1.5 * errors[1] > 1.5**2 * errors[2] > 0
        assert found.orders[name] == pytest.approx(1.0, abs=0.35)  # a delay of half a step and its hold
    assert 0 < quarter.errors["plant.v"].delay < half.errors["plant.v"].delay < whole.errors["plant.v"].delay < 1.5e-3
    assert [each.name.partition(",")[0] for each in orders] == ["plant - controller - observer", "controller - plant - observer"]
    assert whole.estimates["alpha2"] != quarter.estimates["alpha2"]
    content = json.loads((tmp_path / "out" / "coupling.json").read_text(encoding="utf-8"))
    assert content["schemes"][0]["signals"]["plant.v"]["rms"] == whole.errors["plant.v"].rms
    assert "Estimates at the end" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_a_record_has_no_coupling(tmp_path):
    rows = "\n".join(f"{0.001 * k},{np.sin(0.02 * k)},{np.cos(0.01 * k)}" for k in range(500))
    (tmp_path / "r.csv").write_text(f"t,u,y\n{rows}\n", encoding="utf-8")
    (tmp_path / "rig.toml").write_text(
        '[record]\nfile = "r.csv"\ntime = { column = "t", unit = "s" }\ninput = { column = "u", unit = "V", kind = "voltage" }\n'
        'output = { column = "y", unit = "rad", kind = "position" }\n[observer]\nmethod = "rls"\n',
        encoding="utf-8",
    )
    with pytest.raises(BristleError, match="couples nothing"):
        coupling(tmp_path / "rig.toml", tmp_path / "out")
    assert not (tmp_path / "out").exists()
