"""Before the search, of a servo that is given a goal: the kind of its controller, and its gains.

The motion that slides shows both where the encoder is fine and the log fast. In any case the loop
is simulated: a loop follows its goal whatever its gains are, so that no start is too far away.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from bristle.diagnosis.answer import Line, Progress, Reason, finding
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
    START_INTEGRAL,
    controllers,
    large_torques,
    price,
)
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.sliding.stretches import Stretches
from bristle.diagnosis.validation.long_simulation import (
    Records,
    fitted_error,
    refit_horizon,
    with_fitted_starts,
)
from bristle.plant.controller import CONTROLLER
from bristle.plant.servo import A2, J
from bristle.records.record import Record

START_FREQUENCIES = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # Hz: of the loops that are simulated at first
START_DAMPING = 0.8  # of these loops
ACTIONS = ((), ("kd",), ("ki",), ("kd", "ki"))  # parts of a controller beside kp
NEAREST = 1.2  # of the least error over whole records: kinds with a larger one are left
MOST_LOOPS = 3  # kinds that are fitted to segments, with their noise

Case = tuple[Model, Dataset, FittedModel]


def following_case(
    model: Model, records: Sequence[Record], notes: tuple[Line, ...], tell: Progress
) -> PreparedCase:
    """Return a model that follows a setpoint, fitted with the likeliest kind of controller."""
    tell("the controller", 0.0)
    loops = sorted(_loops(model, records), key=lambda each: each[0])
    near = [each for error, each in loops if error <= NEAREST * loops[0][0]][:MOST_LOOPS]
    found = [_fitted(each, records) for each in near]
    likeliest, dataset, base = max(found, key=_likelihood)
    kp = (likeliest.controller or {})["kp"]
    said = finding(Reason.RATIOS_TO_GAIN, kp=kp, unit=model.unit(f"{CONTROLLER.name}.kp"))
    return PreparedCase(likeliest, records, dataset, base, notes, (said,))


def _fitted(model: Model, records: Sequence[Record]) -> Case:
    dataset = dataset_of(model, records)
    return model, dataset, fit_with_noise(dataset, *base_servo_of(model, dataset))


def _likelihood(case: Case) -> float:
    model, _, fitted = case
    return fitted.fit.total - price(model.controller or ())


def _loops(model: Model, records: Sequence[Record]) -> Iterator[tuple[float, Model]]:
    """Give models with a controller of each kind and the error of each over whole records: the
    controllers that the sliding motion shows, the nearest of some loops, and that with a limit.
    """
    known, loops = model.controller or {}, _Loops.of(dataset_of(model, records), records)
    starts = controllers(model, slides_of(model, records))
    for parts in ACTIONS:
        if not set(parts) & set(known):
            tries = [_loop(model, parts, frequency) for frequency in START_FREQUENCIES]
            starts.append(min(tries, key=loops.error))
    best = math.inf, model
    for start in starts:
        found = loops.refitted(start)
        best = min(best, found, key=lambda each: each[0])
        yield found
    if "limit" not in known:
        for limited in _limited(best[1], loops.dataset.stretches):
            yield loops.refitted(limited)


@dataclass(frozen=True)
class _Loops:
    """Whole records, over which models are simulated in their loops."""

    dataset: Dataset
    whole: Segments
    least: float  # error that counts as none [unit of the output]

    @classmethod
    def of(cls, dataset: Dataset, records: Sequence[Record]) -> _Loops:
        own = Records.of(dataset, records, dataset.segments.times)
        return cls(dataset, own.stretches(own.seconds), own.least)

    def error(self, model: Model) -> float:
        """Return the rms error of a model [unit of the output]; infinite where its simulation
        fails.
        """
        servo, values = base_servo_of(model, self.dataset)
        return fitted_error(with_fitted_starts(servo, values, self.whole, self.least))

    def refitted(self, model: Model) -> tuple[float, Model]:
        """Return the rms error of a model refitted to whole records, and that model."""
        servo, values = base_servo_of(model, self.dataset)
        fit = refit_horizon(servo, values, self.whole, self.least)
        if fit is None:
            return math.inf, model
        own = fit.values
        controller = {key: float(own[f"{CONTROLLER.name}.{key}"]) for key in model.controller or ()}
        parameters = {key: float(own.get(key, x)) for key, x in model.parameters.items()}
        effects = {**model.effects, CONTROLLER.name: controller}
        return fitted_error(fit), replace(model, parameters=parameters, effects=effects)


def _loop(model: Model, parts: Sequence[str], frequency: float) -> Model:
    """Return a model with a controller of these parts, and a loop of about this frequency."""
    inertia, omega = model.parameters[J.name], 2 * math.pi * frequency
    known = model.controller or {}
    kp = known.get("kp", inertia * omega**2)
    damping = 2 * START_DAMPING * math.sqrt(inertia * kp)
    own: dict[str, float] = {"kp": kp, **BESIDE_ALL}
    parameters = dict(model.parameters)
    if "kd" in parts:
        own["kd"] = damping
    else:
        low, high = model.bounds.get(A2.name, (0.0, math.inf))
        parameters[A2.name] = min(max(damping, low), high)
    if "ki" in parts:
        own |= {"ki": START_INTEGRAL * kp, "integral": 0.0}
    controller = {CONTROLLER.name: own | known}
    return replace(model, parameters=parameters, effects={**model.effects, **controller})


def _limited(model: Model, over: Stretches) -> Iterator[Model]:
    """Give a model with limits of the torque that it asks for."""
    own = model.controller or {}
    for limit in large_torques(tuple(model.effects), model.settings(), over):
        yield replace(model, effects={**model.effects, CONTROLLER.name: {**own, "limit": limit}})
