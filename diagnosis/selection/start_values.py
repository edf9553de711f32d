"""Start values of effects: from the residual, from the sliding motion, from the nominal model."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, TypeVar

from bristle.common.progress import Progress
from bristle.diagnosis.estimation.dataset import Dataset
from bristle.diagnosis.estimation.fitted_model import (
    FittedModel,
    fits_poorly,
    has_diverged,
    reduced_friction_start,
    sliding_fit,
    under_own_noise,
)
from bristle.diagnosis.estimation.likelihood import Fit, FitPoint, Problem, evaluate
from bristle.diagnosis.estimation.simulator import (
    BRISTLE_EFFECTS,
    OWN_BRISTLES,
)
from bristle.diagnosis.localisation.residual_response import ResidualResponse
from bristle.diagnosis.sliding.fit import SlidingFit, climb
from bristle.diagnosis.sliding.screen import (
    Start,
    dry_friction,
    likeliest_beside,
    sliding_evidence,
)
from bristle.plant.effect import Evidence
from bristle.plant.effects import effect as find_effect

T = TypeVar("T")
S = TypeVar("S")
# times the linear estimate of an effect's first parameter, tried where the model fits poorly
STRENGTH_FACTORS = (1.0, 1.6)


class JointStart(NamedTuple):
    """Start values of a model and an effect: `values` by full names, and those of the effect's free
    parameters.
    """

    values: Mapping[str, float]
    own: Start


@dataclass(frozen=True)
class SearchOptions:
    """What a caller may set for a search.

    Attributes
    ----------
    progress : function
        Called with an effect's name and the fraction of the round that is done.
    start_values : mapping of effect to a sequence of start values
        Tried before those that are derived from the records.
    exhaustive : collection of str
        Effects that are refitted from all their start values in each round.
    test_input_hold : bool
        If false, the input is taken as held between samples.
    jobs : int
        Effects that are tried at a time; 0 for one on each core. The answer is the same for any
        number.
    budget : float
        Seconds for the whole diagnosis, about; once most of them are gone no further effect is
        tried, those under way are left, and the answer says so.
    guess : mapping of str to float
        Parameters of the model before any fit; where one ends far from it, effects are also fitted
        from there.
    joint : mapping of str to a mapping of str to float
        Parameters of the model with an effect, by full names, from which that effect is tried too.
    deadline : float
        Until when effects are tried [s, of `time.perf_counter`]; a diagnosis sets it from the
        budget.
    """

    progress: Progress = lambda text, fraction: None
    start_values: Mapping[str, Sequence[Start]] = field(default_factory=dict)
    exhaustive: Collection[str] = ()
    test_input_hold: bool = True
    jobs: int = 0
    budget: float = math.inf
    guess: Mapping[str, float] = field(default_factory=dict)
    joint: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    deadline: float = math.inf

    @property
    def late(self) -> bool:
        """True once no further effect is to be tried."""
        return time.perf_counter() > self.deadline

    def map(self, function: Callable[[T], S], items: Iterable[T]) -> list[S]:
        """Return the results of a function, in the order of the items; simulations run outside the
        interpreter's lock.
        """
        own = copy_context()  # with the deadline
        with ThreadPoolExecutor(self.jobs or os.cpu_count() or 1, "effects") as pool:
            return list(pool.map(lambda item: own.copy().run(function, item), items))


@dataclass(frozen=True)
class SearchContext:
    """The fitted model on top of which effects are tried, the records, and what all candidates of a
    round share.
    """

    dataset: Dataset
    fitted: FittedModel
    options: SearchOptions = SearchOptions()

    @property
    def fit(self) -> Fit:
        """Fit of the model without any of the candidates."""
        return self.fitted.fit

    def prepare(self) -> None:
        """Compute what all candidates share, before they are tried side by side."""
        _ = self.evidence, self.joint_starts

    @cached_property
    def response(self) -> ResidualResponse:
        """Response of the model's residual."""
        return ResidualResponse(self.fitted, self.dataset)

    @cached_property
    def fits_poorly(self) -> bool:
        """True if the error is so large that noise and start values of the model alone mislead."""
        return fits_poorly(self.dataset, self.fit)

    @cached_property
    def slides(self) -> SlidingFit | None:
        """The model fitted to where the records slide; None where that does not show it."""
        return sliding_fit(self.dataset, self.fitted.servo, self.fit.values)

    @cached_property
    def evidence(self) -> Evidence:
        """What effects derive their start values from."""
        return evidence_of(self.dataset, self.fit, self.response)

    @cached_property
    def joint_starts(self) -> Callable[[str], Sequence[JointStart]]:
        """Function of an effect's name that returns start values of effect and model together: the
        options', and others if the model fits poorly.
        """
        usual = (
            joint_starts_of(self, has_diverged(self.dataset, self.fit))
            if self.fits_poorly
            else lambda name: ()
        )
        given = {
            name: JointStart(values, _of(name, values))
            for name, values in self.options.joint.items()
        }
        return lambda name: [*usual(name), *([given[name]] if name in given else [])]

    def clocks(self, name: str) -> list[tuple[float, ...]]:
        """Return the times of the first samples of the records with which an effect is tried, as of
        `Segments.timed`.

        An effect in the model that depends on time has settled them.
        """
        settled = any(find_effect(other).timing for other in self.fitted.servo.effects)
        return (
            [self.fit.simulator.segments.times]
            if settled
            else self.dataset.segments.clocks(find_effect(name).timing)
        )

    def evidence_at(self, times: tuple[float, ...]) -> Evidence:
        """Return what effects derive start values from, with these times of the first samples."""
        return replace(self.evidence, time=self.dataset.time_at(times))

    def start_values(self, name: str, evidence: Evidence) -> list[Start]:
        """Return start values of an effect: the options' and those derived from evidence."""
        derive = find_effect(name).starts
        assert derive is not None
        return [*self.options.start_values.get(name, ()), *derive(evidence)]

    def own_noise(self, fit: Fit) -> Problem:
        """Return the problem under the noise of a fit's residual."""
        return under_own_noise(self.dataset, fit)

    def screening_noise(self, fit: Fit) -> Problem:
        """Return the problem under which start values are compared: with the noise of the fit if
        the model fits poorly.

        Its own noise would then absorb a missing effect, most of all one that changes slowly.
        """
        return self.own_noise(fit) if self.fits_poorly and fit.weight.any() else self.fitted.problem


