"""Reported sizes and spreads, against simulation: limits of detection and covariances."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from bristle.diagnosis.estimation.uncertainty import covariance
from bristle.diagnosis.free_parameter import Free
from bristle.diagnosis.selection.candidates import EffectFit
from bristle.diagnosis.selection.detection_limit import LARGEST_LIMIT, detection_limits
from bristle.diagnosis.selection.null_distribution import Null
from bristle.diagnosis.selection.start_values import SearchContext
from bristle.diagnosis.selection.stepwise import evaluate_candidates
from bristle.plant.effects import effect

SEGMENTS, PARAMETERS, NOISE = 24, 9, 0.3


def regression(rng, points):
    """A linear model of so many points a segment, with columns that are much alike."""
    return rng.standard_normal((SEGMENTS, points, PARAMETERS)) @ np.triu(np.ones((PARAMETERS,) * 2))


def fit_of(x, rest, judged):
    """What a covariance is computed from; segments that are not judged have residuals as well."""
    x = x / NOISE
    information = np.einsum("sip,siq->pq", x[judged], x[judged])
    return SimpleNamespace(
        slopes=np.einsum("sip,si->sp", x, rest / NOISE),
        weight=judged.astype(float),
        information=information,
        free=(Free("a", -1e9, 1e9),) * PARAMETERS,
    )


def test_the_covariance_is_that_of_the_estimates_of_many_records():
    """Few segments for the parameters: their scores at the maximum are smaller than at the truth,
    by the share that (n + p) / n makes up for.
    """
    rng = np.random.default_rng(7)
    x, judged = regression(rng, 1), np.ones(SEGMENTS, dtype=bool)
    inverse, truth = np.linalg.pinv(x[:, 0]), rng.standard_normal(PARAMETERS)
    found, reported = [], []
    for _ in range(3000):
        y = x @ truth + NOISE * rng.standard_normal((SEGMENTS, 1))
        found.append(inverse @ y.ravel())
        reported.append(np.diag(covariance(fit_of(x, y - x @ found[-1], judged))))
    ratio = np.mean(reported, axis=0) / np.var(found, axis=0)
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.1)


def test_segments_that_are_not_judged_do_not_narrow_the_covariance():
    rng = np.random.default_rng(8)
    x = regression(rng, 3)
    rest, judged = rng.standard_normal((SEGMENTS, 3)), np.arange(SEGMENTS) % 2 > 0
    half = covariance(fit_of(x, rest, judged))
    loud = covariance(fit_of(x, np.where(judged[:, None], rest, 1e3), judged))
    np.testing.assert_array_equal(half, loud)
    scores = fit_of(x, rest, judged).slopes[judged]
    inverse = np.linalg.inv(fit_of(x, rest, judged).information)
    n = np.count_nonzero(judged)
    expected = inverse @ (scores.T @ scores) @ inverse * n / (n - PARAMETERS)
    np.testing.assert_allclose(half, expected, rtol=1e-6)


def test_what_the_records_do_not_show_is_as_wide_as_its_bounds():
    """Two parameters of which only the sum shows: the one with narrow bounds tells the other."""
    rng = np.random.default_rng(9)
    x = rng.standard_normal((SEGMENTS, 1))
    fit = SimpleNamespace(
        slopes=(x * rng.standard_normal((SEGMENTS, 1)))[:, [0, 0]],
        weight=np.ones(SEGMENTS),
        information=np.full((2, 2), float(np.sum(x**2))),
        free=(Free("lag", 0.0, 0.05), Free("damping", 0.0, 1e6)),
    )
    narrow, wide = np.sqrt(np.diag(covariance(fit)))
    assert narrow == pytest.approx(0.05 / np.sqrt(12), rel=1e-3)
    alone = covariance(
        SimpleNamespace(
            slopes=fit.slopes[:, 1:],
            weight=fit.weight,
            information=fit.information[1:, 1:],
            free=fit.free[1:],
        )
    )
    assert wide**2 == pytest.approx(narrow**2 + alone[0, 0], rel=0.1)


def undetected(name, information, free, null, gain=0.0):
    """What is said of an effect whose fit has such an information and gains so much."""
    fit = SimpleNamespace(
        total=100.0 + gain,
        free=[SimpleNamespace(name=each) for each in free],
        information=information,
        collinear_with=lambda place: (),
    )
    [said] = detection_limits([EffectFit(name, fit)], null, 100.0)
    return said


def test_an_effect_of_the_reported_limit_gains_as_much_as_chance_reaches():
    """In a linear model of three nuisance parameters, over many draws of the noise; half a nat more
    by the noise of its own direction.
    """
    rng, level = np.random.default_rng(9), 12.0
    x = rng.standard_normal((200, 4)) @ np.triu(np.ones((4, 4)))
    null = Null(np.full(100, level - 2.0), {"bias": 2.0})
    free = ("J", "a2", "bias.torque", "coulomb.Fc")
    limit = undetected("bias", x.T @ x / NOISE**2, free, null).limit
    y = limit * x[:, 2] + NOISE * rng.standard_normal((4000, 200))

    def squares(columns):
        kept = np.eye(200) - columns @ np.linalg.pinv(columns)
        return np.einsum("ri,ij,rj->r", y, kept, y)

    gains = 0.5 * (squares(np.delete(x, 2, axis=1)) - squares(x)) / NOISE**2
    assert np.mean(gains) == pytest.approx(level + 0.5, rel=0.02)


def test_no_limit_is_reported_that_the_records_do_not_set():
    """Beyond what a parameter may be, or of no size; and none of what was detected."""
    free, null = ("J", "bias.torque"), Null(np.array([10.0]), {})
    most = min(effect("bias").strength.maximum, LARGEST_LIMIT)
    for factor, shown in ((0.99, True), (1.01, False)):
        spread = (factor * most) ** 2 / 20
        said = undetected("bias", np.diag([1.0, 1 / spread]), free, null)
        assert said.limit == (pytest.approx(factor * most) if shown else None)
    share = effect("gain_asymmetry").strength
    wide = np.diag([1.0, 20 / (1.01 * share.maximum) ** 2])
    assert undetected("gain_asymmetry", wide, ("J", share.name), null).limit is None
    assert undetected("bias", np.diag([1.0, 0.0]), free, null).limit is None
    assert undetected("bias", np.eye(2), free, null, gain=10.1).limit is None
    assert undetected("bias", np.eye(2), free, null, gain=10.1).gain == pytest.approx(10.1)
    assert undetected("bias", np.eye(2), free, null, gain=9.9).gain is None


def found_by(made, name):
    """An effect as a search among it alone found it, with null and likelihood without it."""
    found = evaluate_candidates(SearchContext(made.dataset, made.base), [name])
    [candidate] = (each for each in found.trials if each.name == name)
    return candidate, found.null, found.base


@pytest.mark.long
@pytest.mark.parametrize("name", ["bias", "gain_asymmetry"])
def test_a_simulated_effect_is_detected_from_its_limit_on(case, name):
    """The records without it set the limit; then they are simulated with more, and with less."""
    candidate, null, base = found_by(case(None), name)
    [said] = detection_limits([candidate], null, base)
    short = effect(name).strength.name.removeprefix(f"{name}.")
    for share, detected in ((1.3, True), (0.5, False)):
        candidate, own_null, base = found_by(case(name, **{short: share * said.limit}), name)
        gain = candidate.fit.total - base
        assert (gain > own_null.level(name)) is detected
        if detected:
            assert gain == pytest.approx(share**2 * null.level(name), rel=0.35)
