"""The controller's equations: its generator, the statistics of its reference, its timing and its
anti-windup.
"""

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
    record, _ = Native(program_of("controller"), OPEN | parameters).run(
        H, {"y_v": np.zeros(n)}, ["reference"]
    )
    return record[:, 0]


def test_the_generator_is_park_and_millers_exactly():
    program = program_of("controller")
    record, _ = Native(program, {"seed": 5}).run(
        H, {"y_v": np.zeros(20_000)}, ["controller.random"]
    )
    state = int(record[0, 0])
    assert 0 < state < MODULUS
    for value in record[:, 0]:
        assert int(value) == state == value
        state = MULTIPLIER * state % MODULUS


def test_ten_thousand_draws_from_one():
    """The check value of the generator's authors: from 1, the 10 000th draw after it is
    1043618065.
    """
    state = 1
    for _ in range(10_000):
        state = MULTIPLIER * state % MODULUS
    assert state == 1043618065


@pytest.mark.sampled(4)
@pytest.mark.parametrize("order", [1.0, 2.0])
def test_rms_before_clipping(order):
    """Over 12 seeds of 500 s the mean square is that asked for; its standard error follows from the
    correlation time.
    """
    wanted = math.radians(120.0)
    squares = [
        np.mean(reference(500_000, seed=float(seed), order=order) ** 2) for seed in range(1, 13)
    ]
    # var(mean of x^2) = 2 wanted^4 times the integral of the squared autocorrelation over the
    # length
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
    instance, values, starts = Native(program), np.array(program.starts), []
    values[program.index["order"]] = order
    for seed in range(1, 2001):
        values[program.index["seed"]] = seed
        instance.initialise(values)
        starts.append(instance.values[places])
    starts = np.array(starts)
    names = ["controller.x1", "controller.x2"][: int(order)]
    record, _ = Native(program, {"order": order}).run(H, {"y_v": np.zeros(1_000_000)}, names)
    np.testing.assert_allclose(
        starts.T @ starts / len(starts), record.T @ record / len(record), rtol=0.12
    )
    assert np.all(np.abs(starts.mean(axis=0)) < 4.0 * starts.std(axis=0) / math.sqrt(2000))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("order", [1.0, 2.0])
def test_seeds_give_unrelated_references(order):
    """Also neighbouring seeds, whose plain streams would be small multiples of each other
    (correlation 1/k).
    """
    records = np.array([reference(400_000, seed=float(seed), order=order) for seed in range(1, 13)])
    table = np.corrcoef(records)
    assert max(abs(table[a, b]) for a, b in itertools.combinations(range(12), 2)) < 4.5 / math.sqrt(
        400.0 / 0.25
    )


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


# -- feed-forward and compensation -----------------------------------------------------------------

TRUE = {
    "alpha2": 2.0,
    "b": 6.5,
    "Fc": 4.0,
    "sigma0": 600.0,
    "sigma1": 800.0,
    "sigma2": 300.0,
    "c": 150.0,
    "load": 0.7,
}


STATES = {name: f"controller.{name}" for name in ("gain_inertia", "test_acting_load", "bristle")}


def forward(n, estimates, parameters=None, **inputs):
    """Return outputs and some states of the compensation while y_v is 0; `inputs` are constants or
    series.
    """
    given = {"y_v": 0.0, **inputs}
    given |= {
        f"{name}_{what}": value
        for name, x in estimates.items()
        for what, value in (("hat", x), ("valid", 1.0))
    }
    columns = {
        name: np.broadcast_to(np.asarray(value, float), n).copy() for name, value in given.items()
    }
    names = {name: name for name in ("u", "u_compensation", "reference")} | STATES
    record, _ = Native(program_of("controller"), parameters or {}).run(
        H, columns, list(names.values())
    )
    return dict(zip(names, record.T, strict=True))


def test_estimates_that_are_not_valid_change_no_digit():
    """Nor does a b that is 0, whatever else is valid."""
    plain = forward(5000, {})
    hats = {f"{name}_hat": value for name, value in TRUE.items()}
    assert np.array_equal(forward(5000, {}, **hats)["u"], plain["u"])
    assert np.array_equal(forward(5000, TRUE | {"b": 0.0})["u"], plain["u"])
    assert not np.array_equal(forward(5000, TRUE)["u"], plain["u"])
    assert not plain["u_compensation"].any()


def test_the_scale_multiplies_the_reference_alone():
    scaled, plain = forward(3000, {}, reference_scale=0.125), forward(3000, {})
    assert np.array_equal(scaled["reference"][1:], 0.125 * plain["reference"][1:])