def evidence_of(dataset: Dataset, fit: Fit, response: ResidualResponse) -> Evidence:
    """Return what effects derive their start values from, given the residual of a fit."""
    m, values = dataset.motion, fit.values
    return Evidence(
        m.theta,
        m.v * m.moving,
        m.a,
        m.u,
        m.time,
        fit.simulator.segments.h,
        dataset.resolution,
        values["J"],
        dry_friction(fit.free, values, m.u),
        values["b"],
        response.regress,
        dataset.turn,
    )


def bristle_starts(fitted: FittedModel, name: str) -> list[Start]:
    """Return the bristles of a rigid friction law as start values of an effect that replaces them.

    They have been fitted to make up for the missing effect, so that they are closer than start
    values from the residual.
    """
    if name not in BRISTLE_EFFECTS or not fitted.servo.rigid:
        return []
    own = [p.name.removeprefix(f"{name}.") for p in find_effect(name).parameters]
    return [{short: fitted.fit.values[f"{OWN_BRISTLES}.{short}"] for short in own}]


def _of(name: str, values: Mapping[str, float]) -> Start:
    """Return the parameters of an effect, by their short names."""
    return {k.removeprefix(f"{name}."): x for k, x in values.items() if k.startswith(f"{name}.")}


# -- together with the model -----------------------------------------------------------------------
def joint_starts_of(
    context: SearchContext, diverged: bool
) -> Callable[[str], Sequence[JointStart]]:
    """Return the function that gives start values of an effect together with those of a model that
    fits poorly.

    They come from the sliding motion or, where that does not show the model, from the nominal one,
    since the fitted parameters make up for the missing effect. If the model has `diverged`, starts
    with less dry friction are added.
    """
    fitted, slides = context.fitted, context.slides
    usual = (
        (lambda name: sliding_starts(context, slides, name)) if slides else _nominal_starts(context)
    )
    less = reduced_friction_start(fitted)
    if not (less and diverged):
        return usual
    return lambda name: [
        *usual(name),
        *_joined(less, name, context.start_values(name, context.evidence)),
    ]


def _nominal_starts(context: SearchContext) -> Callable[[str], list[JointStart]]:
    """Return the function that gives start values of an effect together with the nominal model."""
    fitted, dataset = context.fitted, context.dataset
    nominal = {f.name: f.nominal_value for f in fitted.servo.free if f.nominal is not None}
    point = FitPoint(
        fitted.fit.simulator, (), {**fitted.fit.values, **nominal}, fitted.problem.initial
    )
    fit = evaluate(fitted.problem, point)
    evidence = evidence_of(dataset, fit, ResidualResponse(replace(fitted, fit=fit), dataset))

    def starts(name: str) -> list[JointStart]:
        first = find_effect(name).strength.name.removeprefix(f"{name}.")
        known = [start for start in context.start_values(name, evidence) if first in start]
        return _joined(
            nominal,
            name,
            [{**start, first: x * start[first]} for start in known for x in STRENGTH_FACTORS],
        )

    return starts


def _joined(values: Mapping[str, float], name: str, starts: Sequence[Start]) -> list[JointStart]:
    """Return start values of an effect, each together with values of the model."""
    return [
        JointStart({**values, **{f"{name}.{k}": v for k, v in start.items()}}, start)
        for start in starts
    ]


def sliding_starts(context: SearchContext, slides: SlidingFit, name: str) -> list[JointStart]:
    """Return the parameters with which an effect explains most of the sliding motion; none if that
    does not show it.
    """
    starts = context.start_values(name, sliding_evidence(slides, context.dataset.turn))
    found = likeliest_beside(slides, name, starts, context.fitted.servo.limits)
    if found is None:
        return []
    best, start = climb(found[0]), found[1]
    return [JointStart(best.free_values, {key: best.values[f"{name}.{key}"] for key in start})]
