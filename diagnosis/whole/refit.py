"""After the search: the models before and after it over whole records, and their parameters
refitted to these.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from bristle.common.metrics import fit_percent, rms
from bristle.diagnosis.conclusion import Case, Conclusion
from bristle.diagnosis.estimation.simulator import Servo
from bristle.diagnosis.estimation.uncertainty import refitted_estimates
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.report import result as answer
from bristle.diagnosis.whole.open_loop import (
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

    def estimates(
        self, model: Model, before: Mapping[str, answer.Estimate]
    ) -> dict[str, answer.Estimate]:
        """Return estimates with those of the refit in their place."""
        return (
            dict(before)
            if self.grown.fit is None
            else refitted_estimates(model, self.grown.fit, before)
        )


def refit_to_whole_records(
    case: Case, found: Conclusion, refit: bool = True
) -> tuple[Conclusion, answer.WholeRecords]:
    """Return a conclusion with parameters refitted to whole records, if that is wanted and
    generalises, and the errors over these.

    Verdict, names and gap stay those of the segments.
    """
    times, segment = found.final.fit.simulator.segments.times, case.dataset.segments.seconds
    records = Records.of(case.dataset, case.records, times)
    after = _Long(
        open_loop_servo(found.final.servo), _values(found.final.fit.values, found.parameters)
    )
    before = after
    if found.final is not case.base:
        before = _Long(open_loop_servo(case.base.servo), _values(case.base.fit.values, found.base))
    same = before is after
    most = general_horizon(after.servo, after.values, records, segment) if refit else 0.0
    if most > 0:
        after = after.refitted(records, segment, most)
        before = (
            after
            if same
            else before.refitted(records, segment, most)
            if after.grown.fit is not None
            else before
        )
    parameters = after.estimates(case.model, found.parameters)
    effects = tuple(
        replace(
            e,
            parameters={
                key: parameters.get(f"{e.name}.{key}", old) for key, old in e.parameters.items()
            },
        )
        for e in found.effects
    )
    whole = replace(_whole_records(case, records, before, after, found.parameters), tried=refit)
    return replace(
        found, base=before.estimates(case.model, found.base), parameters=parameters, effects=effects
    ), whole


def _values(
    fitted: Mapping[str, float], estimates: Mapping[str, answer.Estimate]
) -> dict[str, float]:
    """Return the parameters of a fit, those that were refitted to all segments in their place."""
    return {**fitted, **{name: e.value for name, e in estimates.items()}}


def _whole_records(
    case: Case,
    records: Records,
    before: _Long,
    after: _Long,
    segment_parameters: Mapping[str, answer.Estimate],
) -> answer.WholeRecords:
    segment, refitted = case.dataset.segments.seconds, after.grown.fit is not None
    lengths = [segment, *records.horizons(segment)]
    new = [after.simulated(records, seconds) for seconds in lengths]
    old = new if before is after else [before.simulated(records, seconds) for seconds in lengths]
    usual = (
        [after.simulated(records, seconds, refitted=False) for seconds in lengths]
        if refitted
        else new
    )
    curve = zip(lengths, old, usual, new, strict=True)
    horizons = tuple(
        answer.HorizonError(seconds, *(each.error for each in three)) for seconds, *three in curve
    )
    whole = zip(records.all, new[-1].measured, old[-1].simulated, new[-1].simulated, strict=True)
    rows, traces = [], []
    for r, y, first, last in whole:
        fits = fit_percent(y, first), fit_percent(y, last)
        rows.append(
            answer.RecordError(r.name, case.model.output_unit, rms(y - first), rms(y - last), *fits)
        )
        time = next(given.time for given in case.records if given.name == r.name)
        traces.append(
            answer.Trace(
                r.name, time[: len(y)], r.u[: len(y)], y, first, last, np.zeros(len(y), dtype=bool)
            )
        )
    grown = after.grown
    return answer.WholeRecords(
        tuple(rows), horizons, grown.seconds, grown.whole, dict(segment_parameters), tuple(traces)
    )
