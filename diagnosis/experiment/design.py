"""Choose the input of a further record, or the reference of its loop, to tell apart effects that
these records do not.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from bristle.common.metrics import rms
from bristle.common.table import Array, factor_to
from bristle.diagnosis.answer import DesignedInput, Diagnosis, Finding
from bristle.diagnosis.checks.excitation import excitation
from bristle.diagnosis.estimation.fitted_model import TIE_NATS, sliding_fit
from bristle.diagnosis.experiment.discrimination import Response, Rival, Setup, lead
from bristle.diagnosis.experiment.inputs import Axis, Input, Limits, inputs
from bristle.diagnosis.experiment.references import references
from bristle.diagnosis.selection.criterion import TrialRound, group
from bristle.diagnosis.selection.start_values import SearchOptions
from bristle.diagnosis.sliding.loop import Loop, loop_of
from bristle.diagnosis.sliding.screen import dry_friction
from bristle.diagnosis.stages.case import Budget, SearchedCase
from bristle.plant.known import KNOWN
from bristle.records.headings import without_unit
from bristle.records.layout import Column, Layout

EXPERIMENT_SECONDS = 20.0  # s: length of the record
MOST_RIVALS = 4  # models that an input is to tell apart at most
# of the effects that were tried, if none was above chance: those that are told from no effect
CLOSEST = 2
MARGIN = 0.05  # of the range that was travelled: distance from its ends that a motion is to keep
DISTURBANCES = 2  # disturbances under which each model is to keep it
PEAK_QUANTILE = 0.99  # of the accelerations of the records: what noise does not reach
REFERENCE = "reference"  # column of the file where a loop follows it
OWN_DRAWS = 3  # of the parameters of each model, which tell how far a model leads itself


@dataclass(frozen=True)
class _Design:
    """What an input is chosen for: rivals, limits, and how it will be recorded."""

    rivals: tuple[Rival, ...]
    limits: Limits
    setup: Setup

    @property
    def pairs(self) -> list[tuple[Rival, Rival]]:
        """Pairs to be told apart, both ways: those of different classes, if there are several."""
        pairs = list(permutations(self.rivals, 2))
        apart = [(a, b) for a, b in pairs if _class_of(a) != _class_of(b)]
        return apart or pairs

    def responses(self, given: Array) -> list[Response] | None:
        """Return the responses of the rivals; None if an input or motion leaves its limits."""
        found = []
        for rival in self.rivals:
            seen = rival.response(given, self.setup)
            if seen is None or not self.limits.allow_input(seen.u) or not self._kept([seen]):
                return None
            shaken = rival.disturbed(given, self.setup, DISTURBANCES)
            if shaken is None or not self._kept(shaken):
                return None
            found.append(seen)
        return found

    def _kept(self, responses: Sequence[Response]) -> bool:
        """True if the motion of all keeps to the limits."""
        return all(
            self.limits.allow_motion(self.setup.positions(each.y), MARGIN) for each in responses
        )

    def follow(self, at: float, u: Array) -> float:
        """Return where the last rival is after an input (n,) that begins at rest at a position."""
        seen = self.rivals[-1].response(u, replace(self.setup, start=at))
        return at if seen is None else float(self.setup.positions(seen.y)[-1])

    def tried(self, given: Input) -> _Trial | None:
        """Return the first scale of an input that keeps to the limits, and its gain before what a
        rival leads itself by, or None.
        """
        for one in given.scaled:
            responses = self.responses(one)
            if responses is not None:
                of = dict(zip((rival.name for rival in self.rivals), responses, strict=True))
                gain = min(lead(of[a.name], b, self.setup) for a, b in self.pairs)
                return _Trial(given.motion, one, tuple(responses), gain)
        return None

    def best_of(self, trials: Sequence[_Trial], case: SearchedCase) -> _Trial | None:
        """Return the trial that gains most, if possible of those after which a name may follow."""
        best, allowed = None, False
        for trial in sorted(trials, key=lambda each: -each.gain):
            # what a rival leads itself by makes no gain larger
            if best and trial.gain <= (best.gain if allowed else max(best.gain, TIE_NATS)):
                break
            net = self.beyond_own_lead(trial)
            allows = net.allows_a_name(case)
            if best is None or (allows, net.gain) > (allowed, best.gain):
                best, allowed = net, allows
        return best

    def beyond_own_lead(self, trial: _Trial) -> _Trial:
        """Return a trial with what its gain is beyond that of a rival over itself."""
        return replace(trial, gain=max(trial.gain - self.own_lead(trial.given), 0.0))

    def own_lead(self, given: Array) -> float:
        """Return by how much a rival leads itself with other values that the records allow: what no
        difference of models is.
        """
        rng = np.random.default_rng(0)
        others = [
            (rival, rival.response(given, self.setup, rival.drawn(rng)))
            for rival in self.rivals
            for _ in range(OWN_DRAWS)
        ]
        return max(
            (lead(seen, rival, self.setup) for rival, seen in others if seen is not None),
            default=0.0,
        )


@dataclass(frozen=True)
class _Trial:
    """An input or a reference with the responses of the rivals and its gain [nats]."""

    motion: Finding
    given: Array
    responses: tuple[Response, ...]
    gain: float

    def allows_a_name(self, case: SearchedCase) -> bool:
        """True if it decides, and a name may follow from all records then."""
        some, h, seen = case.records[0], case.dataset.segments.h, self.responses[0]
        time = np.asarray(h * np.arange(len(seen.u)), dtype=np.float64)
        record = replace(some, time=time, u=seen.u, y=seen.y, velocity=None, known={})
        return self.gain > TIE_NATS and not excitation(case.model, [*case.records, record]).uniform


def _class_of(rival: Rival) -> str:
    return group(rival.name) if rival.name else ""


def designed_experiment(case: SearchedCase, answer: Diagnosis, budget: Budget) -> Diagnosis:
    """Return an answer with the input of a record that would tell apart what it leaves open."""
    return replace(answer, designed=design(case, answer, budget.options))


def design(case: SearchedCase, answer: Diagnosis, options: SearchOptions) -> DesignedInput | None:
    """Return the input that tells apart what an answer leaves open by most, or None if it leaves
    nothing open.

    It keeps to the input, its rms and the positions of the records, also under disturbances as
    large as theirs.
    """
    rivals = tuple(rivals_of(case, answer))
    # nobody knows what the rest of an arm does in a new motion
    if len(rivals) < 2 or KNOWN.name in case.model.effects:
        return None
    # what the records keep to
    s, m = case.dataset.segments, case.dataset.motion
    n = s.bins * s.width * max(3, round(EXPERIMENT_SECONDS / s.seconds))
    positions = (float(m.theta.min()), float(m.theta.max()))
    usual = Limits(
        (float(m.u.min()), float(m.u.max())), positions, max(rms(piece.u) for piece in s.pieces)
    )
    start = 0.0 if s.velocity else usual.middle
    ends = max(piece.time + s.h * len(piece.u) for piece in s.pieces)
    loop = _loop(case)
    plan = _Design(rivals, usual, Setup(s, case.dataset.resolution, start, ends, loop, usual.u))
    # the best of all inputs that keep to it, if possible one after which a name may follow
    if loop is None:
        recorded, axis = [piece.u for piece in s.pieces], _axis(rivals[0], m.u)
        choice = inputs(axis, usual, recorded, (n, s.h), plan.follow)
    else:
        motions = [m.theta[m.record == k] for k in range(len(s.pieces))]
        peaks = float(np.abs(m.v).max()), float(np.quantile(np.abs(m.a), PEAK_QUANTILE))
        choice = references(usual, motions, peaks, (n, s.h))
    trials = [trial for trial in options.map(plan.tried, choice) if trial is not None]
    return _described(plan, case, plan.best_of(trials, case))


def _loop(case: SearchedCase) -> Loop | None:
    """Return the position loop that the records were made in, if they show one."""
    slides = sliding_fit(case.dataset, case.base.servo, case.base.fit.values)
    return None if slides is None else loop_of(slides)


def _axis(rival: Rival, u: Array) -> Axis:
    values = rival.fit.values
    friction = dry_friction(rival.fit.free, values, u)
    return Axis(values["J"], values.get("a2", 0.0), friction, values["b"])


def rivals_of(case: SearchedCase, answer: Diagnosis) -> Iterator[Rival]:
    """Give the models that explain the records alike: the members of a tie or class, or those next
    to no effect at all.
    """
    if answer.corrections or answer.verdict == "none":
        return
    deciding, undecided = _deciding_round(case, answer), case.rounds[-1].said.undecided
    names = undecided or (deciding.said.tied if deciding.said.ties else ())
    fitted = sorted(
        (c for c in deciding.trials if c.fit is not None), key=lambda c: -c.penalised_likelihood
    )
    members, most = [c for c in fitted if c.name in names], MOST_RIVALS
    if answer.verdict == "not_identifiable":
        members, most = members or fitted[:CLOSEST], MOST_RIVALS - 1
        yield Rival("", case.final.fit)
    for c in members[:most]:
        assert c.fit is not None
        yield Rival(c.name, c.fit)


def _deciding_round(case: SearchedCase, answer: Diagnosis) -> TrialRound:
    """Return the round whose candidates are compared: the last one, or the last that gave a name,
    if that is in a tie.
    """
    last = case.rounds[-1]
    if last.said.undecided or answer.verdict != "named":
        return last
    return next((r for r in reversed(case.rounds) if r.said.added and r.said.ties), last)


def _described(plan: _Design, case: SearchedCase, best: _Trial | None) -> DesignedInput:
    """Return what is reported of the best input, if there is one."""
    column, own_unit = _column(case.model, plan.setup.loop)
    factor = factor_to(column.unit, column.scale, own_unit)
    gain = 0.0 if best is None else best.gain
    told = best is not None and gain > TIE_NATS
    u = best.given / factor if told and best is not None else np.empty(0)
    time = np.asarray(plan.setup.grid.h * np.arange(len(u)), dtype=np.float64)
    moved = [plan.setup.positions(each.y) for each in best.responses] if best else [np.zeros(1)]
    theta = np.concatenate(moved)
    ends = (float(u.min()), float(u.max()), rms(u)) if told else (math.nan, math.nan, math.nan)
    return DesignedInput(
        tuple(rival.name for rival in plan.rivals),
        gain,
        TIE_NATS,
        best.motion if best else None,
        column.unit,
        *ends,
        plan.setup.start,
        (float(theta.min()), float(theta.max())),
        _headings(case.model, plan.setup.loop),
        time,
        u,
        None if plan.setup.loop is None else plan.setup.loop.frequency,
    )


def _column(model: Layout, loop: Loop | None) -> tuple[Column, str]:
    """Return the column of the records that the file goes with, and its unit in SI."""
    return (model.input, model.input_unit) if loop is None else (model.output, model.output_unit)


def _headings(model: Layout, loop: Loop | None = None) -> tuple[str, str]:
    """Return the columns of the file, with units: as the records name them, or a reference."""
    column, _ = _column(model, loop)
    name = without_unit(column.column) if loop is None else REFERENCE
    time = without_unit(model.time.column) if model.time else "time"
    return f"{time} [s]", f"{name} [{column.unit}]"
