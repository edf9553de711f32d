"""The result of a diagnosis: the content of diagnosis.json, and the curves that the report
draws.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.output import plain
from bristle.diagnosis.estimation.uncertainty import STRENGTH_HALF_WIDTH
from bristle.diagnosis.estimation.uncertainty import Estimate as Estimate
from bristle.diagnosis.localisation.unexplained import Unexplained
from bristle.diagnosis.localisation.unnamed_torque import Curve
from bristle.diagnosis.localisation.views import View as View
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.selection.effect_size import LEAST_FALL
from bristle.plant.effects import effect as find_effect

Array = NDArray[np.float64]
EXPERIMENT_FILE = "experiment.csv"  # holds the input of a record that would tell rivals apart


@dataclass(frozen=True)
class Named:
    """An effect that was added: `gain` is the rise of the log-likelihood [nats], `p` the
    probability of as much by chance.
    """

    name: str
    group: str
    parameters: dict[str, Estimate]
    gain: float
    p: float

    @property
    def known(self) -> bool:
        """True if its strength, or its free play, is known; otherwise it may stand in for something
        else.
        """
        return self.known_within(STRENGTH_HALF_WIDTH)

    def known_within(self, share: float) -> bool:
        """Return whether its strength, or its free play, is known to within this share of its
        value, or given.
        """
        strength = self.parameters.get(
            find_effect(self.name).decisive.name.removeprefix(f"{self.name}.")
        )
        return strength is None or strength.known_within(share)


@dataclass(frozen=True)
class Candidate:
    """A candidate effect of a round; `size` and what follows only of candidates above chance."""

    name: str
    # rise of the log-likelihood [nats]; NaN (null in diagnosis.json) if it was not tried
    gain: float
    level: float  # rise that chance reaches [nats]
    note: str = ""  # why it was not tried
    size: float | None = None  # factor by which the mean squared error falls where it acts
    # gain of the log predictive density of all segments, each under parameters fitted without it
    # [nats]
    kept: float | None = None
    # of these gains and losses of segments: share that is left of the gains
    net: float | None = None
    # log-likelihood of the best candidate above that of this one [nats]
    behind: float | None = None
    doubt: float | None = None  # its standard error [nats]


@dataclass(frozen=True)
class Round:
    """One round of the stepwise search."""

    candidates: tuple[Candidate, ...]
    null_level: float  # gain that chance reaches for the best candidate [nats]
    p: float  # probability of the best candidate's gain by chance
    added: str | None  # the effect that was added
    decision: str  # with its reason
    gain: float = 0.0  # of the best candidate under the noise that it leaves [nats]
    # factor by which the best candidate lowers the mean squared error where it acts
    size: float = 1.0
    finer: float | None = None  # the gain with finer steps of the simulation
    rejected: str | None = None  # the best candidate, if it was not added for a reason of its own


@dataclass(frozen=True)
class Gap:
    """Mean squared output error over held-out segments [`unit`], with optimal initial states."""

    before: float  # of the model refitted without effects
    after: float  # with the named ones
    # what disturbance and sensor noise alone would leave, None where that is not known
    noise_floor: float | None
    output_unit: str

    @property
    def unit(self) -> str:
        """Unit of the output, squared."""
        return f"({self.output_unit})2" if "/" in self.output_unit else f"{self.output_unit}2"

    @property
    def left(self) -> float:
        """Error after over error before."""
        return self.after / self.before if self.before > 0 else 1.0

    @property
    def ratio(self) -> float | None:
        """Error before over noise floor."""
        return None if not self.noise_floor else self.before / self.noise_floor

    @property
    def shrink(self) -> float | None:
        """Share of the error above the noise floor that was closed."""
        if self.noise_floor is None or self.before <= self.noise_floor:
            return None
        return (self.before - self.after) / (self.before - self.noise_floor)


@dataclass(frozen=True)
class UnnamedTorque:
    """The unexplained residual as a sum of smooth functions, each of one variable.

    `before`, `after`: mean squared errors on held-out segments, which took no part in its fit,
    without and with it. `offered`: whether it lowers them enough to be put into a model; if not,
    `reason` says why. `values`: parameters of the model beside it.
    """

    curves: tuple[Curve, ...]
    offered: bool
    before: float
    after: float
    output_unit: str
    values: dict[str, float]
    reason: str = ""

    @property
    def share(self) -> float:
        """Share of the squared error on held-out segments that it explains."""
        return max(0.0, 1.0 - self.after / self.before) if self.before > 0 else 0.0


@dataclass(frozen=True)
class Trace:
    """Measured and simulated output of one record, a value a bin, shape (n,); NaN where it was not
    compared.
    """

    name: str
    time: Array  # [s]
    input: Array  # [SI]
    measured: Array  # [output], as are before and after
    before: Array
    after: Array
    held_out: NDArray[np.bool_]  # whether a bin is in a held-out segment


@dataclass(frozen=True)
class RecordError:
    """Errors of a whole record simulated in open loop [`unit`] and FIT [%]; NaN where the
    simulation fails, FIT at rest too.
    """

    record: str
    unit: str
    rms_before: float
    rms_after: float
    fit_before: float
    fit_after: float


@dataclass(frozen=True)
class HorizonError:
    """Root mean square errors over all records, simulated anew after so many seconds; `segments` as
    fitted to segments.
    """

    seconds: float
    before: float
    segments: float
    after: float


@dataclass(frozen=True)
class WholeRecords:
    """The models before and after the search over whole records.

    `refitted_to`: horizon [s] that the parameters were refitted to; 0 if they are those of the
    segments. `segment_parameters`: what the segments gave, effects included.
    """

    records: tuple[RecordError, ...]
    horizons: tuple[HorizonError, ...]
    refitted_to: float
    whole: bool  # whether that is the longest record
    segment_parameters: dict[str, Estimate]
    traces: tuple[Trace, ...]  # in open loop, a value a sample
    tried: bool = True  # whether a refit was

    @property
    def worse(self) -> bool:
        """True if the squared error over whole records is larger after the search, by as much as an
        effect must lower it.
        """
        return self.horizons[-1].after ** 2 > LEAST_FALL * self.horizons[-1].before ** 2

    @property
    def refitted(self) -> bool:
        """True if the parameters are not those of the segments."""
        return self.refitted_to > 0


HALVES = ("the first half", "the second half")  # parts of a single record


@dataclass(frozen=True)
class Agreement:
    """Whether the records agree on the parameters; `gain` of the log-likelihood with parameters of
    its own for each [nats].

    `values`: by the parameters' names, of each record, or of each half of a single one (SI);
    `differs`: the parameter that differs most beside its uncertainty, or an empty text.
    """

    gain: float
    level: float  # gain up to which they agree [nats]
    values: dict[str, dict[str, float | None]]  # None where a record says nothing of a parameter
    units: dict[str, str]
    differs: str

    @property
    def holds(self) -> bool:
        """True if they agree."""
        return self.gain <= self.level

    @property
    def of_halves(self) -> bool:
        """True if the halves of a single record are compared."""
        return tuple(next(iter(self.values.values()), {})) == HALVES


@dataclass(frozen=True)
class DesignedInput:
    """The input of a record that would tell rivals apart; where none does, `time` and `u` are empty
    and `gain` is the best.

    `gain` is by how much the records are expected to decide between the two rivals that are hardest
    to tell apart [nats].
    """

    rivals: tuple[str, ...]  # effects; empty text: none
    gain: float
    level: float  # gain from which on they count as told apart [nats]
    what: str  # the kind of motion, in words
    unit: str  # of the input in the file, as in the records
    low: float  # least and largest input, and its rms [unit]
    high: float
    rms: float
    # position at which it begins, at rest, and ends of the positions that are expected (SI)
    start: float
    reach: tuple[float, float]
    columns: tuple[str, str]  # of the file: time [s] and input [unit]
    time: Array
    u: Array

    @property
    def written(self) -> bool:
        """True if it would tell the rivals apart, and is written to a file."""
        return len(self.u) > 0


@dataclass(frozen=True)
class Diagnosis:
    """The result of a diagnosis; `to_dict` gives the content of diagnosis.json.

    Attributes
    ----------
    verdict : {"named", "tie", "none", "not_identifiable"}
        Effects were named; effects of several classes explain the records alike; no effect is
        missing; the records cannot tell.
    statement : tuple of str
        The result in sentences.
    effects : tuple of Named
        The effects that were found, with their parameters.
    ties : tuple of tuple of str
        Names of effects that explain the records alike.
    experiment : str
        The experiment that would tell the members of a tie apart; empty without one.
    where : tuple of View
        Localisation of the residual: its predictable share in each view, before and after.
    remains : Unexplained
        Whether a residual is left that no effect explains.
    gap : Gap
        Mean squared error over held-out segments, before and after, and its noise floor.
    excitation : dict of str to object
        What the records excite: ranges of input, speed and position (SI), shares of the time at
        rest, forward, backward; and ``narrow``, why the excitation is too poor, or an empty text.
    findings : tuple of str
        Lines about records and model: what, where, what to do.
    base, parameters : dict of str to Estimate
        Parameters of the model, refitted without effects and with them (SI).
    rounds : tuple of Round
        The rounds of the search, each with its candidates.
    undetected : dict of str to str
        Of each effect that was not found: which size would have been detected, or why it cannot be.
    traces : tuple of Trace
        Signals for the figures.
    model : Model
        The model that was diagnosed.
    proposals : tuple of str
        What to correct in data or model first: a sign, a factor of a unit, a bound.
    seconds : float
        How long it took [s].
    choices, choice_parameters : dict of str to dict of str to Estimate
        Of each member of a tie, as if it had been named: its parameters, and those of the model
        beside it.
    designed : DesignedInput or None
        The input of a record that would tell apart what these records do not; None where there is
        nothing to tell apart.
    whole : WholeRecords or None
        Errors of whole records in open loop, before and after; None if nothing was searched.
    unnamed : UnnamedTorque or None
        What is left unexplained as a function of one variable or two; None where nothing much is
        left.
    agreement : Agreement or None
        Whether the records agree on the parameters; None where that was not tried.
    """

    verdict: str
    statement: tuple[str, ...]
    effects: tuple[Named, ...]
    ties: tuple[tuple[str, ...], ...]
    experiment: str
    where: tuple[View, ...]
    remains: Unexplained
    gap: Gap
    excitation: dict[str, Any]
    findings: tuple[str, ...]
    base: dict[str, Estimate]
    parameters: dict[str, Estimate]
    rounds: tuple[Round, ...]
    undetected: dict[str, str]
    traces: tuple[Trace, ...]
    model: Model
    proposals: tuple[str, ...] = ()
    seconds: float = 0.0
    choices: dict[str, dict[str, Estimate]] = field(default_factory=dict)
    choice_parameters: dict[str, dict[str, Estimate]] = field(default_factory=dict)
    whole: WholeRecords | None = None
    unnamed: UnnamedTorque | None = None
    designed: DesignedInput | None = None
    agreement: Agreement | None = None

    @property
    def records_disagree(self) -> bool:
        """True if the records were compared, and do not agree."""
        return self.agreement is not None and not self.agreement.holds

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the verdict, the answer in sentences, and a table of the
        effects.
        """
        from bristle.common import pages
        from bristle.diagnosis.report.headline import VERDICTS, headline

        return pages.render(
            "bristle.diagnosis.report/notebook.html",
            diagnosis=self,
            heading=headline(self),
            verdict=VERDICTS[self.verdict],
        )

    def to_dict(self) -> dict[str, Any]:
        """Return what diagnosis.json holds: plain numbers, lists and text, no NaN."""
        content: dict[str, Any] = plain(
            {
                "verdict": self.verdict,
                "statement": list(self.statement),
                "effects": [
                    {
                        "name": e.name,
                        "class": e.group,
                        "parameters": _numbers(e.parameters),
                        "gain": e.gain,
                        "p": e.p,
                    }
                    for e in self.effects
                ],
                "ties": [list(t) for t in self.ties],
                "experiment": self.experiment,
                "experiment_input": _designed(self.designed) if self.designed else None,
                "where": [
                    {
                        "view": w.view,
                        "share": w.share,
                        "p": w.p,
                        "share_after": w.share_after,
                        "p_after": w.p_after,
                    }
                    for w in self.where
                ],
                "remains": asdict(self.remains),
                "unnamed_torque": _unnamed(self.unnamed) if self.unnamed else None,
                "agreement": {"holds": self.agreement.holds, **asdict(self.agreement)}
                if self.agreement
                else None,
                "gap": {
                    "before": self.gap.before,
                    "after": self.gap.after,
                    "noise_floor": self.gap.noise_floor,
                    "ratio": self.gap.ratio,
                    "shrink": self.gap.shrink,
                    "unit": self.gap.unit,
                },
                "excitation": self.excitation,
                "findings": list(self.findings),
                "proposals": list(self.proposals),
                "base": _numbers(self.base),
                "parameters": _numbers(self.parameters),
                "rounds": [asdict(r) for r in self.rounds],
                "undetected": dict(self.undetected),
                "choices": {name: _numbers(found) for name, found in self.choices.items()},
                "seconds": self.seconds,
                "open_loop": [asdict(r) for r in self.whole.records] if self.whole else [],
                "whole_record": _whole(self.whole) if self.whole else None,
            }
        )
        return content


