"""Chains cover all segments once, and give what whole records give."""

from __future__ import annotations

import platform
from dataclasses import replace

import numpy as np
import pytest

from bristle.diagnosis.estimation import dataset, simulator
from bristle.diagnosis.estimation.dataset import (
    LANES,
    Grid,
    Segments,
    chains_of,
    cut,
)
from bristle.diagnosis.estimation.simulator import (
    OWN_BRISTLES,
    Servo,
    Simulator,
    fixed_values,
)
from bristle.model import lanes

H, WIDTH, BINS = 1e-3, 8, 50
GRID = Grid(H, WIDTH, BINS, False)
VALUES = {
    "J": 0.01,
    "a2": 0.02,
    "b": 1.0,
    "coulomb.Fc": 0.12,
    "disturbance_step.torque": 0.05,
    "disturbance_step.onset": 8.2,
    f"{OWN_BRISTLES}.stiffness": 1200.0,
    f"{OWN_BRISTLES}.damping": 2.0,
}


def records(*counts: int) -> Segments:
    """Records with so many segments, the second beginning where the first one ends."""
    rng = np.random.default_rng(2)
    pieces, begin = [], 0.0
    for number, count in enumerate(counts):
        u = np.repeat(rng.normal(0.0, 0.3, 4 * count), GRID.bins * GRID.width // 4)
        pieces.append(cut(f"record {number}", begin, u, rng.normal(0.0, 0.3, len(u)), GRID, 1e-3))
        begin += H * len(u)
    return Segments(H, WIDTH, BINS, False, tuple(pieces))


def servo(segments: Segments, effects: tuple[str, ...] = ("disturbance_step",)) -> Simulator:
    return Servo("coulomb", (), ("J", "a2", "coulomb.Fc"), (), fixed_values(H), True).simulator(
        segments, effects
    )


@pytest.mark.parametrize(
    "counts",
    [(1,), (2,), (1, 1), (3, 1), (8,), (50, 50), (37, 12, 1), (1,) * 9, (30,) * 10, (400,)],
)
def test_each_segment_is_simulated_once_after_the_one_before_it(counts):
    segments = records(*counts)
    groups = chains_of(segments)
    assert {len(group.first) for group in groups} == {LANES}
    written = np.concatenate(
        [np.arange(b, e) for g in groups for b, e in zip(g.begin, g.end, strict=True)]
    )
    assert written.tolist() == list(range(sum(counts)))
    starts = np.cumsum([0, *counts[:-1]])
    for group in groups:
        for time, first, begin, end in zip(
            group.times, group.first, group.begin, group.end, strict=True
        ):
            if begin == end:
                continue
            record = int(np.searchsorted(starts, begin, "right")) - 1
            assert end <= starts[record] + counts[record]
            assert first == (begin if begin in starts else begin - 1)
            assert time == pytest.approx(
                segments.pieces[record].time + (first - starts[record]) * segments.seconds
            )


def test_long_records_are_cut_and_short_ones_are_not():
    """Two records of 50 segments take 26 steps instead of 50; two of two segments gain nothing."""
    [cut_up] = chains_of(records(50, 50))
    assert max(cut_up.end - cut_up.first) == 26
    [whole] = chains_of(records(2, 2))
    assert np.count_nonzero(whole.end) == 2


def test_records_of_a_velocity_stay_whole():
    """A position friction would else begin anew at another place in each part."""
    segments = replace(records(50, 50), velocity=True)
    [whole] = chains_of(segments)
    assert (whole.first.tolist(), whole.end.tolist()) == ([0, 50, 0, 0], [50, 100, 0, 0])


@pytest.mark.slow
@pytest.mark.parametrize("effects", [("disturbance_step",), ("input_delay", "disturbance_step")])
def test_parts_of_a_record_give_what_the_whole_record_gives(effects, monkeypatch):
    """Outputs and derivatives, with a clock that runs on; what is left of a hidden state decays in
    the segment before.
    """
    segments = records(24, 9)
    values = VALUES | ({"input_delay.delay": 0.006} if "input_delay" in effects else {})
    starts = segments.initial + np.array([0.0, 0.5])
    parts = servo(segments, effects).run(values, starts, jacobian=True)
    monkeypatch.setattr(dataset, "LANES", 2)
    assert [g.end.tolist() for g in chains_of(segments)] == [[24, 33]]
    whole = servo(segments, effects).run(values, starts, jacobian=True)
    assert whole[2].all()
    for found, expected in zip(parts, whole, strict=True):
        assert found is not None
        size = np.max(np.abs(np.asarray(expected, dtype=float)))
        np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5 * size)
    moved = servo(segments, effects).run(values | {"disturbance_step.onset": 8.6}, starts)[0]
    assert np.any(moved != whole[0])
    assert np.array_equal(moved[:20], whole[0][:20])


def test_one_step_more_in_one_lane_does_not_touch_the_others():
    """A segment that fails is marked; its chain goes on in the next one as if it had begun
    there.
    """
    segments = records(24, 24)
    starts = segments.initial.copy()
    starts[10, 1] = np.nan
    seen, sens, good, _ = servo(segments).run(VALUES, starts, jacobian=True)
    assert np.flatnonzero(~good).tolist() == [10]
    expected, slopes, _, _ = servo(segments).run(VALUES, segments.initial, jacobian=True)
    assert sens is not None
    assert slopes is not None
    apart = np.abs(seen - expected).max(axis=1)
    assert np.all(apart[np.r_[0:10, 12:48]] == 0.0)
    assert apart[11] < 1e-3 * np.ptp(expected)
    np.testing.assert_array_equal(sens[12:], slopes[12:])


def test_records_of_one_segment_with_one_average_can_be_simulated():
    """The shortest there is: all lanes but one are empty."""
    piece = records(1).pieces[0]
    one = Segments(H, len(piece.u), 1, False, (replace(piece, measured=np.zeros((1, 1))),))
    seen, _, good, _ = servo(one).run(VALUES, piece.initial)
    assert good.all()
    assert np.isfinite(seen).all()


@pytest.mark.sampled(4)
@pytest.mark.skipif(
    platform.machine() not in ("x86_64", "AMD64"), reason="names processors of this kind"
)
def test_a_processor_with_narrow_vectors_gives_the_same_digits(monkeypatch):
    segments = records(24, 24)
    own = servo(segments).run(VALUES, segments.initial, jacobian=True)
    monkeypatch.setattr(lanes, "OWN_PROCESSOR", "-march=x86-64")
    simulator._compiled.cache_clear()
    try:
        narrow = servo(segments).run(VALUES, segments.initial, jacobian=True)
    finally:
        simulator._compiled.cache_clear()
    for found, expected in zip(narrow, own, strict=True):
        np.testing.assert_array_equal(np.asarray(found), np.asarray(expected))
