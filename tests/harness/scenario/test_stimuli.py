"""Stimuli: steps, sines and coloured noise on the inputs of the plant."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bristle.harness.cosim.loop import simulate
from bristle.harness.run.checked import RunOptions
from bristle.harness.run.run import run
from bristle.harness.scenario.parts import build_fmus
from bristle.harness.scenario.plan import identification, prepare, validation
from bristle.harness.scenario.reading import load
from bristle.harness.scenario.stimuli import coloured

Maker = Callable[..., Path]
Message = Callable[[Callable[[], Any]], str]
pytestmark = pytest.mark.usefixtures("no_leftovers")

H = 1e-3
J, B, A2 = 0.001, 0.0065, 0.002  # the servo, whose friction is viscous
OPEN_LOOP = '[[stimuli]]\nvariable = "u"\npoints = [["0 s", "0 V"]]\n'


def stimulated(base: str, *stimuli: str) -> str:
    """Return the scenario on a viscous servo with stimuli."""
    return base.replace('"modified"', '"viscous"', 1).replace(
        "[[checks]]", "\n".join([*stimuli, "[[checks]]"]), 1
    )


def torque(text: str) -> str:
    return f'[[stimuli]]\nvariable = "tau_load"\n{text}\n'


def prepared(path: Path) -> Any:
    loaded = load(path)
    return prepare(loaded, build_fmus(loaded))


def velocity(path: Path) -> np.ndarray:
    return simulate(identification(prepared(path)))["plant", "v"]


def driven(torques: np.ndarray) -> np.ndarray:
    """Return the exact velocity of J v' = T - a2 v from rest, with T held over each step."""
    e, v = math.exp(-A2 / J * H), [0.0]
    for value in torques:
        v.append(e * v[-1] + (1 - e) / A2 * value)
    return np.array(v)


def test_constant_step_and_sine_move_the_shaft_as_the_solution_says(
    base: str, scenario_file: Maker
) -> None:
    text = (
        'points = [["0 s", "1 mN.m"], ["0.5 s", "-2 mN.m"]]\nsine = {amplitude = "3 mN.m",'
        ' frequency = "4 Hz", phase = "30 deg"}'
    )
    found = velocity(scenario_file(stimulated(base, OPEN_LOOP, torque(text))))
    t = H * np.arange(2000)
    expected = driven(
        np.where(t < 0.5 - 1e-9, 0.001, -0.002) + 0.003 * np.sin(2 * math.pi * 4 * t + math.pi / 6)
    )
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.max(np.abs(expected)))


@pytest.mark.usefixtures("undrawn")
def test_the_noise_is_what_signals_csv_shows(
    base: str, scenario_file: Maker, tmp_path: Path
) -> None:
    path = scenario_file(
        stimulated(
            base, OPEN_LOOP, torque('noise = {rms = "2 mN.m", bandwidth = "20 Hz", seed = 4}')
        )
    )
    folder = run(path, tmp_path / "out", RunOptions(full=True)).folder
    table = np.genfromtxt(folder / "signals.csv", delimiter=",", names=True)
    assert len(table) == 2001
    np.testing.assert_allclose(table["v"], driven(table["tau_load"][:-1]), atol=1e-6)
    np.testing.assert_allclose(
        table["tau_load"], 0.002 * coloured(2001, 2 * math.pi * 20 * H, 4), rtol=1e-6, atol=1e-9
    )
    assert np.std(table["tau_load"]) > 1e-3


def test_rms_and_bandwidth_of_the_noise() -> None:
    """The mean square over many seeds, at the start too, and a correlation that falls as exp(-2 pi
    f tau).
    """
    corner = 2 * math.pi * 8.0 * H
    noise = np.array([coloured(4000, corner, seed) for seed in range(400)])
    assert np.var(noise) == pytest.approx(1.0, rel=0.03)
    assert np.var(noise[:, 0]) == pytest.approx(1.0, rel=0.25)
    for lag in (10, 40):
        assert np.mean(noise[:, lag:] * noise[:, :-lag]) == pytest.approx(
            math.exp(-corner * lag), abs=0.02
        )
    np.testing.assert_array_equal(noise[7], coloured(4000, corner, 7))
    np.testing.assert_array_equal(noise[7][:100], coloured(100, corner, 7))
    assert abs(np.mean(noise[7] * noise[8])) < 0.3


