"""The answer of a diagnosis and of a validation: data, and reasons as codes with their numbers.

Nothing here is a sentence. `report` writes those from the codes; `writer` is how an answer that a
user holds comes by them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from bristle.common.table import Array
from bristle.diagnosis.modelfile import Model
from bristle.plant.controller import CONTROLLER
from bristle.plant.effects import effect as find_effect
from bristle.plant.unnamed_torque import UNNAMED_KNOTS
from bristle.records.choice import Candidate
from bristle.records.record import Record

# from the strength of an effect to an end of its interval, over the strength, which must be less
STRENGTH_HALF_WIDTH = 0.5
LEAST_FALL = 1.2  # factor by which an effect must lower the mean squared error where it acts
LEAST_ERRORS = 4.0  # standard errors of the predictive gain: least gain that is no chance
# views that contain the sensor's own noise in a closed loop, which a residual follows in any case
SENSOR_VIEWS = ("du",)
OUTLIERS = "some stretches"  # view of the segments with a large error, in diagnosis.json too
LISTED_VIEW_P = 0.05  # p up to which a view is listed ahead of the others
CERTAIN_P = 0.03  # p over all views up to which a share is taken for real
MIN_SHARE = 0.15  # share of the residual's power that a view must predict to be reported

Verdict = Literal["named", "tie", "none", "not_identifiable"]
Outcome = Literal["none", "rejected", "limit", "tie", "added", "withdrawn"]


# -- reasons ---------------------------------------------------------------------------------------
class Reason(StrEnum):
    """Why something was decided, or what was noticed; its value stands in diagnosis.json."""

    # the motion is too uniform to tell effects apart by their form
    ONE_OSCILLATION = "one_oscillation"
    COARSE_INPUT = "coarse_input"
    SHORT_RECORDS = "short_records"
    SMALL_RANGE = "small_range"
    # what the records cannot show
    ONE_DIRECTION = "one_direction"
    NO_REST = "no_rest"
    MOSTLY_REST = "mostly_rest"
    FEW_REVERSALS = "few_reversals"
    NO_SLOW_MOTION = "no_slow_motion"
    EVEN_SPEED = "even_speed"
    LESS_THAN_HALF_A_TURN = "less_than_half_a_turn"
    LESS_THAN_TWO_TURNS = "less_than_two_turns"
    NARROW_BAND = "narrow_band"
    NO_FAST_INPUT = "no_fast_input"
    ONE_FREQUENCY = "one_frequency"
    ONE_SIGN = "one_sign"
    NO_LONG_TIME = "no_long_time"
    OVERLAPPING_TIMES = "overlapping_times"
    UNKNOWN_POSITIONS = "unknown_positions"
    # what looks like a mistake in data or model
    IMPLAUSIBLE = "implausible"
    IN_RECORD = "in_record"
    UNSIGNED_SPEED = "unsigned_speed"
    OTHER_OUTPUT = "other_output"
    SWAPPED_COLUMNS = "swapped_columns"
    FLIPPED_SIGN = "flipped_sign"
    WRONG_INERTIA = "wrong_inertia"
    WRONG_FACTOR = "wrong_factor"
    WIDER_BOUNDS = "wider_bounds"
    # what was noticed before and after the search
    LITTLE_MOTION = "little_motion"
    KNOWN_TORQUE_OFF = "known_torque_off"
    RATIOS_TO_GAIN = "ratios_to_gain"
    SCALED_TO_GAIN = "scaled_to_gain"
    OUTSIDE_BOUNDS = "outside_bounds"
    COMMON_FACTOR = "common_factor"
    INPUT_CHANGES = "input_changes"
    ALIASED = "aliased"
    ALIASED_THROUGHOUT = "aliased_throughout"
    SHORTER_SEGMENTS = "shorter_segments"
    AT_BOUND = "at_bound"
    BEGINS_ANEW = "begins_anew"
    GOES_ON = "goes_on"
    SETS_IN = "sets_in"
    ONE_AFTER_THE_OTHER = "one_after_the_other"
    BUDGET_USED = "budget_used"
    # what a time budget left out
    EFFECTS_UNFINISHED = "effects_unfinished"
    BEST_STARTS_ONLY = "best_starts_only"
    NO_FURTHER_EFFECT = "no_further_effect"
    NOT_REFITTED = "not_refitted"
    NO_UNNAMED_TORQUE = "no_unnamed_torque"
    NOT_COMPARED_RECORDS = "not_compared_records"
    NO_DESIGNED_INPUT = "no_designed_input"
    # why an effect was not tried
    LINEAR_AXIS = "linear_axis"
    NO_POSITION = "no_position"
    RECORDS_LACK = "records_lack"
    REFUSED = "refused"
    OUT_OF_TIME = "out_of_time"
    # what a criterion is not met by
    TOO_SMALL = "too_small"
    NOT_CONFIRMED = "not_confirmed"
    UNCERTAIN_GAIN = "uncertain_gain"
    NOT_COMPARED = "not_compared"
    LESS_LIKELY = "less_likely"
    REJECTED = "rejected"
    # how a round of the search ended
    ADDED = "added"
    SLIDING = "sliding"
    NOT_SLIDING = "not_sliding"
    TIE = "tie"
    BOUND = "bound"
    STANDS_IN = "stands_in"
    CHANCE = "chance"
    NOTHING_TO_ADD = "nothing_to_add"
    OUT_OF_BUDGET = "out_of_budget"
    UNMET = "unmet"
    OTHERS_UNFINISHED = "others_unfinished"
    UNKNOWN_STRENGTH = "unknown_strength"
    FAINT = "faint"
    ONLY_BOUNDS = "only_bounds"
    # what was found in a view of the residual
    WAVE_IN_TIME = "wave_in_time"
    WAVE_ALONG_PATH = "wave_along_path"
    OUTLIER_SEGMENTS = "outlier_segments"
    # why nothing can be named although something is missing
    BUDGET_BEFORE_ALL = "budget_before_all"
    LARGE_DISTURBANCE = "large_disturbance"
    # why no unnamed torque is offered
    NO_FUNCTION = "no_function"
    FUNCTION_NO_BETTER = "function_no_better"
    FUNCTION_TOO_WEAK = "function_too_weak"
    # inputs of a further record
    MANY_STEPS = "many_steps"
    SLOW_RAMPS = "slow_ramps"
    RECORDED_INPUT = "recorded_input"
    QUICKENED_INPUT = "quickened_input"
    VARIED_INPUT = "varied_input"
    # a plant FMU
    FMU_INPUT_UNIT = "fmu_input_unit"
    FMU_FOLLOWED = "fmu_followed"
    FMU_NOT_FOLLOWED = "fmu_not_followed"
    FMU_AGREES = "fmu_agrees"
    FMU_PARAMETER = "fmu_parameter"
    FMU_BY_SEGMENT = "fmu_by_segment"
    FMU_BY_RECORD = "fmu_by_record"
    FMU_OWN_START = "fmu_own_start"
    NO_START_VARIABLE = "no_start_variable"
    # a proposed model file
    SEVERAL_COLUMNS = "several_columns"
    UNEXPLAINED_INPUT = "unexplained_input"
    POSITION_INPUT = "position_input"
    SIGN_TURNED = "sign_turned"
    NEVER_NEGATIVE = "never_negative"
    GUESSED_INERTIA = "guessed_inertia"
    SETPOINT_INPUT = "setpoint_input"
    # why what was found is in doubt
    SUSPECTED = "suspected"
    DOUBT_STRENGTH = "doubt_strength"
    DOUBT_BOUND = "doubt_bound"
    DOUBT_ERROR = "doubt_error"
    DOUBT_WHOLE = "doubt_whole"
    DOUBT_REST = "doubt_rest"
    DOUBT_SIZE = "doubt_size"
    DOUBT_CANCELLING = "doubt_cancelling"
    DOUBT_FAINT = "doubt_faint"


@dataclass(frozen=True)
class Finding:
    """A reason with its numbers and names: text, numbers, findings, or tuples of these."""

    reason: Reason
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def code(self) -> dict[str, Any]:
        """The content of diagnosis.json for it."""
        return {"code": self.reason.value, **{key: _coded(x) for key, x in self.facts.items()}}


# what the records' own reading noticed comes as text
Line = Finding | str


def finding(reason: Reason, **facts: Any) -> Finding:
    """Return a finding with these facts."""
    return Finding(reason, facts)


def coded(line: Line | None) -> Any:
    """Return the code of a line; text and None as they are."""
    return line.code if isinstance(line, Finding) else line


def _coded(fact: Any) -> Any:
    if isinstance(fact, tuple):
        return [_coded(each) for each in fact]
    return coded(fact)


# -- parameters and effects ------------------------------------------------------------------------
@dataclass(frozen=True)
class Estimate:
    """A fitted parameter (SI) with its 95 % interval; `at_bound` where the fit ended at a limit."""

    value: float
    unit: str
    ci95: tuple[float, float] | None
    at_bound: bool = False

    def known_within(self, share: float) -> bool:
        """True if it is at no end of what it may be, and its interval reaches less than this share
        of its value towards 0, and as far in the other direction by the same factor.

        Within a share of 1 it is known that it is not 0.
        """
        if self.ci95 is None or self.at_bound or self.ci95[0] * self.ci95[1] <= 0:
            return False
        near, far = sorted(map(abs, self.ci95))
        return near > (1 - share) * abs(self.value) and far * (1 - share) < abs(self.value)


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

    def known_within(self, share: float) -> bool:
        """Return whether one of its strengths, or its free play, is known to within this share, or
        all are given.
        """
        names = [name.removeprefix(f"{self.name}.") for name in find_effect(self.name).strengths]
        free = [self.parameters[name] for name in names if name in self.parameters]
        return not free or any(each.known_within(share) for each in free)

    def with_estimates(self, fitted: Mapping[str, Estimate]) -> Named:
        """Return the effect with the estimates that there are of its parameters by their full
        names.
        """
        own = {key: fitted.get(f"{self.name}.{key}", e) for key, e in self.parameters.items()}
        return replace(self, parameters=own)


# -- the search ------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Assessment:
    """What an effect is worth, compared with the model without it."""

    level: float = 0.0  # gain that chance reaches [nats]
    # factor by which the mean squared error falls where the effect acts
    error_reduction: float = 1.0
    # of the log predictive density of all segments, each under parameters fitted without it [nats]
    predictive_gain: float = 0.0
    gain_error: float = 0.0  # its standard error, by the segments that become less likely [nats]
    # by how much the best candidate is likelier, and the standard error of that [nats]
    deficit: tuple[float, float] = (0.0, 0.0)

    @property
    def large_enough(self) -> bool:
        """True if the error falls by a factor that matters."""
        return self.error_reduction >= LEAST_FALL

    @property
    def confirmed(self) -> bool:
        """True if segments become likelier under parameters that were fitted without them, by more
        than chance gives.
        """
        return self.predictive_gain > self.level

    @property
    def certain(self) -> bool:
        """True if the losses of some segments are no sign that the gains of others are chance."""
        return self.predictive_gain >= LEAST_ERRORS * self.gain_error

    @property
    def accepted(self) -> bool:
        """True if the effect meets the criterion."""
        return self.large_enough and self.confirmed and self.certain

    @property
    def objection(self) -> Finding | None:
        """Which part of the criterion the effect does not meet."""
        if not self.large_enough:
            return finding(Reason.TOO_SMALL, error_reduction=self.error_reduction)
        if not self.confirmed:
            return finding(Reason.NOT_CONFIRMED, predictive_gain=self.predictive_gain)
        return None if self.certain else finding(Reason.UNCERTAIN_GAIN, error=self.gain_error)


@dataclass(frozen=True)
class CandidateEffect:
    """A candidate effect of a round."""

    name: str
    gain: float  # rise of the log-likelihood [nats]; NaN if it was not tried
    level: float  # rise that chance reaches [nats]
    reason: Line | None = None  # why it was not tried
    assessment: Assessment | None = None  # of those above chance


@dataclass(frozen=True)
class Round:
    """One round of the stepwise search."""

    candidates: tuple[CandidateEffect, ...]  # those that gain most first
    null_level: float  # gain that chance reaches for the best candidate [nats]
    p: float  # probability of the best candidate's gain by chance
    # what was decided on the best candidate, and why: "limit" where it stands in for something
    # else; "withdrawn" where the effect was added and later removed
    outcome: Outcome
    decision: Line
    best: str | None = None  # None if no candidate is above the level that chance reaches
    gain: float = 0.0  # of the best one under the noise that it leaves [nats]
    ties: tuple[str, ...] = ()  # other candidates that the records do not distinguish from it
    cut_short: bool = False  # whether the time budget kept it from trying all start values

    @property
    def added(self) -> str | None:
        """The effect that was added."""
        return self.best if self.outcome == "added" else None

    @property
    def rejected(self) -> str | None:
        """The best candidate, if it was not added for a reason of its own."""
        return self.best if self.outcome in ("rejected", "withdrawn") else None

    @property
    def assessment(self) -> Assessment:
        """What its best candidate is worth."""
        mine = (c.assessment for c in self.candidates if c.name == self.best)
        return next(mine, None) or Assessment()

    @property
    def unfinished(self) -> tuple[str, ...]:
        """Candidates that were not tried, or not to the end, for lack of time."""
        late = finding(Reason.OUT_OF_TIME)
        return tuple(c.name for c in self.candidates if c.reason == late)

    @property
    def tied(self) -> tuple[str, ...]:
        """The best candidate and those that the records do not distinguish from it."""
        return tuple(sorted({self.best, *self.ties})) if self.best else ()

    @property
    def undecided(self) -> tuple[str, ...]:
        """The members of a tie that was not resolved, or what was withdrawn."""
        if self.added or not (self.ties or self.outcome == "withdrawn"):
            return ()
        return self.tied


@dataclass(frozen=True)
class Undetected:
    """What a search says of an effect that it did not add."""

    name: str
    reason: Line | None = None  # why it could not be tried
    # gain of its log-likelihood [nats], if it is above the level that chance reaches
    gain: float | None = None
    failed: Finding | None = None  # with a gain above that level: the condition it does not meet
    # False if no parameter says how large it is: it does not vanish in proportion to its first one
    measurable: bool = True
    # parameters from which these records cannot distinguish its size
    confounded: tuple[str, ...] = ()
    # value of its first parameter [SI] that would have been detected; None if the records set no
    # limit
    limit: float | None = None
    before: str = ""  # the effect that was added after this one was tried
    same_start: bool = False  # whether it holds only if the records start at the same position


# -- the residual ----------------------------------------------------------------------------------
@dataclass(frozen=True)
class ResidualView:
    """What a view predicts of the residual before and after the named effects were added: share of
    its power, and p.
    """

    view: str  # the variables that the residual is taken for a function of
    share: float
    p: float
    share_after: float
    p_after: float
    label: Line = ""  # what was found in it, such as a wave
    # (bins,), values of the variable [SI] at which it is drawn
    centres: Array = field(default_factory=lambda: np.empty(0))
    # (lines, bins), residual torque there [N.m; N on a linear axis]
    before: Array = field(default_factory=lambda: np.empty(0))
    after: Array = field(default_factory=lambda: np.empty(0))  # the same
    lines: tuple[str, ...] = ()  # names of the lines, such as forward and backward
    # length of one period, if that is what is drawn [unit of the variable]
    period: float | None = None


@dataclass(frozen=True)
class Unexplained:
    """Whether a part of the residual is unexplained."""

    flag: bool
    view: str | None  # that it shows in
    share: float  # of the residual
    # rms of the disturbance torque that the fit needs, over that of the input's torque
    disturbance: float = 0.0
    label: Line = ""  # as of the `ResidualView`
    # whether it is so large a part of the error before that what was found may stand in for it
    doubtful: bool = False
    # whether the disturbance is large, and no motion variable predicts much of the residual
    disturbed: bool = False

    @property
    def predictable(self) -> bool:
        """Whether so much of the residual is predicted, reported or not, that noise alone is less
        than the residual.
        """
        return self.flag or (self.view is not None and self.share >= MIN_SHARE)


NOTHING_LEFT = Unexplained(False, None, 0.0)


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
class TorqueCurve:
    """An unnamed torque over one variable: `values` [N.m] at even places from `low` to `high`,
    linear between, constant beyond.
    """

    variable: str  # v, theta, u or t
    low: float
    high: float
    values: Array  # (UNNAMED_KNOTS,)
    half_width: Array  # (UNNAMED_KNOTS,), of the 95 % band

    @property
    def effect(self) -> str:
        """Name of the unnamed torque in a servo."""
        return f"unnamed_torque_{self.variable}"

    @property
    def places(self) -> Array:
        """Values of the variable at which `values` are."""
        return np.linspace(self.low, self.high, UNNAMED_KNOTS)

    @property
    def parameters(self) -> dict[str, float]:
        """Its parameters by their short names."""
        return {"low": self.low, "high": self.high} | {
            f"value{k + 1}": float(x) for k, x in enumerate(self.values)
        }


@dataclass(frozen=True)
class UnnamedTorque:
    """The unexplained residual as a sum of smooth functions, each of one variable.

    `before`, `after`: mean squared errors on held-out segments, which took no part in its fit,
    without and with it. `refused`: why it is not offered, since it does not lower them enough to be
    put into a model. `values`: parameters of the model beside it.
    """

    curves: tuple[TorqueCurve, ...]
    before: float
    after: float
    output_unit: str
    values: dict[str, float]
    refused: Line | None = None

    @property
    def offered(self) -> bool:
        """True if it may be put into a model."""
        return self.refused is None

    @property
    def share(self) -> float:
        """Share of the squared error on held-out segments that it explains."""
        return max(0.0, 1.0 - self.after / self.before) if self.before > 0 else 0.0


# -- records ---------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Excitation:
    """What the records excite: `numbers` with their units, and what they therefore cannot show."""

    numbers: Mapping[str, Any]
    lacks: tuple[str, ...] = ()  # what effects need, and the records do not contain
    # why the motion is too uniform to tell effects apart by their form; None if it is not
    uniform: Finding | None = None
    caveats: tuple[Line, ...] = ()


@dataclass(frozen=True)
class RecordTrace:
    """Measured and simulated output of one record, a value a bin, (n,); NaN where not compared."""

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

    @property
    def worse(self) -> bool:
        """True if the squared error is larger after, by as much as an effect must lower it."""
        return self.after**2 > LEAST_FALL * self.before**2


@dataclass(frozen=True)
class WholeRecords:
    """The models before and after the search over whole records.

    `horizons`: from the length of a segment to the longest record. `refitted_to`: horizon [s] that
    the parameters were refitted to; 0 if they are those of the segments. `segment_parameters`: what
    the segments gave, effects included.
    """

    records: tuple[RecordError, ...]
    horizons: tuple[HorizonError, ...]
    refitted_to: float
    whole: bool  # whether that is the longest record
    segment_parameters: dict[str, Estimate]
    traces: tuple[RecordTrace, ...]  # in open loop, a value a sample
    tried: bool = True  # whether a refit was
    contradicted: bool = False  # whether short stretches contradict it

    @property
    def worse(self) -> bool:
        """True if the squared error over whole records is larger after the search, by as much as an
        effect must lower it.
        """
        return self.horizons[-1].worse

    @property
    def worse_throughout(self) -> bool:
        """True if it is larger at more than half of the horizons beyond a segment.

        What is nearly unstable, such as a raised arm, drifts away in the long run with any model.
        """
        later = self.horizons[1:] or self.horizons
        return 2 * sum(h.worse for h in later) > len(later)

    @property
    def refitted(self) -> bool:
        """True if the parameters are not those of the segments."""
        return self.refitted_to > 0


HALVES = ("the first half", "the second half")  # parts of a single record


@dataclass(frozen=True)
class RecordAgreement:
    """Whether the records agree on the parameters; `gain` of the log-likelihood with parameters of
    its own for each [nats].

    `slides_agree`: whether the sliding motion of each has the same parameters, whatever segments
    say. `values`: by the parameters' names, of each record, or of each half of a single one (SI);
    `differs`: the parameter that differs most beside its uncertainty, or an empty text.
    """

    gain: float
    level: float  # gain up to which they agree [nats]
    values: dict[str, dict[str, float | None]]  # None where a record says nothing of a parameter
    units: dict[str, str]
    differs: str
    slides_agree: bool = False

    @property
    def holds(self) -> bool:
        """True if they agree."""
        return self.gain <= self.level or self.slides_agree

    @property
    def of_halves(self) -> bool:
        """True if the halves of a single record are compared."""
        return tuple(next(iter(self.values.values()), {})) == HALVES


@dataclass(frozen=True)
class DesignedInput:
    """The input of a record that would tell rivals apart; where none does, `time` and `u` are empty
    and `gain` is the best. Where the records were made in a position loop, it is a reference for
    that loop.

    `gain` is by how much the records are expected to decide between the two rivals that are hardest
    to tell apart [nats].
    """

    rivals: tuple[str, ...]  # effects; empty text: none
    gain: float
    level: float  # gain from which on they count as told apart [nats]
    motion: Line | None  # its kind
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
    loop: float | None = None  # Hz, about: of the loop that follows it; None in open loop

    @property
    def written(self) -> bool:
        """True if it would tell the rivals apart, and is written to a file."""
        return len(self.u) > 0


# -- the whole answer ------------------------------------------------------------------------------
class Writer(Protocol):
    """Writes the sentences and the files' content of an answer from its codes."""

    def lines(self, lines: tuple[Line, ...]) -> tuple[str, ...]:
        """Return each line as a sentence."""

    def statement(self, diagnosis: Diagnosis) -> tuple[str, ...]:
        """Return the result in sentences."""

    def findings(self, diagnosis: Diagnosis) -> tuple[str, ...]:
        """Return lines about records and model."""

    def experiment(self, diagnosis: Diagnosis) -> str:
        """Return what to measure next, or an empty text."""

    def undetected(self, diagnosis: Diagnosis) -> dict[str, str]:
        """Return what would have been detected of each effect that was not found."""

    def excitation(self, excited: Excitation) -> dict[str, Any]:
        """Return what the records excite, in numbers and words."""

    def content(self, answer: Diagnosis | Validation) -> dict[str, Any]:
        """Return the content of diagnosis.json or validation.json."""

    def notebook(self, answer: Diagnosis | Validation) -> str:
        """Return what a notebook shows."""


