"""The residual torque as a function of a view, for figures."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.estimation.dataset import Motion
from bristle.diagnosis.localisation.residual_response import ResidualResponse
from bristle.diagnosis.localisation.views import clocks, hats

Array = NDArray[np.float64]

MAP_PHASES = 20  # points of one period that is drawn
MIN_PHASE_SAMPLES = 0.1  # samples at a phase, over their mean number, below which it is not drawn
MIN_BIN_SAMPLES = 5  # samples in a bin below which it is not drawn


def residual_map(
    view: str, m: Motion, before: Array, after: Array, bins: int = 40
) -> dict[str, Any]:
    """Return the residual torques (samples,) averaged in bins of a view: fields of `View`, empty if
    it is not drawn.
    """
    axis = _axis(view, m)
    if axis is None:
        return {}
    x, groups, names = axis
    low, high = np.quantile(x, [0.002, 0.998]).tolist()
    edges = np.linspace(low, high, bins + 1)
    if not edges[-1] > edges[0]:
        return {}
    place = np.digitize(x, edges) - 1
    lines = [[_averages(place, r, g & m.moving, bins) for g in groups] for r in (before, after)]
    return {
        "centres": (edges[1:] + edges[:-1]) / 2,
        "before": np.array(lines[0]),
        "after": np.array(lines[1]),
        "lines": names,
    }


def wave_map(
    view: str, m: Motion, before: ResidualResponse, after: ResidualResponse, period: float | None
) -> dict[str, Any]:
    """Return the torque that repeats with a period [unit of the axis], over one of them: fields of
    `View`.

    Empty where it is not periodic, or where a torque along the whole axis explains more. It is
    fitted through the response: averages of the most likely torque are lower than the torque
    itself, the more so the faster a wave is passed.
    """
    axis = _axis(view, m)
    if axis is None or period is None or np.ptp(axis[0]) <= period:
        return {}
    x, groups, names = axis
    knots = np.linspace(0.0, period, MAP_PHASES + 1)
    table = np.column_stack(
        [np.interp(x, knots[:-1], row, period=period) for row in np.eye(MAP_PHASES)]
    )
    waves, whole = (
        np.column_stack([g[:, None] * each for g in groups])
        for each in (table, hats(x, MAP_PHASES))
    )
    curves, gain = before.regress(waves)
    if view == "tone" and len(groups) > 1:  # of records with their own clock, that with the largest
        largest = int(np.argmax(np.ptp(curves.reshape(-1, MAP_PHASES), axis=1)))
        groups, names = [groups[largest]], names[largest : largest + 1]
        waves = groups[0][:, None] * table
        curves = before.regress(waves)[0]
    elif gain < before.regress(whole)[1]:
        return {}
    seen = m.moving @ waves
    lines = [
        np.where(seen > MIN_PHASE_SAMPLES * seen.mean(), c, np.nan).reshape(-1, MAP_PHASES)
        for c in (curves, after.regress(waves)[0])
    ]
    first, second = (np.column_stack([each, each[:, 0]]) for each in lines)
    return {"centres": knots, "before": first, "after": second, "lines": names, "period": period}


def _axis(view: str, m: Motion) -> tuple[Array, list[NDArray[np.bool_]], tuple[str, ...]] | None:
    """Return the variable that a view is drawn over, the samples of each line, and their names."""
    if view == "tone":
        clock = clocks(m)
        numbers = np.unique(clock)
        names = tuple(f"record {k + 1}" for k in numbers) if len(numbers) > 1 else ()
        return m.time, [clock == k for k in numbers], names
    along, _, side = view.partition(" x ")
    x = {"v": m.v, "a": m.a, "u": m.u, "t": m.time, "theta": m.theta}.get(along)
    if x is None:  # travel, rates and outlier segments are not drawn
        return None
    way = {"direction": m.v, "v": m.v, "u": m.u, "a": m.a}.get(side)
    if way is None:
        return x, [np.ones(len(x), dtype=bool)], ()
    return (
        x,
        [way > 0, way < 0],
        ("forward", "backward") if side in ("direction", "v") else (f"{side} > 0", f"{side} < 0"),
    )


def _averages(place: NDArray[np.int_], values: Array, mask: NDArray[np.bool_], bins: int) -> Array:
    inside = mask & (place >= 0) & (place < bins)
    count = np.bincount(place[inside], minlength=bins)
    total = np.bincount(place[inside], weights=values[inside], minlength=bins)
    return np.where(count >= MIN_BIN_SAMPLES, total / np.maximum(count, 1), np.nan)
