"""The likelihood of sliding motion: the filter against closed forms and another implementation, the
estimates against servos whose parameters are known.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from bristle.diagnosis.free_parameter import Free
from bristle.diagnosis.sliding.fit import (
    SlidingFit,
    SlidingModel,
    evaluate,
    fit_beside,
    fit_sliding,
    loss_at,
)
from bristle.diagnosis.sliding.kalman import KalmanFilter, SlidingNoise
from bristle.diagnosis.sliding.stretches import SETTLING, Stretches, stretches_of
from bristle.diagnosis.sliding.torque import is_faint, sliding_torques

H = 1e-3
NOISE = SlidingNoise(0.01, 0.02, 0.004, 10.0, 2e-5, 1e-5)
FC = 0.12
VALUES = {"J": 0.01, "a2": 0.02, "coulomb.Fc": FC, "b": 1.0, "u_max": 1e9}


@cache
def sampled(noise: SlidingNoise) -> tuple[np.ndarray, np.ndarray]:
    """Transition of (position, speed, disturbance, 1 N.m) over a sample, and the covariance of what
    white noise adds, by the midpoints of many parts.
    """
    rate, parts = 2 * math.pi * noise.corner, 200
    a = np.array([[0, 1, 0], [0, -noise.viscous / noise.inertia, 1 / noise.inertia], [0, 0, -rate]])
    held = np.block([[a, np.array([[0], [1 / noise.inertia], [0]])], [np.zeros((1, 4))]])
    each = [expm(a * (k + 0.5) * H / parts) for k in range(parts)]
    slow = 2 * rate * noise.torque**2 * sum(np.outer(p[:, 2], p[:, 2]) for p in each)
    white = (noise.white / noise.inertia) ** 2 * sum(np.outer(p[:, 1], p[:, 1]) for p in each)
    return expm(H * held), (slow + white) * H / parts


def slid(
    seed: int,
    velocity: bool = False,
    noise: SlidingNoise = NOISE,
    seconds: float = 24.0,
    drag: float = 0.0,
) -> Stretches:
    """Two records of a servo, one sliding forward and one backward, made sample by sample.

    J v' = u + d - a2 v - s Fc - drag v |v|, d' = -w d + white noise; exact over each held input.
    """
    rng, n = np.random.default_rng(seed), round(seconds / H)
    whole, spread = sampled(noise)
    kicks = rng.standard_normal((n, 3)) @ np.linalg.cholesky(spread + 1e-30 * np.eye(3)).T
    sign = np.where(np.arange(n) < n // 2, 1.0, -1.0)
    u = sign * (FC + 0.1) + 0.08 * np.sin(2 * np.pi * 0.7 * np.arange(n) * H)
    u += 0.05 * np.sin(2 * np.pi * 5.3 * np.arange(n) * H)
    x, shown = np.array([0.0, 5.0, noise.torque * rng.standard_normal()]), np.empty(n)
    for k in range(n):
        if k == n // 2:
            x[1] = -5.0
        shown[k] = x[1 if velocity else 0]
        x = whole[:3, :3] @ x + whole[:3, 3] * (u[k] - sign[k] * (FC + drag * x[1] ** 2)) + kicks[k]
    shown += noise.sensor * rng.standard_normal(n)
    halves = slice(n // 2), slice(n // 2, n)
    records = [(H * np.arange(n)[half], u[half], shown[half]) for half in halves]
    return stretches_of(records, H, velocity, noise.sensor)


def fitted(over: Stretches, **nominal: float) -> SlidingFit:
    given = {"J": 0.013, "a2": 0.03, "coulomb.Fc": 0.09, **nominal}
    free = tuple(Free(name, 0.0, 100 * value) for name, value in given.items())
    fit = fit_sliding(SlidingModel("coulomb", (), free, over, 2e-5), VALUES | given)
    assert fit is not None
    return fit


# -- stretches -------------------------------------------------------------------------------------
def test_stretches_leave_out_reversals_and_rest() -> None:
    t = H * np.arange(6000)
    speed = np.where(t < 2, 2.0, np.where(t < 3, 0.0, -1.0))
    over = stretches_of([(t, 0 * t, np.cumsum(speed) * H)], H, False, 1e-5)
    assert len(over.begin) == 2
    assert over.end[0] * H < 2.02 < 3 < over.begin[1] * H
    assert np.mean(np.sign(over.v[over.counted]) == np.sign(speed[over.counted])) > 0.998
    assert over.seconds == pytest.approx(5.0, abs=0.15)


def test_short_motion_and_motion_within_the_sensors_steps_do_not_slide() -> None:
    t = H * np.arange(4000)
    burst = np.where((t > 1) & (t < 1.02), 3.0, 0.0)
    assert len(stretches_of([(t, 0 * t, np.cumsum(burst) * H)], H, False, 1e-5).counted) == 0
    creep = np.floor(0.01 * t / 1e-3) * 1e-3
    assert len(stretches_of([(t, 0 * t, creep)], H, False, 1e-3).begin) == 0


# -- filter ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("velocity", [False, True])
def test_innovations_have_the_variance_of_the_riccati_equation(velocity: bool) -> None:
    """Another implementation: the stationary covariance by scipy, from matrices made here."""
    over = slid(1, velocity)
    shows = np.array([[0.0, 1.0, 0.0]]) if velocity else np.array([[1.0, 0.0, 0.0]])
    step, spread = sampled(NOISE)
    states = slice(1, 3) if velocity else slice(0, 3)
    kept = (states, states)
    steady = solve_discrete_are(step[kept].T, shows[:, states].T, spread[kept], [[NOISE.sensor**2]])
    expected = float((shows[:, states] @ steady @ shows[:, states].T)[0, 0]) + NOISE.sensor**2
    assert KalmanFilter(NOISE, over).variance[-1] == pytest.approx(expected, rel=1e-5)


def test_what_moves_as_the_model_says_leaves_no_innovation() -> None:
    """x = c t + (v0 - c)(1 - e^{-t/T}) T under a constant torque, c = T/a2: the closed form."""
    t = H * np.arange(3000)
    steady, constant = 0.1 / NOISE.viscous, NOISE.inertia / NOISE.viscous
    y = steady * t + (2.0 - steady) * constant * -np.expm1(-t / constant)
    over = stretches_of([(t, np.full(3000, 0.1), y)], H, False, 1e-6)
    innovations, _ = KalmanFilter(NOISE, over).innovations(over.measured, over.u)
    later = over.age > 200  # the start is only known to within the change of speed in a sample
    assert np.abs(innovations[later]).max() < 1e-9
    wrong, _ = KalmanFilter(NOISE, over).innovations(over.measured, 1.01 * over.u)
    assert np.abs(wrong[later]).max() > 1e-8


def test_innovations_are_white_and_have_their_variance() -> None:
    over = slid(2)
    fit = evaluate(SlidingModel("coulomb", (), (), over, 2e-5), VALUES, NOISE)
    white = fit.innovations / np.sqrt(fit.filter.variance)
    n = len(white)
    assert np.mean(white**2) == pytest.approx(1.0, abs=4 * math.sqrt(2 / n))
    for lag in (1, 2, 5, 20):
        assert abs(np.mean(white[lag:] * white[:-lag])) < 4 / math.sqrt(n)


@pytest.mark.parametrize("velocity", [False, True])
def test_slopes_are_those_of_the_likelihood(velocity: bool) -> None:
    """By difference quotients of the log-likelihood, at a point that is not its maximum."""
    over = slid(3, velocity, seconds=4.0)
    values = VALUES | {"J": 0.011, "a2": 0.03, "coulomb.Fc": 0.1}
    noise = SlidingNoise(0.011, 0.03, 0.005, 6.0, 3e-5, 2e-5)
    free = tuple(Free(name, 0.0, 1.0) for name in ("J", "a2", "coulomb.Fc"))
    model = SlidingModel("coulomb", (), free, over, 2e-5)

    def total(step: float, k: int) -> float:
        factors = np.ones(7)
        factors[k] += step
        own = {f.name: values[f.name] * x for f, x in zip(free, factors, strict=False)}
        changed = SlidingNoise(
            own["J"],
            own["a2"],
            *(x * y for x, y in zip((0.005, 6.0, 3e-5, 2e-5), factors[3:], strict=True)),
        )
        return evaluate(model, values | own, changed).total

    scale = [*(values[f.name] for f in free), 1.0, 1.0, 1.0, 1.0]
    quotients = [(total(1e-5, k) - total(-1e-5, k)) / 2e-5 for k in range(7)]
    slopes = evaluate(model, values, noise).gradient * scale
    assert slopes == pytest.approx(quotients, rel=1e-4, abs=1e-3)


def test_a_torque_changes_innovations_by_its_column() -> None:
    over = slid(4, seconds=4.0)
    through, torque = KalmanFilter(NOISE, over), 0.01 * np.cos(over.theta)
    one, _ = through.innovations(over.measured, over.u)
    two, _ = through.innovations(over.measured, over.u + torque)
    assert two - one == pytest.approx(through.columns(torque[None])[:, 0], abs=1e-12)


# -- estimates -------------------------------------------------------------------------------------
@pytest.mark.parametrize("velocity", [False, True])
def test_parameters_and_noise_are_found_again(velocity: bool) -> None:
    noise = SlidingNoise(0.01, 0.02, 0.004, 10.0, 5e-3, 1e-5) if velocity else NOISE
    fit = fitted(slid(5, velocity, noise))
    deviations = fit.deviations()
    for name in ("J", "a2", "coulomb.Fc"):
        assert abs(fit.values[name] - VALUES[name]) < 4 * deviations[name]
        assert deviations[name] < 0.1 * VALUES[name]
    assert fit.noise.torque == pytest.approx(noise.torque, rel=0.15)
    assert fit.noise.corner == pytest.approx(noise.corner, rel=0.4)
    assert fit.noise.sensor == pytest.approx(noise.sensor, rel=0.05)


def test_a_white_torque_is_told_from_a_slow_one() -> None:
    noise = replace(NOISE, torque=0.002, corner=0.5, white=2e-4)
    found = fitted(slid(6, noise=noise)).noise
    assert found.white == pytest.approx(noise.white, rel=0.1)
    assert 0.001 < found.torque < 0.004
    assert fitted(slid(6)).noise.white < 5e-5


def test_starts_far_away_end_at_the_same_place() -> None:
    over = slid(6, seconds=8.0)
    near, far = fitted(over), fitted(over, J=0.1, a2=0.2, **{"coulomb.Fc": 0.012})
    assert far.total == pytest.approx(near.total, abs=0.1)
    assert far.values["J"] == pytest.approx(near.values["J"], rel=1e-3)


@pytest.mark.sampled(4)
def test_intervals_cover() -> None:
    """Of 40 records at most 6 are outside a 95 % interval (more: 0.4 %), and errors are about as
    large as their deviations.
    """
    names, errors = ("J", "a2", "coulomb.Fc"), []
    for seed in range(40):
        fit = fitted(slid(100 + seed, seconds=6.0))
        known = fit.deviations()
        errors.append([(fit.values[name] - VALUES[name]) / known[name] for name in names])
    assert np.max(np.sum(np.abs(errors) > 1.96, axis=0)) <= 6
    spread = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all((spread > 0.5) & (spread < 1.25))


@pytest.mark.parametrize("drag", [0.0, 0.001])
def test_friction_of_the_speed_is_not_biased_by_what_comes_after(drag: float) -> None:
    """Off by a standard deviation of the mean or two, over records of their own."""
    noise, off = replace(NOISE, torque=0.02), []
    for seed in range(8):
        base = fitted(slid(20 + seed, noise=noise, drag=drag))
        start = {"quadratic_drag.coefficient": 0.002}
        free = (Free("quadratic_drag.coefficient", -1.0, 1.0),)
        fit = fit_beside(base, "quadratic_drag", free, start, 40)
        name = "quadratic_drag.coefficient"
        off.append((fit.values[name] - drag) / fit.deviations()[name])
    assert abs(np.mean(off)) < 3 / math.sqrt(len(off))


def test_a_torque_that_follows_the_speed_is_no_inertia() -> None:
    """Taken from the speed at each sample it would come half a sample late, and with c = 3e-3 at
    10 rad/s be an inertia 0.3 % larger.
    """
    rng, n, parts, drag = np.random.default_rng(4), 12000, 20, 3e-3
    t, dt = H * np.arange(n), H / 20
    records = []
    for sign in (1.0, -1.0):
        u = sign * (FC + 0.5) + 0.5 * np.sin(9.0 * t) + 0.4 * np.sin(31.0 * t)
        theta, v, d, shown = 0.0, sign * 10.0, 0.0, np.empty(n)
        for k in range(n):
            shown[k] = theta
            for _ in range(parts):
                d += dt * 2 * math.pi * 10.0 * -d + 0.01 * math.sqrt(dt) * rng.standard_normal()
                last, middle = v, v
                for _ in range(3):  # implicit midpoint
                    torque = u[k] + d - 0.02 * middle - sign * (FC + drag * middle**2)
                    v = last + dt / 0.01 * torque
                    middle = (last + v) / 2
                theta += dt * middle
        records.append((t, u, shown + 2e-5 * rng.standard_normal(n)))
    name, over = "quadratic_drag.coefficient", stretches_of(records, H, False, 2e-5)
    given = {"J": 0.013, "a2": 0.03, "coulomb.Fc": 0.09, name: 0.002}
    free = tuple(Free(key, 0.0, 100 * value) for key, value in given.items())
    model = SlidingModel("coulomb", ("quadratic_drag",), free, over, 2e-5)
    fit = fit_sliding(model, VALUES | given)
    assert fit is not None
    known = fit.deviations()
    assert known["J"] < 1e-3 * 0.01
    assert abs(fit.values["J"] - 0.01) < 3 * known["J"]
    assert abs(fit.values[name] - drag) < 3 * known[name]


def test_regression_gives_the_size_of_a_torque() -> None:
    over = slid(7, seconds=10.0)
    added = 0.02 * np.cos(2 * over.theta)
    other = Stretches(**{**vars_of(over), "u": over.u - added})
    answer, gain = fitted(other).regress(np.column_stack([np.cos(2 * over.theta), over.time]))
    assert answer[0] == pytest.approx(0.02, rel=0.1)
    assert abs(answer[1]) < 1e-3
    assert gain > 50.0
    assert fitted(over).regress(np.cos(2 * over.theta)[:, None])[1] < 6.0


@pytest.mark.parametrize(
    ("effect", "parameter"), [("input_delay", "delay"), ("electrical_pole", "time_constant")]
)
@pytest.mark.parametrize(("late", "faint"), [(2e-4, True), (6e-3, False)])
def test_a_delay_is_faint_where_the_torque_that_it_takes_is(effect, parameter, late, faint):
    """By the input itself, taken so much later."""
    over = slid(1)
    torques = sliding_torques("coulomb", (effect,), VALUES | {f"{effect}.{parameter}": late}, over)
    times = H * np.arange(len(over.u))
    taken = np.interp(times - late, times, over.u) - over.u
    inside = over.counted[np.abs(np.diff(over.u))[over.counted - 1] < 0.01]  # within a record
    assert np.abs(torques[effect] - taken)[inside].max() < 0.12 * np.abs(taken[inside]).max()
    assert is_faint(torques, "coulomb", effect) is faint


def vars_of(over: Stretches) -> dict[str, object]:
    names = ("h", "velocity", "measured", "u", "time", "record", "theta", "v", "a", "begin", "end")
    return {name: getattr(over, name) for name in names}


def test_too_little_motion_and_hidden_states_give_no_fit() -> None:
    over = slid(8, seconds=2.0)
    short = Stretches(**{**vars_of(over), "end": over.begin + SETTLING + 50})
    free = (Free("J", 0.0, 1.0),)
    assert fit_sliding(SlidingModel("coulomb", (), free, short, 2e-5), VALUES) is None
    for name in ("compliance", "input_delay", "presliding", "eccentric_encoder"):
        assert fit_sliding(SlidingModel("coulomb", (name,), free, over, 2e-5), VALUES) is None


def test_what_the_motion_does_not_show_has_no_interval() -> None:
    """The step comes after the records: neither its torque nor its onset changes anything."""
    over = slid(9, seconds=8.0)
    own = ("disturbance_step.torque", "disturbance_step.onset")
    free = (Free("J", 0.0, 1.0), *(Free(name, 0.0, 100.0) for name in own))
    values = VALUES | {own[0]: 0.01, own[1]: 50.0}
    model = SlidingModel("coulomb", ("disturbance_step",), free, over, 2e-5)
    known = evaluate(model, values, NOISE).deviations()
    assert 0.0 < known["J"] < 1e-3
    assert known[own[0]] == known[own[1]] == math.inf


def test_a_standard_error_from_the_best_costs_half_a_nat() -> None:
    fit = fitted(slid(4))
    spread = np.linalg.inv(fit.information)[:, 0]  # how all parameters follow the first

    def at(errors: float) -> float:
        step = errors * spread / math.sqrt(spread[0])
        changed = {f.name: float(d) for f, d in zip(fit.model.free, step, strict=False)}
        return loss_at(fit, {name: fit.values[name] + d for name, d in changed.items()})

    assert at(0.0) == pytest.approx(0.0, abs=0.02)
    assert at(1.0) == pytest.approx(0.5, abs=0.1)
    assert at(-6.0) == pytest.approx(18.0, rel=0.1)
