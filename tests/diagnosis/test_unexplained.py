"""The unexplained residual: no flag for a small one or for the form of a named effect, but one for
a wave that is left.
"""

from __future__ import annotations

import numpy as np
import pytest

from bristle.diagnosis.answer import OUTLIERS, Gap
from bristle.diagnosis.localisation.unexplained import FinalModel, unexplained
from bristle.diagnosis.localisation.views import Share

TURN = 2 * np.pi
HALF = Gap(2.0, 1.0, 0.1, "rad")  # an effect was named that left half of the error


def said(share, *named, gap=HALF, turn=TURN, disturbance=0.0, **values):
    """What is unexplained of a residual that one view predicts."""
    model = FinalModel(
        named, values, turn, gap.after / gap.before, gap.before / gap.after, disturbance
    )
    return unexplained([share, Share("t", 0.01, 1.0)], model)


def test_what_is_left_casts_doubt_where_it_is_large_beside_the_error_before():
    """Not an oscillation in time that is large only beside what is left."""
    small = Gap(20.0, 1.0, 0.1, "rad")
    assert said(Share("v", 0.5, 0.001), "gravity").doubtful
    tone = said(Share("tone", 0.5, 0.001), "gravity", gap=small)
    assert tone.flag
    assert not tone.doubtful


def test_a_certain_and_large_share_is_reported_in_any_view():
    assert said(Share("history", 0.5, 0.001)).flag
    assert said(Share("history", 0.5, 0.001), "gravity").flag
    assert said(Share("history", 0.5, 0.001), "gravity").view == "history"


@pytest.mark.parametrize(
    "share", [Share("history", 0.5, 0.05), Share("history", 0.15, 0.001), Share("du", 0.9, 0.001)]
)
def test_an_uncertain_small_or_sensor_share_is_not_reported(share):
    assert not said(share).flag


@pytest.mark.parametrize(("share", "flag"), [(0.19, False), (0.21, True)])
def test_what_is_left_is_measured_by_the_gap_there_was(share, flag):
    assert said(Share("history", share, 0.001), "gravity").flag is flag


@pytest.mark.parametrize(("share", "flag"), [(0.19, False), (0.21, True)])
def test_without_a_name_a_fifth_of_the_residual_is_reported(share, flag):
    """Where servos differ from those of the calibration, views predict a little of anything."""
    assert said(Share("tone", share, 0.001)).flag is flag
    assert not said(Share("tone", share, 0.05)).flag


@pytest.mark.parametrize(("disturbance", "large"), [(0.11, False), (1.8, True)])
def test_a_large_disturbance_is_called_that(disturbance, large):
    """It is not said that something is missing where nothing but chance predicts it."""
    nothing = Share("theta x a", 1.0, 0.049)
    left = said(nothing, disturbance=disturbance)
    assert (left.flag, left.disturbed) == (False, large)
    assert (left.view, left.disturbance) == (None, disturbance)
    assert not said(nothing, "gravity", disturbance=disturbance).disturbed


def test_what_is_left_of_a_gap_that_was_closed_is_small():
    closed = Gap(2.0, 0.05, 0.05, "rad")
    assert not said(Share("history", 0.5, 0.001), "gravity", gap=closed).flag
    assert not said(Share("tone", 0.25, 0.001), "gravity", gap=closed).flag
    # which is no form of any effect
    tone = said(Share("tone", 0.9, 0.001, label="3 Hz"), "gravity", gap=closed)
    assert (tone.flag, tone.view, tone.label) == (True, "tone", "3 Hz")
    assert said(Share("history", 0.5, 0.001), "gravity").flag


def test_an_effect_that_does_not_lower_the_held_out_error_leaves_a_flag():
    vain = Gap(2.0, 2.1, 0.1, "rad")
    assert said(Share("history", 0.1, 0.5), "gravity", gap=vain).flag
    # may act in none of those segments
    assert not said(Share("history", 0.1, 0.5), "saturation", gap=vain).flag
    assert not said(Share("history", 0.1, 0.5), gap=vain).flag


def test_a_multiple_of_the_named_wave_is_its_form():
    for times, flag in ((2, False), (3, False), (2.5, True), (7, True)):
        assert (
            said(Share("theta x a", 0.9, 0.001, periods=times), "eccentric_encoder").flag is flag
        ), times


def test_the_named_wave_itself_is_reported_on_less_evidence():
    weak = {"share": 0.4, "p": 0.2, "alone": 0.02}
    assert said(Share("theta x a", **weak, periods=1.0), "eccentric_encoder").flag
    assert not said(Share("theta x a", **weak, periods=5.0), "eccentric_encoder").flag
    assert not said(
        Share("theta x a", **weak | {"alone": 0.2}, periods=1.0), "eccentric_encoder"
    ).flag


def test_waves_are_counted_along_the_path_that_a_motion_repeats_after():
    """2 rad that count as a turn: 7 periods of them are a wave of 7 pi to the radian."""
    where = {"turn": 2.0, "cogging.periods": 7 * np.pi}
    assert not said(Share("theta x u", 0.9, 0.001, periods=14.0), "cogging", **where).flag
    assert said(Share("theta x u", 0.4, 0.2, alone=0.02, periods=7.0), "cogging", **where).flag


def test_outlier_segments_of_a_contact_with_free_play_are_not_flagged():
    assert not said(Share(OUTLIERS, 0.9, 0.001), "backlash").flag
    assert said(Share(OUTLIERS, 0.9, 0.001), "gravity").flag
