"""Effects of the plant in scenarios: built, set, refused, and scored only where a true value
exists.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bristle.harness.cosim.loop import simulate
from bristle.harness.run.checked import RunOptions
from bristle.harness.run.run import run
from bristle.harness.scenario.parts import Kind, build_fmus
from bristle.harness.scenario.plan import identification, prepare
from bristle.harness.scenario.reading import load
from bristle.observer import methods

Maker = Callable[..., Path]
Message = Callable[[Callable[[], Any]], str]
pytestmark = pytest.mark.usefixtures("no_leftovers")

EFFECTS = 'law = "modified"\neffects = {effects}\n'


def with_effects(base: str, *effects: str, parameters: str = "") -> str:
    """Return the scenario with effects and their parameters."""
    text = base.replace('law = "modified"\n', EFFECTS.format(effects=list(effects)), 1)
    return text.replace('J = "0.001 kg.m2"\n', f'J = "0.001 kg.m2"\n{parameters}\n', 1)


def signals(
    path: Path, fmi: int = 2, kind: Kind = "native", overrides: tuple[str, ...] = ()
) -> np.ndarray:
    loaded = load(path, overrides)
    return simulate(identification(prepare(loaded, build_fmus(loaded, fmi, kind)))).values


@pytest.mark.sampled(4)
@pytest.mark.usefixtures("undrawn")
def test_all_kinds_of_fmu_give_the_same_digits(base: str, scenario_file: Maker) -> None:
    path = scenario_file(
        with_effects(base, "cogging", "backlash", "input_noise", "measurement_delay").replace(
            "2 s", "0.5 s"
        )
    )
    native = signals(path)
    np.testing.assert_array_equal(native, signals(path, 3))
    np.testing.assert_allclose(native, signals(path, 2, "python"), rtol=1e-10, atol=1e-11)
    assert np.ptp(native[:, 0]) > 0


def test_a_parameter_of_an_effect_is_set_in_the_file_and_from_the_command_line(
    base: str, scenario_file: Maker
) -> None:
    default = signals(scenario_file(with_effects(base, "bias")))
    strong = signals(
        scenario_file(with_effects(base, "bias", parameters='bias.torque = "3 mN.m"'), "strong")
    )
    assert np.nanmax(np.abs(strong - default)) > 1e-3
    np.testing.assert_array_equal(
        strong,
        signals(
            scenario_file(with_effects(base, "bias")),
            overrides=("plant.parameters.bias.torque=3 mN.m",),
        ),
    )


def test_effects_from_the_command_line(base: str, scenario_file: Maker) -> None:
    one = signals(scenario_file(base), overrides=('plant.effects=["bias"]',))
    np.testing.assert_array_equal(one, signals(scenario_file(with_effects(base, "bias"))))


@pytest.mark.sampled(4)
def test_a_bias_is_the_load_that_an_observer_should_find(
    base: str, scenario_file: Maker, tmp_path: Path
) -> None:
    text = with_effects(base, "bias", parameters='bias.torque = "0.4 mN.m"').replace("2 s", "20 s")
    done = run(scenario_file(text), tmp_path, RunOptions())
    load = done.result["estimates"]["load"]
    assert load["true"] == pytest.approx(0.4e-3 / 1e-3)
    assert load["valid"]
    assert abs(load["error_percent"]) < 5


def test_the_observer_gets_the_input_without_the_noise(base: str, scenario_file: Maker) -> None:
    path = scenario_file(with_effects(base, "input_noise"))
    loaded = load(path)
    links = identification(prepare(loaded, build_fmus(loaded))).links
    assert (("controller", "u"), ("observer", "u")) in links
    assert (("controller", "u"), ("plant", "u")) in links


@pytest.mark.sampled(4)
@pytest.mark.parametrize("sensor", ["clean", "encoder"])
def test_a_delay_reaches_whatever_the_observer_reads(
    sensor: str, base: str, scenario_file: Maker
) -> None:
    """Driven in open loop, all that an observer can read is shifted by the delay."""
    driven = with_effects(base, "measurement_delay").replace(
        "[[checks]]",
        '[[stimuli]]\nvariable = "u"\npoints = [["0 s", "3 V"], ["1 s", "-2 V"]]\n\n[[checks]]',
        1,
    )
    path = scenario_file(f'sensor = "{sensor}"\n{driven}')
    found = []
    for samples in (0, 5):
        loaded = load(path, (f"plant.parameters.measurement_delay.samples={samples}",))
        setup = prepare(loaded, build_fmus(loaded))
        trace = simulate(identification(setup))
        found.append(np.column_stack([trace["plant", name] for name in setup.sensor]))
    np.testing.assert_allclose(found[1][6:], found[0][1:-5], rtol=1e-9, atol=1e-9)
    assert np.ptp(found[0]) > 1.0


def test_a_smooth_law_with_effects_has_an_encoder(base: str, scenario_file: Maker) -> None:
    loaded = load(scenario_file('sensor = "encoder"\n' + with_effects(base, "bias")))
    setup = prepare(loaded, build_fmus(loaded))
    assert np.ptp(simulate(identification(setup))["plant", "theta_enc"]) > 0.1


@pytest.mark.usefixtures("undrawn")
def test_a_parameter_without_a_true_value_has_no_error(
    base: str, scenario_file: Maker, tmp_path: Path
) -> None:
    path = scenario_file(with_effects(base, "friction_drift").replace("2 s", "6 s"))
    estimates = run(path, tmp_path / "out", RunOptions()).result["estimates"]
    assert estimates["alpha2"]["true"] == 2.0
    assert estimates["alpha2"]["error_percent"] is not None
    assert estimates["Fc"]["final"] is not None
    assert estimates["Fc"]["true"] is None
    assert estimates["Fc"]["error_percent"] is None


@pytest.mark.parametrize(
    ("plant", "words"),
    [
        (
            ("modified", ["coging"], ""),
            ["plant:", "unknown effect 'coging'", "did you mean 'cogging'"],
        ),
        (("modified", ["presliding"], ""), ["plant:", "'presliding' cannot join law 'modified'"]),
        (
            ("modfied", ["bias"], ""),
            ["plant:", "unknown friction law 'modfied'", "did you mean 'modified'"],
        ),
        (("modified", ["bias", "bias"], ""), ["plant:", "'bias' is given twice"]),
        (
            ("modified", ["bias"], 'bias.torqe = "1 N.m"'),
            ["plant.parameters.bias.torqe", "did you mean 'bias.torque'"],
        ),
        (("modified", ["bias"], "bias.torque = 1"), ["plant.parameters.bias.torque", "no unit"]),
        (
            ("modified", ["measurement_delay"], "measurement_delay.samples = 41"),
            ["outside [0, 40]"],
        ),
        (
            ("modified", ["input_noise"], "input_noise.seed = 1.5"),
            ["plant.parameters.input_noise.seed", "whole number"],
        ),
    ],
)
def test_what_cannot_be_is_one_line(
    plant: tuple[str, list[str], str],
    words: list[str],
    base: str,
    scenario_file: Maker,
    message: Message,
) -> None:
    law, effects, parameters = plant
    path = scenario_file(
        with_effects(base, *effects, parameters=parameters).replace('"modified"', f'"{law}"', 1)
    )

    def read() -> None:
        loaded = load(path)
        prepare(loaded, build_fmus(loaded))

    line = message(read)
    assert line.startswith(f"{path}: ")
    for word in words:
        assert word in line, line


def test_effects_and_a_foreign_plant_exclude_each_other(
    base: str, scenario_file: Maker, message: Message
) -> None:
    path = scenario_file(
        with_effects(base, "bias").replace('law = "modified"', 'fmu = "other.fmu"')
    )
    assert "effects join a law, and fmu is given" in message(lambda: load(path))


@pytest.mark.sampled(8)
@pytest.mark.parametrize("method", methods())
def test_no_method_is_taken_for_diverged(base: str, scenario_file: Maker, method: str) -> None:
    path = scenario_file(base.replace('duration = "2 s"', 'duration = "3 s"\nsensor = "encoder"'))
    loaded = load(path, (f"observer.method={method}",))
    setup = prepare(loaded, build_fmus(loaded, 2, "native"))
    assert not simulate(identification(setup)).failure


def test_a_torque_on_the_shaft_is_the_true_load(
    base: str, scenario_file: Maker, tmp_path: Path
) -> None:
    stimulus = (
        '[[stimuli]]\nvariable = "tau_load"\npoints = [["0 s", "0 N.m"], ["1 s", "0.0004'
        ' N.m"]]\n[[checks]]'
    )
    result = run(scenario_file(base.replace("[[checks]]", stimulus, 1)), tmp_path / "out").result
    load_found = result["estimates"]["load"]
    assert load_found["true"] == pytest.approx(0.4)
    assert "load_valid" in (tmp_path / "out" / "case" / "signals.csv").read_text().partition("\n")[
        0
    ].split(",")
