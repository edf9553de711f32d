"""Tubes: what repeated runs did stays inside in value and time, what they did not do does not."""

from __future__ import annotations

import numpy as np
import pytest

from bristle.harness.baseline.tube import SAFETY, SHIFT_SAFETY, Spread, Tube

TIME = np.arange(0, 10, 1e-3)


def tube_of(reference: np.ndarray, *runs: np.ndarray) -> Tube:
    spread = Spread({"x": reference})
    for run in runs:
        spread.add({"x": run})
    return spread.tube("x")


def inside(tube: Tube, values: np.ndarray) -> bool:
    return bool(((values >= tube.lower) & (values <= tube.upper)).all())


def test_without_a_spread_only_the_written_digits_are_open() -> None:
    x = np.sin(TIME)
    tube = tube_of(x, x)
    assert tube.shift == 0
    assert inside(tube, np.array([float(f"{each:.10g}") for each in x]))
    assert not inside(tube, x * (1 + 1e-8))


def test_the_spread_is_multiplied_and_belongs_to_its_part_of_the_run() -> None:
    x, late = np.sin(TIME), TIME > 8
    tube = tube_of(x, x + 1e-3 * late, x - 1e-3 * late)
    assert inside(tube, x + 0.99 * SAFETY * 1e-3 * late)
    assert not inside(tube, x + 1.01 * SAFETY * 1e-3 * late)
    assert not inside(tube, x + 1e-4 * (TIME < 7))


def jump(at: float, size: float = 1.0) -> np.ndarray:
    return np.where(at - 1e-9 <= TIME, size, 0.0)


def test_an_event_may_move_in_time_by_what_was_measured_and_not_in_value() -> None:
    tube = tube_of(jump(5.0), jump(5.002), jump(4.999))
    assert tube.shift == 2
    assert inside(tube, jump(5.0 + SHIFT_SAFETY * 2e-3))
    assert not inside(tube, jump(5.05))
    assert not inside(tube, jump(5.0, 1.01))


def test_no_number_in_a_run_allows_anything_there_and_none_in_the_reference_nothing_wider() -> None:
    x = np.sin(TIME)
    tube = tube_of(x, np.where(TIME > 9, np.nan, x))
    assert not np.isfinite(tube.upper[-1])
    assert np.isfinite(tube.upper[0])
    gap = np.where(TIME > 9, np.nan, x)
    bounds = tube_of(gap, gap)
    assert inside(Tube(bounds.lower[:8000], bounds.upper[:8000], 0), x[:8000])


@pytest.mark.parametrize("rows", [1, 2, 5])
def test_a_short_run_has_a_tube_too(rows: int) -> None:
    x = np.arange(rows, dtype=float)
    assert inside(tube_of(x, x), x)
