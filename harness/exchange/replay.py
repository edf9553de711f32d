"""A repeated run against the signals that came with it: how far each is from its reference, as
table and page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bristle.common.errors import BristleError
from bristle.common.signals import Array, table_text
from bristle.harness.cosim.bus import BusTrace

MOST_ROWS = 2001  # of a table of signals
LONGEST_REPLAY = 10_000_000  # steps
STEPS_BY_DEFAULT = 500  # of an experiment that says nothing about its step


@dataclass(frozen=True)
class SignalAgreement:
    """How far a signal is from its reference: largest difference over its size, and when; None if
    the signal is missing.
    """

    name: str
    worst: float | None
    time: float
    limit: float
    why: str = ""  # why there is no difference

    @property
    def holds(self) -> bool:
        """Whether it is within the tolerance."""
        return self.worst is not None and self.worst <= self.limit


def agreement(
    reference: tuple[Array, Mapping[str, Array]],
    time: Array,
    signals: Mapping[str, Array],
    limit: float,
    slack: int = 0,
) -> tuple[SignalAgreement, ...]:
    """Compare signals with a reference at its times.

    Parameters
    ----------
    reference : (ndarray, shape (rows,); mapping of str to ndarray, shape (rows,))
        Times [s] and signals.
    time, signals : ndarray, shape (n,), and mapping of str to ndarray, shape (n,)
        What is compared, at rising times.
    limit : float
        Largest difference allowed, over the range of a signal or its largest value.
    slack : int
        Rows that a signal may be early or late.
    """
    (at, columns), half = reference, 0.5 * (time[-1] - time[0]) / max(1, len(time) - 1)
    outside = ""
    if at[0] < time[0] - half or at[-1] > time[-1] + half:
        outside = (
            f"the reference is from {at[0]:g} to {at[-1]:g} s, the run from {time[0]:g} to"
            f" {time[-1]:g} s"
        )
    agreements = []
    for name, expected in columns.items():
        got = signals.get(name)
        if got is None or outside:
            agreements.append(SignalAgreement(name, None, 0.0, limit, outside or "no such output"))
            continue
        size = max(float(np.ptp(expected)), float(np.abs(expected).max()), np.finfo(float).tiny)
        low, high = _range(at, time, got, slack)
        distance = np.maximum(np.maximum(low - expected, expected - high), 0.0) / size
        worst = int(np.argmax(np.where(np.isnan(distance), np.inf, distance)))
        value = float(distance[worst])
        agreements.append(
            SignalAgreement(name, value if np.isfinite(value) else None, float(at[worst]), limit)
        )
    return tuple(agreements)


def _range(at: Array, time: Array, got: Array, slack: int) -> tuple[Array, Array]:
    """Return the least and the largest value of a signal around each time."""
    here = np.interp(at, time, got)
    rows = np.searchsorted(time, at)
    near = (
        [got[np.clip(rows + shift, 0, len(got) - 1)] for shift in range(-slack, slack + 1)]
        if slack
        else []
    )
    both = np.array([here, *near])
    return both.min(axis=0), both.max(axis=0)


def verdict_of(failure: object, compared: bool, signals: Sequence[SignalAgreement]) -> str:
    """Return ``pass``, ``fail`` (also with nothing to compare), or ``ran`` without a reference."""
    if failure or not all(each.holds for each in signals) or (compared and not signals):
        return "fail"
    return "pass" if compared else "ran"


def number_of_steps(start: float, stop: float, step: float) -> int:
    """Return how many steps of a length [s] are from start to stop; `BristleError` if none."""
    steps = round((stop - start) / step) if step > 0 else 0
    if not 1 <= steps <= LONGEST_REPLAY:
        raise BristleError(
            f"has {steps} steps of {step:g} s from {start:g} to {stop:g} s; allowed are 1 to"
            f" {LONGEST_REPLAY}, longer than 0 s"
        )
    return steps


def held(time: Array, values: Array, at: Array, step: float) -> Array:
    """Return the last of the values, given at rising times, at each of the times `at`, which may be
    off by rounding.
    """
    rows = np.searchsorted(time, at + 1e-9 * step, side="right") - 1
    return values[np.clip(rows, 0, None)]


def signals_text(trace: BusTrace, names: Sequence[str]) -> str:
    """Return the signals of a run as a table, thinned to equal steps."""
    stride = max(1, -(-trace.steps // (MOST_ROWS - 1)))
    columns = dict(zip(names, trace.values.T, strict=True))
    return table_text(
        {name: values[::stride] for name, values in {"time": trace.time, **columns}.items()}
    )


def rows_of(signals: Sequence[SignalAgreement]) -> list[dict[str, Any]]:
    """Return them as result.json has them."""
    return [
        {
            "name": e.name,
            "worst": e.worst,
            "time_s": e.time,
            "limit": e.limit,
            "pass": e.holds,
            "why": e.why,
        }
        for e in signals
    ]
