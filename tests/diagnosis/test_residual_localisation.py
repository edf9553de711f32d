"""Views of the residual: a residual that depends on one is located there with its share; noise is
located nowhere.
"""

from __future__ import annotations

from copy import copy

import numpy as np
import pytest

from bristle import records_from_arrays
from bristle.diagnosis.answer import OUTLIERS
from bristle.diagnosis.checks.preparation import prepared_case
from bristle.diagnosis.localisation.maps import residual_map, wave_map
from bristle.diagnosis.localisation.residual_localisation import SIGN_DRAWS, shares, views_of
from bristle.diagnosis.localisation.residual_response import ResidualResponse
from bristle.diagnosis.localisation.views import clocks, hats, hysteresis
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.report.text.said import said

SHARE = 0.6
MADE = {  # a torque that follows a view, of the motion and the time t
    "v": lambda m, t: np.sign(m.v) * np.exp(-np.abs(m.v)),
    "theta": lambda m, t: np.sin(9 * m.theta),
    "theta x direction": lambda m, t: np.sign(m.v) * np.sin(2 * m.theta + 0.3),
    "t": lambda m, t: np.where(t > 5, 1.0, 0.0),
    "t x direction": lambda m, t: np.sign(m.v) * t,
    "v x u": lambda m, t: m.v * np.abs(m.u),
    "tone": lambda m, t: np.sin(2 * np.pi * 6.3 * t),
    "u": lambda m, t: np.where(np.abs(m.u) < 0.1, m.u, 0.0),
}


@pytest.fixture(scope="module")
def plain(case):
    return case(None)


def seen_through(plain, torque=None, seed=3):
    """The shares of noise and of what a torque (samples,) does, SHARE of what is whitened; and its
    power in the output.
    """
    dataset, response = plain.dataset, copy(ResidualResponse(plain.base, plain.dataset))
    noise = np.random.default_rng(seed).standard_normal(response.rest.shape)
    response.rest = response.freed(noise[:, :, None])[:, :, 0]
    rough, live, expected = np.zeros(response.rest.shape), np.flatnonzero(response.weight > 0), 0.0
    if torque is not None:
        made = response.free_of_model(response.through(torque[:, None]))[:, :, 0]
        power = [
            float(np.einsum("s,sn,sn->", response.weight, each, each))
            for each in (response.rest, made)
        ]
        size = np.sqrt(SHARE / (1 - SHARE) * power[0] / power[1])
        response.rest = response.rest + size * made
        shown = [
            np.square(response.plain(each[live][:, :, None], live)).sum()
            for each in (size * made, response.rest)
        ]
        expected = shown[0] / shown[1]
        rough = (
            size
            * torque.reshape(len(rough), rough.shape[1], -1).mean(axis=2)
            * (response.weight > 0)[:, None]
        )
    return shares(response, dataset.motion, dataset.segments.h, dataset.resolution, rough), expected


@pytest.mark.parametrize("view", list(MADE))
def test_what_follows_a_view_is_found_there(plain, view):
    m = plain.dataset.motion
    found, share = seen_through(plain, MADE[view](m, m.time))
    assert found[0].view == view, [(each.view, each.share) for each in found[:3]]
    assert found[0].p == 1 / (SIGN_DRAWS + 1)
    assert 0.6 * share < found[0].share < 1.15 * share  # what is fitted is held back a little
    if view == "tone":
        assert float(said(found[0].label).removesuffix(" Hz")) == pytest.approx(6.3, abs=0.1)
    if view == "theta":
        assert said(found[0].label) == "9 in a turn"


@pytest.mark.sampled(4)
def test_noise_follows_nothing(plain):
    smallest = np.array(
        [min(each.p for each in seen_through(plain, seed=seed)[0]) for seed in range(20)]
    )
    # the p of the strongest of all views: one in ten is that small
    assert np.sum(smallest <= 0.1) <= 5
    assert np.sum(smallest <= 0.5) >= 4


