"""Before the search: records -> `Dataset` -> the servo that a model describes -> `FittedModel`."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bristle.common.errors import BristleError
from bristle.common.progress import Progress
from bristle.common.table import Array
from bristle.diagnosis.answer import Diagnosis, Finding, Gap, Line, Reason, finding
from bristle.diagnosis.checks.excitation import excitation
from bristle.diagnosis.checks.input_hold import SLOW_SAMPLING
from bristle.diagnosis.checks.plausibility import Plausibility, check
from bristle.diagnosis.estimation.dataset import (
    SEGMENT_SECONDS,
    STATE_SMOOTHING,
    Dataset,
    Grid,
    Piece,
    Segments,
    cut,
    motion,
)
from bristle.diagnosis.estimation.fitted_model import (
    LARGE_DISTURBANCE,
    FittedModel,
    fit_from_several_starts,
    has_diverged,
    rough_sliding_fit,
    sliding_fit,
)
from bristle.diagnosis.estimation.likelihood import FitPoint, Problem, evaluate, mean_square
from bristle.diagnosis.estimation.noise import white_noise
from bristle.diagnosis.estimation.simulator import (
    BRISTLE_EFFECTS,
    OWN_BRISTLES,
    Servo,
    fixed_values,
)
from bristle.diagnosis.free_parameter import Free, free_parameters
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.sliding.fit import SlidingFit
from bristle.diagnosis.sliding.stretches import Stretches, smooth, stretches_of
from bristle.diagnosis.sliding.torque import driving_input
from bristle.plant.controller import CONTROLLER
from bristle.plant.effect import RecordedMotion
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects
from bristle.plant.friction import law as find_law
from bristle.plant.known import KNOWN
from bristle.plant.unnamed_torque import UNNAMED_TORQUES
from bristle.records.record import Record

USUAL_TIME_CONSTANT = 0.5  # s: J/a2 of such a servo
SEGMENT_FACTOR = 4.0  # lengths of segments are that of the usual servo times a power of it
SCALE_SD = 0.05  # of the scale of a known torque, where the input is a torque
# s: lag of the velocity in drives, and how much it differs: a period or two and a filter
USUAL_LAG = 2e-3
LEAST_SEGMENTS = 40  # segments that records give at least where segments are longer than usual
SEGMENT_BINS = 50  # averages per segment; shorter than usual ones have as many samples at least
SHORTEST_SHARE = 0.25  # of the length of a segment: shortest segment for a model that diverges
# of the sensor's step: largest deflection of the bristles of rigid friction
BRISTLE_DEFLECTION = 0.25


@dataclass(frozen=True)
class PreparedCase:
    """What is searched: a model and records, the records as a dataset, and the model fitted to it
    without further effects.

    `notes`: of the records; `later`: of their preparation, which follow those of the search;
    `joint`: as of `SearchOptions`.
    `remark` adds what else is to be said of an answer once the conclusion is known; `otherwise`
    prepares the case another way, where nothing is found.
    """

    model: Model
    records: Sequence[Record]
    dataset: Dataset
    base: FittedModel
    notes: tuple[Line, ...] = ()
    later: tuple[Line, ...] = ()
    remark: Callable[[Diagnosis], Diagnosis] | None = None
    otherwise: Callable[[], PreparedCase] | None = None
    joint: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def notes_of(records: Sequence[Record], held: tuple[Finding, ...]) -> tuple[Line, ...]:
    """Return what is said of the records: what their reading noticed, how the input was held."""
    first, *others = records
    return (*first.findings, *held, *(line for record in others for line in record.findings))


def prepared_case(
    model: Model, records: Sequence[Record], notes: tuple[Line, ...], tell: Progress
) -> PreparedCase | Diagnosis:
    """Return the model fitted to the records, or a diagnosis where the two seem not to match."""
    said, dataset = check(model, records), dataset_of(model, records)
    if said.corrections:
        gap = nominal_gap(dataset, *base_servo_of(model, dataset))
        return implausible(model, records, gap, said, notes)
    tell("base refit", 0.0)
    servo, values = base_servo_of(model, dataset)
    base = fit_from_several_starts(dataset, servo, values)
    case = PreparedCase(model, records, dataset, base, notes, said.notes)
    if not has_diverged(dataset, base.fit):
        return case
    if _lacks_much(dataset, servo, values):
        return replace(case, otherwise=lambda: _in_shorter_segments(case))
    return _in_shorter_segments(case)


def slides_of(dataset: Dataset) -> Callable[[Model], SlidingFit | None]:
    """Return what fits models to where records slide."""
    return lambda tried: rough_sliding_fit(dataset, *base_servo_of(tried, dataset))


def implausible(
    model: Model,
    records: Sequence[Record],
    gap: float,
    said: Plausibility,
    notes: tuple[Line, ...],
) -> Diagnosis:
    """Return a diagnosis where data and model seem not to match; `gap` as of `not_searched`."""
    lead = finding(Reason.IMPLAUSIBLE, corrections=said.corrections)
    answer = not_searched(model, records, gap, lead, (*notes, *said.notes))
    return replace(answer, corrections=said.corrections)


def not_searched(
    model: Model, records: Sequence[Record], gap: float, lead: Finding, notes: tuple[Line, ...]
) -> Diagnosis:
    """Return a diagnosis without a search; `gap` is the mean squared error of the model [output
    squared], `lead` is why.
    """
    errors = Gap(gap, gap, None, model.output_unit)
    excited = excitation(model, records)
    return Diagnosis("not_identifiable", errors, excited, model, leads=(lead,), notes=notes)


def segment_seconds(model: Model, records: Sequence[Record]) -> float:
    """Return how long segments are [s]: as many of the servo's nominal time constants J/a2 as
    usual, to within a factor of 2.

    In a small part of a time constant the motion shows little of what acts on it. The nominal a2 is
    rough, but one that was fitted would make up for what the model lacks.
    """
    h, whole, a2 = records[0].h, sum(len(r) * r.h for r in records), model.parameters.get("a2", 0.0)
    if not a2 > 0:
        return SEGMENT_SECONDS
    power = round(math.log(model.parameters["J"] / a2 / USUAL_TIME_CONSTANT, SEGMENT_FACTOR))
    while power < 0 and SEGMENT_SECONDS * SEGMENT_FACTOR**power < SEGMENT_BINS * h:
        power += 1
    while power > 0 and SEGMENT_SECONDS * SEGMENT_FACTOR**power * LEAST_SEGMENTS > whole:
        power -= 1
    return SEGMENT_SECONDS * SEGMENT_FACTOR**power


def dataset_of(model: Model, records: Sequence[Record], seconds: float | None = None) -> Dataset:
    """Return the records as segments of so many seconds, by default of a length for this servo,
    with their smoothed motion.
    """
    # the grid of segments and of the averages in them
    seconds = seconds or segment_seconds(model, records)
    h, velocity = records[0].h, model.output_kind == "velocity"
    length = max(8, round(seconds / h))
    width = max(1, length // SEGMENT_BINS)
    bins = length // width
    long = [r for r in records if len(r) >= 3 * length]
    if not long:
        raise BristleError(
            f"records: none lasts three segments of {length * h:g} s; give longer ones"
        )
    resolution, grid = _resolution_of(model, long), Grid(h, width, bins, velocity)
    # the segments, their smoothed motion, and which effects these records can show
    pieces = tuple(
        cut(r.name, float(r.time[0]), r.u, r.y, grid, resolution).beside(r.known) for r in long
    )
    segments = Segments(h, width, bins, velocity, pieces)
    least = resolution / math.sqrt(12 * width) / 3
    moved = motion(segments, [r.y for r in long], resolution, max(STATE_SMOOTHING / 2, 2 * h))
    stretches = _stretches(long, velocity, resolution)
    if model.controller is not None:
        moved = replace(moved, u=_asked(model, stretches, pieces))
    shown = excitation(model, records)
    excluded = excluded_effects(model, shown.lacks)
    return Dataset(
        segments,
        moved,
        stretches,
        resolution,
        least,
        shown.uniform,
        excluded,
        model.linear,
        float(np.ptp(moved.theta)) if model.linear else 2 * math.pi,
        h >= SLOW_SAMPLING and not any(r.ahead for r in records),
    )


def _stretches(records: Sequence[Record], velocity: bool, resolution: float) -> Stretches:
    """Return where records slide."""
    known = {name: np.concatenate([r.known[name] for r in records]) for name in records[0].known}
    parts = [(r.time, r.u, r.y) for r in records]
    return stretches_of(parts, records[0].h, velocity, resolution, known)


def _asked(model: Model, over: Stretches, pieces: Sequence[Piece]) -> Array:
    """Return what a controller asks for (samples,), cut to segments."""
    asked = driving_input(tuple(model.effects), model.settings(), over)
    parts = [asked[over.record == k][: len(piece.u)] for k, piece in enumerate(pieces)]
    return np.concatenate(parts)


def _resolution_of(model: Model, records: Sequence[Record]) -> float:
    """Return the sensor's step [unit of the output], or the noise in its place."""
    known = model.resolution or max(r.resolution or 0.0 for r in records)
    noise = np.median([np.std(r.y - smooth(r.y, r.h, 3 * r.h)) for r in records])
    return known or max(float(noise), 1e-12)


