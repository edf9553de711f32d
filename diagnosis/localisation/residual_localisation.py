"""Where the residual is: the share that each view of the motion predicts, with its p."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfftfreq
from scipy.stats import binom
from scipy.stats import f as f_ratio

from bristle.diagnosis.answer import LISTED_VIEW_P, OUTLIERS, Reason, ResidualView, finding
from bristle.diagnosis.estimation.dataset import (
    Dataset,
    Motion,
)
from bristle.diagnosis.estimation.fitted_model import FittedModel
from bristle.diagnosis.estimation.likelihood import T_DEGREES_OF_FREEDOM, evaluate
from bristle.diagnosis.localisation.maps import residual_map, wave_map
from bristle.diagnosis.localisation.residual_response import ResidualResponse, chance
from bristle.diagnosis.localisation.views import Share, bases, clocks, harmonics
from bristle.diagnosis.sliding.torque import sliding_torques
from bristle.plant.wording import ROTARY, Wording

Array = NDArray[np.float64]

FOLDS = 5  # of the cross-validation over segments
SIGN_DRAWS = 999  # draws of random signs of the segments for a p
DRAWS_AT_ONCE = 50  # draws whose spectra are computed together
# draws as high as the observed line after which a spectral line counts as an ordinary one
SUFFICIENT_DRAWS = 20
LEAST_VIEW_P = 1 / (1 + SIGN_DRAWS)  # smallest p that is reported
VIEW_RIDGE = 1e-3  # ridge of a view's regression, relative to its mean power
TONE_BAND = (0.2, 45.0)  # frequencies [Hz] at which an oscillation in time is searched
SPECTRUM_PADDING = 4  # length of a zero-padded spectrum over that of the record
MOST_PERIODS = 60  # periods in a turn up to which a wave along the position is searched
MAPPED_VIEWS = 6  # views whose residual is drawn
OUTLIER_MISFIT = 5.0  # mean whitened squared error of a segment from which it is an outlier


def spectrum(
    time: Array, clock: NDArray[np.int_], rough: Array
) -> tuple[Array, Callable[[Array], Array]]:
    """Return frequencies (k,) [Hz] within `TONE_BAND`, and a function: signs (..., segments) ->
    amplitudes (..., k) of the torque.

    `time` and the torque `rough` are averaged by bins (segments, bins), `clock` is (segments,). The
    powers of segments with different clocks are added, because their phases are unrelated. Each
    segment is transformed once, about its own first bin: a spectrum is linear in it.
    """
    step = float(np.median(np.diff(time, axis=1)))
    which, row = np.unique(clock, return_inverse=True)
    first = np.array([time[row == k].min() for k in range(len(which))])
    begin = time[:, 0] - first[row]
    length = round(float(begin.max()) / step) + rough.shape[1]
    frequency = rfftfreq(SPECTRUM_PADDING * length, step)
    frequency = frequency[(frequency >= TONE_BAND[0]) & (frequency <= TONE_BAND[1])]
    turn = -2j * np.pi * frequency
    lines = rough @ np.exp(np.outer(step * np.arange(rough.shape[1]), turn))
    lines *= np.exp(np.outer(begin, turn))

    own = [
        (row == k, part[row == k].copy())
        for k in range(len(which))
        for part in (lines.real, lines.imag)
    ]

    def amplitudes(signs: Array) -> Array:
        return np.asarray(np.sqrt(sum(np.square(signs[..., mine] @ part) for mine, part in own)))

    return np.asarray(frequency), amplitudes


def _searched(
    response: ResidualResponse, m: Motion, rough: Array, wording: Wording
) -> dict[str, tuple[Array, dict[str, Any]]]:
    """Return waves with the frequency that fits the residual best, in time and along the position,
    with fields of a `Share`.
    """
    middle = _middle(response, rough)
    r, theta = rough.ravel(), m.theta[middle]
    clock = clocks(m)
    # the strongest line of the residual's spectrum, a wave of its own for each clock
    frequency, amplitudes = spectrum(
        m.time[middle].reshape(rough.shape), clock[middle].reshape(rough.shape)[:, 0], rough
    )
    tone = float(frequency[int(np.argmax(amplitudes(np.ones(len(rough)))))])
    own = [
        (clock == k)[:, None] * harmonics(2 * np.pi * tone * m.time, 1) for k in np.unique(clock)
    ]
    tables: dict[str, tuple[Array, dict[str, Any]]] = {
        "tone": (
            np.column_stack(own),
            {"label": finding(Reason.WAVE_IN_TIME, frequency=tone), "frequency": tone},
        )
    }
    # the strongest wave along the position, for each way in which it may act
    turns = np.arange(1.0, MOST_PERIODS + 1)
    spin = np.exp(-1j * np.outer(turns, theta))
    one, way = np.ones_like(m.u), np.sign(m.v)
    # an inertia that varies with the position acts by both acceleration and squared speed
    for view, factors in (
        ("theta", (one,)),
        ("theta x direction", (way,)),
        ("theta x u", (m.u,)),
        ("theta x a", (m.a, m.v**2)),
    ):
        power = np.sum(
            [np.abs(spin @ (r * f[middle])) ** 2 / max(float(f @ f), 1e-300) for f in factors],
            axis=0,
        )
        periods = float(turns[int(np.argmax(power))])
        label = finding(Reason.WAVE_ALONG_PATH, periods=periods, path=wording.range)
        waves = [f[:, None] * harmonics(periods * m.theta, 1) for f in factors]
        tables[view] = (
            np.column_stack(waves),
            {"label": label, "periods": periods},
        )
    return tables


def _middle(response: ResidualResponse, rough: Array) -> NDArray[np.int_]:
    """Return the samples in the middle of each bin."""
    skip = response.shape[1] // rough.shape[1]
    return np.arange(rough.size * skip).reshape(-1, skip)[:, skip // 2]


def shares(
    response: ResidualResponse,
    m: Motion,
    h: float,
    step: float,
    rough: Array,
    wording: Wording = ROTARY,
) -> list[Share]:
    """Return the views with their shares, the largest first; outlier segments come last.

    A view's function is fitted on four fifths of the segments; its p is how often the strongest of
    all views predicts the rest as well when segments get random signs. A tone is compared with the
    highest lines of such spectra too, because its frequency was chosen. The share is the power of
    the view's function in the output. Source: liu1988 (wild bootstrap).
    """
    live = np.flatnonzero(response.weight > 0)
    rng = np.random.default_rng(2)
    signs = np.concatenate(
        [np.ones((1, len(live))), rng.choice([-1.0, 1.0], size=(SIGN_DRAWS, len(live)))]
    )
    # of each view its table of functions, with the strongest wave in it
    details, tables = {}, bases(m, h, step)
    for view, (waves, facts) in _searched(response, m, rough, wording).items():
        tables[view] = np.column_stack([tables[view], waves]) if view in tables else waves
        details[view] = facts
    # how well each predicts left-out segments, with their signs and with random ones
    predicted = {view: _predicted(response, basis, live, signs) for view, basis in tables.items()}
    strongest = np.max([draws[1:] for draws, _ in predicted.values()], axis=0)
    ps = {
        view: (chance(strongest, draws[0]), chance(draws[1:], draws[0]))
        for view, (draws, _) in predicted.items()
    }
    # a tone also has to exceed the highest line of spectra with random signs
    middle = _middle(response, rough).reshape(rough.shape)[live]
    highest = line_p(m.time[middle], clocks(m)[middle[:, 0]], rough[live], signs)
    ps["tone"] = max(ps["tone"][0], highest), max(ps["tone"][1], highest)
    # shares of the output's power
    whole = float(np.square(response.plain(response.rest[live][:, :, None], live)).mean())
    result = []
    for view, (_, power) in predicted.items():
        result.append(
            Share(
                view,
                float(np.clip(power / whole, 0.0, 1.0)),
                ps[view][0],
                alone=ps[view][1],
                **details.get(view, {}),
            )
        )
    return [*sorted(result, key=lambda each: -each.share), _outlier_share(response, m, live)]


def line_p(time: Array, clock: NDArray[np.int_], rough: Array, signs: Array) -> float:
    """Return how often the highest line of a spectrum is as high when segments get random signs;
    the first are the true ones.

    Each draw has its own frequency, as the data had. Draws end early where the p is large.
    Parameters as of `spectrum`; signs (draws, segments). Source: besag1991 (sequential Monte Carlo
    p-values).
    """
    _, amplitudes = spectrum(time, clock, rough)
    seen, higher = amplitudes(signs[0]).max(), 0
    for first in range(1, len(signs), DRAWS_AT_ONCE):
        counted = higher + np.cumsum(
            amplitudes(signs[first : first + DRAWS_AT_ONCE]).max(axis=1) >= seen
        )
        if counted[-1] >= SUFFICIENT_DRAWS:
            return SUFFICIENT_DRAWS / (first + int(np.searchsorted(counted, SUFFICIENT_DRAWS)))
        higher = int(counted[-1])
    return (1 + higher) / len(signs)


def _outlier_share(response: ResidualResponse, m: Motion, live: NDArray[np.int_]) -> Share:
    """Return the share of the squared error in outlier segments.

    Its p is the probability of so many, with the heavy-tailed distribution that the fit assumes for
    the misfit of a segment.
    """
    misfit = np.square(response.rest[live]).mean(axis=1)
    far = misfit > OUTLIER_MISFIT
    power = np.square(response.plain(response.rest[live][:, :, None], live)).mean(axis=(1, 2))
    p = float(
        binom.sf(
            np.count_nonzero(far) - 1,
            len(live),
            f_ratio.sf(OUTLIER_MISFIT, response.rest.shape[1] - 2, T_DEGREES_OF_FREEDOM),
        )
    )
    worst = m.time.reshape(response.shape)[live[int(np.argmax(misfit))], 0]
    label = finding(
        Reason.OUTLIER_SEGMENTS,
        segments=int(np.count_nonzero(far)),
        of=len(live),
        worst=float(worst),
    )
    return Share(OUTLIERS, float(power[far].sum() / power.sum()), p, label)


def _predicted(
    response: ResidualResponse, basis: Array, live: NDArray[np.int_], signs: Array
) -> tuple[Array, float]:
    """Return for each set of signs by how much the weighted square of left-out segments falls, and
    a power.

    The power is the mean square [output squared] of what the view's function does to the output,
    less what chance contributes.
    """
    columns = response.free_of_model(response.through(basis))[live]
    weight, rest = response.weight[live], response.rest[live]
    grams = np.matmul(columns.transpose(0, 2, 1), columns) * weight[:, None, None]
    slopes = np.matmul(columns.transpose(0, 2, 1), rest[:, :, None])[:, :, 0] * weight[:, None]
    total = grams.sum(axis=0)
    k = len(total)
    ridge = VIEW_RIDGE * np.trace(total) / k * np.eye(k) + 1e-300 * np.eye(k)
    fold, gain = np.arange(len(live)) % FOLDS, np.zeros(len(signs))
    for f in range(FOLDS):
        test = fold == f
        held = grams[test].sum(axis=0)
        learned = np.linalg.solve(total - held + ridge, ((signs[:, ~test]) @ slopes[~test]).T).T
        seen = signs[:, test] @ slopes[test]
        gain += 2 * np.einsum("rk,rk->r", learned, seen) - np.einsum(
            "rk,kl,rl->r", learned, held, learned, optimize=True
        )
    inverse = np.linalg.inv(total + ridge)
    outer = inverse @ slopes.sum(axis=0)
    chance = inverse @ (slopes.T @ slopes) @ inverse
    seen = response.plain(columns, live).reshape(-1, k)
    gram = seen.T @ seen / len(seen)
    return gain, float(outer @ gram @ outer - np.sum(chance * gram))


# a search ends where nothing is left of a residual, which the answer then shows
@lru_cache(maxsize=1)
def _localised(
    fitted: FittedModel, dataset: Dataset
) -> tuple[list[Share], Array, ResidualResponse]:
    """Return what each view predicts of a residual, the torque behind it (samples,) [N.m], and the
    response it comes from.
    """
    response = ResidualResponse(fitted, dataset)
    torque = response.torque() * (fitted.fit.weight > 0)[:, None]
    rough = torque.reshape(len(torque), dataset.segments.bins, -1).mean(axis=2)
    # periods are counted along the path after which a motion begins anew
    factor = 2 * math.pi / dataset.turn
    around = replace(
        dataset.motion, theta=factor * dataset.motion.theta, a=_acceleration(fitted, dataset)
    )
    wording = Wording(dataset.linear)
    return (
        shares(response, around, dataset.segments.h, factor * dataset.resolution, rough, wording),
        torque.ravel(),
        response,
    )


def _acceleration(fitted: FittedModel, dataset: Dataset) -> Array:
    """Return the acceleration (samples,) that the model gives the recorded motion [rad/s2]: what is
    left of the torque accelerates the servo too, but is no function of it.
    """
    servo, over = fitted.servo, dataset.stretches
    values = {**servo.fixed, **fitted.fit.values}
    torques = sliding_torques(servo.law, servo.effects, values, over)
    own = (np.sum(list(torques.values()), axis=0) - values["a2"] * over.v) / values["J"]
    parts = [own[over.record == k][: len(p.u)] for k, p in enumerate(dataset.segments.pieces)]
    return np.concatenate(parts)


def views_of(fitted: FittedModel, dataset: Dataset) -> list[Share]:
    """Return what each view predicts of a fitted model's residual."""
    return _localised(fitted, dataset)[0]


