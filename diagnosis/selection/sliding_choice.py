"""The effect that sliding motion shows beyond doubt, in the place of what simulated segments say.

The likelihood of the innovations is exact while the servo slides. That of segments is not where a
servo sticks in between: what friction does there within a step of the sensor is then most of their
residual, and hides effects that are seen in the motion at once.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

from scipy.stats import chi2

from bristle.diagnosis.answer import Reason, finding
from bristle.diagnosis.estimation.fitted_model import TIE_NATS, refit_with_noise
from bristle.diagnosis.selection.candidates import EffectFit, fit_at
from bristle.diagnosis.selection.criterion import TrialRound, group
from bristle.diagnosis.selection.start_values import SearchContext
from bristle.diagnosis.sliding.fit import ITERATIONS, SlidingFit, at_guess, with_fast_disturbance
from bristle.diagnosis.sliding.screen import (
    GROSS_GAIN,
    POSITION_TORQUES,
    Start,
    best_start,
    each_beside,
    likeliest_beside,
    sliding_evidence,
)
from bristle.diagnosis.sliding.torque import is_faint, sliding_torques
from bristle.plant.effects import effect as find_effect
from bristle.plant.servo import J

MOST_CLIMBED = 6  # effects that are fitted to the end
LEAST_P = 1e-16  # a probability that is less is given as this
FAR = 2.0  # from its given value, as a factor, where an inertia may stand in for another torque

Found = tuple[str, SlidingFit, Start]


def by_sliding(context: SearchContext, latest: TrialRound) -> TrialRound:
    """Return a round with the effect added that sliding motion shows, and without one that it
    denies; the same round if it shows none, several alike, or the one that was added.
    """
    if latest.said.unfinished or context.options.late:
        return latest
    base = context.slides
    if base is None:
        return latest
    found = _most_likely(context, base, latest)
    if _is_clear(latest, base, found):
        return _added(context, latest, base, found[0])
    if any(_is_denied(latest, base, each) for each in found):
        return latest.rejected(finding(Reason.NOT_SLIDING, effect=latest.said.added))
    return latest


def _is_clear(latest: TrialRound, base: SlidingFit, found: Sequence[Found]) -> bool:
    """Return whether the first effect found gains much and more than any of another class, is not
    faint, and segments have not added it or one of its class, nor hold one for likely that sliding
    motion does not show.
    """
    if not found or found[0][1].worth < base.worth + GROSS_GAIN:
        return False
    name, best, _ = found[0]
    known = latest.said.added and group(latest.said.added) == group(name)
    if known or not _acts(best, name, best.values):
        return False
    for other, fit, _ in found[1:]:
        # what segments add as well has two likelihoods on its side
        margin = GROSS_GAIN if other == latest.said.added else TIE_NATS
        if group(other) != group(name) and fit.worth > best.worth - margin:
            return False
    shown = [other for other, _, _ in found]
    return not (latest.best and latest.assessment.accepted and latest.best.name not in shown)


def _is_denied(latest: TrialRound, base: SlidingFit, found: Found) -> bool:
    """Return whether the effect that segments add gains nothing in the motion that its torque would
    change.
    """
    name, fit, _ = found
    # where one switches, slopes do not lead to the likeliest place
    if name != latest.said.added or find_effect(name).nonsmooth or find_effect(name).sparse:
        return False
    assert latest.best is not None
    assert latest.best.fit is not None
    return fit.worth <= base.worth and _acts(fit, name, fit.values | latest.best.fit.values)


def _acts(fit: SlidingFit, name: str, values: Mapping[str, float]) -> bool:
    """Return whether the torque of an effect with these values is more than faint somewhere in the
    sliding motion.
    """
    model, over = fit.model, fit.model.over
    torques = sliding_torques(model.law, model.effects, values, over)
    seen = {key: torque[over.counted] for key, torque in torques.items()}
    return not is_faint(seen, model.law, name)


def _most_likely(context: SearchContext, base: SlidingFit, latest: TrialRound) -> list[Found]:
    """Return the likeliest effects that sliding motion shows, and the best of a round if it shows
    that, each fitted to the end beside the model; the likeliest first.
    """
    evidence, fast = sliding_evidence(base, context.dataset.turn), with_fast_disturbance(base)

    def screened(name: str) -> tuple[float, str, Start] | None:
        best = best_start(fast, name, context.start_values(name, evidence))
        return best and (best[0], name, best[1])

    def fitted(name: str, start: Start) -> Found | None:
        limits = context.fitted.servo.limits
        best = likeliest_beside(base, name, [start], limits, ITERATIONS)
        return best and (name, *best)

    names = [c.name for c in latest.trials if c.fit is not None]
    shown = [each for each in context.options.map(screened, names) if each is not None]
    shown.sort(key=lambda each: -each[0])
    hopeful = [name for gain, name, _ in shown if gain > TIE_NATS]
    near = {*hopeful[:MOST_CLIMBED], latest.said.best}
    chosen = [(name, start) for _, name, start in shown if name in near]
    ends = context.options.map(lambda each: fitted(*each), chosen)
    ends += _from_guess(context, base, names)
    best = dict[str, Found]()
    for each in sorted((each for each in ends if each), key=lambda each: -each[1].worth):
        best.setdefault(each[0], each)
    return list(best.values())


def _from_guess(
    context: SearchContext, base: SlidingFit, names: Collection[str]
) -> Iterator[Found]:
    """Give fits of those effects that may be most of the torque, from the parameters as they were
    given: an inertia that went far from them has taken the place of such a torque.
    """
    guess = {k: x for k, x in context.options.guess.items() if k in base.free_values}
    inertia = base.values[J.name] / guess.get(J.name, base.values[J.name])
    if max(inertia, 1 / inertia) < FAR:
        return
    tried = [name for name in POSITION_TORQUES if name in names]
    limits = context.fitted.servo.limits
    yield from each_beside(at_guess(base, guess), tried, context.dataset.turn, limits)


def _added(
    context: SearchContext, latest: TrialRound, base: SlidingFit, found: Found
) -> TrialRound:
    """Return a round with the effect found added, fitted to the segments from there."""
    name, best, start = found
    simulator = context.fitted.servo.simulator(context.fit.simulator.segments, (name,))
    own = {key: best.values[f"{name}.{key}"] for key in start}
    place = best.free_values, context.fitted.problem.initial
    fit = refit_with_noise(context.dataset, fit_at(context, simulator, name, own, place))
    chosen, gain = EffectFit(name, fit), best.total - base.total
    trials = tuple(chosen if c.name == name else c for c in latest.trials)
    # chance, by the ratio of likelihoods, in as many effects as were tried
    more = len(best.model.free) - len(base.model.free)
    p = min(1.0, max(len(trials) * float(chi2.sf(2 * gain, more)), LEAST_P))
    return replace(latest, best=chosen, trials=trials).with_said(
        best=name,
        gain=gain,
        p=p,
        outcome="added",
        ties=(),
        decision=finding(Reason.SLIDING, effect=name, gain=gain),
    )
