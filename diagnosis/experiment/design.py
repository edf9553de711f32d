"""Choose the input of a further record to tell apart effects that these records do not."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from bristle.common.metrics import rms
from bristle.common.table import Array, factor_to
from bristle.diagnosis.answer import DesignedInput, Diagnosis, Finding
from bristle.diagnosis.checks.excitation import excitation
from bristle.diagnosis.estimation.fitted_model import TIE_NATS
from bristle.diagnosis.experiment.discrimination import Rival, Setup, disturbed, lead
from bristle.diagnosis.experiment.inputs import Axis, Input, Limits, inputs
from bristle.diagnosis.selection.criterion import TrialRound, group
from bristle.diagnosis.selection.start_values import SearchOptions, dry_friction
from bristle.diagnosis.stages.case import Budget, SearchedCase
from bristle.records.headings import without_unit
from bristle.records.layout import Layout

EXPERIMENT_SECONDS = 20.0  # s: length of the record
MOST_RIVALS = 4  # models that an input is to tell apart at most
# of the effects that were tried, if none was above chance: those that are told from no effect
CLOSEST = 2
MARGIN = 0.05  # of the range that was travelled: distance from its ends that a motion is to keep
DISTURBANCES = 2  # disturbances under which each model is to keep it
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

    def outputs(self, u: Array) -> list[Array] | None:
        """Return the outputs of the rivals; None if an input or motion leaves one's limits."""
        if not self.limits.allow_input(u):
            return None
        outputs = []
        for rival in self.rivals:
            y = self._kept(rival, u)
            rng = np.random.default_rng(0)
            fit, h = rival.fit, self.setup.grid.h
            shaken = [disturbed(u, fit.noise, fit.values["b"], h, rng) for _ in range(DISTURBANCES)]
            if y is None or any(self._kept(rival, each) is None for each in shaken):
                return None
            outputs.append(y)
        return outputs

    def _kept(self, rival: Rival, u: Array) -> Array | None:
        """Return the output of a rival if its motion keeps to the limits."""
        y = rival.output(u, self.setup)
        return (
            y
            if y is not None and self.limits.allow_motion(self.setup.positions(y), MARGIN)
            else None
        )

    def follow(self, at: float, u: Array) -> float:
        """Return where the last rival is after an input (n,) that begins at rest at a position."""
        setup = replace(self.setup, start=at)
        y = self.rivals[-1].output(u, setup)
        return at if y is None else float(setup.positions(y)[-1])

    def tried(self, given: Input) -> _Trial | None:
        """Return the first scale of an input that keeps to the limits, and its gain, or None."""
        for u in given.scaled:
            outputs = self.outputs(u)
            if outputs is not None:
                of = dict(zip((rival.name for rival in self.rivals), outputs, strict=True))
                gain = min(lead(of[a.name], u, b, self.setup) for a, b in self.pairs)
                return _Trial(given.motion, u, tuple(outputs), max(gain - self.own_lead(u), 0.0))
        return None

    def own_lead(self, u: Array) -> float:
        """Return by how much a rival leads itself with other values that the records allow: what no
        difference of models is.
        """
        rng = np.random.default_rng(0)
        others = [
            (rival, rival.output(u, self.setup, rival.drawn(rng)))
            for rival in self.rivals
            for _ in range(OWN_DRAWS)
        ]
        return max(
            (lead(y, u, rival, self.setup) for rival, y in others if y is not None), default=0.0
        )


@dataclass(frozen=True)
class _Trial:
    """An input with the outputs of the rivals and its gain [nats]."""

    motion: Finding
    u: Array
    outputs: tuple[Array, ...]
    gain: float

    def allows_a_name(self, case: SearchedCase) -> bool:
        """True if it decides, and a name may follow from all records then."""
        some, h = case.records[0], case.dataset.segments.h
        time = np.asarray(h * np.arange(len(self.u)), dtype=np.float64)
        record = replace(some, time=time, u=self.u, y=self.outputs[0], velocity=None)
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
    if len(rivals) < 2:
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
    plan = _Design(rivals, usual, Setup(s, case.dataset.resolution, start, ends))
    # the best of all inputs that keep to it, if possible one after which a name may follow
    choice = inputs(
        _axis(rivals[0], m.u), usual, [piece.u for piece in s.pieces], (n, s.h), plan.follow
    )
    trials = [trial for trial in options.map(plan.tried, choice) if trial is not None]
    ordered = sorted(trials, key=lambda trial: -trial.gain)
    best = next(
        (trial for trial in ordered if trial.allows_a_name(case)), ordered[0] if ordered else None
    )
    return _described(plan, case, best)


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
    column = case.model.input
    factor = factor_to(column.unit, column.scale, case.model.input_unit)
    gain = 0.0 if best is None else best.gain
    told = best is not None and gain > TIE_NATS
    u = best.u / factor if told and best is not None else np.empty(0)
    time = np.asarray(plan.setup.grid.h * np.arange(len(u)), dtype=np.float64)
    theta = np.concatenate([plan.setup.positions(y) for y in best.outputs]) if best else np.zeros(1)
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
        _headings(case.model),
        time,
        u,
    )


def _headings(model: Layout) -> tuple[str, str]:
    """Return the columns of the file: as the records name them, with units."""
    return (
        f"{without_unit(model.time.column)} [s]",
        f"{without_unit(model.input.column)} [{model.input.unit}]",
    )
