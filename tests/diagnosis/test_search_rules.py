"""Rules of the search, each on its own: from where candidates are stepped, and how often."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bristle.diagnosis.estimation.simulator import Simulator
from bristle.diagnosis.selection import candidates, refinement
from bristle.diagnosis.selection.candidates import (
    CLIMB_REPEATS,
    EXHAUSTIVE,
    QUICK,
    REFINEMENT_STEPS,
    EffectFit,
)
from bristle.plant.effects import effect


@pytest.fixture
def climb(monkeypatch):
    """Return what advances a candidate through such log-likelihoods, one a refit, and says how many
    were used; the model without it has 0.
    """

    def of(name, begin, totals, play="", effort=EXHAUSTIVE):
        left = list(totals)

        def refit(fit, noise, steps):
            return SimpleNamespace(total=left.pop(0), simulator=fit.simulator)

        monkeypatch.setattr(candidates, "refit_rescored", refit)
        monkeypatch.setattr(candidates, "value_under_noise", lambda fit, noise: (fit.total, fit))
        fit = SimpleNamespace(total=begin, simulator=SimpleNamespace(play=play))
        context = SimpleNamespace(fit=SimpleNamespace(total=0.0), screening_noise=None)
        found = candidates.advance_candidate(context, EffectFit(name, fit, predicted=50.0), effort)
        used = len(totals) - len(left)
        assert found.predicted == found.fit.total == totals[used - 1]
        return used

    return of


@pytest.mark.parametrize(
    ("begin", "totals", "used"),
    [
        (-100.0, [-60.0, -30.0, -20.0, 9.0], 3),  # gains 40, 30 and 10 of 100, 60 and 30
        (-100.0, [-70.0, 5.0], 1),  # less than half of the 70 that are still lacking
        (-100.0, [-66.0, -60.0, 5.0], 2),
        (-100.0, [5.0, 60.0], 1),  # likelier than the model without it
        (5.0, [8.0, 60.0], 1),
        (-100.0, [-110.0, 60.0], 1),  # worse
        (-100.0, [-50.0, -25.0, -12.0, -6.0, -3.0], CLIMB_REPEATS),
    ],
)
def test_steps_are_repeated_while_they_gain_half_of_what_is_lacking(climb, begin, totals, used):
    assert climb("bias", begin, totals) == used


def test_a_contact_takes_its_steps_once(climb):
    assert climb("backlash", -100.0, [-50.0, -25.0]) == 1


@pytest.mark.parametrize(("predicted", "refits"), [(1.0, 0), (-19.0, 0), (3.0, 1), (-21.0, 1)])
def test_an_effect_that_changes_nothing_at_its_start_is_left_there(monkeypatch, predicted, refits):
    """Unless all start values are tried."""
    count = []
    monkeypatch.setattr(candidates, "refit_rescored", lambda fit, *_: count.append(1) or fit)
    monkeypatch.setattr(candidates, "value_under_noise", lambda fit, noise: (fit.total, fit))
    fit = SimpleNamespace(total=1.0, simulator=SimpleNamespace(play=""))
    context = SimpleNamespace(fit=SimpleNamespace(total=0.0), screening_noise=None)
    candidate = EffectFit("bias", fit, predicted=predicted)
    candidates.advance_candidate(context, candidate, QUICK)
    assert len(count) == refits
    candidates.advance_candidate(context, candidate, EXHAUSTIVE)
    assert len(count) == refits + 1


@pytest.mark.parametrize(("play", "steps"), [("backlash.play", REFINEMENT_STEPS), ("", 0)])
def test_initial_states_are_refined_beside_free_play_alone(monkeypatch, play, steps):
    """They were fitted without the effect, which moves the load to elsewhere in its play."""
    monkeypatch.setattr(candidates, "evaluate", lambda problem, point: point)
    monkeypatch.setattr(
        candidates, "refine_initial_states", lambda problem, fit, steps: (fit, steps)
    )
    servo = SimpleNamespace(free_beside=lambda name: (), limits={})
    model = SimpleNamespace(simulator=SimpleNamespace(play=play), values={"J": 0.01})
    context = SimpleNamespace(
        fit=model, fitted=SimpleNamespace(problem=None, fit=model, servo=servo)
    )
    point, taken = candidates.fit_at(context, "simulator", "bias", {}, ({}, "states"))
    assert taken == steps
    assert (point.simulator, point.initial) == ("simulator", "states")
    assert point.values["J"] == 0.01
    assert "bias.torque" in point.values


@pytest.mark.parametrize(
    ("name", "before", "beside", "kept"),
    [
        ("compliance", 1.0, 2.0, "beside"),
        ("compliance", 2.0, 1.0, "before"),
        ("stribeck", 1.0, 2.0, "before"),
    ],
)
def test_another_shape_of_a_coupling_is_compared_with_the_best_usual_one(
    monkeypatch, name, before, beside, kept
):
    """Also with the usual shape beside the other one's parameters, which may be a better maximum of
    the likelihood.
    """
    asked = {}

    def evaluate(problem, point):
        asked.update(point)
        return SimpleNamespace(total=beside, which="beside")

    monkeypatch.setattr(refinement, "evaluate", evaluate)
    monkeypatch.setattr(refinement, "resume", lambda problem, fit, iterations: fit)
    monkeypatch.setattr(refinement, "refit_nonsmooth", lambda fit, noise, effects: fit)
    context = SimpleNamespace(
        fit=SimpleNamespace(at=lambda values, initial: values),
        fitted=SimpleNamespace(servo=SimpleNamespace(effects=(name,))),
    )
    shape = next(iter(effect(name).shape_parameters))
    other = SimpleNamespace(values={"J": 0.02, f"{name}.{shape}": 7.0}, initial=None)
    usual = SimpleNamespace(total=before, which="before")
    found = refinement._usual_shape(context, None, usual, other, name)
    assert found.which == kept
    if effect(name).coupling:
        assert asked == {"J": 0.02, f"{name}.{shape}": 7.0} | effect(name).inactive_values


@pytest.mark.parametrize("b", [1.0, 4.0, -0.5])
def test_where_a_load_may_begin_depends_on_the_torque_not_on_the_unit_of_the_input(case, b):
    """Anywhere in its play, and beyond it as far as the rms torque bends the contact."""
    segments = case(None).dataset.segments
    torque = np.concatenate([piece.u for piece in segments.pieces])
    scaled = replace(
        segments, pieces=tuple(replace(piece, u=piece.u / b) for piece in segments.pieces)
    )
    simulator = Simulator("coulomb", ("backlash",), scaled, ("J", "a2"), {})
    values = {"b": b, "backlash.stiffness": 50.0, "backlash.play": 0.03}
    place, speed = simulator.hidden_spread(values)
    assert place == pytest.approx(1.0 + np.sqrt(np.mean(torque**2)) / 50.0 / 0.015)
    assert 0 < speed < np.abs(np.concatenate([p.initial[:, 1] for p in segments.pieces])).max()
