"""Noise of the input and delay of the measurement, against what they must do to a servo whose
solution is known.
"""

import math

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.model.generator import MODULUS, MULTIPLIER, NORMAL_DRAWS
from bristle.model.native import Native
from bristle.plant.effects import effects
from bristle.plant.servo import servo_program
from bristle.plant.signal_effects import SIGNAL_EFFECTS, extension

H = 1e-3
J, B, A2 = 0.001, 0.0065, 0.002  # the defaults of the servo
GRID = 2 * math.pi / 40000
OUTPUTS = ["theta", "v", "F", "theta_enc", "v_enc"]


def run(effect, law="lugre", record=OUTPUTS, n=400, **parameters):
    program = servo_program(law, effects=(effect,) if effect else ())
    u = 3.0 * np.sin(0.05 * np.arange(n)) + 1.0
    given = {f"{effect}.{name}": value for name, value in parameters.items()}
    return Native(program, given | {"theta_start": 0.3, "v_start": 0.5}).run(H, {"u": u}, record)[0]


@pytest.mark.parametrize("law", ["lugre", "coulomb", "gms"])
@pytest.mark.parametrize("k", [0, 1, 7, 40])
def test_a_delay_of_k_samples_shifts_all_outputs_by_k_rows(k, law):
    plain, late = run(None, law), run("measurement_delay", law, samples=float(k))
    columns = slice(None) if k else [0, 1, 3, 4]
    np.testing.assert_allclose(
        late[k + 1 :, columns], plain[1 : len(plain) - k, columns], rtol=1e-12, atol=1e-13
    )
    np.testing.assert_array_equal(late[: k + 1, 0], 0.3)
    np.testing.assert_array_equal(late[: k + 1, 1], 0.5)
    assert np.max(np.abs(np.diff(plain[:, 0]))) > 1e-4


def test_a_fraction_of_a_sample_is_on_the_line_between_two_rows():
    plain, late = run(None), run("measurement_delay", samples=2.25)
    for column in (0, 1, 2):
        between = 0.75 * plain[2:-2, column] + 0.25 * plain[1:-3, column]
        np.testing.assert_allclose(late[4:, column], between, rtol=1e-12, atol=1e-13)


def test_the_encoder_counts_the_delayed_position():
    late = run("measurement_delay", samples=2.5)
    np.testing.assert_allclose(late[:, 3], np.floor(late[:, 0] / GRID) * GRID, rtol=0, atol=1e-12)
    np.testing.assert_allclose(late[1:, 4], np.diff(late[:, 3]) / H, rtol=0, atol=1e-9)
    assert np.ptp(late[:, 3]) > 100 * GRID


def drawn(state, n):
    """Return n sums of 12 numbers of the generator, in whole numbers, less their mean."""
    found = []
    for _ in range(n):
        total = 0
        for _ in range(NORMAL_DRAWS):
            state = MULTIPLIER * state % MODULUS
            total += state
        found.append(total / MODULUS - NORMAL_DRAWS / 2)
    return np.array(found)


def test_the_noise_reaches_the_servo_and_is_what_the_generator_draws():
    """v(k+1) = e v(k) + (1 - e) (b/a2) (u + n) of a viscous servo gives the noise back."""
    n, sd = 4000, 0.2
    program = servo_program("viscous", encoder=False, effects=("input_noise",))
    native = Native(
        program, {"input_noise.sd": sd, "input_noise.seed": 7.0, "solver.tolerance": 1e-11}
    )
    record, _ = native.run(H, {"u": np.full(n, 1.5)}, ["v", "viscous.input_noise.random"])
    e = math.exp(-A2 / J * H)
    noise = (record[1:, 0] - e * record[:-1, 0]) / ((1 - e) * B / A2) - 1.5
    np.testing.assert_allclose(noise, sd * drawn(int(record[0, 1]), len(noise)), atol=1e-5)
    assert np.std(noise) == pytest.approx(sd, rel=4 / math.sqrt(2 * n))  # four standard errors
    assert abs(np.mean(noise)) < 4 * sd / math.sqrt(n)
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 4 / math.sqrt(n)


def test_the_seed_chooses_the_noise():
    one, again, other = (run("input_noise", seed=seed) for seed in (1.0, 1.0, 2.0))
    np.testing.assert_array_equal(one, again)
    assert np.max(np.abs(one[:, 1] - other[:, 1])) > 1e-3
    np.testing.assert_allclose(
        run("input_noise", sd=0.0)[1:], run(None)[1:], rtol=1e-12, atol=1e-13
    )


def test_the_noise_enters_before_the_limit_of_the_drive():
    program = servo_program("viscous", encoder=False, effects=("input_noise",))
    loud = {"input_noise.sd": 1e6, "u_max": 2.0}
    record, _ = Native(program, loud).run(H, {"u": np.zeros(500)}, ["v"])
    step = B / A2 * 2.0 * (1 - math.exp(-A2 / J * H))
    assert np.max(np.abs(np.diff(record[:, 0]))) <= 2 * step
    assert np.max(np.abs(np.diff(record[:, 0]))) > 0.9 * step


def test_a_constant_torque_shifts_the_steady_velocity_by_its_ratio_to_the_viscous_friction():
    speeds = []
    for torque in (0.0, 0.003):
        program = servo_program("viscous", effects=("bias",))
        record, _ = Native(program, {"bias.torque": torque}).run(
            H, {"u": np.full(15_000, 4.0)}, ["v"]
        )
        speeds.append(record[-1, 0])
    assert speeds[1] - speeds[0] == pytest.approx(0.003 / A2, rel=1e-9)


def test_signal_effects_are_no_part_of_a_diagnosis():
    assert not set(SIGNAL_EFFECTS) & set(effects())
    assert extension("input_noise") is SIGNAL_EFFECTS["input_noise"]
    assert extension("bias") is effects()["bias"]
    for name, each in SIGNAL_EFFECTS.items():
        assert each.name == name
        assert each.without_truth == ()
        assert all(p.name.startswith(f"{name}.") for p in each.parameters)
    with pytest.raises(
        BristleError, match=r"unknown effect 'input_nois' \(did you mean 'input_noise'\?\)"
    ):
        extension("input_nois")