@dataclass(frozen=True)
class BetweenSensors:
    """What lies between two positions: parts with their parameters, by name, and the rms of the
    difference before and after it [`unit`].
    """

    parts: Mapping[str, Mapping[str, Estimate]]
    before: float
    after: float
    unit: str


@dataclass(frozen=True)
class SeenController:
    """The controller that made the input of a goal: its gains, by the names of `[controller]`, and
    the share of the input that its law explains.

    "ahead", among them: samples by which the goal's rate leads that of the last two samples.
    `lag`, `delay` [s]: of the output that it sees, and from there to the input. `of`: whether its
    goal is a "position" or a "velocity"; then kd is its gain, and kp that over the integral.
    """

    gains: Mapping[str, Estimate]
    share: float
    lag: float
    delay: float
    of: str


class _Written:
    writer: ClassVar[Writer]  # given by the package


@dataclass(frozen=True)
class Diagnosis(_Written):
    """The result of a diagnosis; `to_dict` gives the content of diagnosis.json.

    Attributes
    ----------
    verdict : {"named", "tie", "none", "not_identifiable"}
        Effects were named; effects of several classes explain the records alike; no effect is
        missing; the records cannot tell.
    effects : tuple of Named
        The effects that were found, with their parameters.
    ties : tuple of tuple of str
        Names of effects that explain the records alike.
    where : tuple of ResidualView
        Localisation of the residual: its predictable share in each view, before and after.
    remains : Unexplained
        Whether a residual is left that no effect explains.
    gap : Gap
        Mean squared error over held-out segments, before and after, and its noise floor.
    excited : Excitation
        What the records excite.
    base, fitted : dict of str to Estimate
        Parameters of the model, refitted without effects and with them (SI); the latter by full
        names with those of the effects.
    rounds : tuple of Round
        The rounds of the search, each with its candidates.
    limits : tuple of Undetected
        What the search says of each effect that was not found.
    traces : tuple of RecordTrace
        Signals for the figures.
    model : Model
        The model that was diagnosed.
    leads : tuple of Finding or str
        What the statement begins with.
    notes : tuple of Finding or str
        About records and model: what, where, what to do.
    corrections : tuple of Finding or str
        What to correct in data or model first: a sign, a factor of a unit, a bound.
    uniform : Finding or None
        Why the search took the motion for too uniform to tell effects apart by their form.
    unidentified : tuple of str
        The model's parameters if the records determine none of them.
    hindrance : Finding or None
        Why nothing can be named although something is missing for certain; None where the motion or
        a tie is the reason.
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
    between : BetweenSensors or None
        What lies between the positions of motor and load; None where one was measured.
    seen_controller : SeenController or None
        What made the input of a goal; None where no goal was recorded beside it.
    unnamed : UnnamedTorque or None
        What is left unexplained as a function of one variable or two; None where nothing much is
        left.
    agreement : RecordAgreement or None
        Whether the records agree on the parameters; None where that was not tried.
    suspects : tuple of Named
        Effects that were found and are in doubt, so that they are not named; then `effects` is
        empty.
    doubts : tuple of Finding
        Why they are in doubt.
    """

    verdict: Verdict
    gap: Gap
    excited: Excitation
    model: Model
    effects: tuple[Named, ...] = ()
    ties: tuple[tuple[str, ...], ...] = ()
    where: tuple[ResidualView, ...] = ()
    remains: Unexplained = NOTHING_LEFT
    base: dict[str, Estimate] = field(default_factory=dict)
    fitted: dict[str, Estimate] = field(default_factory=dict)
    rounds: tuple[Round, ...] = ()
    limits: tuple[Undetected, ...] = ()
    traces: tuple[RecordTrace, ...] = ()
    leads: tuple[Line, ...] = ()
    notes: tuple[Line, ...] = ()
    corrections: tuple[Line, ...] = ()
    uniform: Finding | None = None
    unidentified: tuple[str, ...] = ()
    hindrance: Finding | None = None
    seconds: float = 0.0
    choices: dict[str, dict[str, Estimate]] = field(default_factory=dict)
    choice_parameters: dict[str, dict[str, Estimate]] = field(default_factory=dict)
    whole: WholeRecords | None = None
    between: BetweenSensors | None = None
    seen_controller: SeenController | None = None
    unnamed: UnnamedTorque | None = None
    designed: DesignedInput | None = None
    agreement: RecordAgreement | None = None
    suspects: tuple[Named, ...] = ()
    doubts: tuple[Finding, ...] = ()

    @property
    def found(self) -> tuple[Named, ...]:
        """The effects that the model was refitted with, named or suspected."""
        return (*self.effects, *self.suspects)

    @property
    def parameters(self) -> dict[str, Estimate]:
        """Parameters of the model, refitted with the effects, without those of the found ones."""
        found = {effect.name for effect in self.found}
        own = {key: e for key, e in self.fitted.items() if key.split(".")[0] not in found}
        return own | self._scale

    @property
    def _scale(self) -> dict[str, Estimate]:
        """The gain that all torques are relative to, where none was measured."""
        name = f"{CONTROLLER.name}.kp"
        if self.model.controller is None or "kp" not in self.model.controller:
            return {}
        return {name: Estimate(self.model.controller["kp"], self.model.unit(name), None)}

    @property
    def records_disagree(self) -> bool:
        """True if the records were compared, and do not agree."""
        return self.agreement is not None and not self.agreement.holds

    @property
    def statement(self) -> tuple[str, ...]:
        """The result in sentences."""
        return self.writer.statement(self)

    @property
    def experiment(self) -> str:
        """What to measure next; empty where there is nothing to tell apart."""
        return self.writer.experiment(self)

    @property
    def findings(self) -> tuple[str, ...]:
        """Lines about records and model: what, where, what to do."""
        return self.writer.findings(self)

    @property
    def proposals(self) -> tuple[str, ...]:
        """What to correct in data or model first, in sentences."""
        return self.writer.lines(self.corrections)

    @property
    def undetected(self) -> dict[str, str]:
        """Of each effect that was not found: which size would have been detected, or why it cannot
        be.
        """
        return self.writer.undetected(self)

    @property
    def excitation(self) -> dict[str, Any]:
        """What the records excite: ranges of input, speed and position (SI), shares of the time at
        rest, forward, backward; and ``narrow``, why the motion is too uniform, or an empty text.
        """
        return self.writer.excitation(self.excited)

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the verdict, the answer, a table of the effects."""
        return self.writer.notebook(self)

    def to_dict(self) -> dict[str, Any]:
        """Return what diagnosis.json holds: plain numbers, lists and text, no NaN."""
        return self.writer.content(self)


@dataclass(frozen=True)
class AfterStart:
    """Errors of a record in open loop after its first `samples`, to which alone its start was
    fitted: as of `ValidatedRecord`.
    """

    samples: int
    rms: float
    fit_percent: float
    mse_percent: float


@dataclass(frozen=True)
class ValidatedRecord:
    """A record in open loop: errors in `unit`, FIT and the error of eq. (25) in per cent; NaN where
    they cannot be given.

    `horizons`: (horizon [s], rms error); the last one is the whole record. `time` [s], `input`
    [SI], `measured`, `simulated`: sample by sample, shape (n,). `after_start`: the errors where the
    start is not fitted to the whole record; None if that was not asked for, or is not possible.
    """

    name: str
    unit: str
    rms: float
    fit_percent: float
    mse_percent: float
    horizons: tuple[tuple[float, float], ...]
    time: Array
    input: Array
    measured: Array
    simulated: Array
    after_start: AfterStart | None = None

    @property
    def trace(self) -> RecordTrace:
        """The signals, for a figure."""
        held_out, seen = np.zeros(len(self.time), bool), self.simulated
        return RecordTrace(self.name, self.time, self.input, self.measured, seen, seen, held_out)


@dataclass(frozen=True)
class Validation(_Written):
    """The result of a validation; `to_dict` gives the content of validation.json.

    Attributes
    ----------
    name : str
        What was validated: the name of a file, or of a friction law.
    kind : {"position", "velocity"}
        What was measured.
    records : tuple of ValidatedRecord
        Errors and signals of each record.
    notes : tuple of Finding or str
        About the records and how the model was run.
    """

    name: str
    kind: str
    records: tuple[ValidatedRecord, ...]
    notes: tuple[Line, ...] = ()

    @property
    def findings(self) -> tuple[str, ...]:
        """Lines about the records and how the model was run."""
        return self.writer.lines(self.notes)

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the errors of each record."""
        return self.writer.notebook(self)

    def to_dict(self) -> dict[str, Any]:
        """Return what validation.json holds: plain numbers, lists and text, no NaN."""
        return self.writer.content(self)


