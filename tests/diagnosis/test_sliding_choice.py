"""What sliding motion adds to a round of the search, and what it denies."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bristle.diagnosis.answer import Estimate, Reason, finding
from bristle.diagnosis.selection.candidates import EffectFit
from bristle.diagnosis.selection.criterion import TrialRound
from bristle.diagnosis.selection.null_distribution import Null
from bristle.diagnosis.selection.sliding_choice import by_sliding
from bristle.diagnosis.selection.start_values import SearchContext
from bristle.diagnosis.stages.sliding_motion import _moved

NAMES = ("bias", "quadratic_drag", "stribeck", "cogging", "gain_asymmetry", "backlash")


def round_of(context: SearchContext, added: str | None = None) -> TrialRound:
    """Return a round in which segments have added this effect, at the values of the model."""
    trials = tuple(EffectFit(name, context.fit) for name in NAMES)
    best = next((each for each in trials if each.name == added), None)
    latest = TrialRound.of(trials, Null(np.ones(1), {}), context.fit.total, best)
    decision = finding(Reason.ADDED, effect=added) if added else finding(Reason.CHANCE)
    return latest.with_said(outcome="added" if added else "none", decision=decision)


def decided(latest: TrialRound) -> tuple[str, str | None, Reason]:
    return latest.said.outcome, latest.said.best, latest.said.decision.reason


@pytest.mark.parametrize("hidden", ["quadratic_drag", "gain_asymmetry"])
def test_what_sliding_shows_is_added_whatever_segments_say(case, hidden: str) -> None:
    own = case(hidden)
    context = SearchContext(own.dataset, own.base)
    for before in (None, "cogging"):
        latest = by_sliding(context, round_of(context, before))
        assert decided(latest) == ("added", hidden, Reason.SLIDING)
        assert latest.said.gain > 20
        assert latest.said.p < 1e-6
        assert latest.best is not None
        assert latest.best.fit is not None
        assert latest.best.fit.total > context.fit.total


def test_nothing_is_added_where_nothing_is_missing(case) -> None:
    plain = case(None)
    context = SearchContext(plain.dataset, plain.base)
    latest = round_of(context)
    assert by_sliding(context, latest) is latest


def test_an_effect_that_would_show_and_does_not_is_denied(case) -> None:
    """One too faint to show is left to the segments, and so is one that switches."""
    plain = case(None)
    context = SearchContext(plain.dataset, plain.base)

    def added(name: str, **values: float) -> TrialRound:
        own = {f"{name}.{key}": value for key, value in values.items()}
        latest = round_of(context, name)
        fit = replace(context.fit, values={**context.fit.values, **own})
        return by_sliding(context, replace(latest, best=EffectFit(name, fit)))

    cogging = {"phase": 0.0, "periods": 7.0, "amplitude2": 0.0, "phase2": 0.0}
    denied = added("cogging", amplitude=0.03, **cogging)
    assert decided(denied) == ("rejected", "cogging", Reason.NOT_SLIDING)
    assert decided(added("cogging", amplitude=0.001, **cogging))[0] == "added"
    assert decided(added("backlash", play=0.1, stiffness=50.0))[0] == "added"


@pytest.mark.parametrize(("by_motion", "taken"), [(1.05, 1.05), (1.3, 1.1), (None, 1.0)])
def test_what_segments_show_goes_with_the_motion_within_its_interval(by_motion, taken) -> None:
    values = {} if by_motion is None else {"dead_zone.width": by_motion}
    given = Estimate(1.0, "N.m", (0.9, 1.1))
    moved = _moved({"dead_zone.width": given}, SimpleNamespace(values=values))
    assert moved == {"dead_zone.width": replace(given, value=taken)}