def test_a_sine_of_the_voltage_reaches_plant_and_observer(base: str, scenario_file: Maker) -> None:
    sine = '[[stimuli]]\nvariable = "u"\nsine = {amplitude = "2 V", frequency = "1 Hz"}\n'
    bus = identification(prepared(scenario_file(stimulated(base, sine))))
    assert set(bus.series) == {("plant", "u"), ("observer", "u")}
    expected = 2.0 * np.sin(2 * math.pi * H * np.arange(2000))
    np.testing.assert_allclose(bus.series["plant", "u"], expected, atol=1e-12)
    found = simulate(bus)["plant", "v"]
    np.testing.assert_allclose(found, driven(B * expected), atol=1e-6 * np.max(np.abs(found)))


def test_the_second_run_has_the_last_level_and_the_noise(base: str, scenario_file: Maker) -> None:
    text = torque(
        'points = [["0 s", "1 mN.m"], ["1 s", "2 mN.m"]]\nnoise = {rms = "1 mN.m", bandwidth = "5'
        ' Hz"}'
    )
    setup = prepared(scenario_file(stimulated(base, text, '[validation]\nduration = "3 s"\n')))
    first, second = (
        bus.series["plant", "tau_load"] for bus in (identification(setup), validation(setup))
    )
    assert (len(first), len(second)) == (2000, 3000)
    np.testing.assert_allclose(second[1000:2000], first[1000:], rtol=1e-12)
    np.testing.assert_allclose(second[:1000] - first[:1000], 0.001, rtol=1e-9)


@pytest.mark.usefixtures("undrawn")
def test_a_load_that_varies_scales_the_truth(
    base: str, scenario_file: Maker, tmp_path: Path
) -> None:
    sine = (
        '[[stimuli]]\nvariable = "load_scale"\nsine = {amplitude = 0.25, frequency = "0.5 Hz",'
        ' phase = "90 deg"}\n'
    )
    path = scenario_file(base.replace("2 s", "4 s").replace("[[checks]]", f"{sine}\n[[checks]]", 1))
    done = run(path, tmp_path / "out", RunOptions())
    true = json.loads((done.folder / "result.json").read_text())["estimates"]["Fc"]["true"]
    steady = json.loads(
        (run(scenario_file(base, "steady"), tmp_path / "out").folder / "result.json").read_text()
    )
    # the estimate of the last row belongs to the row before
    scale = 1 + 0.25 * math.cos(math.pi * (4.0 - H))
    assert true == pytest.approx(scale * steady["estimates"]["Fc"]["true"], rel=1e-9)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["stimuli[0]", "give points, sine or noise"]),
        (
            'sine = {amplitude = "1 V", frequency = "1 Hz"}',
            ["stimuli[0].sine.amplitude", "'V' does not fit"],
        ),
        (
            'sine = {amplitude = "-1 N.m", frequency = "1 Hz"}',
            ["stimuli[0].sine.amplitude", "at least 0"],
        ),
        (
            'sine = {amplitude = "1 N.m", frequency = "500 Hz"}',
            ["stimuli[0].sine.frequency", "below 500 Hz"],
        ),
        (
            'sine = {amplitude = "1 N.m", frequency = "0 Hz"}',
            ["stimuli[0].sine.frequency", "higher than 0 Hz"],
        ),
        (
            'sine = {amplitude = "1 N.m", freqency = "1 Hz"}',
            ["stimuli[0].sine.freqency", "did you mean 'frequency'"],
        ),
        ('noise = {rms = "1 N.m"}', ["stimuli[0].noise.bandwidth", "missing"]),
        ('noise = {rms = 1.0, bandwidth = "1 Hz"}', ["stimuli[0].noise.rms", "has no unit"]),
        (
            'noise = {rms = "1 N.m", bandwidth = "600 Hz"}',
            ["stimuli[0].noise.bandwidth", "below 500 Hz"],
        ),
        (
            'noise = {rms = "1 N.m", bandwidth = "1 Hz", seed = -1}',
            ["stimuli[0].noise.seed", "at least 0"],
        ),
    ],
)
def test_what_cannot_be_is_one_line(
    text: str, words: list[str], base: str, scenario_file: Maker, message: Message
) -> None:
    path = scenario_file(stimulated(base, torque(text)))
    line = message(lambda: prepared(path))
    assert line.startswith(f"{path}: ")
    for word in words:
        assert word in line, line


def test_a_sum_outside_the_interval_of_the_input_is_one_line(
    base: str, scenario_file: Maker, message: Message
) -> None:
    text = '[[stimuli]]\nvariable = "load_scale"\nsine = {amplitude = 1.5, frequency = "1 Hz"}\n'
    line = message(lambda: prepared(scenario_file(stimulated(base, text))))
    assert 'stimuli[0] = "load_scale"' in line
    assert "outside [0, 1e+06];" in line