def recorded_motion(dataset: Dataset) -> RecordedMotion:
    """Return what effects derive the limits of their parameters from."""
    m, s = dataset.motion, dataset.segments
    time = dataset.time_at(s.consecutive(range(len(s.pieces)))) if s.own_clocks else m.time
    return RecordedMotion(
        m.theta, m.v, m.u, time, dataset.turn, dataset.segments.seconds, dataset.linear
    )


def limits(dataset: Dataset) -> dict[str, tuple[float, float]]:
    """Return how far parameters of effects may move on this axis and in these records."""
    m = recorded_motion(dataset)
    return {
        key: ends
        for e in effects().values()
        if e.limits
        for key, ends in e.by_full_name(e.limits(m)).items()
    }


def credible(dataset: Dataset) -> dict[str, tuple[float, float]]:
    """Return the intervals of parameters outside which an effect needs a stronger gain."""
    m = recorded_motion(dataset)
    return {
        key: ends
        for e in effects().values()
        if e.credible
        for key, ends in e.by_full_name(e.credible(m)).items()
    }


def excluded_effects(model: Model, lacks: Collection[str] = ()) -> dict[str, Finding]:
    """Return the effects that are no candidates, each with the reason: the servo of a model cannot
    lack them, the sensor cannot show them, or the records lack (`lacks`) what they need.
    """
    law, unknown = find_law(model.friction), model.output_kind == "velocity"
    excluded = {}
    for e in effects().values():
        # the last reason that holds is given
        if e.excluded and (why := e.excluded(law)):
            excluded[e.name] = finding(Reason.REFUSED, why=why)
        if e.once_per_turn and model.linear:
            excluded[e.name] = finding(Reason.LINEAR_AXIS)
        if e.follow and unknown:
            excluded[e.name] = finding(Reason.NO_POSITION)
        needs = [need for need in e.needs if need in lacks]
        needs += [f"a column of the {x.name}" for x in e.inputs if x.name not in model.known]
        if needs:
            excluded[e.name] = finding(Reason.RECORDS_LACK, what=tuple(needs))
    return excluded


