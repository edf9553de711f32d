"""Before the search: records as segments, the servo that a model describes, and its fit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from bristle.common.errors import BristleError
from bristle.diagnosis.checks.excitation import excitation
from bristle.diagnosis.checks.input_hold import SLOW_SAMPLING
from bristle.diagnosis.estimation.dataset import Dataset, FittedModel, base_servo, fit_from_several_starts
from bristle.diagnosis.estimation.likelihood import evaluate, mean_square
from bristle.diagnosis.estimation.noise import Noise
from bristle.diagnosis.estimation.segments import SEGMENT_BINS, SEGMENT_SECONDS, STATE_SMOOTHING, Segments, cut, motion, smooth
from bristle.diagnosis.estimation.simulator import BRISTLE_EFFECTS, OWN_BRISTLES, Free, Servo, free_parameters, inactive_values
from bristle.diagnosis.localisation.views import TURN_EFFECTS
from bristle.diagnosis.modelfile import NO_LIMIT, Model
from bristle.plant.friction import law as find_law
from bristle.records.record import Record

SHORTEST_SEGMENT = 0.1  # s: in less, friction and inertia hardly show
LONGEST_INTERNAL_STEP = 1e-3  # s: longest internal step
SMOOTH_LAW_TOLERANCE = 1e-5  # of smooth laws: far below what a record can tell
SWALLOWED_SHARE = 0.8  # of the time, in which a dead zone may hold the input back, or a saturation be reached
MOSTLY_SWALLOWED = 0.5  # of the time: a dead zone that swallows more says that the input does next to nothing
STRIBECK_SPEED_SHARE = 0.25  # of the top speed, but for rare ones: up to there a Stribeck curve must have fallen
POLE_SHARE = 0.25  # of a segment: the slowest electrical pole
EDGE_SHARE = 0.05  # of the time, at either end, in which no step is looked for; of speeds, that are rare


def dataset_of(model: Model, records: Sequence[Record], seconds: float = SEGMENT_SECONDS) -> Dataset:
    """Return the records as segments of so many seconds with their smoothed motion."""
    h, velocity = records[0].h, model.output_kind == "velocity"
    length = max(8, round(seconds / h))
    width = max(1, length // SEGMENT_BINS)
    bins = length // width
    long = [r for r in records if len(r) >= 3 * length]
    if not long:
        raise BristleError(f"records: none lasts three segments of {length * h:g} s; give longer ones")
    resolution = model.resolution or max(r.resolution or 0.0 for r in records)
    noise = float(np.median([np.std(r.y - smooth(r.y, h, 3 * h)) for r in long]))
    resolution = resolution or max(noise, 1e-12)
    pieces = [cut(r.name, float(r.time[0]), h, r.u, r.y, velocity, resolution, width, bins) for r in long]
    segments = Segments(tuple(pieces), h, width, bins, velocity)
    least = resolution / math.sqrt(12 * width) / 3
    moved = motion(segments, [r.y for r in long], resolution, max(STATE_SMOOTHING / 2, 2 * h))
    barred = {"stribeck": f"the law '{model.friction}' has a Stribeck curve of its own"} if _falls(model) else {}
    doubtful = h >= SLOW_SAMPLING and not any(r.ahead for r in records)
    dataset = Dataset(segments, moved, resolution, least, excitation(model, records)["narrow"], barred, doubtful=doubtful)
    if not model.linear:
        return dataset
    barred |= {name: "needs a shaft that turns: this axis is linear" for name in TURN_EFFECTS}
    return replace(dataset, barred=barred, linear=True, turn=float(np.ptp(moved.theta)))


def _falls(model: Model) -> bool:
    """True if the friction of the law itself falls with the speed: it has a static friction."""
    return any(p.name.endswith(".Fs") for p in find_law(model.friction).parameters)


def limits(dataset: Dataset) -> dict[str, tuple[float, float]]:
    """Return how far parameters of effects may move on this axis and in these records.

    Periods: at least two in a turn or, on a linear axis, in the range that was travelled; fewer are no ripple, but any
    slow change with the position. (Friction that changes once in a turn has a cause in a shaft.) A step: where enough is
    seen before and after, else it is a bias with a few odd segments. A stop: touched less than half of the time, else it
    is a spring or a bias. A dead zone or a saturation: one that swallows nearly the whole input, or leaves only its sign,
    says that the input explains nothing. A Stribeck curve: one that has fallen well within the speeds that are seen, else it
    is a drag by another name. An electrical pole: several times faster than a segment lasts, else it is an integrator.
    """
    s, least = dataset.segments, 2 * 2 * math.pi / dataset.turn
    periodic = ("cogging.periods", "position_friction.periods") if dataset.linear else ("cogging.periods",)
    first, last = np.quantile(dataset.motion.time, [EDGE_SHARE, 1 - EDGE_SHARE])
    middle = float(np.median(dataset.motion.theta))
    least_u, most_u = np.quantile(np.abs(dataset.motion.u), [1 - SWALLOWED_SHARE, SWALLOWED_SHARE])
    return {
        "dead_zone.width": (0.0, float(most_u)),
        "disturbance_step.onset": (float(first), float(last)),
        "hard_stop.upper": (middle, math.inf),
        "hard_stop.lower": (-math.inf, middle),
        "saturation.limit": (float(least_u), math.inf),
        "electrical_pole.time_constant": (0.0, POLE_SHARE * s.seconds),
        "stribeck.speed": (0.0, STRIBECK_SPEED_SHARE * float(np.quantile(np.abs(dataset.motion.v), 1 - EDGE_SHARE))),
        **{name: (least, math.inf) for name in periodic},
    }


def credible(dataset: Dataset) -> dict[str, tuple[float, float]]:
    """Return the intervals of parameters beyond which an effect must be beyond doubt."""
    return {"dead_zone.width": (0.0, float(np.quantile(np.abs(dataset.motion.u), MOSTLY_SWALLOWED)))}


def fixed_values(h: float) -> dict[str, float]:
    """Return the settings of the simulation for a sampling period."""
    step = h / math.ceil(h / LONGEST_INTERNAL_STEP - 1e-9)
    return {"solver.friction_step": step, "solver.tolerance": SMOOTH_LAW_TOLERANCE, "u_max": NO_LIMIT}


def base_servo_of(model: Model, dataset: Dataset) -> tuple[Servo, dict[str, float]]:
    """Return the servo that a model describes, its own effects included, and the values it starts from."""
    s = dataset.segments
    step = dataset.resolution * (s.h if s.velocity else 1.0)
    servo, values = base_servo(model.friction, {"b": 1.0, **model.parameters}, model.bounds, fixed_values(s.h), step)
    rigid = servo.rigid and not set(model.effects) & set(BRISTLE_EFFECTS)
    free = tuple(f for f in servo.free if rigid or not f.name.startswith(f"{OWN_BRISTLES}."))
    own = {f"{effect}.{name}": value for effect, given in model.effects.items() for name, value in given.items()}
    more = tuple(f for effect, given in model.effects.items() for f in _held(effect, given))
    servo = replace(
        servo, effects=tuple(model.effects), free=(*free, *more), rigid=rigid, limits=limits(dataset), credible=credible(dataset),
    )  # fmt: skip
    return servo, {**values, **own}


def _held(effect: str, given: Mapping[str, float]) -> Iterator[Free]:
    """Give the free parameters of an effect that the model has already, loosely held by their values there.

    A parameter at a value where it does nothing, such as an amplitude of 0 or a stop that is never reached, stays.
    """
    resting = {key for key, value in inactive_values(effect).items() if given[key.removeprefix(f"{effect}.")] == value}
    for f in free_parameters(effect, {name: value for name, value in given.items() if f"{effect}.{name}" not in resting}, {}):
        value = given[f.name.removeprefix(f"{effect}.")]
        known = math.log(value) if f.factor else value
        yield replace(f, nominal=known, doubt=1.0 if f.factor else 2.0 * abs(value)) if value else f


def prepare_model(model: Model, records: Sequence[Record], dataset: Dataset) -> tuple[Dataset, FittedModel, list[str]]:
    """Return the records in segments that the model can follow, the model fitted to them, and findings.

    A light servo in a stiff loop runs away from what was measured as soon as anything is missing; what it does then says
    nothing of what that is. Shorter segments do.
    """
    usual, asked = dataset.segments.seconds, SEGMENT_SECONDS
    base = fit_from_several_starts(dataset, *base_servo_of(model, dataset))
    while dataset.away(base.fit) and asked / 2 >= SHORTEST_SEGMENT:
        asked /= 2
        shorter = dataset_of(model, records, asked)
        if shorter.segments.seconds < dataset.segments.seconds:
            dataset, base = shorter, fit_from_several_starts(shorter, *base_servo_of(model, shorter))
    seconds = dataset.segments.seconds
    line = f"the model runs away from these records within {usual:.3g} s: it was compared over {seconds:.3g} s at a time"
    return dataset, base, [line] if seconds < usual else []


def nominal_gap(dataset: Dataset, servo: Servo, values: Mapping[str, float]) -> float:
    """Return the mean squared error of a servo as it is [output squared]; NaN if it cannot follow the records at all."""
    white = Noise(np.eye(dataset.segments.bins), 0.0, 0.0, 1.0, 1.0)
    problem = dataset.problem(white, dataset.segments.judged)
    fit = evaluate(problem, servo.simulator(dataset.segments), servo.free, dict(values), dataset.segments.starts)
    live = fit.weight > 0
    return mean_square(fit, live) if live.any() else math.nan
