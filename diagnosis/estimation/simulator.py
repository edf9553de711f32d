"""The servo that is fitted, its free parameters, and its simulation with exact derivatives."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from bristle.common.table import Array
from bristle.diagnosis.estimation.dataset import LANES, Chains, Segments, chains_of
from bristle.diagnosis.free_parameter import Free
from bristle.diagnosis.modelfile import NO_LIMIT
from bristle.model.lanes import Lanes
from bristle.model.native import pointer
from bristle.model.program import Program
from bristle.plant.controller import CONTROLLER
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects
from bristle.plant.servo import LOAD_STARTS, servo_program
from bristle.plant.unnamed_torque import UNNAMED_TORQUES

Mask = NDArray[np.bool_]

# state of the load: state of the motor with which a segment sets it
LEADERS = {"theta_load": "theta", "v_load": "v"}
FOLLOWERS = {**LEADERS, f"{CONTROLLER.name}.speed": "v"}  # all states that segments set so
START_STATES = ("theta_start", "v_start")
# initial states of a load with free play: how far and how much slower it lags
LOAD_STATES = tuple(p.name for p in LOAD_STARTS)
LOAD_SPEED_SHARE = 0.3  # of the rms speed: standard deviation of that lag of a load's speed
LEAST_PLAY = 1e-9  # rad: least half play by which a load's place is divided
# part of each simulation of rigid friction
OWN_BRISTLES = next(e.name for e in all_effects().values() if e.rigid_friction)
# effects that take the place of these bristles
BRISTLE_EFFECTS = tuple(e.name for e in all_effects().values() if e.bristles)
LONGEST_INTERNAL_STEP = 1e-3  # s: longest internal step of the simulation
# s: by as much a controller's filter and period may make it late; what is less is no effect
LOOP_DELAY = 5e-3
SMOOTH_LAW_TOLERANCE = 1e-5  # relative tolerance of the integrator for smooth laws


def fixed_values(h: float) -> dict[str, float]:
    """Return the settings of the simulation for a sampling period."""
    step = h / math.ceil(h / LONGEST_INTERNAL_STEP - 1e-9)
    return {
        "solver.friction_step": step,
        "solver.tolerance": SMOOTH_LAW_TOLERANCE,
        "u_max": NO_LIMIT,
    }


def play_parameter(effects: Sequence[str]) -> str:
    """Return the parameter that is the free play of a coupling's load, or an empty text."""
    return next(
        (
            f"{name}.{find_effect(name).free_play}"
            for name in effects
            if find_effect(name).free_play
        ),
        "",
    )


@lru_cache(maxsize=256)  # four rounds of all effects
def _program(law: str, effects: tuple[str, ...], velocity: bool, base: tuple[str, ...]) -> Program:
    fitted = [name for name in effects if name not in UNNAMED_TORQUES]
    wanted = [
        *base,
        *(p.name for name in fitted for p in find_effect(name).parameters),
        *START_STATES,
    ]
    wanted += LOAD_STATES if play_parameter(effects) else ()
    observed = "v" if velocity else "theta"
    return servo_program(
        law, encoder=False, effects=effects, sensitivities=tuple(wanted), observed=observed
    )


@lru_cache(maxsize=512)
def _compiled(
    law: str, effects: tuple[str, ...], velocity: bool, base: tuple[str, ...], width: int
) -> Lanes:
    program = _program(law, effects, velocity, base)
    return Lanes(program, width, "models of effects")


