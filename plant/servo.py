"""The servo: voltage drive with saturation, inertia, a friction law, effects, and (optionally) an
encoder.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import casadi as ca

from bristle.common.errors import BristleError, EquationError
from bristle.common.plugins import naming_plugins
from bristle.model.normalised import OBSERVED
from bristle.model.program import Program
from bristle.model.system import SAMPLE_TIME, System
from bristle.model.variables import Namespace, Parameter, State, Variable
from bristle.plant.effect import LONGEST_DELAY, Effects, Extension, arrange
from bristle.plant.friction import law as find_law
from bristle.plant.friction import laws
from bristle.plant.law import Friction, FrictionLaw
from bristle.plant.signal_effects import extension

__all__ = ["servo", "servo_program"]

SX = ca.SX

RIG = "dixit2008 section IV-A"
DRIVE, VISCOUS, TWO_BODIES = "dixit2008 eq. (7)", "dixit2008 eq. (8)", "spong2006 chapter 6"
_BEHIND = "how far the load is behind the motor at the start"
_SLOWER = "how much slower the load is at the start"
J = Parameter("J", "J", "kg.m2", 0.001, 1e-9, 1e6, "inertia", "dixit2008 eq. (7), section IV-A")
B = Parameter("b", "b", "N.m/V", 0.0065, -1e6, 1e6, "torque per volt of the drive", DRIVE)
A2 = Parameter("a2", "alpha2", "N.m.s/rad", 0.002, 0.0, 1e6, "viscous friction", VISCOUS)
U_MAX = Parameter("u_max", "u_max", "V", 24.0, 0.0, 1e6, "largest voltage the drive can give", RIG)
THETA_START = Parameter(
    "theta_start", "theta0", "rad", 0.0, -1e6, 1e6, "position at the start", DRIVE
)
V_START = Parameter("v_start", "v0", "rad/s", 0.0, -1e4, 1e4, "velocity at the start", DRIVE)
TWIST_START = Parameter("twist_start", "e0", "rad", 0.0, -1e6, 1e6, _BEHIND, TWO_BODIES)
TWISTING_START = Parameter("twisting_start", "w0", "rad/s", 0.0, -1e4, 1e4, _SLOWER, TWO_BODIES)
LOAD_STARTS = (TWIST_START, TWISTING_START)  # start values of a servo with a second inertia
ENCODER_COUNTS = Parameter(
    "encoder.counts", "N", "1", 40000.0, 1.0, 1e9, "encoder counts in a turn", RIG
)


def servo(law: FrictionLaw, encoder: bool = True, effects: Sequence[Extension] = ()) -> System:
    """Compose a law and effects into the servo J v' = b sat(u) + tau_load - load_scale F_law - a2
    v, theta' = v.

    With a second inertia, theta and v are the motor's, which friction acts on and the encoder
    shows; tau_load acts on the load. Output theta, v and encoder are what is measured; F is the
    friction torque, effects included. A delay of the measurement delays F too, so that it belongs
    to v.

    Source: dixit2008 eq. (7)-(8); the load inputs follow the rig of section IV-A, whose normal load
    scales friction.
    """
    ordered = arrange(effects)
    with naming_plugins([law, *ordered]):
        return _servo(law, encoder, ordered).check()


def _servo(law: FrictionLaw, encoder: bool, ordered: Sequence[Extension]) -> System:
    system = System(law.name, _described(law.description, ordered))
    j, b, a2, u_max = (system.parameter(p) for p in (J, B, A2, U_MAX))
    start = system.parameter(THETA_START), system.parameter(V_START)
    for parameter in (*law.parameters, *(p for effect in ordered for p in effect.parameters)):
        system.parameter(parameter)
    u, tau_load, load_scale = _inputs(system)
    theta = system.state(State("theta", "rad", "position", initial=start[0]))
    v = system.state(State("v", "rad/s", "velocity", initial=start[1]))
    p = system.namespace(f"{law.name}.")
    _declare_states(system, law, ordered)
    # torques
    work = Effects(system, ordered, theta, v)
    friction = law.equations(p, v)
    asked = work.input("command", u)
    motor = b * work.input("drive", ca.fmin(ca.fmax(asked, -u_max), u_max))
    dry, bound, backward = work.friction(law, friction, load_scale, motor, j)
    bristles = work.bristles(law, friction.bound)
    body = work.inertia(j), a2, bound
    torque, inertia, kept = _bodies(system, work, body, motor, tau_load)
    smooth = kept * (dry + a2 * v)
    bound, backward = _scaled(kept, bound), _scaled(kept, backward)
    # rates
    system.rate("theta", v)
    system.rate("v", (torque - smooth) / inertia)
    _declare_rates(system, friction)
    force = smooth
    if bound is not None and bristles is not None:
        force = smooth + _bristles(system, inertia, bound, backward, *bristles)
    elif bound is not None:
        system.dry_friction("v", inertia, bound, backward)
        lower = bound if backward is None else backward
        # at rest the friction is whatever holds the shaft, up to the bound
        sliding = ca.if_else(v > 0, bound, -lower)
        holding = ca.fmin(ca.fmax(torque - smooth, -lower), bound)
        force = smooth + ca.if_else(v == 0, holding, sliding)
    # what is measured, and what is true
    delay = _outputs(system, work, ordered, start, force, encoder)
    lost = {name for effect in ordered for name in effect.without_truth}
    load, delayed = work.load() / j, SX(0) if delay is None else delay
    true = {"alpha2": a2 / j, "b": b / j, "load": load, "delay": delayed, **friction.true}
    _true_values(system, {name: x for name, x in true.items() if name not in lost})
    return system


def _inputs(system: System) -> tuple[SX, SX, SX]:
    """Declare the inputs: voltage, external torque, factor of the dry friction."""
    u = Variable("u", "V", "voltage asked of the drive", minimum=-1e9, maximum=1e9)
    torque = Variable("tau_load", "N.m", "external torque on the shaft", minimum=-1e9, maximum=1e9)
    scaled = "normal load over nominal; scales dry friction"
    scale = Variable("load_scale", "1", scaled, 1.0, minimum=0.0, maximum=1e6)
    return system.input(u), system.input(torque), system.input(scale)


def _declare_rates(system: System, friction: Friction) -> None:
    """Give the states and modes of the law their equations."""
    for name, rate in friction.rates.items():
        system.rate(name, rate)
    for name, (following, *past) in friction.switches.items():
        system.update(name, following)
        system.margin(name, *past)


def _described(what: str, effects: Sequence[Extension]) -> str:
    """Return what a servo is, with its effects and the normalised parameters that have no true
    value beside them.
    """
    lost = dict.fromkeys(name for effect in effects for name in effect.without_truth)
    said = f"; no true value of {', '.join(lost)}" if lost else ""
    return " with ".join([what, *(effect.name for effect in effects)]) + said


def _declare_states(system: System, law: FrictionLaw, effects: Sequence[Extension]) -> None:
    """Declare the states of the law and, under their names, of the effects with their inputs."""
    p = system.namespace(f"{law.name}.")
    for state in law.states:
        system.state(replace(state, scale=state.scale(p) if callable(state.scale) else state.scale))
    for mode in law.modes:
        system.mode(mode)
    for effect in effects:
        p = system.namespace(f"{effect.name}.")
        for own in effect.inputs:
            system.input(replace(own, name=f"{effect.name}.{own.name}"))
        for state in effect.states:
            system.state(_started(effect, state, p))
        for state in effect.sampled:
            system.sampled(_started(effect, state, p))


def _started(effect: Extension, state: State, p: Namespace) -> State:
    """Return a state of an effect under its full name, with its start value as an expression."""
    initial = state.initial(p) if callable(state.initial) else state.initial
    return replace(state, name=f"{effect.name}.{state.name}", initial=initial)


def _outputs(
    system: System,
    work: Effects,
    effects: Sequence[Extension],
    start: tuple[SX, SX],
    force: SX,
    encoder: bool,
) -> SX | None:
    """Declare what is measured; return its delay, if it has one."""
    theta, v = system.symbols["theta"], system.symbols["v"]
    theta_shown, v_shown = work.shown(theta, v)
    if any(effect.follow for effect in effects):
        work.follow(system.end("theta"), system.end("v"))
    # what is shown at the start, where the effects' states have their start values
    first = ca.vertcat(*work.shown(*start))
    names = [f"{effect.name}.{state.name}" for effect in effects for state in effect.states]
    begin = ca.vertcat(*(SX(system.states[name].initial) for name in names))
    at_start = ca.substitute(first, system.vector(names), begin) if begin.numel() else first
    theta_first, v_first = ca.vertsplit(at_start)
    delay = work.delay()
    position = Variable("theta", "rad", "position")
    shown = _output(system, position, theta_shown, theta_first, delay)
    _output(system, Variable("v", "rad/s", "velocity"), v_shown, v_first, delay)
    torque = Variable("F", "N.m", "friction torque, viscous part included")
    _output(system, torque, force, SX(0), delay)
    if encoder:
        _encoder(system, shown, theta_first)
    return delay


def _output(system: System, variable: Variable, value: SX, start: SX, delay: SX | None) -> SX:
    """Declare an output, delayed by so many sampling periods; return what it shows once the present
    sample is taken.

    Before the start it was what it is at the start. The samples on either side of the delay are
    interpolated linearly. Source: laakso1996 (fractional delay of order one).
    """
    if delay is None:
        system.output(variable, value)
        return value
    line = []
    for i in range(LONGEST_DELAY + 1):
        meaning = f"{variable.name} of {i} samples before"
        state = State(f"{variable.name}_{i}", variable.unit, meaning, initial=start)
        line.append(system.sampled(state, after=True))
    following = [value, *line[:-1]]
    for i, sample in enumerate(following):
        system.update(f"{variable.name}_{i}", sample)
    weights = [ca.fmax(0, 1 - ca.fabs(delay - i)) for i in range(LONGEST_DELAY + 1)]
    system.output(variable, sum((w * x for w, x in zip(weights, line, strict=True)), SX(0)))
    return sum((w * x for w, x in zip(weights, following, strict=True)), SX(0))


def _bristles(
    system: System, inertia: SX, bound: SX, backward: SX | None, stiffness: SX, damping: SX
) -> SX:
    """Make the dry friction elastic before it slides; return its torque.

    Source: canudas1995 (LuGre with Fs = Fc).
    """
    # without friction the bristles hold no torque, and no division by zero occurs
    upper = ca.fmax(bound, 1e-12)
    lower = upper if backward is None else ca.fmax(backward, 1e-12)
    z, v = (
        system.state(State("z", "rad", "bristle deflection", scale=upper / stiffness)),
        system.symbols["v"],
    )
    bending = v - stiffness * ca.fabs(v) * z / ca.if_else(v < 0, lower, upper)
    system.rate("z", bending)
    system.dry_friction(
        "v", inertia, upper, None if backward is None else lower, ("z", stiffness, damping)
    )
    return stiffness * z + damping * bending


def _bodies(
    system: System, work: Effects, servo: tuple[SX, SX, SX | None], motor: SX, tau_load: SX
) -> tuple[SX, SX, SX]:
    """Return torque without friction, inertia, and the share of the friction of the motor side; add
    the load behind a coupling, where there is one.

    `servo`: its inertia, viscous friction and bound of the dry friction. Source: spong2006 (chapter
    6: two inertias behind each other).
    """
    j, a2, bound = servo
    theta, v = system.symbols["theta"], system.symbols["v"]
    if not work.coupled:
        alone = work.torque(work.torque(motor + tau_load, False, theta, v), True, theta, v)
        return alone, j, SX(1)
    at = system.symbols["theta_start"] - system.parameter(TWIST_START)
    speed = system.symbols["v_start"] - system.parameter(TWISTING_START)
    theta_load = system.state(State("theta_load", "rad", "position of the load", initial=at))
    v_load = system.state(State("v_load", "rad/s", "velocity of the load", initial=speed))
    coupling = work.couple(theta - theta_load, v - v_load)
    system.rate("theta_load", v_load)
    load = work.torque(tau_load + coupling.torque, True, theta_load, v_load)
    inertia = coupling.share * j
    if coupling.friction is not None:
        load -= coupling.friction * a2 * v_load
        if bound is not None:
            load -= _drag(coupling.friction * bound, inertia, v_load, system.parameter(SAMPLE_TIME))
    system.rate("v_load", load / inertia)
    system.output(Variable("theta_load", "rad", "position of the load"), theta_load)
    system.output(Variable("v_load", "rad/s", "velocity of the load"), v_load)
    kept = SX(1) if coupling.friction is None else 1 - coupling.friction
    shaft = work.torque(motor - coupling.torque, False, theta, v)
    return shaft, (1 - coupling.share) * j, kept


def _scaled(by: SX, bound: SX | None) -> SX | None:
    return None if bound is None else by * bound


def _drag(bound: SX, inertia: SX, v: SX, period: SX) -> SX:
    """Return the dry friction of a load that nothing measures, smooth about standstill.

    F = Fc v / (|v| + Fc h / J): a sampling period brings it nearly to rest. Source: andersson2007
    (regularised Coulomb friction).
    """
    return bound * v / (ca.fabs(v) + bound * period / inertia + 1e-12)


def _encoder(system: System, theta: SX, theta_start: SX) -> None:
    """Counts floored to the grid, and their difference over a sampling period.

    Source: dixit2008 section IV-A (10 000 pulses, quadrature: 40 000 counts a turn).
    """
    counts, period = system.parameter(ENCODER_COUNTS), system.parameter(SAMPLE_TIME)
    grid = 2 * math.pi / counts
    start = ca.floor(theta_start / grid)
    now = system.sampled(State("count", "1", "encoder count", initial=start), after=True)
    rate = system.sampled(
        State("count_change", "1", "counts in the last period", initial=0.0), after=True
    )
    system.update("count", ca.floor(theta / grid))
    system.update("count_change", ca.floor(theta / grid) - now)
    system.output(Variable("theta_enc", "rad", "position the encoder shows"), now * grid)
    system.output(
        Variable("v_enc", "rad/s", "velocity from the encoder's counts"), rate * grid / period
    )


def _true_values(system: System, true: dict[str, SX]) -> None:
    """Publish what an observer may estimate; what the law does not have, or not beside its effects,
    is 0 and not valid.

    The load is that without tau_load, which is an input.
    """
    for name, (unit, description) in OBSERVED.items():
        system.calculate(
            Variable(f"true.{name}", unit, f"{description}, as an observer should find it"),
            true.get(name, SX(0)),
        )
        valid = Variable(
            f"true.{name}_valid", "1", f"the law has a true value of {name}", boolean=True
        )
        system.calculate(valid, SX(1.0 if name in true else 0.0))


def servo_program(
    law: str | None = None,
    *,
    encoder: bool = True,
    effects: Sequence[str] = (),
    sensitivities: tuple[str, ...] = (),
    observed: str | None = None,
) -> Program:
    """Return the servo as a program: one law, or all laws that the effects can join behind the
    selector `law`.

    `sensitivities` and `observed` as of `Program`.

    Raises
    ------
    BristleError
        If the law or an effect is unknown, or if they cannot be combined.
    """
    added = [extension(name) for name in effects]
    chosen = laws().values() if law is None else [find_law(law)]
    systems = _joined(list(chosen), encoder, added)
    name = "_".join(["ServoPlant", *([] if law is None else [law]), *sorted(effects)])
    if law is not None:
        about = f"servo with {systems[0].description}"
        return Program(
            name, systems, description=about, sensitivities=sensitivities, observed=observed
        )
    about = _described("servo with a friction law chosen by the parameter law", added)
    return Program(name, systems, "law", about)


def _joined(
    chosen: Sequence[FrictionLaw], encoder: bool, effects: Sequence[Extension]
) -> list[System]:
    """Return the servos of the laws that the effects can join; raise the last refusal if none."""
    found, refusal = [], None
    for law in chosen:
        try:
            found.append(servo(law, encoder, effects))
        except EquationError:
            raise
        except BristleError as error:
            refusal = error
    if not found and refusal is not None:
        raise refusal
    return found
