"""Effects that can act through the input, as a small FMU: what to feed a plant so that it behaves
as if it had them.

Between two samples the plant holds its input, while a torque moves on: it is taken for the middle
of the coming period, from the position and velocity at its start. The output follows the inputs at
once, so a host that passes it on within the step adds no delay; one that exchanges all signals
between steps (Jacobi) adds a sample.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import casadi as ca

from bristle.common.errors import BristleError
from bristle.model.program import Program
from bristle.model.system import SAMPLE_TIME, System
from bristle.model.variables import Variable
from bristle.plant.effect import Effect, Effects, arrange
from bristle.plant.effects import effect as find_effect
from bristle.plant.servo import U_MAX, B

SX = ca.SX
REFUSED = {  # slot of an effect: why no input can stand in for it
    "factor": (
        "changes dry friction, which holds and lets go within a sample; an input that answers a"
        " sample later is wrong"
    ),
    "bound": (
        "adds dry friction, which holds and lets go within a sample; an input that answers a sample"
        " later is wrong"
    ),
    "bristles": "puts bristles under the friction, whose bending an input does not see",
    "coupling": "puts a second inertia behind the motor, whose motion an input does not see",
    "output": "changes what is measured, not what the input does",
}


def refusal(name: str, present: Sequence[str] = (), added: Sequence[str] = ()) -> str | None:
    """Return why an effect cannot act through the input, in one line, or None if it can.

    `present` are the effects of the whole model, `added` those of them that the plant to be
    corrected lacks.
    """
    effect = find_effect(name)
    for slot, reason in REFUSED.items():
        if getattr(effect, slot) is not None:
            return f"{name} {reason}"
    for other in map(find_effect, present):
        if effect.load_side and other.coupling is not None:
            return (
                f"{name} acts on the load behind the coupling of {other.name}, which an input"
                " reaches later"
            )
        if other.name not in added and (other.command or other.drive):
            return (
                f"{name} would pass through {other.name}, which the plant has already, and be"
                " changed by it"
            )
    return None


def correction_program(
    effects: Sequence[str], parameters: Mapping[str, float] | None = None
) -> Program:
    """Return the program Correction: inputs u [V] and, where needed, theta [rad] and v [rad/s];
    output u_corrected [V].

    Parameters
    ----------
    effects : sequence of str
        Names of effects.
    parameters : mapping of str to float, optional
        Start values of b, u_max, sample_time and the effects' parameters [SI]; what is not used is
        left out.

    Raises
    ------
    BristleError
        If an effect is unknown or cannot act through the input, there is none, or a value is
        outside its interval.
    """
    if not effects:
        raise BristleError("a correction of no effect changes nothing; name one")
    for name in effects:
        if reason := refusal(name):
            raise BristleError(f"no correction: {reason}; use a plant that has the effect")
    ordered = arrange([find_effect(name) for name in effects])
    system = _system(ordered)
    given = {name: value for name, value in (parameters or {}).items() if name in system.parameters}
    if given.get("b") == 0:
        raise BristleError(
            "b = 0 N.m/V: the input gives no torque, so it cannot correct one; give b"
        )
    name = "_".join(["Correction", *sorted(effects)])
    return Program(name, [system], description=system.description).preset(given)


def _system(effects: Sequence[Effect]) -> System:
    """Return u' = drive(limit(command(u))) + T/b, in the servo's order of the same effects."""
    system = System(
        "correction", "input for a plant without " + ", ".join(effect.name for effect in effects)
    )
    b, u_max = system.parameter(B), system.parameter(U_MAX)
    system.parameter(SAMPLE_TIME)
    for parameter in (p for effect in effects for p in effect.parameters):
        system.parameter(parameter)
    u = system.input(Variable("u", "V", "input meant for the plant", minimum=-1e9, maximum=1e9))
    for effect in effects:
        for state in effect.states:
            system.state(replace(state, name=f"{effect.name}.{state.name}"))
        for state in effect.sampled:
            system.sampled(replace(state, name=f"{effect.name}.{state.name}"))
    theta, v = SX.sym("theta"), SX.sym("v")  # inputs only if an equation reads them
    work = Effects(system, effects, theta, v)
    asked = work.input("drive", ca.fmin(ca.fmax(work.input("command", u), -u_max), u_max))
    torque = work.torque(work.torque(SX(0), False, theta, v), True, theta, v)
    corrected = _held(system, asked if torque.is_zero() else asked + torque / b, theta, v)
    result = Variable("u_corrected", "V", "input for the plant, held over the coming period")
    system.output(result, _with_inputs(system, corrected, theta, v))
    system.rates = {
        name: _with_inputs(system, rate, theta, v) for name, rate in system.rates.items()
    }
    return system


def _held(system: System, value: SX, theta: SX, v: SX) -> SX:
    """Return the value for the middle of the period that begins now: states half a step on, samples
    already taken.

    The half step is one of the linearly implicit Euler method, which stays stable for states faster
    than the period.
    """
    half = system.symbols[SAMPLE_TIME.name] / 2
    if system.states:
        x, rate = system.vector(list(system.states)), system.rate_vector()
        ahead = x + ca.solve(SX.eye(x.numel()) - half * ca.jacobian(rate, x), half * rate)
        [value] = ca.substitute([value], [x], [ahead])
    if system.before:
        line = list(system.before)
        taken = ca.vertcat(*(system.updates[name] for name in line))
        [value] = ca.substitute([value], [system.vector(line)], [taken])
    [value] = ca.substitute(
        [value],
        [ca.vertcat(theta, system.time)],
        [ca.vertcat(theta + half * v, system.time + half)],
    )
    return SX(value)


def _with_inputs(system: System, value: SX, theta: SX, v: SX) -> SX:
    """Declare position and velocity as inputs, where they are read, and put them in place."""
    read = {symbol.name() for symbol in ca.symvar(value)}
    for symbol, unit, meaning in (
        (theta, "rad", "position of the plant"),
        (v, "rad/s", "velocity of the plant"),
    ):
        name = symbol.name()
        if name in read:
            own = (
                system.symbols[name]
                if name in system.inputs
                else system.input(Variable(name, unit, meaning))
            )
            [value] = ca.substitute([value], [symbol], [own])
    return SX(value)
