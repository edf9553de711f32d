"""An input that changed between samples is detected and averaged; an input that was held is
kept.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bristle.diagnosis import diagnose, records_from_arrays
from bristle.diagnosis.checks.input_hold import (
    SLOW_SAMPLING,
    estimate_input_share,
    with_input_share,
)
from bristle.diagnosis.checks.preparation import base_servo_of, dataset_of, notes_of
from bristle.diagnosis.estimation.fitted_model import fit_from_several_starts
from bristle.diagnosis.report.text.said import said

EVERY = 8  # sample of a drive that works at 1 kHz is logged


@pytest.fixture
def logged(measured, model):
    """Return what gives two records that are logged too slowly; the input as it was then, or
    averaged until the next sample.
    """

    def of(name=None, averaged=False, every=EVERY):
        runs = []
        for seed in (1, 2):
            t, u, y, _ = measured(name, seed) if name else measured(seed=seed, plain=1)
            means = u.reshape(-1, every).mean(axis=1)
            runs.append((f"run {seed}", t[::every], means if averaged else u[::every], y[::every]))
        return records_from_arrays(model, runs)

    return of


def begun(model, records):
    dataset = dataset_of(model, records)
    return dataset, fit_from_several_starts(dataset, *base_servo_of(model, dataset))


@pytest.mark.sampled(4)
def test_an_input_that_changes_between_the_samples_is_found_out(model, logged):
    records = logged()
    found = estimate_input_share(*begun(model, records))
    assert found is not None
    # the mean place of what the drive held
    assert found.share == pytest.approx((EVERY - 1) / (2 * EVERY), abs=0.05)
    again = with_input_share(records, found)
    assert "between samples" in said(notes_of(again, found)[-1])
    np.testing.assert_allclose(
        again[1].u[:-1], records[1].u[:-1] + found.share * np.diff(records[1].u)
    )
    assert estimate_input_share(*begun(model, again)) is None  # is tested once


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", [None, "bias", "input_delay", "compliance"])
def test_an_input_that_was_held_stays(model, logged, name):
    assert estimate_input_share(*begun(model, logged(name, averaged=True))) is None


def test_what_is_logged_as_fast_as_the_drive_works_is_not_asked(model, logged):
    dataset, base = begun(model, logged(every=1))
    assert dataset.segments.h < SLOW_SAMPLING
    assert not dataset.input_may_change
    # and would stay
    assert estimate_input_share(replace(dataset, input_may_change=True), base) is None


@pytest.mark.long
def test_what_is_missing_is_named_alone_once_the_input_is_right(model, logged):
    """The base fit without it hides the input's delay; it comes to light when the effect is
    added.
    """
    found = diagnose(model, logged("bias"))
    assert [e.group for e in found.effects] == ["bias/asymmetric_coulomb"]
    assert any("between samples" in line for line in found.findings)
