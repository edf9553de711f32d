"""Before the search, of a servo that is given a goal: the kind of its controller, and its gains.

The motion that slides shows both where the encoder is fine and the log fast. In any case the loop
is simulated: a loop follows its goal whatever its gains are, so that no start is too far away.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bristle.common.errors import BristleError
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
    CONTROLLER_KINDS,
    START_INTEGRAL,
    START_WEIGHT,
    controllers,
    damping_of,
    large_torques,
    parts_of,
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
LOOP_TORQUES = ("gravity", "bias")  # torques without which a loop may be far off
START_DAMPING = 0.8  # of these loops
NEAREST = 1.2  # of the least error over whole records: kinds with a larger one are left
RESCALED = 1.5  # factor of all torques from which on a loop is refitted
MOST_LOOPS = 3  # kinds that are fitted to segments, with their noise

Case = tuple[Model, Dataset, FittedModel]
Effects = Mapping[str, Mapping[str, float]]


def following_case(
    model: Model, records: Sequence[Record], notes: tuple[Line, ...], tell: Progress
) -> PreparedCase:
    """Return a model that follows a setpoint, fitted with the likeliest kind of controller."""
    tell("the controller", 0.0)
    loops, asked = _loops(model, records), model
    if "kp" in (model.controller or {}) and _at_bound(loops[0][1], records, J.name):
        model = _in_units_of_gain(model, records)
        loops = _loops(model, records)
    found = [_fitted(each, records) for each in _nearest(loops)]
    likeliest, dataset, base = max(found, key=_likelihood)
    away = _carried(likeliest) - set(model.effects)
    joint = {name: {f.name: base.fit.values[f.name] for f in base.fit.free} for name in away}
    if away:
        # the search is to find it, from what was found beside it
        own = {name: x for name, x in likeliest.effects.items() if name not in away}
        likeliest, dataset, base = _fitted(replace(likeliest, effects=own), records)
    later = _of_the_unit(asked, model, likeliest)
    return PreparedCase(likeliest, records, dataset, base, notes, later, joint=joint)


def _of_the_unit(asked: Model, model: Model, found: Model) -> tuple[Line, ...]:
    """Return what is said of the unit of torque: `model`, the one asked for in units of its kp."""
    kp, unit = (found.controller or {})["kp"], found.unit(f"{CONTROLLER.name}.kp")
    if "kp" not in (model.controller or {}):
        return (finding(Reason.RATIOS_TO_GAIN, kp=kp, unit=unit),)
    if model is asked:
        return ()
    now, bounds = model.parameters[J.name], asked.bounds[J.name]
    given = {"kp": kp, "unit": unit, "inertia": now, "inertia_unit": model.unit(J.name)}
    scale = now / asked.parameters[J.name]
    return (finding(Reason.SCALED_TO_GAIN, scale=scale, bounds=bounds, **given),)


def _nearest(loops: Sequence[tuple[float, Model]]) -> list[Model]:
    """Return the best of each kind whose error is near the least, those of the fewest parts first:
    over whole records the error is that of the disturbance, which more parts follow as well.
    """
    kinds: dict[frozenset[str], Model] = {}
    for error, each in loops:
        if error <= NEAREST * loops[0][0]:
            kinds.setdefault(parts_of(each.controller or ()) | _carried(each), each)
    return [kinds[kind] for kind in sorted(kinds, key=len)[:MOST_LOOPS]]


def _carried(model: Model) -> frozenset[str]:
    """Return the torques that a loop carries, of those without which it may be far off."""
    return frozenset(LOOP_TORQUES) & set(model.effects)


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
    return fitted.fit.total - price(model.controller or ()) - GROSS_GAIN * len(_carried(model))


def _loops(model: Model, records: Sequence[Record]) -> list[tuple[float, Model]]:
    """Give models with a controller of each kind and the error of each over whole records: the
    controllers that the sliding motion shows, the nearest of some loops, and that with a limit; the
    loops also with a torque that they carry, which a model far from it would make up for.
    """
    dataset = dataset_of(model, records)
    loops = _Loops.of(model, dataset, records)
    starts = controllers(model, slides_of(dataset))
    found = loops.of_all_kinds({}, starts)
    for torque in _torques(model, records):
        found += loops.of_all_kinds(torque)
    found.sort(key=_error)
    if not (starts or math.isfinite(found[0][0])):
        raise BristleError(
            "records: too little motion to find the controller; record longer moves of the"
            " setpoint, or give kp, ki and kd in [controller]"
        )
    return found


@dataclass(frozen=True)
class _Loops:
    """Whole records, over which a model is simulated in loops of all kinds."""

    model: Model
    dataset: Dataset
    whole: Segments
    least: float  # error that counts as none [unit of the output]

    @classmethod
    def of(cls, model: Model, dataset: Dataset, records: Sequence[Record]) -> _Loops:
        own = Records.of(dataset, records, dataset.segments.times)
        return cls(model, dataset, own.stretches(own.seconds), own.least)

    def of_all_kinds(
        self, torque: Effects, starts: Sequence[Model] = ()
    ) -> list[tuple[float, Model]]:
        """Return the refitted starts and a model with the nearest loop of each kind, also with a
        limit of its torque, with the error of each. `torque` as of `_loop`; integral action holds a
        constant one.
        """
        known, kinds = self.model.controller or {}, [*starts]
        for parts in CONTROLLER_KINDS:
            if not (set(parts) & set(known) or ("ki" in parts and "bias" in torque)):
                tries = [_loop(self.model, parts, f, torque) for f in START_FREQUENCIES]
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
        if self._holds(found):
            return math.inf, found
        if not (is_open(self.model) and math.isfinite(error)):
            return error, found
        found, factor = centred(found, self.model.parameters[J.name])
        near = 1.0 / RESCALED <= factor <= RESCALED
        return (error, found) if near else min(self._refitted(found), (error, found), key=_error)

    def _holds(self, model: Model) -> bool:
        """Return whether integral action that is not known is so slow that all it does over a
        record is to hold a constant torque: that is no controller's, but a bias that is missing.
        """
        own = model.controller or {}
        slow = own.get("ki", math.inf) * self.whole.seconds < own["kp"]
        return slow and "ki" not in (self.model.controller or {})

    def _refitted(self, model: Model) -> tuple[float, Model]:
        servo, values = base_servo_of(model, self.dataset)
        fit = refit_horizon(servo, values, self.whole, self.least)
        if fit is None:
            return math.inf, model
        own = fit.values
        controller = {key: float(own[f"{CONTROLLER.name}.{key}"]) for key in model.controller or ()}
        parameters = {key: float(own.get(key, x)) for key, x in model.parameters.items()}
        effects = {**model.effects, CONTROLLER.name: controller}
        for name in _carried(model):
            effects[name] = {key: float(own[f"{name}.{key}"]) for key in effects[name]}
        return fitted_error(fit), replace(model, parameters=parameters, effects=effects)


def _error(found: tuple[float, Model]) -> float:
    return found[0]


def _torques(model: Model, records: Sequence[Record]) -> Iterator[Effects]:
    """Give start values of torques over kp that a loop may carry, those apart that the model has,
    from what is left between goal and position.
    """
    y = np.concatenate([r.y for r in records])
    left = np.concatenate([r.u for r in records]) - y
    ahead = np.concatenate([np.sign(np.gradient(r.y)) for r in records])
    columns = np.column_stack([np.sin(y), np.cos(y), ahead, np.ones(len(y))])
    (sine, cosine, *_, constant), *_ = np.linalg.lstsq(columns, left, rcond=None)
    gravity = {"amplitude": math.hypot(sine, cosine), "phase": math.atan2(cosine, sine)}
    if not (model.linear or "gravity" in model.effects):
        defaults = find_effect("gravity").inactive_values.items()
        shape = {name.partition(".")[2]: value for name, value in defaults}
        yield {"gravity": gravity | shape}
    if "bias" not in model.effects:
        yield {"bias": {"torque": -float(constant)}}


def _loop(model: Model, parts: Sequence[str], frequency: float, torque: Effects) -> Model:
    """Return a model with a controller of these parts, and a loop of about this frequency, which
    carries a torque: an effect with its parameters, its strength over kp; empty for none.
    """
    inertia, omega = model.parameters[J.name], 2 * math.pi * frequency
    known = model.controller or {}
    kp = known.get("kp", inertia * omega**2)
    damping = 2 * START_DAMPING * math.sqrt(inertia * kp)
    own: dict[str, float] = {"kp": kp, **BESIDE_ALL}
    parameters = dict(model.parameters)
    if "kd" in parts:
        own |= damping_of(model, damping)
    else:
        low, high = model.bounds.get(A2.name, (0.0, math.inf))
        parameters[A2.name] = min(max(damping, low), high)
    if "ki" in parts:
        own |= {"ki": START_INTEGRAL * kp, "integral": 0.0}
    if "weight" in parts:
        own["weight"] = START_WEIGHT
    effects = {**model.effects, CONTROLLER.name: own | known}
    for name, values in torque.items():
        strength = find_effect(name).strength.name.partition(".")[2]
        effects[name] = {**values, strength: kp * values[strength]}
    return replace(model, parameters=parameters, effects=effects)


def _limited(model: Model, over: Stretches) -> Iterator[Model]:
    """Give a model with limits of the torque that it asks for."""
    own = model.controller or {}
    for limit in large_torques(tuple(model.effects), model.settings(), over):
        yield replace(model, effects={**model.effects, CONTROLLER.name: {**own, "limit": limit}})