def _unnamed(found: UnnamedTorque) -> dict[str, Any]:
    curves = [
        {"variable": c.variable, "places": c.places, "torque": c.values, "half_width": c.half_width}
        for c in found.curves
    ]
    return {
        "offered": found.offered,
        "reason": found.reason,
        "share": found.share,
        "rms_before": math.sqrt(found.before),
        "rms_after": math.sqrt(found.after),
        "functions": curves,
    }


def _designed(found: DesignedInput) -> dict[str, Any]:
    said = {
        "file": EXPERIMENT_FILE if found.written else None,
        "rivals": list(found.rivals),
        "gain": found.gain,
        "level": found.level,
    }
    if not found.written:
        return said
    ends = {
        "input_unit": found.unit,
        "input_low": found.low,
        "input_high": found.high,
        "input_rms": found.rms,
    }
    place = {"start": found.start, "position_low": found.reach[0], "position_high": found.reach[1]}
    return {
        **said,
        "motion": found.what,
        "seconds": float(found.time[-1] - found.time[0]),
        **ends,
        **place,
    }


def _whole(found: WholeRecords) -> dict[str, Any]:
    return {
        "refitted": found.refitted,
        "refitted_to": found.refitted_to if found.refitted else None,
        "horizons": [asdict(h) for h in found.horizons],
        "segment_parameters": _numbers(found.segment_parameters),
    }


def _numbers(estimates: dict[str, Estimate]) -> dict[str, dict[str, Any]]:
    return {name: asdict(e) for name, e in estimates.items()}
