"""Before the search: records as segments, the servo that a model describes, and its fit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from bristle.diagnosis.bench import Bench, Stage, base_servo, settle_well
from bristle.diagnosis.candidates import ELASTIC, RIGID, Servo, freedom, idle
from bristle.diagnosis.excitation import excitation
from bristle.diagnosis.feed import SLOW
from bristle.diagnosis.fit import Free, evaluate
from bristle.diagnosis.lens import motion
from bristle.diagnosis.modelfile import NO_LIMIT, Model
from bristle.diagnosis.noise import Noise
from bristle.diagnosis.record import Record
from bristle.diagnosis.segments import BINS, SEGMENT, SMOOTH, Segments, cut, smooth
from bristle.diagnosis.size import mean_square
from bristle.diagnosis.views import ONCE
from bristle.model.errors import BristleError
from bristle.plant.friction import law as find_law

SHORTEST = 0.1  # s: in less, friction and inertia hardly show
STEP = 1e-3  # s: longest internal step
TOLERANCE = 1e-5  # of smooth laws: far below what a record can tell
SWALLOWED = 0.8  # of the time, in which a dead zone may hold the input back, or a saturation be reached
MOSTLY = 0.5  # of the time: a dead zone that swallows more says that the input does next to nothing
FALLEN = 0.25  # of the top speed, but for rare ones: up to there a Stribeck curve must have fallen
POLE = 0.25  # of a segment: the slowest electrical pole
EDGE = 0.05  # of the time, at either end, in which no step is looked for; of speeds, that are rare


def bench_of(model: Model, records: Sequence[Record], seconds: float = SEGMENT) -> Bench:
    """Return the records as segments of so many seconds with their smoothed motion."""
    h, velocity = records[0].h, model.output_kind == "velocity"
    length = max(8, round(seconds / h))
    width = max(1, length // BINS)
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
    moved = motion(segments, [r.y for r in long], resolution, max(SMOOTH / 2, 2 * h))
    barred = {"stribeck": f"the law '{model.friction}' has a Stribeck curve of its own"} if _falls(model) else {}
    doubtful = h >= SLOW and not any(r.ahead for r in records)
    bench = Bench(segments, moved, resolution, least, excitation(model, records)["narrow"], barred, doubtful=doubtful)
    if not model.linear:
        return bench
    barred |= {name: "needs a shaft that turns: this axis is linear" for name in ONCE}
    return replace(bench, barred=barred, linear=True, turn=float(np.ptp(moved.theta)))


def _falls(model: Model) -> bool:
    """True if the friction of the law itself falls with the speed: it has a static friction."""
    return any(p.name.endswith(".Fs") for p in find_law(model.friction).parameters)


def limits(bench: Bench) -> dict[str, tuple[float, float]]:
    """Return how far parameters of effects may move on this axis and in these records.

    Periods: at least two in a turn or, on a linear axis, in the range that was travelled; fewer are no ripple, but any
    slow change with the position. (Friction that changes once in a turn has a cause in a shaft.) A step: where enough is
    seen before and after, else it is a bias with a few odd segments. A stop: touched less than half of the time, else it
    is a spring or a bias. A dead zone or a saturation: one that swallows nearly the whole input, or leaves only its sign,
    says that the input explains nothing. A Stribeck curve: one that has fallen well within the speeds that are seen, else it
    is a drag by another name. An electrical pole: several times faster than a segment lasts, else it is an integrator.
    """
    s, least = bench.segments, 2 * 2 * math.pi / bench.turn
    periodic = ("cogging.periods", "position_friction.periods") if bench.linear else ("cogging.periods",)
    first, last = np.quantile(bench.motion.time, [EDGE, 1 - EDGE])
    middle = float(np.median(bench.motion.theta))
    least_u, most_u = np.quantile(np.abs(bench.motion.u), [1 - SWALLOWED, SWALLOWED])
    return {
        "dead_zone.width": (0.0, float(most_u)),
        "disturbance_step.onset": (float(first), float(last)),
        "hard_stop.upper": (middle, math.inf),
        "hard_stop.lower": (-math.inf, middle),
        "saturation.limit": (float(least_u), math.inf),
        "electrical_pole.time_constant": (0.0, POLE * s.seconds),
        "stribeck.speed": (0.0, FALLEN * float(np.quantile(np.abs(bench.motion.v), 1 - EDGE))),
        **{name: (least, math.inf) for name in periodic},
    }


def credible(bench: Bench) -> dict[str, tuple[float, float]]:
    """Return the intervals of parameters beyond which an effect must be beyond doubt."""
    return {"dead_zone.width": (0.0, float(np.quantile(np.abs(bench.motion.u), MOSTLY)))}


def fixed_values(h: float) -> dict[str, float]:
    """Return the settings of the simulation for a sampling period."""
    step = h / math.ceil(h / STEP - 1e-9)
    return {"solver.friction_step": step, "solver.tolerance": TOLERANCE, "u_max": NO_LIMIT}


def base_of(model: Model, bench: Bench) -> tuple[Servo, dict[str, float]]:
    """Return the servo that a model describes, its own effects included, and the values it starts from."""
    s = bench.segments
    step = bench.resolution * (s.h if s.velocity else 1.0)
    servo, values = base_servo(model.friction, {"b": 1.0, **model.parameters}, model.bounds, fixed_values(s.h), step)
    rigid = servo.rigid and not set(model.effects) & set(ELASTIC)
    free = tuple(f for f in servo.free if rigid or not f.name.startswith(f"{RIGID}."))
    own = {f"{effect}.{name}": value for effect, given in model.effects.items() for name, value in given.items()}
    more = tuple(f for effect, given in model.effects.items() for f in _held(effect, given))
    servo = replace(
        servo, effects=tuple(model.effects), free=(*free, *more), rigid=rigid, limits=limits(bench), credible=credible(bench),
    )  # fmt: skip
    return servo, {**values, **own}


def _held(effect: str, given: Mapping[str, float]) -> Iterator[Free]:
    """Give the free parameters of an effect that the model has already, loosely held by their values there.

    A parameter at a value where it does nothing, such as an amplitude of 0 or a stop that is never reached, stays.
    """
    resting = {key for key, value in idle(effect).items() if given[key.removeprefix(f"{effect}.")] == value}
    for f in freedom(effect, {name: value for name, value in given.items() if f"{effect}.{name}" not in resting}, {}):
        value = given[f.name.removeprefix(f"{effect}.")]
        known = math.log(value) if f.factor else value
        yield replace(f, nominal=known, doubt=1.0 if f.factor else 2.0 * abs(value)) if value else f


def prepared(model: Model, records: Sequence[Record], bench: Bench) -> tuple[Bench, Stage, list[str]]:
    """Return the records in segments that the model can follow, the model fitted to them, and findings.

    A light servo in a stiff loop runs away from what was measured as soon as anything is missing; what it does then says
    nothing of what that is. Shorter segments do.
    """
    usual, asked = bench.segments.seconds, SEGMENT
    base = settle_well(bench, *base_of(model, bench))
    while bench.away(base.fit) and asked / 2 >= SHORTEST:
        asked /= 2
        shorter = bench_of(model, records, asked)
        if shorter.segments.seconds < bench.segments.seconds:
            bench, base = shorter, settle_well(shorter, *base_of(model, shorter))
    seconds = bench.segments.seconds
    line = f"the model runs away from these records within {usual:.3g} s: it was compared over {seconds:.3g} s at a time"
    return bench, base, [line] if seconds < usual else []


def nominal_gap(bench: Bench, servo: Servo, values: Mapping[str, float]) -> float:
    """Return the mean squared error of a servo as it is [output squared]; NaN if it cannot follow the records at all."""
    white = Noise(np.eye(bench.segments.bins), 0.0, 0.0, 1.0, 1.0)
    problem = bench.problem(white, bench.segments.judged)
    fit = evaluate(problem, servo.simulator(bench.segments), servo.free, dict(values), bench.segments.starts)
    live = fit.weight > 0
    return mean_square(fit, live) if live.any() else math.nan
