"""The unit of torque of a servo that is given a goal: without a measured torque, inertia, damping,
friction and the controller's gains may all be scaled alike.
"""

from __future__ import annotations

import re
from dataclasses import replace

from bristle.diagnosis.modelfile import Model
from bristle.plant.controller import CONTROLLER
from bristle.plant.servo import J

ROOM = 2.0  # at least, between a parameter and the upper end of its bounds


def is_open(model: Model) -> bool:
    """Return whether nothing that is known of the controller gives the unit."""
    return not any(_is_torque(model, f"{CONTROLLER.name}.{key}") for key in model.controller or ())


def scaled(model: Model, factor: float) -> Model:
    """Return a model with all torques times a factor; its bounds stay."""
    effects = {
        name: {
            key: x * (factor if _is_torque(model, f"{name}.{key}") else 1.0)
            for key, x in own.items()
        }
        for name, own in model.effects.items()
    }
    return replace(model, parameters=_times(model, factor), effects=effects)


def centred(model: Model, nominal: float) -> tuple[Model, float]:
    """Return a model scaled so that its inertia is the nominal one, or as near to it as the bounds
    of all that is scaled allow, and by which factor.
    """
    room = [
        high / model.parameters[name]
        for name, (_, high) in model.bounds.items()
        if model.parameters.get(name, 0.0) > 0.0 and _is_torque(model, name)
    ]
    factor = min([nominal / model.parameters[J.name], *(each / ROOM for each in room)])
    return scaled(model, factor), factor


def with_inertia(model: Model, inertia: float) -> Model:
    """Return a model whose parameters, with their bounds, are scaled so that its inertia is this
    one [kg.m2]; its controller stays.
    """
    factor = inertia / model.parameters[J.name]
    bounds = {
        name: (low * factor, high * factor) if _is_torque(model, name) else (low, high)
        for name, (low, high) in model.bounds.items()
    }
    return replace(model, parameters=_times(model, factor), bounds=bounds)


def _times(model: Model, factor: float) -> dict[str, float]:
    return {k: x * (factor if _is_torque(model, k) else 1.0) for k, x in model.parameters.items()}


def _is_torque(model: Model, name: str) -> bool:
    """Return whether a parameter is proportional to all torques: its unit has that of a force."""
    return re.split(r"[./]", model.unit(name))[0] in ("N", "kg")