# -- a proposed model file -------------------------------------------------------------------------
@dataclass(frozen=True)
class Rough:
    """A rough parameter [SI]: value, standard error (None for a guess) and bounds."""

    value: float
    error: float | None
    low: float
    high: float


@dataclass(frozen=True)
class Proposal:
    """What `propose` found.

    Attributes
    ----------
    paths : tuple of Path
        The measured files.
    time, input, output : Candidate
        What was chosen.
    others : dict of str to tuple of Candidate
        Other candidates for each of these roles, the likeliest first.
    rough : dict of str to Rough
        J, a2 and Fc; per unit of the input where this is a voltage or a current.
    doubts : tuple of Finding or str
        What could not be told and was assumed.
    records : tuple of Record
        The records, checked and repaired.
    explained : float
        Share of the input that J, a2 and Fc explain.
    excited : Excitation
        What the records excite, as a diagnosis reports it.
    differences : bool
        Whether the output is a velocity that is the difference of a position's readings; the
        records hold that position then.
    loop : float or None
        Frequency [Hz, about] of the position loop that the records show; None if they show none.
    controller : dict of str to float, or None
        What the controller that follows a setpoint looks like, relative to J; None for another
        input.
    """

    paths: tuple[Path, ...]
    time: Candidate
    input: Candidate
    output: Candidate
    others: Mapping[str, tuple[Candidate, ...]]
    rough: Mapping[str, Rough]
    doubts: tuple[Line, ...]
    records: tuple[Record, ...]
    explained: float
    excited: Excitation
    differences: bool
    loop: float | None = None
    controller: Mapping[str, float] | None = None
