"""Simulations over long stretches of records, up to whole ones: their error, and parameters
refitted to them.

A model that is fitted to short segments may drift away over a whole record: a segment hardly shows
what acts slowly. Fitted to the output error of whole records from the start, a fit may end far from
the optimum, or not find one. So the horizon grows, each fit beginning where the last one ended, as
far as the simulation stays with the records.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bristle.common.metrics import rms
from bristle.common.table import Array
from bristle.diagnosis.estimation.dataset import (
    STATE_SMOOTHING,
    Dataset,
    Grid,
    Piece,
    Segments,
    cut,
)
from bristle.diagnosis.estimation.initial_states import refine_initial_states
from bristle.diagnosis.estimation.likelihood import Fit, FitPoint, Problem, evaluate
from bristle.diagnosis.estimation.noise import white_noise
from bristle.diagnosis.estimation.optimiser import refit
from bristle.diagnosis.estimation.simulator import (
    OWN_BRISTLES,
    Servo,
)
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects
from bristle.records.record import Record

LONG_BINS = 500  # averages of a stretch at most
GROWTH = 4.0  # ratio of a horizon to the one before
# a horizon that is this close to the longest record's length is left out before that
WHOLE_RATIO = 1.5
ERROR_PASSES = 3  # fits to a horizon, each with the error of the one before as its noise
ERROR_FALL = 0.98  # ratio of the error to the one before from which on these fits end
START_STEPS = 2  # steps of the starts of stretches where no parameter is fitted
# factor by which the squared error falls in records that took no part in a refit, for it to be kept
GENERALISES = 1.2


@dataclass(frozen=True)
class Records:
    """Records of one sampling period, and the least noise of the sensor [unit of the output]."""

    all: tuple[Record, ...]
    velocity: bool
    resolution: float
    least: float

    @classmethod
    def of(cls, dataset: Dataset, records: Sequence[Record], times: Sequence[float]) -> Records:
        """Return those of the records that a dataset holds, with these times of their first samples
        [s] (see `Segments.clocks`).
        """
        shifts = {
            piece.name: time - piece.time
            for piece, time in zip(dataset.segments.pieces, times, strict=True)
        }
        kept = tuple(replace(r, time=r.time + shifts[r.name]) for r in records if r.name in shifts)
        return cls(kept, dataset.segments.velocity, dataset.resolution, dataset.least_sd)

    @property
    def seconds(self) -> float:
        """Length of the longest record [s]."""
        return max(len(r) * r.h for r in self.all)

    @property
    def samples(self) -> int:
        """Length of the longest record."""
        return max(map(len, self.all))

    def head(self, samples: int) -> Records:
        """Return the first samples of each record."""
        return replace(self, all=tuple(r.part(slice(samples)) for r in self.all))

    def halves(self) -> tuple[Records, Records]:
        """Return every second record and the others or, of a single record, its two halves."""
        if len(self.all) > 1:
            return replace(self, all=self.all[::2]), replace(self, all=self.all[1::2])
        middle = len(self.all[0]) // 2
        return replace(self, all=(self.all[0].part(slice(middle)),)), replace(
            self, all=(self.all[0].part(slice(middle, None)),)
        )

    def horizons(self, segment: float) -> list[float]:
        """Return growing horizons, from above a segment's length [s] to the longest record's."""
        lengths, longest = [], self.seconds
        while WHOLE_RATIO * GROWTH * segment < longest:
            segment *= GROWTH
            lengths.append(segment)
        return [*lengths, longest]

    def stretches(self, seconds: float, bins: int = LONG_BINS) -> Segments:
        """Return the records cut into stretches of so many seconds or, if they are shorter, whole
        ones, of at most `bins` averages.

        A stretch is simulated from its start to its end; averages beyond the end of a record are
        NaN.
        """
        h = self.all[0].h
        length = min(max(2, round(seconds / h)), self.samples)
        width = -(-length // bins)
        grid = Grid(h, width, -(-length // width), self.velocity)
        pieces = tuple(_stretches_of(r, grid, self.resolution) for r in self.all)
        return Segments(h, width, grid.bins, self.velocity, pieces)


def _stretches_of(record: Record, grid: Grid, resolution: float) -> Piece:
    length = grid.bins * grid.width
    n = max(1, round(len(record) / length))
    more = max(0, n * length - len(record))
    u, y = (
        np.pad(record.u, (0, more))[: n * length],
        np.pad(record.y, (0, more), mode="edge")[: n * length],
    )
    known = {name: np.pad(x, (0, more), mode="edge") for name, x in record.known.items()}
    piece = cut(record.name, float(record.time[0]), u, y, grid, resolution).beside(known)
    # a smoothed velocity is that of the middle of its window, which the start of a record is not
    if not grid.velocity:
        window = record.h * np.arange(
            min(1 + 2 * max(2, round(STATE_SMOOTHING / record.h)), len(record))
        )
        piece.initial[0] = np.polynomial.polynomial.polyfit(window, record.y[: len(window)], 2)[:2]
    ends = grid.width * (1 + np.arange(piece.measured.size)).reshape(piece.measured.shape)
    return replace(piece, measured=np.where(ends <= len(record), piece.measured, np.nan))


# -- simulation ------------------------------------------------------------------------------------
def open_loop_servo(servo: Servo) -> Servo:
    """Return a servo with what long simulations determine free: its own parameters, and the
    strength of each effect.

    The form of an effect (where, how often, when it acts) shows within segments, and a long
    simulation has many optima in it. Bristles that stand for nothing but the sensor's step are left
    out.
    """
    strengths = {find_effect(name).strength.name for name in servo.effects}
    free = tuple(
        f for f in servo.free if f.name in strengths or f.name.split(".")[0] not in all_effects()
    )
    return replace(servo, free=free, rigid=servo.rigid and OWN_BRISTLES in servo.effects)


def open_loop_problem(segments: Segments, error: float) -> Problem:
    """Return the problem of plain output errors of so much rms; a stretch is an outlier only with
    more than tenfold squares.

    The error of a long simulation grows from its start on, where it is 0 only because it begins
    there. The position at the start is a nuisance therefore, and known no better than any other.
    """
    # so wide, the squares of a whole stretch count as one of a normal error
    wide = error * math.sqrt(segments.bins)
    deviation = segments.initial_sd
    deviation[:, 0] = np.maximum(deviation[:, 0], wide)
    everything = np.ones(len(deviation), dtype=bool)
    return replace(
        Problem.of(segments, white_noise(segments.bins, wide), everything), initial_sd=deviation
    )


def fitted_error(fit: Fit) -> float:
    """Return the rms error over all stretches [unit of the output]; infinite if one failed."""
    known = np.isfinite(fit.simulator.segments.measured)
    return rms(fit.residual[known]) if fit.good.all() else math.inf


def with_fitted_starts(
    servo: Servo, values: Mapping[str, float], segments: Segments, least: float
) -> Fit:
    """Return the simulation of stretches with given parameters, their starts fitted; `least`: error
    that counts as none.
    """
    point = FitPoint(servo.simulator(segments), (), dict(values), segments.initial)
    simulated, _, good, _ = point.simulator.run(values, segments.initial)
    error = (segments.measured - simulated)[good]
    size = rms(error[np.isfinite(error)])
    problem = open_loop_problem(segments, size if size > least else least)
    return refine_initial_states(problem, evaluate(problem, point), START_STEPS)


@dataclass(frozen=True)
class OpenLoop:
    """Whole records simulated from their start to their end: measured and simulated output of each,
    arrays (n,).
    """

    measured: tuple[Array, ...]
    simulated: tuple[Array, ...]  # NaN where the simulation failed

    @property
    def error(self) -> float:
        """The rms error over all records; NaN if the simulation of one failed."""
        return rms(
            np.concatenate(
                [y - seen for y, seen in zip(self.measured, self.simulated, strict=True)]
            )
        )


def open_loop(
    servo: Servo, values: Mapping[str, float], records: Records, seconds: float
) -> OpenLoop:
    """Return the outputs of a servo, sample by sample, that begins anew after so many seconds;
    starts are fitted.
    """
    fit = with_fitted_starts(servo, values, records.stretches(seconds), records.least)
    s = fit.simulator.segments
    return _begun_at(servo, values, records, s.seconds, fit.initial)


def open_loop_after(
    servo: Servo, values: Mapping[str, float], records: Records, samples: int
) -> OpenLoop:
    """Return the outputs of a servo over whole records, their starts fitted to the first `samples`
    alone.
    """
    head = records.head(samples)
    fit = with_fitted_starts(servo, values, head.stretches(head.seconds), records.least)
    return _begun_at(servo, values, records, records.seconds, fit.initial)


def _begun_at(
    servo: Servo, values: Mapping[str, float], records: Records, seconds: float, starts: Array
) -> OpenLoop:
    fine = records.stretches(seconds, records.samples)
    simulated, _, good, _ = servo.simulator(fine).run(values, starts)
    return split(records, np.where(good[:, None], simulated, np.nan))


def split(records: Records, simulated: Array) -> OpenLoop:
    """Return outputs of stretches (stretches, samples) as those of the records they are from."""
    length = simulated.shape[1]
    parts = np.split(
        simulated, np.cumsum([max(1, round(len(r) / length)) for r in records.all])[:-1]
    )
    pairs = [(r.y[: p.size], p.ravel()[: len(r)]) for r, p in zip(records.all, parts, strict=True)]
    return OpenLoop(tuple(y for y, _ in pairs), tuple(seen for _, seen in pairs))


# -- refit -----------------------------------------------------------------------------------------
def refit_horizon(
    servo: Servo, values: Mapping[str, float], segments: Segments, least: float
) -> Fit | None:
    """Return the fit of parameters and starts to plain output errors; None if it does not stay with
    the records all the while.
    """
    fit = with_fitted_starts(servo, values, segments, least)
    error = first = fitted_error(fit)
    for _ in range(ERROR_PASSES if stays(fit) else 0):
        problem = open_loop_problem(segments, max(error, least))
        fit = refit(problem, FitPoint(fit.simulator, servo.free, fit.values, fit.initial))
        before, error = error, fitted_error(fit)
        if not error < ERROR_FALL * before:
            break
    return fit if stays(fit) and error <= first else None


def stays(fit: Fit) -> bool:
    """True if a simulation stays with the records: it is closer to each stretch, on the whole, than
    the stretch's mean is.
    """
    measured = fit.simulator.segments.measured
    known = np.isfinite(measured)
    apart = measured - np.nanmean(measured, axis=1, keepdims=True)
    return fitted_error(fit) < rms(apart[known])


@dataclass(frozen=True)
class Grown:
    """A fit to the longest horizon that the simulation stayed with; None if there is none."""

    seconds: float  # the horizon; 0 where there is none
    whole: bool  # whether that is the longest record
    fit: Fit | None


def refit_growing(
    servo: Servo,
    values: Mapping[str, float],
    records: Records,
    segment: float,
    most: float = math.inf,
) -> Grown:
    """Refit parameters on horizons that grow from a segment to `most` [s], as far as the simulation
    stays with the records.
    """
    horizons = records.horizons(segment)
    grown = Grown(0.0, False, None)
    for seconds in horizons:
        fit = (
            refit_horizon(servo, values, records.stretches(seconds), records.least)
            if seconds <= most
            else None
        )
        if fit is None:
            break
        grown, values = Grown(seconds, seconds == horizons[-1], fit), fit.values
    return grown


def general_horizon(
    servo: Servo, values: Mapping[str, float], records: Records, segment: float
) -> float:
    """Return the horizon [s] up to which refits to one half of the records lower the error in the
    other half, both ways.

    It is infinite if they do so up to the longest one, 0 if they never do. In the long run random
    disturbances add up to a drift, which a refit follows as well as it can; only what it gains
    where it was not fitted is due to the model, and that shows at every horizon. Source: stone1974
    (cross-validation).
    """
    halves, longest = records.halves(), 0.0
    known = [values, values]
    for lengths in zip(*(half.horizons(segment) for half in halves), strict=False):
        for k, seconds in enumerate(lengths):
            fit = refit_horizon(servo, known[k], halves[k].stretches(seconds), records.least)
            if fit is None:
                return longest
            known[k], stretches = fit.values, halves[1 - k].stretches(seconds)
            before, after = (
                fitted_error(with_fitted_starts(servo, each, stretches, records.least))
                for each in (values, fit.values)
            )
            if not (GENERALISES * after**2 <= before**2 and math.isfinite(after)):
                return longest
        longest = min(lengths)
    return math.inf
