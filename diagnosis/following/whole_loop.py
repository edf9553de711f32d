"""Before the search, of a servo that is given a goal: the kind of its controller, and its gains.

The motion that slides shows both where the encoder is fine and the log fast. In any case the loop
is simulated: a loop follows its goal whatever its gains are, so that no start is too far away.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bristle.common.progress import Progress
from bristle.diagnosis.answer import Line, Reason, finding
from bristle.diagnosis.checks.preparation import (
    PreparedCase,
    base_servo_of,
    dataset_of,
    slides_of,
)
from bristle.diagnosis.estimation.dataset import Dataset, Segments
from bristle.diagnosis.estimation.fitted_model import FittedModel, fit_with_noise
from bristle.diagnosis.following.controller import (
    BESIDE_ALL,
    KINDS,
    START_FORWARD,
    START_INTEGRAL,
    START_WEIGHT,
    controllers,
    large_torques,
    price,
)
from bristle.diagnosis.following.torque_unit import centred, is_open, with_inertia
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.sliding.screen import GROSS_GAIN
from bristle.diagnosis.sliding.stretches import Stretches
from bristle.diagnosis.validation.long_simulation import (
    Records,
    fitted_error,
    refit_horizon,
    with_fitted_starts,
)
from bristle.plant.controller import CONTROLLER
from bristle.plant.effects import effect as find_effect
from bristle.plant.servo import A2, J
from bristle.records.record import Record

START_FREQUENCIES = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # Hz: of the loops that are simulated at first
GRAVITY = "gravity"  # the torque without which a loop may be far off
START_DAMPING = 0.8  # of these loops
NEAREST = 1.2  # of the least error over whole records: kinds with a larger one are left
RESCALED = 1.5  # factor of all torques from which on a loop is refitted
MOST_LOOPS = 3  # kinds that are fitted to segments, with their noise

Case = tuple[Model, Dataset, FittedModel]


def following_case(
    model: Model, records: Sequence[Record], notes: tuple[Line, ...], tell: Progress
) -> PreparedCase:
    """Return a model that follows a setpoint, fitted with the likeliest kind of controller."""
    tell("the controller", 0.0)
    loops, asked = _loops(model, records), model
    if "kp" in (model.controller or {}) and _at_bound(loops[0][1], records, J.name):
        model = _in_units_of_gain(model, records)
        loops = _loops(model, records)
    near = [each for error, each in loops if error <= NEAREST * loops[0][0]][:MOST_LOOPS]
    found = [_fitted(each, records) for each in near]
    likeliest, dataset, base = max(found, key=_likelihood)
    if GRAVITY in set(likeliest.effects) - set(model.effects):
        # the search is to find it, from what was found beside it
        likeliest, dataset, base = _fitted(_without_weight(likeliest), records)
    kp = (likeliest.controller or {})["kp"]
    unit = model.unit(f"{CONTROLLER.name}.kp")
    if "kp" not in (model.controller or {}):
        later: tuple[Line, ...] = (finding(Reason.RATIOS_TO_GAIN, kp=kp, unit=unit),)
    elif model is not asked:
        low, high = asked.bounds[J.name]
        now = model.parameters[J.name]
        scale = now / asked.parameters[J.name]
        given = {"kp": kp, "unit": unit, "inertia": now, "inertia_unit": model.unit(J.name)}
        later = (finding(Reason.SCALED_TO_GAIN, scale=scale, bounds=(low, high), **given),)
    else:
        later = ()
    return PreparedCase(likeliest, records, dataset, base, notes, later)


def _at_bound(model: Model, records: Sequence[Record], name: str) -> bool:
    """True if a parameter of a model is at an end of its bounds."""
    servo, values = base_servo_of(model, dataset_of(model, records))
    return any(f.at_binding_bound(values[f.name]) for f in servo.free if f.name == name)


def _in_units_of_gain(model: Model, records: Sequence[Record]) -> Model:
    """Return a model whose inertia, damping and friction, with their bounds, are all scaled so that
    the inertia is the one that the records show under the gain that is given.
    """
    given = (model.controller or {})["kp"]
    free = replace(model, effects={**model.effects, CONTROLLER.name: {}})
    _, found = _loops(free, records)[0]
    kp = (found.controller or {})["kp"]
    return with_inertia(model, given / kp * found.parameters[J.name])


def _fitted(model: Model, records: Sequence[Record]) -> Case:
    dataset = dataset_of(model, records)
    return model, dataset, fit_with_noise(dataset, *base_servo_of(model, dataset))


def _likelihood(case: Case) -> float:
    model, _, fitted = case
    weight = GROSS_GAIN if GRAVITY in model.effects else 0.0
    return fitted.fit.total - price(model.controller or ()) - weight


def _loops(model: Model, records: Sequence[Record]) -> list[tuple[float, Model]]:
    """Give models with a controller of each kind and the error of each over whole records: the
    controllers that the sliding motion shows, the nearest of some loops, and that with a limit; the
    loops also with a weight that they carry, which a model far from it would make up for.
    """
    dataset = dataset_of(model, records)
    loops = _Loops.of(model, dataset, records)
    found = loops.of_all_kinds(model, {}, controllers(model, slides_of(dataset)))
    if not (model.linear or GRAVITY in model.effects):
        found += loops.of_all_kinds(model, _weight(records))
    return sorted(found, key=_error)


@dataclass(frozen=True)
class _Loops:
    """Whole records, over which models are simulated in their loops."""

    dataset: Dataset
    whole: Segments
    least: float  # error that counts as none [unit of the output]
    nominal: float | None  # inertia, where the unit of torque is open

    @classmethod
    def of(cls, model: Model, dataset: Dataset, records: Sequence[Record]) -> _Loops:
        own = Records.of(dataset, records, dataset.segments.times)
        nominal = model.parameters[J.name] if is_open(model) else None
        return cls(dataset, own.stretches(own.seconds), own.least, nominal)

    def of_all_kinds(
        self, model: Model, weight: Mapping[str, float], starts: Sequence[Model] = ()
    ) -> list[tuple[float, Model]]:
        """Return the refitted starts and a model with the nearest loop of each kind, also with a
        limit of its torque, with the error of each. `weight` as of `_loop`.
        """
        known, kinds = model.controller or {}, [*starts]
        for parts in KINDS:
            if not set(parts) & set(known):
                tries = [_loop(model, parts, f, weight) for f in START_FREQUENCIES]
                kinds.append(min(tries, key=self.error))
        found = [self.refitted(each) for each in kinds]
        if "limit" not in known:
            nearest = min(found, key=_error)[1]
            limited = _limited(nearest, self.dataset.stretches)
            found += [self.refitted(each) for each in limited]
        return found

    def error(self, model: Model) -> float:
        """Return the rms error of a model [unit of the output]; infinite where its simulation
        fails.
        """
        servo, values = base_servo_of(model, self.dataset)
        return fitted_error(with_fitted_starts(servo, values, self.whole, self.least))

    def refitted(self, model: Model) -> tuple[float, Model]:
        """Return the rms error of a model refitted to whole records, and that model; where nothing
        gives the unit of torque, in one that leaves all parameters room.
        """
        error, found = self._refitted(model)
        if self.nominal is None or not math.isfinite(error):
            return error, found
        found, factor = centred(found, self.nominal)
        near = 1.0 / RESCALED <= factor <= RESCALED
        return (error, found) if near else min(self._refitted(found), (error, found), key=_error)

    def _refitted(self, model: Model) -> tuple[float, Model]:
        servo, values = base_servo_of(model, self.dataset)
        fit = refit_horizon(servo, values, self.whole, self.least)
        if fit is None:
            return math.inf, model
        own = fit.values
        controller = {key: float(own[f"{CONTROLLER.name}.{key}"]) for key in model.controller or ()}
        parameters = {key: float(own.get(key, x)) for key, x in model.parameters.items()}
        effects = {**model.effects, CONTROLLER.name: controller}
        if GRAVITY in effects:
            effects[GRAVITY] = {key: own[f"{GRAVITY}.{key}"] for key in effects[GRAVITY]}
        return fitted_error(fit), replace(model, parameters=parameters, effects=effects)


def _error(found: tuple[float, Model]) -> float:
    return found[0]


def _weight(records: Sequence[Record]) -> dict[str, float]:
    """Return start values of gravity over kp, from what is left between goal and position."""
    y = np.concatenate([r.y for r in records])
    left = np.concatenate([r.u for r in records]) - y
    ahead = np.concatenate([np.sign(np.gradient(r.y)) for r in records])
    columns = np.column_stack([np.sin(y), np.cos(y), ahead, np.ones(len(y))])
    (sine, cosine, *_), *_ = np.linalg.lstsq(columns, left, rcond=None)
    defaults = find_effect(GRAVITY).inactive_values.items()
    shape = {name.partition(".")[2]: value for name, value in defaults}
    return {"amplitude": math.hypot(sine, cosine), "phase": math.atan2(cosine, sine), **shape}


def _without_weight(model: Model) -> Model:
    return replace(model, effects={k: x for k, x in model.effects.items() if k != GRAVITY})


def _loop(
    model: Model, parts: Sequence[str], frequency: float, weight: Mapping[str, float]
) -> Model:
    """Return a model with a controller of these parts, and a loop of about this frequency, which
    carries a weight: parameters of gravity, its amplitude over kp; empty for none.
    """
    inertia, omega = model.parameters[J.name], 2 * math.pi * frequency
    known = model.controller or {}
    kp = known.get("kp", inertia * omega**2)
    damping = 2 * START_DAMPING * math.sqrt(inertia * kp)
    own: dict[str, float] = {"kp": kp, **BESIDE_ALL}
    parameters = dict(model.parameters)
    if "kd" in parts:
        own |= {"kd": damping, "forward": START_FORWARD}
    else:
        low, high = model.bounds.get(A2.name, (0.0, math.inf))
        parameters[A2.name] = min(max(damping, low), high)
    if "ki" in parts:
        own |= {"ki": START_INTEGRAL * kp, "integral": 0.0}
    if "weight" in parts:
        own["weight"] = START_WEIGHT
    effects = {**model.effects, CONTROLLER.name: own | known}
    if weight:
        effects[GRAVITY] = {**weight, "amplitude": kp * weight["amplitude"]}
    return replace(model, parameters=parameters, effects=effects)


def _limited(model: Model, over: Stretches) -> Iterator[Model]:
    """Give a model with limits of the torque that it asks for."""
    own = model.controller or {}
    for limit in large_torques(tuple(model.effects), model.settings(), over):
        yield replace(model, effects={**model.effects, CONTROLLER.name: {**own, "limit": limit}})