class Simulator:
    """A servo with effects, simulated over segments with exact derivatives.

    `law`: friction law. `effects`: names of effects. `segments`: records to simulate. `base`:
    parameters of the servo and its law with derivatives; those of the effects always have them.
    `fixed`: values of other parameters, such as the internal step.
    """

    def __init__(
        self,
        law: str,
        effects: Sequence[str],
        segments: Segments,
        base: Sequence[str],
        fixed: Mapping[str, float],
    ) -> None:
        self.segments, self.effects = segments, tuple(effects)
        self._made_from = law, tuple(effects), tuple(base), dict(fixed)
        self.play = play_parameter(effects)
        self.width = len(START_STATES) + (len(LOAD_STATES) if self.play else 0)
        self._chains = chains_of(segments, CONTROLLER.name in effects)
        made = law, tuple(sorted(effects)), segments.velocity, tuple(base)
        # its own: diagnoses may run in parallel
        self._lanes = _compiled(*made, len(self._chains[0].times)).twin()
        program = self._lanes.program
        self.names = program.sensitivities[: -self.width]
        self._v = np.array(program.starts)
        known = {"sample_time": segments.h, "solver.max_step": segments.h, **fixed}
        for name in known.keys() & program.index.keys():
            self._v[program.index[name]] = known[name]
        # what only effects that are not there depend on is no input
        given = {name: x for name, x in segments.inputs.items() if name in program.index}
        self._u, count = given["u"], len(given["u"])
        self._inputs = np.array([given[name] for name in given]).reshape(-1, count)
        self._places = np.array([program.index[name] for name in given], dtype=np.int32)
        self._observed = program.index["v" if segments.velocity else "theta"]
        self._place_starts(list(program.variants[program.chosen].system.states))

    def _place_starts(self, states: Sequence[str]) -> None:
        """Find where the initial states of a segment go among those of the program."""
        velocity = self.segments.velocity
        # what is set itself, and what follows it
        chosen = ["v"] if velocity else ["theta", "v"]
        follow = [FOLLOWERS.get(name, "") for name in states]
        self._set = np.array([states.index(name) for name in chosen], dtype=np.int32)
        self._column = np.array(
            [len(self.names) + (name == "v") for name in chosen], dtype=np.int32
        )
        self._leader = np.array(
            [chosen.index(f) if f in chosen else -1 for f in follow], dtype=np.int32
        )
        self._chosen = slice(1 if velocity else 0, self.width)
        # a load with free play lags behind its motor
        leaders = LEADERS if self.play else {}
        pairs = [(states.index(load), states.index(motor)) for load, motor in leaders.items()]
        self._load, self._motor = (
            np.array([pair[i] for pair in pairs], dtype=np.int32) for i in (0, 1)
        )
        self._lag = len(self.names) + len(START_STATES) + np.arange(len(pairs), dtype=np.int32)

    def over(self, segments: Segments) -> Simulator:
        """Return the same over other segments of the same sampling period and output."""
        law, effects, base, fixed = self._made_from
        return Simulator(law, effects, segments, base, fixed)

    def hidden_spread(self, values: Mapping[str, float]) -> Array:
        """Return the prior standard deviations (width - 2,) of the initial states that no sensor
        shows; their means are 0.

        A load may be anywhere within its play, and beyond it by the deflection of the contact under
        the rms torque.
        """
        if not self.play:
            return np.empty(0)
        u, v = self._usual
        deflection = (
            abs(values["b"]) * u / self._value(f"{self.play.split('.')[0]}.stiffness", values)
        )
        return np.array([1.0 + deflection / self._half(values), LOAD_SPEED_SHARE * v + 1e-9])

    @cached_property
    def _usual(self) -> tuple[float, float]:
        """Root mean squares of the input and of the speeds at the starts of the segments."""
        return float(np.sqrt(np.mean(np.square(self._u)))), float(
            np.sqrt(np.mean(np.square(self.segments.initial[:, 1])))
        )

    def _half(self, values: Mapping[str, float]) -> float:
        return max(0.5 * self._value(self.play, values), LEAST_PLAY)

    def _value(self, name: str, values: Mapping[str, float]) -> float:
        return float(values.get(name, self._v[self._lanes.program.index[name]]))

    def run(
        self, values: Mapping[str, float], initial: Array, jacobian: bool = False
    ) -> tuple[Array, Array | None, Mask, Array]:
        """Simulate all segments from initial states (segments, width): position, velocity and, of a
        load with free play, how far (over half the play) and how much slower it lags.

        Where the latter are left out or NaN, the load continues from the end of the previous
        segment.

        Returns `simulated` (segments, bins): averages of the output. `derivatives` (segments, bins,
        len(names) + width): by the parameters and by the initial states. `good` (segments,): False
        where the simulation failed; other values there are undefined. `initial` (segments, width):
        the initial states that were simulated.
        """
        s, count = self.segments, len(initial)
        # initial states in the simulator's own columns, lags in rad and rad/s
        starts = np.full((count, self.width), np.nan)
        starts[:, : initial.shape[1]] = initial[:, : self.width]
        if self.play:
            starts[:, 2] *= self._half(values)
        simulated = np.empty((count, s.bins))
        sens = np.empty((count, s.bins, len(self.names) + self.width)) if jacobian else None
        good = np.empty(count, dtype=np.uint8)
        chosen = np.ascontiguousarray(starts[:, self._chosen])
        # chains of segments, one group after the other, each chain a lane
        for chains in self._chains:
            self._lanes.begin(self._table(chains, values, starts))
            self._lanes.library.lanes_segments(
                ctypes.c_void_p(self._lanes.address),
                pointer(chains.times),
                pointer(chains.first),
                pointer(chains.begin),
                pointer(chains.end),
                s.bins,
                s.width,
                ctypes.c_double(s.h),
                len(self._places),
                pointer(self._places),
                pointer(self._inputs),
                ctypes.c_longlong(self._inputs.shape[1]),
                len(self._set),
                pointer(self._set),
                pointer(self._column),
                pointer(self._leader),
                pointer(chosen),
                len(self._load),
                pointer(self._load),
                pointer(self._motor),
                pointer(self._lag),
                self._observed,
                pointer(simulated),
                pointer(sens),
                pointer(good),
            )
        # the states that were simulated, a lag again over half the play
        starts[:, self._chosen] = chosen
        if self.play:
            self._scale_by_play(values, starts, sens)
        return simulated, sens, good.astype(bool), starts

    def follow(
        self,
        values: Mapping[str, float],
        reference: Array,
        disturbance: Array,
        loop: tuple[float, float, float, float],
    ) -> tuple[Array, Array, Mask]:
        """Follow a reference from the start of the only segment, in a position loop.

        `reference` (n, 2): position and its rate. `disturbance` (n, LANES): in the unit of the
        input, one a lane. `loop`: input by error and by its rate, and least and largest input.

        Returns output and input (n, LANES) at each sample, and which lanes came to the end.
        """
        lanes, n, h = self._lanes, len(reference), self.segments.h
        [chains] = self._chains
        lanes.begin(self._table(chains, values, self.segments.initial))
        index = lanes.program.index
        places = np.array([index[x] for x in ("u", "theta", "v")] + [self._observed], np.int32)
        gains, ends = np.array(loop[:2]), np.array(loop[2:])
        seen, driven = np.zeros((n, LANES)), np.zeros((n, LANES))
        good = np.zeros(LANES, dtype=np.uint8)
        lanes.library.lanes_follow(
            ctypes.c_void_p(lanes.address),
            ctypes.c_longlong(n),
            ctypes.c_double(h),
            ctypes.c_double(self.segments.times[0]),
            pointer(places),
            pointer(gains),
            pointer(ends),
            pointer(np.ascontiguousarray(reference)),
            pointer(np.ascontiguousarray(disturbance)),
            pointer(seen),
            pointer(driven),
            pointer(good),
        )
        return seen, driven, good.astype(bool)

    def _table(self, chains: Chains, values: Mapping[str, float], starts: Array) -> Array:
        """Return the variables (variables, lanes) with which chains begin."""
        index = self._lanes.program.index
        v = self._v.copy()
        for name, value in values.items():
            if name in index:
                v[index[name]] = value
        table = np.repeat(v[:, None], len(chains.first), axis=1)
        table[self._places] = self._inputs[
            :, chains.first * self.segments.bins * self.segments.width
        ]
        for name, column in zip(START_STATES, starts[chains.first].T, strict=False):
            if not (self.segments.velocity and name == "theta_start"):
                table[index[name]] = column
        return table

    def _scale_by_play(
        self, values: Mapping[str, float], initial: Array, sens: Array | None
    ) -> None:
        """Scale a load's place by half the play, in place, so that contact stays as it changes."""
        half, place = self._half(values), len(self.names) + 2
        initial[:, 2] /= half
        if sens is not None:
            sens[:, :, self.names.index(self.play)] += 0.5 * sens[:, :, place] * initial[:, 2, None]
            sens[:, :, place] *= half