def localise(
    dataset: Dataset, base: FittedModel, final: FittedModel
) -> tuple[tuple[ResidualView, ...], list[Share]]:
    """Return the views before and after, under the final noise, with maps, and shares after."""
    after, new, response = _localised(final, dataset)
    before, old = after, new
    if final is not base:
        refitted = evaluate(final.problem, base.fit)
        before, old, _ = _localised(FittedModel(base.servo, final.problem, refitted), dataset)
    # what chance gives comes last, whatever its share
    before = sorted(before, key=lambda share: share.p > LISTED_VIEW_P)
    responses = ResidualResponse(base, dataset), response  # each under its own noise
    later = {share.view: share for share in after}
    views: list[ResidualView] = []
    maps = 0
    for share in before:
        late, drawn = later[share.view], {}
        if maps < MAPPED_VIEWS:
            drawn = wave_map(share.view, dataset.motion, *responses, share.period(dataset.turn))
            drawn = drawn or residual_map(share.view, dataset.motion, old, new)
        maps += bool(drawn)
        ps = max(share.p, LEAST_VIEW_P), max(late.p, LEAST_VIEW_P)
        views.append(
            ResidualView(share.view, share.share, ps[0], late.share, ps[1], share.label, **drawn)
        )
    return tuple(views), after
