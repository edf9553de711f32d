"""What friction leaves in the rest positions of an axis that is sampled slower than it moves.

Between two samples such an axis, a valve in a historian's log say, comes to rest. Of the balance of
input, spring and friction only |u - k theta - c| <= F shows: it stays as long as the input is less
than the static friction away from where it stands, else it slips until the kinetic friction holds
it. Source: he2007 (a valve that sticks, by two friction bands).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from bristle.common.errors import BristleError
from bristle.common.metrics import NORMAL_95
from bristle.common.table import Array
from bristle.records.formats.reading import read_columns

NOISE_FACTOR = 4.0  # deviations of the noise from which on the output has moved
WHOLE = 1e-5  # how far a whole number is off by rounding
QUARTER = 0.25  # of the changes: so many are noise at least
FEWEST_MOVES = 5  # either way: fewer do not tell what friction holds against
MOVE_BLOCKS = 20  # parts of a record whose errors count as independent
FALL = 1.2  # factor by which the squared error must fall for more friction to be there
LEAST_EXPLAINED = 0.5  # of the squares of the changes where it moves: what the answer must tell

Behaviour = Literal["follows", "dead band", "stick and slip"]
Interval = tuple[float, float]


@dataclass(frozen=True)
class StickSlip:
    """What the rest positions of an axis show.

    Attributes
    ----------
    behaviour : str
        ``follows``: no friction is seen; ``dead band``: static and kinetic friction are alike, or
        it is a play, which rest positions cannot tell; ``stick and slip``: it jumps.
    samples, moves : int
        Samples, and times at which it began to move.
    gain, offset : float
        Output over input, and the output at an input of 0.
    gain_interval : tuple of float
        95 % interval of the gain.
    static, static_interval : float, tuple of float
        How far the input is from where the axis stands when it begins to move, in the unit of the
        input; the interval holds what the input passed between two samples.
    kinetic, kinetic_interval : float, tuple of float
        How far it still is where the axis stops; negative if it moves on beyond.
    jump : float
        Slip, in the unit of the output.
    error : dict of str to float
        Rms error of the output, predicted from the sample before, by what is assumed.
    """

    behaviour: Behaviour
    samples: int
    moves: int
    gain: float
    gain_interval: Interval
    offset: float
    static: float
    static_interval: Interval
    kinetic: float
    kinetic_interval: Interval
    jump: float
    error: dict[Behaviour, float]


@dataclass(frozen=True)
class _Moves:
    """Begin and end of each move, as samples, and its direction."""

    begin: NDArray[np.int_]
    end: NDArray[np.int_]
    sign: Array
    moving: NDArray[np.bool_]  # of each change
    least: float  # least change that is one


def stick_slip(
    u: Sequence[float] | Array, y: Sequence[float] | Array, resolution: float = 0.0
) -> StickSlip:
    """Find what friction or play leaves in the rest positions of a slow axis.

    Parameters
    ----------
    u, y : array of shape (n,)
        Input and measured position, in any unit, so slow that the axis rests between two samples.
    resolution : float, optional
        Step of the sensor of the position, in its unit; by default the last digit that is written.

    Returns
    -------
    StickSlip
        Static and kinetic friction, as distances of the input, with 95 % intervals.

    Raises
    ------
    BristleError
        If the axis hardly moves, or does not follow this input.
    """
    u, y = (np.asarray(each, dtype=float) for each in (u, y))
    if u.shape != y.shape or u.ndim != 1:
        raise BristleError(f"input and output have shapes {u.shape} and {y.shape}; give one each")
    valid = np.isfinite(u) & np.isfinite(y)
    u, y = u[valid], y[valid]
    if len(u) < 4 * FEWEST_MOVES:
        raise BristleError(f"{len(u)} samples; give {4 * FEWEST_MOVES} at least, of many moves")
    # a gain below 0 is that of the input turned around
    turned = -1.0 if len(u) > 1 and np.sum((u - u.mean()) * (y - y.mean())) < 0 else 1.0
    found = _of_positive(turned * u, y, resolution)
    gain, ends = found.gain * turned, sorted(turned * end for end in found.gain_interval)
    return StickSlip(**{**vars(found), "gain": gain, "gain_interval": (ends[0], ends[1])})


def stick_slip_of_file(path: Path, input_: str, output: str, resolution: float = 0.0) -> StickSlip:
    """Return what two columns of a file show; errors as of `stick_slip`, with the file's name."""
    columns = read_columns(path)
    if missing := [name for name in (input_, output) if name not in columns]:
        raise BristleError(
            f"record {path}: lacks the column '{missing[0]}'; there are: {', '.join(columns)}"
        )
    if input_ == output:
        raise BristleError(f"record {path}: '{input_}' is asked for as input and as output")
    try:
        return stick_slip(columns[input_], columns[output], resolution)
    except BristleError as error:
        raise BristleError(f"record {path}: {error}") from None