def base_servo_of(model: Model, dataset: Dataset) -> tuple[Servo, dict[str, float]]:
    """Return the servo that a model describes, its own effects included, and its start values.

    Parameters with bounds are free, with a wide prior around their nominal values.
    """
    s, given = dataset.segments, {"b": 1.0, **model.parameters}
    # the model's own parameters
    free = []
    own = {name: ends for name, ends in model.bounds.items() if name in given}
    for name, (low, high) in own.items():
        doubt = max(2.0 * abs(given[name]), 0.5 * (high - low), 1e-12)
        free.append(Free(name, low, high, nominal=given[name], prior_sd=doubt))
    values, dry = (
        dict(given),
        f"{model.friction}.Fc" in given and not find_law(model.friction).states,
    )
    rigid = dry and not set(model.effects) & set(BRISTLE_EFFECTS)
    # rigid friction gets bristles that deflect by less than a step of the sensor
    if dry:
        step = dataset.resolution * (s.h if s.velocity else 1.0)  # of the sensor, in position
        least = max(given[f"{model.friction}.Fc"], 1e-9) / (BRISTLE_DEFLECTION * step)
        damping = (3 * least * given["J"]) ** 0.5
        values |= {f"{OWN_BRISTLES}.stiffness": 3 * least, f"{OWN_BRISTLES}.damping": damping}
        if rigid:
            free.append(
                Free(
                    f"{OWN_BRISTLES}.stiffness", least, 1e4 * least, True, math.log(3 * least), 1.0
                )
            )
            free.append(
                Free(f"{OWN_BRISTLES}.damping", 0.0, 30 * damping, False, damping, 2 * damping)
            )
    # effects that the model has already
    for effect, its in model.effects.items():
        values |= {f"{effect}.{name}": value for name, value in its.items()}
        if effect not in UNNAMED_TORQUES:
            free += [_bounded(model, f) for f in _prior_around(effect, its)]
    free = _of_known_torque(model, _of_controller(free, dataset.resolution))
    servo = Servo(
        model.friction,
        tuple(model.effects),
        tuple(own),
        tuple(free),
        fixed_values(s.h),
        rigid,
        limits(dataset),
        credible(dataset),
    )
    return servo, values


