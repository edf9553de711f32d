"""The controller's equations: its generator, the statistics of its reference, its timing and its anti-windup."""

import itertools
import math

import numpy as np
import pytest

from bristle.fmus.build import program_of
from bristle.model.generator import MODULUS, MULTIPLIER
from bristle.model.native import Native

H = 1e-3
OPEN = {"clip": 1e4}


def reference(n, **parameters):
    record, _ = Native(program_of("controller"), OPEN | parameters).run(H, {"y_v": np.zeros(n)}, ["reference"])
    return record[:, 0]


def test_the_generator_is_park_and_millers_exactly():
    program = program_of("controller")
    record, _ = Native(program, {"seed": 5}).run(H, {"y_v": np.zeros(20_000)}, ["controller.random"])
    state = int(record[0, 0])
    assert 0 < state < MODULUS
    for value in record[:, 0]:
        assert int(value) == state == value
        state = MULTIPLIER * state % MODULUS


def test_ten_thousand_draws_from_one():
    """The check value of the generator's authors: from 1, the 10 000th draw after it is 1043618065."""
    state = 1
    for _ in range(10_000):
        state = MULTIPLIER * state % MODULUS
    assert state == 1043618065


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_rms_before_clipping(order):
    """Over 12 seeds of 500 s the mean square is that asked for; its standard error follows from the correlation time."""
    wanted = math.radians(120.0)
    squares = [np.mean(reference(500_000, seed=float(seed), order=order) ** 2) for seed in range(1, 13)]
    # var(mean of x^2) = 2 wanted^4 times the integral of the squared autocorrelation over the length
    correlation = {1.0: 1.0 / 5.0, 2.0: 5.0 / (4.0 * 5.0)}[order]  # s
    error = wanted**2 * math.sqrt(2.0 * correlation / 6000.0)
    assert abs(np.mean(squares) - wanted**2) < 3.5 * error
    assert error < 0.015 * wanted**2
    assert 0.5 * math.sqrt(12) * error < np.std(squares) < 2.0 * math.sqrt(12) * error


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_the_start_is_stationary(order):
    """The start over 2000 seeds has the covariance of a long record."""
    program = program_of("controller")
    places = [program.index["controller.x1"], program.index["controller.x2"]][: int(order)]
    starts = np.array([Native(program, {"seed": float(k), "order": order}).values[places] for k in range(1, 2001)])
    names = ["controller.x1", "controller.x2"][: int(order)]
    record, _ = Native(program, {"order": order}).run(H, {"y_v": np.zeros(1_000_000)}, names)
    np.testing.assert_allclose(starts.T @ starts / len(starts), record.T @ record / len(record), rtol=0.12)
    assert np.all(np.abs(starts.mean(axis=0)) < 4.0 * starts.std(axis=0) / math.sqrt(2000))


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_seeds_give_unrelated_references(order):
    """Also neighbouring seeds, whose plain streams would be small multiples of each other (correlation 1/k)."""
    records = np.array([reference(400_000, seed=float(seed), order=order) for seed in range(1, 13)])
    table = np.corrcoef(records)
    assert max(abs(table[a, b]) for a, b in itertools.combinations(range(12), 2)) < 4.5 / math.sqrt(400.0 / 0.25)


def test_clipping():
    record = reference(200_000, clip=math.radians(150.0))
    assert np.max(np.abs(record)) == math.radians(150.0)
    assert 0.1 < np.mean(np.abs(record) == math.radians(150.0)) < 0.4


def law(record, y, kp=4.0, ki=20.0, limit=24.0):
    """The control law in plain numbers."""
    integral, voltages = 0.0, [0.0]
    for r, v in zip(record, y, strict=False):
        error = r - v
        wanted = kp * error + integral
        voltages.append(min(max(wanted, -limit), limit))
        if abs(wanted) < limit or wanted * error < 0:
            integral += ki * H * error
    return voltages


@pytest.mark.parametrize("limit", [24.0, 3.0])
def test_control_law_timing_and_anti_windup(built, Raw, limit):
    """u published at t_(k+1) is the law's answer to reference and y_v at t_k; saturated or not."""
    raw = Raw(built("controller").info)
    handle = raw.running(u_max=limit, seed=4.0)
    y = 3.0 * np.sin(0.01 * np.arange(3000))
    voltages, references = raw.get(handle, "u"), raw.get(handle, "reference")
    for k, value in enumerate(y):
        assert raw.set(handle, "y_v", float(value)) == 0
        assert raw.step(handle, H * k, H) == 0
        [u, r] = raw.get(handle, "u", "reference")
        voltages.append(u)
        references.append(r)
    expected = law(references, y, limit=limit)
    np.testing.assert_allclose(voltages, expected, rtol=0, atol=1e-11)
    shifted = law(references, np.roll(y, 1), limit=limit)
    assert np.max(np.abs(np.array(voltages) - shifted)) > 1e-3
    assert np.any(np.abs(expected) == limit) == (limit == 3.0) or limit == 24.0