def _of_positive(u: Array, y: Array, resolution: float) -> StickSlip:
    """Return what an axis of positive gain shows."""
    everywhere = np.column_stack([y, np.ones(len(y))])
    line, spread = _regression(everywhere, u)
    moves = _moves(u, y, 1 / line[0] if line[0] else 0.0, resolution)
    rows = np.column_stack([y[moves.end], np.ones(len(moves.end)), moves.sign])
    (k, c, kinetic), deviations = _regression(rows, u[moves.end])
    if not (k > 0 and line[0] > 0):
        raise _does_not_follow()
    kinetic_interval = _interval(kinetic, deviations[2])
    distance = u[1:] - k * y[:-1] - c  # before each change
    around = float(np.std(u[moves.end] - rows @ (k, c, kinetic)))  # where it comes to rest
    static, static_interval = _static(distance, moves, k * moves.least + around)
    predicted: dict[Behaviour, Array] = {
        "follows": (u[1:] - line[1]) / line[0],
        "dead band": _next(u, y, (k, c), (kinetic, kinetic)),
        "stick and slip": _next(u, y, (k, c), (static, kinetic)),
    }
    error = {name: float(np.sqrt(np.mean((y[1:] - x) ** 2))) for name, x in predicted.items()}
    behaviour: Behaviour = "follows"
    if kinetic_interval[0] > 0 and _falls(error["follows"], error["dead band"]):
        behaviour = "dead band"
    apart = static_interval[0] > kinetic_interval[1]
    if apart and _falls(error[behaviour], error["stick and slip"]):
        behaviour = "stick and slip"
    if behaviour != "follows":
        slips = behaviour == "stick and slip"
        _must_rest(distance, moves, static_interval[0] if slips else kinetic - k * moves.least)
    held = 0.0 if behaviour == "follows" else kinetic * moves.sign
    left = y[moves.end] - (u[moves.end] - c - held) / k
    if np.sum(left**2) > (1 - LEAST_EXPLAINED) * np.sum((y[moves.end] - y[moves.begin - 1]) ** 2):
        raise _does_not_follow()
    if behaviour == "follows":
        (k, c), deviations = line, spread
    return StickSlip(
        behaviour,
        len(y),
        len(moves.begin),
        float(1 / k),
        _interval(1 / k, deviations[0] / k**2),
        float(-c / k),
        static,
        static_interval,
        float(kinetic),
        kinetic_interval,
        float((static - kinetic) / k),
        error,
    )


def _does_not_follow() -> BristleError:
    return BristleError(
        "the output does not follow this input, with or without friction; name the columns of both,"
        " and take what the axis is told, not what it makes of it"
    )


def _must_rest(distance: Array, moves: _Moves, band: float) -> None:
    """Refuse an output that moves on where the input no longer moves it: it lags."""
    later = moves.moving.copy()
    later[moves.begin - 1] = False
    if np.sum(np.abs(distance[later]) < band) > len(moves.begin):
        raise BristleError(
            f"the output moves on for {np.sum(moves.moving) / len(moves.begin):.0f} samples where"
            " friction would hold it: it lags, and does not rest between samples; give the position"
            " of the axis itself, or only every so many samples"
        )


def _falls(before: float, after: float) -> bool:
    return FALL * after**2 < before**2