def _of_controller(free: Sequence[Free], resolution: float) -> list[Free]:
    """Return free parameters without kp, which all else is relative to, and with what is known of
    a controller: its reading is off by a step of the sensor or so, and its lag is that of drives,
    which beside a damping the motion does not show, as J - kd lag is all that counts.
    """
    known = {
        f"{CONTROLLER.name}.offset": (0.0, resolution),
        f"{CONTROLLER.name}.lag": (USUAL_LAG, USUAL_LAG),
    }
    return [
        replace(f, nominal=known[f.name][0], prior_sd=known[f.name][1]) if f.name in known else f
        for f in free
        if f.name != f"{CONTROLLER.name}.kp"
    ]


def _of_known_torque(model: Model, free: Sequence[Free]) -> list[Free]:
    """Return free parameters with what is known of the scale of a known torque, where the input is
    one too: masses and torque constants are off by a few percent.
    """
    if model.input_kind not in ("torque", "force"):
        return list(free)
    scale = f"{KNOWN.name}.scale"
    return [replace(f, prior_sd=SCALE_SD) if f.name == scale else f for f in free]


def _bounded(model: Model, free: Free) -> Free:
    """Return a parameter within the bounds that a model gives it."""
    low, high = model.bounds.get(free.name, (free.low, free.high))
    return replace(free, low=max(low, free.low), high=min(high, free.high))


def _prior_around(effect: str, given: Mapping[str, float]) -> Iterator[Free]:
    """Give the free parameters of an effect that the model has already, each with a wide prior
    around its value there.

    A parameter at a value where it does nothing, such as an amplitude of 0 or a stop that is never
    reached, stays fixed.
    """
    inactive = {
        key
        for key, value in find_effect(effect).inactive_values.items()
        if key.removeprefix(f"{effect}.") in given
        and given[key.removeprefix(f"{effect}.")] == value
    }
    for f in free_parameters(
        effect,
        {name: value for name, value in given.items() if f"{effect}.{name}" not in inactive},
        {},
    ):
        value = given[f.name.removeprefix(f"{effect}.")]
        nominal = math.log(value) if f.factor else value
        yield (
            replace(f, nominal=nominal, prior_sd=1.0 if f.factor else 2.0 * abs(value))
            if value
            else f
        )


def _in_shorter_segments(case: PreparedCase) -> PreparedCase:
    """Return a case in segments that its model can follow, with what is said of them.

    The simulation of a light servo in a stiff loop diverges from the measured motion as soon as
    anything is missing, and its residual does not show what. Shorter segments prevent that. Where
    the sliding motion shows that much is missing, they hide it: there they come second.
    """
    dataset, base = case.dataset, case.base
    usual = asked = dataset.segments.seconds
    while has_diverged(dataset, base.fit) and asked / 2 >= SHORTEST_SHARE * usual:
        asked /= 2
        shorter = dataset_of(case.model, case.records, asked)
        if shorter.segments.seconds < dataset.segments.seconds:
            dataset = shorter
            base = fit_from_several_starts(dataset, *base_servo_of(case.model, dataset))
    seconds = dataset.segments.seconds
    if seconds == usual:
        return replace(case, otherwise=None)
    said = finding(Reason.SHORTER_SEGMENTS, usual=usual, seconds=seconds)
    return replace(case, dataset=dataset, base=base, later=(said, *case.later), otherwise=None)


def _lacks_much(dataset: Dataset, servo: Servo, values: Mapping[str, float]) -> bool:
    """Return whether the sliding motion needs a large disturbance."""
    slides = sliding_fit(dataset, servo, values)
    return slides is not None and slides.disturbance > LARGE_DISTURBANCE


def nominal_gap(dataset: Dataset, servo: Servo, values: Mapping[str, float]) -> float:
    """Return the mean squared error of a servo as it is [output squared]; NaN if every simulation
    of a segment fails.
    """
    s = dataset.segments
    problem = Problem.of(s, white_noise(s.bins, 1.0), s.counted)
    fit = evaluate(problem, FitPoint(servo.simulator(s), servo.free, dict(values), s.initial))
    live = fit.weight > 0
    return mean_square(fit, live) if live.any() else math.nan
