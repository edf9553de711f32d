"""Noise: what a residual was made of is found again, and whitening leaves nothing of it but
ones.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from bristle.diagnosis.estimation.noise import CORNERS, estimate, response
from bristle.model.native import Native
from bristle.plant.servo import servo_program

H, WIDTH, BINS, SEGMENTS = 1e-3, 8, 50, 400
J, A2 = 0.01, 0.02


@pytest.fixture(scope="module")
def pulses():
    return response(J, A2, H, WIDTH, BINS, False)


def made(pulses, torque, corner, sensor, seed=1):
    """Averages under a torque that is white noise behind a lag (AR(1) in samples), and independent
    errors.
    """
    rng = np.random.default_rng(seed)
    n = pulses.shape[1]
    pole = math.exp(-2 * math.pi * corner * H)
    driven = math.sqrt(1 - pole**2) * rng.standard_normal((SEGMENTS, n + 3000))
    colour = lfilter([1.0], [1.0, -pole], driven, axis=1)[:, -n:]
    # unknown start states
    start = rng.normal(0, 1.0, (SEGMENTS, 2)) @ np.stack([np.ones(BINS), np.linspace(-1, 1, BINS)])
    return torque * colour @ pulses.T + sensor * rng.standard_normal((SEGMENTS, BINS)) + start


@pytest.mark.parametrize("corner", [3.0, 10.0, 30.0])
@pytest.mark.parametrize(("torque", "sensor"), [(0.004, 1e-4), (0.02, 5e-6), (0.05, 3e-4)])
def test_both_variances_are_found_again(pulses, torque, corner, sensor):
    """Torque and sensor noise, whichever is the louder, under start states a thousand times as
    large.
    """
    found = estimate(made(pulses, torque, corner, sensor), np.ones(SEGMENTS), pulses, H, 1e-7)
    assert found.corner == corner
    assert found.torque == pytest.approx(torque, rel=0.15)
    if sensor > 1e-5:  # a part hidden by the torque is estimated less closely
        assert found.sensor == pytest.approx(sensor, rel=0.1)


def test_whitening_leaves_ones(pulses):
    found = estimate(made(pulses, 0.004, 10.0, 1e-4), np.ones(SEGMENTS), pulses, H, 1e-7)
    rng = np.random.default_rng(3)
    again = made(pulses, 0.004, 10.0, 1e-4, seed=8)
    free = np.linalg.svd(np.column_stack([np.ones(BINS), np.arange(BINS)]))[0][:, 2:]
    cover = np.linalg.inv(found.whiten) @ np.linalg.inv(found.whiten).T
    expected = free.T @ cover @ free
    # what start states cannot touch
    z = np.linalg.solve(np.linalg.cholesky(expected), free.T @ again.T)
    assert np.mean(z**2) == pytest.approx(1.0, abs=0.03)
    spread = np.linalg.eigvalsh(z @ z.T / SEGMENTS)
    usual = np.linalg.eigvalsh(np.cov(rng.standard_normal((BINS - 2, SEGMENTS)), bias=True))
    assert spread[-1] < 1.25 * usual[-1]
    assert spread[0] > 0.75 * usual[0]
    sign, log_det = np.linalg.slogdet(cover)
    assert sign == 1
    assert found.log_det == pytest.approx(log_det, abs=1e-6)


def test_segments_without_weight_do_not_count(pulses):
    residual, weight = made(pulses, 0.004, 10.0, 1e-4), np.ones(SEGMENTS)
    spoilt = residual.copy()
    spoilt[::4] *= 50
    weight[::4] = 0.0
    kept = estimate(residual, weight, pulses, H, 1e-7)
    assert estimate(spoilt, weight, pulses, H, 1e-7).torque == kept.torque
    assert estimate(spoilt, np.ones(SEGMENTS), pulses, H, 1e-7).torque > 5 * kept.torque


def test_a_sensor_is_never_better_than_its_resolution(pulses):
    assert estimate(
        made(pulses, 0.004, 10.0, 1e-7), np.ones(SEGMENTS), pulses, H, 5e-5
    ).sensor >= 5e-5 * (1 - 1e-12)


@pytest.mark.parametrize("velocity", [False, True])
def test_the_response_is_that_of_a_servo_without_friction(velocity):
    torque = 0.1 * np.random.default_rng(2).standard_normal(WIDTH * BINS)
    parameters = {"J": J, "a2": A2, "b": 1.0, "u_max": 1e6, "solver.tolerance": 1e-10}
    record, _ = Native(servo_program("viscous", encoder=False), parameters).run(
        H, {"u": torque}, ["v" if velocity else "theta"]
    )
    expected = record[:-1, 0].reshape(BINS, WIDTH).mean(axis=1)
    np.testing.assert_allclose(
        response(J, A2, H, WIDTH, BINS, velocity) @ torque,
        expected,
        rtol=0,
        atol=1e-7 * np.ptp(expected),
    )


def test_the_corners_tried_span_what_a_segment_can_tell():
    assert CORNERS[0] <= 1 / (2 * math.pi * H * WIDTH * BINS) * 3
    assert CORNERS[-1] >= 1 / (2 * H * WIDTH)