def followed(friction, estimates, seconds=40.0, late=0, order=2.0):
    """Return the rms tracking error over the second half, on v' = b u - alpha2 v - friction,
    exactly sampled.
    """
    n, v, w = round(seconds / H), 0.0, 0.0
    controller = Native(
        program_of("controller"), {"order": order, "rms": math.radians(15.0), "fade": 1e-3}
    )
    given = {
        f"{name}_{what}": value
        for name, x in estimates.items()
        for what, value in (("hat", x), ("valid", 1.0))
    }
    kept, errors, voltages = math.exp(-TRUE["alpha2"] * H), [], [0.0] * (1 + late)
    columns = {"y_v": np.zeros(1), **{name: np.array([value]) for name, value in given.items()}}
    for _ in range(n):
        columns["y_v"][0] = v
        record, _ = controller.run(H, columns, ["u", "reference"])
        errors.append(record[0, 1] - v)
        steps = 10 if friction else 1
        for _ in range(steps):
            w += H / steps * TRUE["c"] * (TRUE["Fc"] * v - abs(v) * w) if friction else 0.0
            part = kept ** (1 / steps)
            v = part * v + (1 - part) / TRUE["alpha2"] * (TRUE["b"] * voltages[0] - w)
        voltages = [*voltages[1:], record[1, 0]]
    return float(np.sqrt(np.mean(np.square(errors[n // 2 :]))))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("order", [1.0, 2.0])
def test_a_known_linear_servo_follows_its_reference(order):
    """Also one whose acceleration is white noise. The same voltage one sample later leaves twenty
    times more.
    """
    known = {name: TRUE[name] for name in ("alpha2", "b")}
    alone, right, late = (
        followed(False, *case, order=order)
        for case in (({}, 20.0), (known, 20.0), (known, 20.0, 1))
    )
    assert right < 2e-3 * alone
    assert late > 10 * right


@pytest.mark.sampled(4)
def test_known_friction_is_compensated():
    linear = {name: TRUE[name] for name in ("alpha2", "b")}
    alone, without, coulomb, whole = (
        followed(True, each, 20.0)
        for each in ({}, linear, linear | {"Fc": 4.0}, linear | {"Fc": 4.0, "c": TRUE["c"]})
    )
    assert without > 0.8 * alone
    assert coulomb < 0.2 * alone
    assert whole < 0.02 * alone


def test_levels_come_from_sigma_and_c_where_these_are_valid():
    """At a constant speed W tends to (sigma0 + sum sigma_i phi_i)/c; without all of them to Fc."""
    slow = {"order": 2.0, "cutoff": 1e-3, "fade": 1e-3}
    speed = math.radians(20.0)
    scale = speed / forward(1000, {}, slow)["reference"][-1]
    for missing, level in ((None, (600 + 800 * math.exp(-4.0) + 300) / 150), ("sigma1", 4.0)):
        estimates = {
            name: value for name, value in TRUE.items() if name not in (missing, "load", "alpha2")
        }
        assert forward(1000, estimates, slow, reference_scale=scale)["bristle"][
            -1
        ] * 6.5 == pytest.approx(level, rel=0.01)
    # against the load
    assert forward(1000, TRUE, slow)["test_acting_load"][-1] * 6.5 == pytest.approx(-0.7)


def test_an_estimate_fades_in_and_out():
    n, begin, end, fade = 9000, 2000, 6000, 1.5
    valid = np.zeros(n)
    valid[begin:end] = 1.0
    gain = forward(n, {}, {"fade": fade}, b_hat=6.5, b_valid=valid)["gain_inertia"] * 6.5
    for k in (begin + 100, begin + 3000):
        assert gain[k] == pytest.approx(1 - math.exp(-(k - begin) * H / fade))
    assert gain[end + 1500] == pytest.approx(gain[end] * math.exp(-1500 * H / fade))


def test_feed_forward_is_added_before_the_limit_and_does_not_wind_up():
    pushed = np.zeros(4000)
    pushed[1000:3000] = 1e3
    u, reference = (forward(4000, {}, u_ff=pushed)[name] for name in ("u", "reference"))
    assert np.max(np.abs(u)) == 24.0
    integral, expected = 0.0, [0.0]
    for error, push in zip(reference, pushed, strict=False):
        wanted = 4.0 * error + integral + push
        expected.append(min(max(wanted, -24.0), 24.0))
        integral += 20.0 * H * error if abs(wanted) < 24.0 or wanted * error < 0 else 0.0
    np.testing.assert_allclose(u, expected, rtol=0, atol=1e-11)


def test_absurd_estimates_leave_every_output_finite():
    tiny = dict.fromkeys(TRUE, 1e-300) | {"tau": 1e-300, "width": 1e-300}
    for estimates in (
        tiny,
        {"b": 5e-324, "alpha2": 0.0},
        {name: 1e300 for name in tiny},
        {name: -1e300 for name in tiny},
        tiny | {"sigma0": 1e300},
    ):
        for found in forward(3000, estimates).values():
            assert np.isfinite(found).all()


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    "wrong", [{"b": 2.0}, {"b": 20.0}, {"Fc": 20.0}, {"Fc": -4.0}, {"alpha2": 40.0}, {"load": 5.0}]
)
def test_wrong_estimates_are_not_worse_than_none(wrong):
    """What does not make tracking better is taken back, though the estimates are called valid."""
    known = {"alpha2": 2.0, "b": 6.5, "Fc": 4.0, "c": 150.0}
    alone, found = (followed(True, each, 20.0) for each in ({}, known | wrong))
    assert found < alone