@dataclass(frozen=True)
class Servo:
    """The model to which candidates are added.

    `law`, `effects`: friction law and effects. `rigid`: True if dry friction has bristles that
    deflect by less than the sensor's step. Models of rigid friction do not agree more closely than
    that; without bristles each effect would be fitted to the difference. `limits`: intervals of
    effects' parameters on this axis, where they are narrower than in general. `credible`: intervals
    outside which an effect needs stronger evidence.
    """

    law: str
    effects: tuple[str, ...]
    base: tuple[str, ...]  # parameters of the servo and its law with derivatives
    free: tuple[Free, ...]  # free parameters
    fixed: Mapping[str, float]  # settings of the simulation
    rigid: bool
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    credible: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def simulator(self, segments: Segments, more: tuple[str, ...] = ()) -> Simulator:
        """Return a simulator of the servo with more effects added."""
        effects = (*self.effects, *more)
        bristles = self.rigid and not set(effects) & set(BRISTLE_EFFECTS)
        return Simulator(
            self.law,
            (*effects, OWN_BRISTLES) if bristles else effects,
            segments,
            self.base,
            self.fixed,
        )

    def free_beside(self, name: str) -> tuple[Free, ...]:
        """Return the free parameters that stay when an effect is added."""
        return tuple(
            f
            for f in self.free
            if name not in BRISTLE_EFFECTS or not f.name.startswith(f"{OWN_BRISTLES}.")
        )

    def adds_nothing(self, name: str, values: Mapping[str, float]) -> bool:
        """True if an effect's bristles are as stiff as the servo's own, or if it is late by no more
        than the servo's controller may be.
        """
        strength = find_effect(name).strength
        if CONTROLLER.name in self.effects and strength.unit == "s":
            return values[strength.name] <= LOOP_DELAY
        if name not in BRISTLE_EFFECTS or not self.rigid:
            return False
        return values[f"{name}.stiffness"] >= next(
            f.nominal_value for f in self.free if f.name == f"{OWN_BRISTLES}.stiffness"
        )