def test_outlier_segments_are_recognised(plain):
    response, m = copy(ResidualResponse(plain.base, plain.dataset)), plain.dataset.motion
    noise = np.random.default_rng(3).standard_normal(response.rest.shape)
    live = np.flatnonzero(response.weight > 0)
    noise[live[[2, 9, 17]]] *= 30
    response.rest = response.freed(noise[:, :, None])[:, :, 0]
    found = shares(
        response,
        m,
        plain.dataset.segments.h,
        plain.dataset.resolution,
        np.zeros(response.rest.shape),
    )
    found.reverse()  # they come last
    assert found[0].view == OUTLIERS
    assert found[0].share > 0.9
    assert found[0].p < 1e-3
    assert said(found[0].label).startswith(f"3 of {len(live)} segments")


def test_the_same_residual_is_judged_the_same(plain):
    assert seen_through(plain) == seen_through(plain)


def test_hats_add_up_to_one_and_follow_any_broken_line():
    x = np.random.default_rng(1).uniform(-2, 3, 500)
    table = hats(x, 5)
    assert table.shape == (500, 5)
    np.testing.assert_allclose(table.sum(axis=1), 1.0, atol=1e-12)
    knots = np.quantile(x, np.linspace(0.005, 0.995, 5))
    line = np.interp(x, knots, [0.0, 2.0, -1.0, 3.0, 3.0])
    np.testing.assert_allclose(table @ [0.0, 2.0, -1.0, 3.0, 3.0], line, atol=1e-12)
    np.testing.assert_array_equal(hats(np.full(20, 0.7)), np.ones((20, 1)))


def test_a_stop_is_elastic_then_slides_and_knows_no_other_record():
    theta = np.concatenate([np.linspace(0, 1, 11), np.linspace(1, 0.7, 4)[1:], [50.0, 50.05]])
    record = np.array([0] * 14 + [1] * 2)
    found = hysteresis(theta, record, np.array([0.25]))[:, 0]
    np.testing.assert_allclose(found[:4], [0.0, 0.4, 0.8, 1.0])
    assert np.all(found[3:11] == 1.0)
    np.testing.assert_allclose(found[11:14], [0.6, 0.2, -0.2], atol=1e-12)
    # from record to record nothing bends
    np.testing.assert_allclose(found[14:], [-0.2, 0.0], atol=1e-12)


def test_a_map_shows_both_ways_of_going(plain):
    m = plain.dataset.motion
    torque = np.sign(m.v) * np.sin(m.theta)
    drawn = residual_map("theta x direction", m, torque, 0 * torque)
    assert drawn["lines"] == ("forward", "backward")
    forward, backward = np.asarray(drawn["before"])
    known = np.isfinite(forward) & np.isfinite(backward)
    assert np.sum(known) > 20
    np.testing.assert_allclose(
        forward[known], np.sin(np.asarray(drawn["centres"]))[known], atol=0.1
    )
    np.testing.assert_allclose(
        backward[known], -np.sin(np.asarray(drawn["centres"]))[known], atol=0.1
    )
    assert np.nanmax(np.abs(np.asarray(drawn["after"]))) == 0.0
    assert residual_map("v", m, torque, torque)["lines"] == ()


def through(plain, torque):
    """Return a response whose residual is what a torque (samples,) does."""
    response = copy(ResidualResponse(plain.base, plain.dataset))
    response.rest = response.free_of_model(response.through(torque[:, None]))[:, :, 0]
    return response


@pytest.mark.parametrize("view", ["theta", "theta x direction", "tone"])
def test_a_wave_is_drawn_over_one_period_and_as_high_as_it_is(plain, view):
    m, period = plain.dataset.motion, 0.16 if view == "tone" else 2 * np.pi / 9
    wave = 0.06 * np.sin(2 * np.pi / period * (m.time if view == "tone" else m.theta) + 0.4)
    torque = wave * np.sign(m.v) if "x" in view else wave
    drawn = wave_map(view, m, through(plain, torque), through(plain, 0 * torque), period)
    assert drawn["period"] == period
    np.testing.assert_allclose(drawn["centres"][[0, -1]], [0.0, period])
    for line, sign in zip(drawn["before"], (1, -1), strict=False):
        # of a tone one record is drawn, half of what there is
        near = 0.025 if view == "tone" else 0.008
        np.testing.assert_allclose(
            line, sign * 0.06 * np.sin(2 * np.pi / period * drawn["centres"] + 0.4), atol=near
        )
    assert np.abs(drawn["after"]).max() == 0.0