def _interval(value: float, sd: float) -> Interval:
    return value - NORMAL_95 * sd, value + NORMAL_95 * sd


def _moves(u: Array, y: Array, gain: float, resolution: float) -> _Moves:
    """Return the moves of the output: changes beyond noise, one after another in one direction."""
    steps = np.diff(y)
    # an axis at rest shows the noise, and one that follows shows it beside the input
    noise = min(
        _noise(each, resolution or _digit(y)) for each in (steps, steps - gain * np.diff(u))
    )
    least = NOISE_FACTOR * noise
    sign = np.sign(steps) * (np.abs(steps) > least)
    begin = np.flatnonzero((sign != 0) & (sign != np.r_[0, sign[:-1]])) + 1
    end = np.flatnonzero((sign != 0) & (sign != np.r_[sign[1:], 0])) + 1
    way = sign[begin - 1]
    if min(np.sum(way > 0), np.sum(way < 0)) < FEWEST_MOVES:
        raise BristleError(
            f"the output begins to move {np.sum(way > 0)} times up and {np.sum(way < 0)} times"
            f" down, each by more than {least:.3g}; at least {FEWEST_MOVES} times either way are"
            " needed: give a longer record or, where it creeps, only every so many samples"
        )
    return _Moves(begin, end, way, sign != 0, float(least))


def _noise(changes: Array, step: float) -> float:
    """Return the deviation of most of the changes; where many are none, as a sensor of such a step
    leaves them: at least of half a step.
    """
    quarter = float(np.quantile(np.abs(changes), QUARTER, method="higher"))
    if quarter > 0:
        return max(quarter / float(ndtri((1 + QUARTER) / 2)), step / 2)
    none = float(np.mean(changes == 0))
    return step / 2 / min(float(ndtri((1 + none) / 2)), 1.0)


def _digit(values: Array) -> float:
    """Return the step in which values are written: 1, 2, 2.5 or 5 of a decimal digit; 0 where
    there is none.
    """
    for power in range(2, -10, -1):
        for digit in (5.0, 2.5, 2.0, 1.0):
            whole = values / (digit * 10.0**power)
            if np.abs(whole - np.round(whole)).max() < WHOLE:
                return digit * 10.0**power
    return 0.0


def _regression(rows: Array, values: Array) -> tuple[Array, Array]:
    """Return the coefficients of rows (n, k) and their deviations, by the scatter of blocks."""
    found, *_ = np.linalg.lstsq(rows, values, rcond=None)
    scores = rows * (values - rows @ found)[:, None]
    sums = np.array(
        [part.sum(axis=0) for part in np.array_split(scores, min(MOVE_BLOCKS, len(rows)))]
    )
    inverse = np.linalg.pinv(rows.T @ rows)
    return np.asarray(found), np.asarray(np.sqrt(np.diag(inverse @ (sums.T @ sums) @ inverse)))


def _static(distance: Array, moves: _Moves, unseen: float) -> tuple[float, Interval]:
    """Return the distance of the input, before each change (n,), from which on the axis moves, and
    its interval: between those at which it stayed and those at which it began to move, and as much
    wider as is not seen of them.
    """
    stayed = np.sort(np.abs(distance[~moves.moving]))
    began = np.sort(distance[moves.begin - 1] * moves.sign)
    ends = np.sort(np.r_[stayed, began])
    wrong = len(stayed) - np.searchsorted(stayed, ends, "right") + np.searchsorted(began, ends)
    best = ends[wrong == wrong.min()]
    low, high = float(best[0]), float(began[began >= best[-1]][:1].sum() or best[-1])
    return (low + high) / 2, (low - unseen, high + unseen)


def _next(u: Array, y: Array, line: tuple[float, float], bands: tuple[float, float]) -> Array:
    """Return the output at each sample but the first, predicted from the one before."""
    (k, c), (static, kinetic) = line, bands
    left = u[1:] - c - k * y[:-1]
    return np.where(np.abs(left) > static, (u[1:] - c - np.sign(left) * kinetic) / k, y[:-1])
