"""The torque of a servo that slides, as a function of its motion and input."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache

import casadi as ca
import numpy as np

from bristle.common.errors import BristleError, NotStaticError
from bristle.common.table import Array
from bristle.diagnosis.sliding.stretches import Stretches
from bristle.model.python import for_arrays
from bristle.model.system import System
from bristle.model.variables import Namespace
from bristle.plant.controller import CONTROLLER
from bristle.plant.effect import Context, Effect
from bristle.plant.effects import effect as find_effect
from bristle.plant.friction import law as find_law
from bristle.plant.servo import servo

Names = tuple[str, ...]
DRIVE = "drive"
# of the torques of drive and dry friction: their errors, where as large, pass for anything
FAINT = 0.02
RECORDED = (
    "a",
    "u_before",
    "u_first",
    "error_sum",
)  # what only states that a record shows depend on
MOTION = ("theta", "v", "u", "time", *RECORDED)


@lru_cache(maxsize=128)
def _function(
    law: str, effects: Names, free: Names
) -> tuple[Callable[[list[Array | float]], list[Array]], Mapping[str, float], Mapping[str, float]]:
    """Return the torque without inertia and viscous friction, and its slopes by free parameters, as
    a function of motion, what is known and parameters; usual values of what is known and of the
    parameters.
    """
    members = [find_effect(name) for name in effects]
    system = servo(find_law(law), False, members)
    symbols = system.symbols | {name: ca.SX.sym(name) for name in RECORDED}
    symbols["time"] = system.time
    seen = _recorded(members, symbols)
    other = {*system.before, *system.after, *system.modes} - set(seen)
    if other or not all(map(_is_static, members)):
        raise NotStaticError
    rate, v = system.rates["v"], system.symbols["v"]
    if (dry := system.dry) is not None:
        backward = dry.bound if dry.backward is None else dry.backward
        rate = rate - ca.if_else(v > 0, dry.bound, -backward) / dry.inertia
    own = ca.vertcat(*(symbols[name] for name in seen))
    rate = ca.substitute(rate, own, ca.vertcat(*seen.values())) if seen else rate
    rate = ca.substitute(rate, *_settled(system, seen))
    names = tuple(system.parameters)
    known = {f"{e.name}.{each.name}": each.start for e in members for each in e.inputs}
    load = ca.vertcat(symbols["tau_load"], symbols["load_scale"])
    rate = ca.substitute(system.expand(rate), load, ca.DM([0.0, 1.0]))
    torque = symbols["J"] * rate + symbols["a2"] * v
    both = ca.vertcat(torque, *(ca.jacobian(torque, symbols[name]) for name in free))
    inputs = [ca.vertcat(*(symbols[name] for name in (*MOTION, *known, *names)))]
    function = ca.Function("sliding", inputs, [ca.cse(ca.densify(both))])
    defaults = {name: p.default for name, p in system.parameters.items()}
    return for_arrays(function), known, defaults


def _is_static(effect: Effect) -> bool:
    """Return whether what an effect does depends on no older input and on no other inertia."""
    if effect.recorded:
        return True
    return not (effect.states or effect.output or effect.coupling or effect.bristles)


def _recorded(members: Sequence[Effect], symbols: Mapping[str, ca.SX]) -> dict[str, ca.SX]:
    """Return the states of effects that a recorded motion shows, by their full names."""
    found: dict[str, ca.SX] = {}
    for effect in members:
        if effect.recorded:
            p = Namespace(dict(symbols), f"{effect.name}.")
            c = Context(p, p.theta, p.v, p.u, p.time, ca.SX(0))
            found |= {f"{effect.name}.{name}": x for name, x in effect.recorded(c).items()}
    return found


def _settled(system: System, seen: Collection[str]) -> tuple[ca.SX, ca.SX]:
    """Return the hidden states and the values at which they stay while the servo slides.

    Raise `NotStaticError` where their rates are not linear in them.
    """
    hidden = [name for name in system.states if name not in ("theta", "v", *seen)]
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
    function, usual, defaults = _function(law, effects, free)
    known = {**defaults, **values, "sample_time": over.h}
    shown = CONTROLLER.name in effects
    # a controller holds from sample to sample what it sees there
    theta, v = (over.theta, over.v) if shown else over.halfway
    motion: list[Array | float] = [theta, v, over.u, over.time]
    motion += [getattr(over, name) if shown else 0.0 for name in RECORDED]
    beside = [over.known.get(name, start) for name, start in usual.items()]
    torque, *slopes = (
        np.broadcast_to(each, over.theta.shape)
        for each in function([*motion, *beside, *(known[name] for name in defaults)])
    )
    return np.asarray(torque), np.array(slopes).reshape(len(free), len(over.theta))


@lru_cache(maxsize=8)
def _asked(names: Names) -> Callable[[list[Array | float]], list[Array]]:
    """Return what a controller asks for, as a function of motion and parameters."""
    symbols = {name: ca.SX.sym(name) for name in (*MOTION, *names, "sample_time")}
    found = _recorded([CONTROLLER], symbols)
    p = Namespace(symbols | found, f"{CONTROLLER.name}.")
    assert CONTROLLER.command is not None
    asked = CONTROLLER.command(Context(p, p.theta, p.v, p.u, p.time, ca.SX(0)))
    return for_arrays(ca.Function("asked", [ca.vertcat(*symbols.values())], [asked]))


def driving_input(effects: Names, values: Mapping[str, float], over: Stretches) -> Array:
    """Return the input (samples,), or the torque [N.m] that a controller makes of a setpoint."""
    if CONTROLLER.name not in effects:
        return over.u
    defaults = {p.name: p.default for p in CONTROLLER.parameters}
    function = _asked(tuple(defaults))
    motion = [getattr(over, name) for name in MOTION]
    own = [values.get(name, default) for name, default in defaults.items()]
    [torque] = function([*motion, *own, over.h])
    return torque


def sliding_torques(
    law: str, effects: Names, values: Mapping[str, float], over: Stretches
) -> dict[str, Array]:
    """Return the torques (samples,) of the drive (`DRIVE`), the friction law and the effects along
    the measured motion [N.m]; those that depend on more than that are left out.
    """
    follows = tuple(e for e in effects if e == CONTROLLER.name)

    def torque(law: str, *names: str) -> Array:
        return sliding_torque(law, (*names, *follows), (), values, over)[0]

    parts = {DRIVE: values["b"] * driving_input(effects, values, over)}
    with suppress(BristleError):
        bare = torque(law)
        parts[law] = bare - torque("viscous")
        for name in (e for e in effects if e not in follows):
            with suppress(BristleError):
                parts[name] = (
                    _lagging(name, values, over)
                    if "du" in find_effect(name).residual
                    else torque(law, name) - bare
                )
    return parts


def _lagging(name: str, values: Mapping[str, float], over: Stretches) -> Array:
    """Return the torque [N.m] that an effect takes from the input by acting on it later, to first
    order in the time by which it is late.
    """
    rate = (over.u - over.u_before) / over.h
    return np.asarray(-values["b"] * values[find_effect(name).strength.name] * rate)


def is_faint(torques: Mapping[str, Array], law: str, name: str) -> bool:
    """Return whether the torque of an effect is small beside those of drive and friction law at
    every sample; at rest the friction is what it can be.
    """
    if name not in torques:
        return False
    known = np.abs(torques[DRIVE]) + np.abs(torques[law]).max()
    return bool((np.abs(torques[name]) < FAINT * known).all())