def test_what_does_not_repeat_is_drawn_along_the_whole_axis(plain):
    m = plain.dataset.motion
    stop = through(plain, np.maximum(m.theta - np.quantile(m.theta, 0.9), 0.0))
    assert wave_map("theta", m, stop, stop, 2 * np.pi / 9) == {}
    assert wave_map("theta", m, stop, stop, None) == wave_map("history", m, stop, stop, 0.1) == {}
    assert wave_map("theta", m, stop, stop, 2 * np.ptp(m.theta)) == {}


def test_a_tone_is_drawn_from_the_record_that_has_it(plain):
    """Each record begins at 0, so that they have no phase in common; only the second one swings."""
    m, period = plain.dataset.motion, 1 / 6.3
    assert len(np.unique(clocks(m))) == 2
    torque = np.where(m.record == 1, 0.06 * np.sin(2 * np.pi * 6.3 * m.time + 0.4), 0.0)
    drawn = wave_map("tone", m, through(plain, torque), through(plain, 0 * torque), period)
    assert drawn["lines"] == ("record 2",)
    np.testing.assert_allclose(
        drawn["before"][0], 0.06 * np.sin(2 * np.pi * 6.3 * drawn["centres"] + 0.4), atol=0.008
    )


def swung(tree, disturbance, varies):
    """Return views of the residual of a servo in an encoder's loop that lacks a `disturbance` [of
    the friction] and an inertia J (1 + varies cos 2 theta), the largest first.
    """
    J, a2, Fc, h, parts, step = 0.04, 1.0, 0.6, 1e-3, 4, 2e-5
    rng, n, q, v, seen, d = np.random.default_rng(5), 12000, 0.0, 0.0, 0.0, 0.0
    omega, size, phase = rng.uniform(1.0, 5.0, 3), [0.7, 0.5, 0.3], rng.uniform(0, 6, 3)
    keep, dt, shown, u = np.exp(-2 * np.pi * 3.0 * h), h / parts, np.zeros(n), np.zeros(n)
    for k in range(n):
        angle = omega * k * h + phase
        goal, rate = np.dot(size, np.sin(angle)), np.dot(size * omega, np.cos(angle))
        shown[k] = step * np.floor(q / step)
        seen += (1 - np.exp(-h / 3e-3)) * ((shown[k] - shown[max(k - 1, 0)]) / h - seen)
        u[k] = J * (30 * (rate - seen) + 225 * (goal - shown[k])) + 0.8 * a2 * rate
        d = keep * d + np.sqrt(1 - keep**2) * disturbance * Fc * rng.standard_normal()
        for _ in range(parts):
            inertia = J * (1 + varies * np.cos(2 * q))
            pull = u[k] + d - a2 * v + J * varies * np.sin(2 * q) * v**2
            free, most = v + dt * pull / inertia, dt * Fc / inertia
            v = free - np.clip(free, -most, most)
            q += dt * v
    values = {"J": 0.05, "a2": 1.0, "Fc": 0.5}
    bounds = {"J": [1e-3, 1.0], "a2": [0.0, 10.0], "Fc": [0.0, 10.0]}
    model = Model.from_dict(tree | {"parameters": values, "bounds": bounds}, "model")
    records = records_from_arrays(model, [("a", h * np.arange(n), u, shown)])
    made = prepared_case(model, records, (), lambda *_: None)
    return [each.view for each in views_of(made.base, made.dataset) if each.share > 0.2]


def test_an_acceleration_that_a_disturbance_gives_is_no_inertia_that_varies(tree):
    """A measured acceleration holds what the disturbance does, and would predict all of it."""
    assert "theta x a" not in swung(tree, disturbance=0.08, varies=0.0)
    assert swung(tree, disturbance=0.02, varies=0.3)[0] == "theta x a"
