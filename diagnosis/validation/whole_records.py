"""After the search: the models over whole records, and their parameters refitted to these."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from bristle.common.metrics import fit_percent, rms
from bristle.diagnosis.answer import (
    Diagnosis,
    Estimate,
    HorizonError,
    RecordError,
    RecordTrace,
    WholeRecords,
)
from bristle.diagnosis.estimation.fitted_model import FittedModel, sliding_fit
from bristle.diagnosis.estimation.optimiser import refit_initial_states
from bristle.diagnosis.estimation.simulator import Servo
from bristle.diagnosis.estimation.uncertainty import refitted_estimates
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.sliding.fit import loss_at
from bristle.diagnosis.sliding.screen import GROSS_GAIN
from bristle.diagnosis.stages.case import Budget, SearchedCase
from bristle.diagnosis.validation.long_simulation import (
    Grown,
    OpenLoop,
    Records,
    general_horizon,
    open_loop,
    open_loop_servo,
    refit_growing,
)

NOT_REFITTED = Grown(0.0, False, None)


@dataclass(frozen=True)
class _Long:
    """A model over long stretches: as the segments gave it, and refitted."""

    servo: Servo
    values: Mapping[str, float]
    grown: Grown = NOT_REFITTED

    @property
    def last(self) -> Mapping[str, float]:
        """The values of the refit, if there is one."""
        return self.values if self.grown.fit is None else self.grown.fit.values

    def refitted(self, records: Records, segment: float, most: float) -> _Long:
        """Return the model refitted on horizons that grow to `most` [s], where that lowers the
        error of whole records.
        """
        new = replace(self, grown=refit_growing(self.servo, self.values, records, segment, most))
        before, after = (
            open_loop(self.servo, values, records, records.seconds).error
            for values in (self.values, new.last)
        )
        return new if after < before or (math.isfinite(after) and math.isnan(before)) else self

    def simulated(self, records: Records, seconds: float, refitted: bool = True) -> OpenLoop:
        """Return the simulation of stretches of so many seconds."""
        return open_loop(self.servo, self.last if refitted else self.values, records, seconds)

    def estimates(self, model: Model, before: Mapping[str, Estimate]) -> dict[str, Estimate]:
        """Return estimates with those of the refit in their place."""
        return (
            dict(before)
            if self.grown.fit is None
            else refitted_estimates(model, self.grown.fit, before)
        )


def refitted_to_whole_records(case: SearchedCase, answer: Diagnosis, _: Budget) -> Diagnosis:
    """Return an answer with parameters refitted to whole records, if that generalises, and the
    errors over these.

    Verdict, names and gap stay those of the segments.
    """
    return _over_whole_records(case, answer, refit=True)


def as_fitted_to_segments(case: SearchedCase, answer: Diagnosis, _: Budget) -> Diagnosis:
    """Return an answer with the errors over whole records, parameters as the segments gave them."""
    return _over_whole_records(case, answer, refit=False)


def _over_whole_records(case: SearchedCase, answer: Diagnosis, refit: bool) -> Diagnosis:
    times, segment = case.final.fit.simulator.segments.times, case.dataset.segments.seconds
    records = Records.of(case.dataset, case.records, times)
    # both models, which are one where no effect is named
    after = _Long(open_loop_servo(case.final.servo), _values(case.final.fit.values, answer.fitted))
    before = after
    if case.final is not case.base:
        before = _Long(open_loop_servo(case.base.servo), _values(case.base.fit.values, answer.base))
    same = before is after
    # their refit, the model before the search only where the one after it is refitted
    most = general_horizon(after.servo, after.values, records, segment) if refit else 0.0
    contradicted = False
    if most > 0:
        after = after.refitted(records, segment, most)
        contradicted = after.grown.fit is not None and _is_contradicted(case, after)
        after = replace(after, grown=NOT_REFITTED) if contradicted else after
        if same:
            before = after
        elif after.grown.fit is not None:
            before = before.refitted(records, segment, most)
    fitted = after.estimates(case.model, answer.fitted)
    whole = _whole_records(case, records, before, after, answer.fitted)
    return replace(
        answer,
        base=before.estimates(case.model, answer.base),
        fitted=fitted,
        effects=tuple(effect.with_estimates(fitted) for effect in answer.effects),
        whole=replace(whole, tried=refit, contradicted=contradicted),
    )


def _is_contradicted(case: SearchedCase, refitted: _Long) -> bool:
    """Return whether the motion that slides contradicts refitted parameters: over long times a slow
    disturbance adds up to a drift, which an inertia may follow. Of a servo that is given a goal the
    segments show more than that motion: those decide.
    """
    if case.model.controller is not None:
        return _loss_of_segments(case.final, refitted.last) > GROSS_GAIN
    slides = sliding_fit(case.dataset, case.final.servo, refitted.values)
    return slides is not None and loss_at(slides, refitted.last) > GROSS_GAIN


def _loss_of_segments(final: FittedModel, values: Mapping[str, float]) -> float:
    """Return how much less likely the segments are with other values than as fitted [nats]."""
    own = final.fit.values
    moved = final.fit.at(values={name: values.get(name, x) for name, x in own.items()})
    fitted, others = (refit_initial_states(final.problem, each) for each in (final.fit, moved))
    return fitted.total - others.total


def _values(fitted: Mapping[str, float], estimates: Mapping[str, Estimate]) -> dict[str, float]:
    """Return the parameters of a fit, those that were refitted to all segments in their place."""
    return {**fitted, **{name: e.value for name, e in estimates.items()}}


def _whole_records(
    case: SearchedCase,
    records: Records,
    before: _Long,
    after: _Long,
    segment_parameters: Mapping[str, Estimate],
) -> WholeRecords:
    segment, refitted = case.dataset.segments.seconds, after.grown.fit is not None
    lengths = [segment, *records.horizons(segment)]
    # each length simulated before and after, and after as the segments gave the parameters
    new = [after.simulated(records, seconds) for seconds in lengths]
    old = new if before is after else [before.simulated(records, seconds) for seconds in lengths]
    usual = (
        [after.simulated(records, seconds, refitted=False) for seconds in lengths]
        if refitted
        else new
    )
    curve = zip(lengths, old, usual, new, strict=True)
    horizons = tuple(
        HorizonError(seconds, *(each.error for each in three)) for seconds, *three in curve
    )
    # the longest one, record by record
    times = {given.name: given.time for given in case.records}
    whole = zip(records.all, new[-1].measured, old[-1].simulated, new[-1].simulated, strict=True)
    rows, traces = [], []
    for r, y, first, last in whole:
        n, unit = len(y), case.model.output_unit
        fits = fit_percent(y, first), fit_percent(y, last)
        rows.append(RecordError(r.name, unit, rms(y - first), rms(y - last), *fits))
        seen = y, first, last, np.zeros(n, dtype=bool)
        traces.append(RecordTrace(r.name, times[r.name][:n], r.u[:n], *seen))
    grown = after.grown
    return WholeRecords(
        tuple(rows), horizons, grown.seconds, grown.whole, dict(segment_parameters), tuple(traces)
    )
