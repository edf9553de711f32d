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
    InputShare,
    estimate_input_share,
    with_input_share,
)
from bristle.diagnosis.checks.preparation import base_servo_of, dataset_of, notes_of
from bristle.diagnosis.estimation.fitted_model import fit_from_several_starts
from bristle.diagnosis.report.text.said import said
from bristle.records.input_hold import aliased
from bristle.records.record import Record

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
    again, notes = with_input_share(records, found)
    assert "between samples" in said(notes_of(records, notes)[-1])
    np.testing.assert_allclose(
        again[1].u[:-1], records[1].u[:-1] + found.share * np.diff(records[1].u)
    )
    assert estimate_input_share(*begun(model, again)) is None  # is tested once


def swept(rates, rate=200.0):
    """Return a record of an input whose frequency [Hz] follows these values, each for 3 s."""
    h = 1 / rate
    t = 5.0 + h * np.arange(round(3 * rate) * len(rates))
    phase = 2 * np.pi * h * np.cumsum(np.repeat(rates, round(3 * rate)))
    u = np.where(np.repeat(rates, round(3 * rate)) > 0, np.sin(phase), 0.0)
    return Record("sweep", t, h, u, np.cumsum(u))


def test_what_samples_do_not_show_is_left_out_until_the_input_rests():
    """Beyond half the sampling rate, as at 190 Hz of 200, a sine looks slow."""
    record = swept([5.0, 80.0, 190.0, 0.0, 8.0])
    [first, second], [note] = with_input_share([record], InputShare(0.3, 100.0))
    assert (first.name, second.name) == ("sweep", "sweep, part 2")
    assert first.time[-1] == pytest.approx(8.0, abs=0.15)
    assert second.time[0] == pytest.approx(14.0, abs=0.15)
    assert second.time[-1] == record.time[-1]
    assert note.facts["begin"] == pytest.approx(8.0, abs=0.15)
    assert "aliasing" in said(note)
    again, [note] = with_input_share([first, second], InputShare(0.3, 100.0))
    assert [r.ahead for r in again] == [0.3, 0.3]
    assert "aliasing" not in said(note)


def test_where_nothing_else_is_left_it_is_said_alone():
    record = swept([80.0, 90.0])
    [same], [note, _] = with_input_share([record], InputShare(0.3, 100.0))
    assert len(same) == len(record)
    assert "no other part is long enough" in said(note)
    for slow in ([5.0], [20.0, 0.0]):
        assert len(with_input_share([swept(slow)], InputShare(0.3, 100.0))[1]) == 1


@pytest.mark.parametrize("shape", ["steps", "noise", "out of rest"])
def test_steps_and_noise_that_vary_slowly_are_shown_by_their_samples(shape):
    record = swept([2.0, 4.0])
    rng = np.random.default_rng(1)
    slow = np.convolve(rng.normal(size=len(record)), np.ones(12) / 12, mode="same")
    out_of_rest = np.where(np.arange(len(record)) < 300, 0.0, np.cos(0.05 * np.arange(len(record))))
    u = {"steps": np.sign(record.u), "noise": slow, "out of rest": out_of_rest}[shape]
    assert not aliased(u).any()


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
