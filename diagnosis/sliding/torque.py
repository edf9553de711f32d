"""The torque of a servo that slides, as a function of its motion and input."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache

import casadi as ca
import numpy as np

from bristle.common.errors import NotStaticError
from bristle.common.table import Array
from bristle.diagnosis.sliding.stretches import Stretches
from bristle.model.python import for_arrays
from bristle.model.system import System
from bristle.plant.effect import Effect
from bristle.plant.effects import effect as find_effect
from bristle.plant.friction import law as find_law
from bristle.plant.servo import servo

Names = tuple[str, ...]
MOTION = ("theta", "v", "u", "time")


@lru_cache(maxsize=128)
def _function(
    law: str, effects: Names, free: Names
) -> tuple[Callable[[list[Array | float]], list[Array]], Mapping[str, float]]:
    """Return the torque without inertia and viscous friction, and its slopes by free parameters, as
    a function of motion and parameters; and the parameters' defaults.
    """
    members = [find_effect(name) for name in effects]
    system = servo(find_law(law), False, members)
    if system.before or system.after or system.modes or not all(map(_is_static, members)):
        raise NotStaticError
    rate, v = system.rates["v"], system.symbols["v"]
    if (dry := system.dry) is not None:
        backward = dry.bound if dry.backward is None else dry.backward
        rate = rate - ca.if_else(v > 0, dry.bound, -backward) / dry.inertia
    rate = ca.substitute(rate, *_settled(system))
    names, symbols = tuple(system.parameters), system.symbols | {"time": system.time}
    load = ca.vertcat(symbols["tau_load"], symbols["load_scale"])
    rate = ca.substitute(system.expand(rate), load, ca.DM([0.0, 1.0]))
    torque = symbols["J"] * rate + symbols["a2"] * v
    both = ca.vertcat(torque, *(ca.jacobian(torque, symbols[name]) for name in free))
    inputs = [ca.vertcat(*(symbols[name] for name in (*MOTION, *names)))]
    function = ca.Function("sliding", inputs, [ca.cse(ca.densify(both))])
    return for_arrays(function), {name: p.default for name, p in system.parameters.items()}


def _is_static(effect: Effect) -> bool:
    """Return whether what an effect does depends on no older input and on no other inertia."""
    return not (effect.states or effect.output or effect.coupling or effect.bristles)


def _settled(system: System) -> tuple[ca.SX, ca.SX]:
    """Return the hidden states and the values at which they stay while the servo slides.

    Raise `NotStaticError` where their rates are not linear in them.
    """
    hidden = [name for name in system.states if name not in ("theta", "v")]
    states = system.vector(hidden) if hidden else ca.SX(0, 1)
    rates = ca.vertcat(*(system.rates[name] for name in hidden)) if hidden else ca.SX(0, 1)
    slope = ca.jacobian(rates, states)
    if ca.depends_on(slope, states):
        raise NotStaticError
    at_zero = ca.substitute(rates, states, ca.SX.zeros(len(hidden)))
    return states, -ca.solve(slope, at_zero) if hidden else states


def sliding_torque(
    law: str, effects: Names, free: Names, values: Mapping[str, float], over: Stretches
) -> tuple[Array, Array]:
    """Return the torque (samples,) beside inertia, viscous friction and disturbance [N.m], and its
    slopes (free, samples) by parameters, along the measured motion.

    Raise `NotStaticError` where it depends on more than motion and input.
    """
    function, defaults = _function(law, effects, free)
    known = {**defaults, **values}
    motion: list[Array | float] = [over.theta, over.v, over.u, over.time]
    torque, *slopes = (
        np.broadcast_to(each, over.theta.shape)
        for each in function([*motion, *(known[name] for name in defaults)])
    )
    return np.asarray(torque), np.array(slopes).reshape(len(free), len(over.theta))
