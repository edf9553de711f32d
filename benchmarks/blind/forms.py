"""What is hidden: every effect of the catalogue in its own form and in another of the same physics,
effects outside the catalogue, and other formulations of Coulomb friction.

A draw fixes the shape of an effect (phases, periods, places) and leaves one number, its strength,
to be adapted to a gap ratio. The fields are those of the struct Plant in truth.c; what is named
like a parameter of the catalogue means it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scene import Scene, log_uniform
from truth import RESOLUTION, Record, base_friction

Generator = np.random.Generator
Fields = dict[str, float]

PARAMETERS = {  # of the catalogue; a rise too short to see is none
    "bias": ("torque",),
    "asymmetric_coulomb": ("share",),
    "quadratic_drag": ("coefficient",),
    "stribeck": ("excess", "speed"),
    "presliding": ("stiffness",),
    "bristle_damping": ("stiffness", "damping"),
    "cogging": ("amplitude", "phase", "periods", "amplitude2", "phase2"),
    "gravity": ("amplitude", "phase"),
    "dead_zone": ("width",),
    "saturation": ("limit",),
    "gain_asymmetry": ("share",),
    "input_delay": ("delay",),
    "electrical_pole": ("time_constant",),
    "backlash": ("share", "play", "stiffness", "dissipation"),
    "compliance": ("share", "stiffness", "damping"),
    "load_friction": ("coefficient", "falling", "speed"),
    "hard_stop": ("stiffness", "upper", "lower"),
    "friction_drift": ("rate",),
    "disturbance_step": ("torque", "onset"),
    "eccentric_encoder": ("amplitude", "phase"),
    "position_friction": ("amplitude", "periods", "phase"),
    "encoder_play": ("play",),
    "asymmetric_viscous": ("coefficient",),
    "gear_loss": ("driving", "driven"),
    "return_spring": ("stiffness", "rest"),
    "torque_ripple": ("share", "periods", "phase"),
}

CLASSES = {
    "bias": "bias/asymmetric_coulomb",
    "asymmetric_coulomb": "bias/asymmetric_coulomb",
    "input_delay": "input_delay/electrical_pole",
    "electrical_pole": "input_delay/electrical_pole",
    "presliding": "presliding/bristle_damping",
    "bristle_damping": "presliding/bristle_damping",
    "load_friction": "load_friction/gear_loss",
    "gear_loss": "load_friction/gear_loss",
    "gravity": "gravity/return_spring",
    "return_spring": "gravity/return_spring",
}


# other forms that an effect of the catalogue can take as well, by a parameter of its form; of these
# kinds only
TAKEN = {
    "gravity": None,
    "eccentric_encoder": None,
    "position_friction": None,
    "friction_drift": None,
    "compliance": None,
    "backlash": None,
    "hard_stop": 1.0,
    "load_friction": 1.0,
    "stribeck": 1.0,
}


def can_be_taken(name: str, fields: Fields) -> bool:
    """Return whether the other form that was drawn of an effect is one that the catalogue can
    take.
    """
    return name in TAKEN and TAKEN[name] in (None, fields.get(f"{name}_kind"))


def class_of(name: str) -> str:
    """Return the class of an effect: alone, unless data may not tell it from another."""
    return CLASSES.get(name, name)


@dataclass(frozen=True)
class Shape:
    """An effect whose strength is still open: `fields(strength)`, strength between low and high,
    `guess` to begin with.

    `power` is about d log(ratio - 1) / d log(strength).
    """

    fields: Callable[[float], Fields]
    low: float
    guess: float
    high: float
    power: float = 2.0


@dataclass(frozen=True)
class Setting:
    """What a draw may look at: the servo, and its records without the effect."""

    scene: Scene
    records: list[Record]
    other: bool  # draw the other form

    def base(self, name: str) -> float:
        """Return J, a2 or Fc."""
        return self.scene.base[name]

    def position(self, share: float) -> float:
        """Return a quantile of the position."""
        return float(np.quantile(np.concatenate([r.theta for r in self.records]), share))

    def torque(self, share: float) -> float:
        """Return a quantile of |u|."""
        return float(np.quantile(np.abs(np.concatenate([r.u for r in self.records])), share))


Draw = Callable[[Generator, Setting], Shape]


def sign(rng: Generator) -> float:
    """Return -1 or 1."""
    return 1.0 if rng.random() < 0.5 else -1.0


def phase(rng: Generator) -> float:
    """Return an angle of the whole circle."""
    return float(rng.uniform(-math.pi, math.pi))


def bias(rng: Generator, s: Setting) -> Shape:
    """Constant torque; other form: varying by a tenth with position."""
    side = sign(rng)
    more = (
        {"bias_ripple": rng.uniform(0.07, 0.12), "bias_ripple_phase": phase(rng)} if s.other else {}
    )
    return Shape(lambda m: {"bias_torque": side * m, **more}, 1e-4, 2e-3, 0.08)


def asymmetric_coulomb(rng: Generator, s: Setting) -> Shape:
    """Excess forward; other form: viscous friction is asymmetric too."""
    side, viscous = sign(rng), rng.uniform(0.4, 0.8) if s.other else 0.0
    return Shape(
        lambda m: {
            "asymmetric_coulomb_share": side * m,
            "asymmetric_coulomb_viscous": side * m * viscous,
        },
        0.002,
        0.02,
        0.6,
    )


def quadratic_drag(rng: Generator, s: Setting) -> Shape:
    """Square of the speed; other form: another power, away from viscous friction."""
    exponent = (
        (rng.uniform(1.65, 1.85) if rng.random() < 0.5 else rng.uniform(2.2, 2.7))
        if s.other
        else 0.0
    )
    top = 5.0 ** (2 - exponent) if exponent else 1.0
    return Shape(
        lambda m: {"quadratic_drag_coefficient": m * top, "quadratic_drag_exponent": exponent},
        2e-5,
        3e-4,
        2e-2,
    )


def stribeck(rng: Generator, s: Setting) -> Shape:
    """Gaussian; other form: exponential or Lorentzian."""
    speed, kind = log_uniform(rng, 0.05, 1.0), float(rng.integers(1, 3)) if s.other else 0.0
    return Shape(
        lambda m: {"stribeck_excess": m, "stribeck_speed": speed, "stribeck_kind": kind},
        0.01,
        0.1,
        1.5,
    )


def presliding(rng: Generator, s: Setting) -> Shape:
    """One bristle element, strength its travel; other form: two elements."""
    split, ratio = rng.uniform(0.3, 0.5), rng.uniform(0.15, 0.35)

    def fields(travel: float) -> Fields:
        if not s.other:
            return {"presliding_stiffness": s.base("Fc") / travel}
        first = s.base("Fc") * (1 - split) / travel
        return {"presliding_stiffness": first, "presliding_split": split, "presliding_ratio": ratio}

    return Shape(fields, 5e-4, 4e-3, 0.2, 1.5)


def bristle_damping(rng: Generator, s: Setting) -> Shape:
    """Bristles with damping, strength their travel; other form: the damping fades with the
    speed.
    """
    damping, fade = rng.uniform(0.1, 0.6), log_uniform(rng, 0.1, 0.5) if s.other else 0.0

    def fields(travel: float) -> Fields:
        stiffness = s.base("Fc") / travel
        return {
            "bristle_damping_stiffness": stiffness,
            "bristle_damping_damping": 2 * damping * math.sqrt(stiffness * s.base("J")),
            "bristle_damping_fade": fade,
        }

    return Shape(fields, 5e-4, 4e-3, 0.2, 1.5)


def cogging(rng: Generator, s: Setting) -> Shape:
    """One or two harmonics; other form: a third one, or an edgy wave."""
    periods, shift = float(rng.integers(3, 41)), phase(rng)
    second = rng.uniform(0.2, 0.5) if not s.other and rng.random() < 0.5 else 0.0
    more: Fields = {"cogging_phase2": phase(rng)} if second else {}
    if s.other and rng.random() < 0.5:
        more = {"cogging_third": rng.uniform(0.2, 0.4), "cogging_third_phase": phase(rng)}
    elif s.other:
        more = {"cogging_steep": rng.uniform(1.5, 4)}
    wave = {"cogging_periods": periods, "cogging_phase": shift, **more}
    return Shape(
        lambda m: {**wave, "cogging_amplitude": m, "cogging_amplitude2": m * second},
        3e-4,
        4e-3,
        0.08,
    )


def gravity(rng: Generator, s: Setting) -> Shape:
    """One term; other form: with a second harmonic."""
    more = (
        {"gravity_second": rng.uniform(0.15, 0.3), "gravity_second_phase": phase(rng)}
        if s.other
        else {}
    )
    shift = phase(rng)
    return Shape(
        lambda m: {"gravity_amplitude": m, "gravity_phase": shift, **more}, 2e-4, 3e-3, 0.3
    )


def dead_zone(rng: Generator, s: Setting) -> Shape:
    """Sharp; other form: rounded, by a hyperbola or tanh."""
    kind = float(rng.integers(1, 3)) if s.other else 0.0
    return Shape(lambda m: {"dead_zone_width": m, "dead_zone_kind": kind}, 1e-3, 0.02, 0.12)


def saturation(rng: Generator, s: Setting) -> Shape:
    """Sharp, strength 1/limit; other form: a rounded knee."""
    knee = rng.uniform(6, 12) if s.other else 0.0
    high, low = 1 / s.torque(0.6), 1 / s.torque(0.9999)
    guess = 1 / s.torque(0.99)
    return Shape(
        lambda m: {"saturation_limit": 1 / m, "saturation_sharpness": knee},
        0.8 * low,
        guess,
        high,
        8.0,
    )


def gain_asymmetry(rng: Generator, s: Setting) -> Shape:
    """|u|; other form: with a rounded corner, or a power of |u|."""
    side, more = sign(rng), {}
    if s.other:
        rounded = rng.random() < 0.5
        more = (
            {"gain_asymmetry_width": rng.uniform(0.03, 0.1)}
            if rounded
            else {"gain_asymmetry_power": rng.uniform(1.15, 1.4)}
        )
    return Shape(lambda m: {"gain_asymmetry_share": side * m, **more}, 0.003, 0.03, 0.5)


def input_delay(rng: Generator, s: Setting) -> Shape:
    """Constant; other form: jitter."""
    jitter = rng.uniform(0.15, 0.35) if s.other else 0.0
    return Shape(
        lambda m: {"input_delay_delay": m, "input_delay_jitter": jitter}, 4e-4, 2e-3, 15e-3
    )


def electrical_pole(rng: Generator, s: Setting) -> Shape:
    """First order; other form: two equal poles."""
    order = 2.0 if s.other else 0.0
    return Shape(
        lambda m: {"electrical_pole_time_constant": m, "electrical_pole_order": order},
        4e-4,
        2e-3,
        15e-3,
    )


def backlash(rng: Generator, s: Setting) -> Shape:
    """Linear contact, strength the play; other form: a Hertzian contact."""
    share = rng.uniform(0.25, 0.6)
    # well above the sweep, or it is a compliance
    stiffness = share * s.base("J") * (2 * math.pi * rng.uniform(35, 60)) ** 2
    fixed = {
        "backlash_share": share,
        "backlash_stiffness": stiffness,
        "backlash_dissipation": rng.uniform(0.5, 3),
    }
    fixed["backlash_hertz"] = 1.5 if s.other else 0.0
    return Shape(lambda m: {**fixed, "backlash_play": m}, 4e-3, 1e-2, 0.15, 1.5)


def compliance(rng: Generator, s: Setting) -> Shape:
    """Linear shaft, strength its period (resonance with the motor blocked); other form: a
    stiffening one.
    """
    share, damping, bend = rng.uniform(0.25, 0.65), rng.uniform(0.01, 0.06), rng.uniform(0.15, 0.4)

    def fields(time: float) -> Fields:
        inertia, omega = share * s.base("J"), 2 * math.pi / time
        stiffness = inertia * omega**2
        twist = 0.3 / stiffness  # at 0.3 N.m the stiffness has grown by the share `bend`
        return {
            "compliance_share": share,
            "compliance_stiffness": stiffness,
            "compliance_damping": 2 * damping * inertia * omega,
            "compliance_stiffening": bend / twist**2 if s.other else 0.0,
        }

    return Shape(fields, 1 / 60, 1 / 22, 1 / 8, 5.0)


def load_friction(rng: Generator, s: Setting) -> Shape:
    """Proportional to the motor torque; other form: a power of it, or with a part that falls with
    the speed.
    """
    more = {"load_friction_power": rng.uniform(1.2, 1.6)} if s.other else {}
    falling = 0.0
    if s.other and rng.random() < 0.5:
        falling, speed = rng.uniform(0.5, 2.0), log_uniform(rng, 0.05, 0.5)
        more = {"load_friction_kind": 1.0, "load_friction_speed": speed}
    return Shape(
        lambda m: {
            "load_friction_coefficient": m,
            "load_friction_falling": m * falling,
            **more,
        },
        0.005,
        0.05,
        0.3,
    )


def hard_stop(rng: Generator, s: Setting) -> Shape:
    """Linear stop at one or both ends, strength how far it cuts into the range; other form:
    quadratic or damped.
    """
    ends, stiffness = rng.choice(["upper", "upper", "lower", "both"]), log_uniform(rng, 0.3, 8)
    kind = float(rng.integers(1, 3)) if s.other else 0.0
    damping = stiffness * rng.uniform(0.01, 0.03) if kind == 2 else 0.0
    top, bottom = s.position(1.0), s.position(0.0)

    def fields(cut: float) -> Fields:
        place = {
            "hard_stop_upper": top - cut if ends != "lower" else 1e6,
            "hard_stop_lower": bottom + cut if ends != "upper" else -1e6,
        }
        return {
            **place,
            "hard_stop_stiffness": stiffness,
            "hard_stop_kind": kind,
            "hard_stop_damping": damping,
        }

    return Shape(fields, 2e-3, 0.05 / math.sqrt(stiffness), 0.2 * (top - bottom), 1.5)


def friction_drift(rng: Generator, s: Setting) -> Shape:
    """Linear in time; other form: settling."""
    side, settling = sign(rng), rng.uniform(10, 40) if s.other else 0.0
    return Shape(
        lambda m: {"friction_drift_rate": side * m, "friction_drift_settling": settling},
        3e-4,
        3e-3,
        0.018 if side < 0 else 0.05,
    )


def disturbance_step(rng: Generator, s: Setting) -> Shape:
    """A step within one of the records; other form: a ramp, or a smooth rise."""
    onset = rng.uniform(3, 17) if rng.random() < 0.5 else rng.uniform(28, 42)
    side, kind = sign(rng), 1.0 if s.other and rng.random() < 0.5 else 0.0
    rise = (rng.uniform(0.2, 0.6) if kind else rng.uniform(0.5, 2)) if s.other else 1e-3
    fixed = {
        "disturbance_step_onset": onset,
        "disturbance_step_rise": rise,
        "disturbance_step_kind": kind,
    }
    return Shape(lambda m: {**fixed, "disturbance_step_torque": side * m}, 2e-4, 4e-3, 0.08)


def eccentric_encoder(rng: Generator, s: Setting) -> Shape:
    """Once in a turn; other form: with a second harmonic."""
    more = (
        {
            "eccentric_encoder_second": rng.uniform(0.15, 0.3),
            "eccentric_encoder_second_phase": phase(rng),
        }
        if s.other
        else {}
    )
    shift = phase(rng)
    return Shape(
        lambda m: {"eccentric_encoder_amplitude": m, "eccentric_encoder_phase": shift, **more},
        3e-4,
        1.8e-2,
        0.06,
    )


def position_friction(rng: Generator, s: Setting) -> Shape:
    """One wave, one to four in a turn; other form: with a second harmonic."""
    more = (
        {
            "position_friction_second": rng.uniform(0.2, 0.35),
            "position_friction_second_phase": phase(rng),
        }
        if s.other
        else {}
    )
    fixed = {
        "position_friction_periods": float(rng.integers(1, 5)),
        "position_friction_phase": phase(rng),
        **more,
    }
    return Shape(lambda m: {**fixed, "position_friction_amplitude": m}, 0.005, 0.06, 0.7)


def encoder_play(rng: Generator, s: Setting) -> Shape:
    """Play at the sensor; other form: the encoder is taken along softly."""
    rounding = rng.uniform(2.5, 6) if s.other else 0.0
    return Shape(
        lambda m: {"encoder_play_play": m, "encoder_play_rounding": rounding},
        1.5e-3,
        8e-3,
        0.1,
        1.5,
    )


def asymmetric_viscous(rng: Generator, s: Setting) -> Shape:
    """In proportion to |v|; other form: to a power of it."""
    side, power = sign(rng), rng.uniform(1.2, 1.4) if s.other else 0.0
    return Shape(
        lambda m: {"asymmetric_viscous_coefficient": side * m, "asymmetric_viscous_power": power},
        1e-4,
        2e-3,
        0.03,
    )


def gear_loss(rng: Generator, s: Setting) -> Shape:
    """In proportion to the motor torque, less in one direction of the power; other form: a power of
    it.
    """
    power, less, drives = (
        rng.uniform(1.2, 1.6) if s.other else 0.0,
        rng.uniform(0.0, 0.3),
        rng.random() < 0.5,
    )

    def fields(m: float) -> Fields:
        driving, driven = (m, less * m) if drives else (less * m, m)
        return {"gear_loss_driving": driving, "gear_loss_driven": driven, "gear_loss_power": power}

    return Shape(fields, 0.005, 0.06, 0.6)


def return_spring(rng: Generator, s: Setting) -> Shape:
    """Linear, at rest somewhere in the middle of the range; other form: one that stiffens, by half
    or more at the ends.
    """
    low, high = s.position(0.0), s.position(1.0)
    rest, stiffening = rng.uniform(0.3, 0.7), rng.uniform(0.5, 1.5) if s.other else 0.0
    fixed = {
        "return_spring_rest": low + rest * (high - low),
        "return_spring_stiffening": stiffening / (0.5 * (high - low)) ** 2,
    }
    return Shape(lambda m: {**fixed, "return_spring_stiffness": m / (high - low)}, 4e-4, 6e-3, 0.6)


def torque_ripple(rng: Generator, s: Setting) -> Shape:
    """A torque constant that varies with position; other form: with a second harmonic.

    Source: krishnan2010 (torque ripple in proportion to the current).
    """
    fixed = {"torque_ripple_periods": float(rng.integers(1, 13)), "torque_ripple_phase": phase(rng)}
    if s.other:
        fixed["torque_ripple_second"] = rng.uniform(0.2, 0.35)
        fixed["torque_ripple_second_phase"] = phase(rng)
    return Shape(lambda m: {**fixed, "torque_ripple_share": m}, 0.003, 0.04, 0.5)


EFFECTS: dict[str, Draw] = {
    draw.__name__: draw
    for draw in (
        bias,
        asymmetric_coulomb,
        quadratic_drag,
        stribeck,
        presliding,
        bristle_damping,
        cogging,
        gravity,
        dead_zone,
        saturation,
        gain_asymmetry,
        input_delay,
        electrical_pole,
        backlash,
        compliance,
        load_friction,
        hard_stop,
        friction_drift,
        disturbance_step,
        eccentric_encoder,
        position_friction,
        encoder_play,
        asymmetric_viscous,
        gear_loss,
        return_spring,
        torque_ripple,
    )
}

# show in few segments: all are looked at
LOCAL = {"hard_stop", "saturation", "disturbance_step", "disturbance_burst"}

SLOTS = {  # of two effects with the same slot only one can act
    "presliding": "bristles",
    "bristle_damping": "bristles",
    "backlash": "second inertia",
    "compliance": "second inertia",
}


def can_join(first: str, second: str) -> bool:
    """Return whether two effects of different classes can act at once."""
    return class_of(first) != class_of(second) and (SLOTS.get(first) or first) != (
        SLOTS.get(second) or second
    )


def timed_tone(rng: Generator, s: Setting) -> Shape:
    """A torque that is a sine in time."""
    fixed = {"tone_frequency": 2 * math.pi * log_uniform(rng, 0.4, 8), "tone_phase": phase(rng)}
    return Shape(lambda m: {**fixed, "tone_amplitude": m}, 3e-4, 4e-3, 0.1)


def gain_compression(rng: Generator, s: Setting) -> Shape:
    """A gain that falls smoothly over the whole range of the input; strength 1/level."""
    return Shape(lambda m: {"compression_level": 1 / m}, 0.02, 0.2, 2.0)


def bouc_wen(rng: Generator, s: Setting) -> Shape:
    """A softening hysteretic spring beside the friction, over a wide travel.

    Source: wen1976 (n = 1, equal shape parameters).
    """
    travel = log_uniform(rng, 0.3, 2.0)
    return Shape(lambda m: {"hysteresis_torque": m, "hysteresis_travel": travel}, 3e-4, 6e-3, 0.15)


def viscous_drift(rng: Generator, s: Setting) -> Shape:
    """Viscous friction that changes with time, as when a lubricant warms."""
    side = sign(rng)
    return Shape(lambda m: {"viscous_drift_rate": side * m}, 5e-4, 5e-3, 0.02 if side < 0 else 0.1)


def inertia_ripple(rng: Generator, s: Setting) -> Shape:
    """An inertia that varies with position, with the torque that conserves its energy.

    Source: spong2006 chapter 7 (Lagrange's equation of one coordinate).
    """
    fixed = {
        "inertia_ripple_periods": float(rng.integers(1, 3)),
        "inertia_ripple_phase": phase(rng),
    }
    return Shape(lambda m: {**fixed, "inertia_ripple_share": m}, 0.003, 0.03, 0.5)


def disturbance_burst(rng: Generator, s: Setting) -> Shape:
    """Two incommensurable tones in bursts."""
    spacing = rng.uniform(3, 7)
    fixed = {
        "burst_spacing": spacing,
        "burst_width": rng.uniform(0.3, 0.8),
        "burst_start": rng.uniform(0, spacing),
        "burst_frequency": 2 * math.pi * log_uniform(rng, 0.8, 5),
    }
    return Shape(lambda m: {**fixed, "burst_amplitude": m}, 1e-3, 1e-2, 0.2)


OUTSIDE: dict[str, Draw] = {
    draw.__name__: draw
    for draw in (
        timed_tone,
        gain_compression,
        bouc_wen,
        viscous_drift,
        inertia_ripple,
        disturbance_burst,
    )
}


def other_friction(rng: Generator, base: Fields) -> tuple[str, Fields]:
    """Return another formulation of Coulomb friction whose presliding stays below an encoder count.

    How far below is for the gap ratio of a control to say: a whole count shows.
    """
    kind = str(rng.choice(["lugre", "dahl", "regularised"]))
    travel = RESOLUTION * log_uniform(rng, 0.03, 0.5)
    if kind == "regularised":
        return kind, {"regular": log_uniform(rng, 1e-4, 4e-4)}
    if kind == "dahl":
        return kind, {"sigma0": base["Fc"] / travel}
    return kind, base_friction(base["J"], base["Fc"], travel) | {
        "sigma1_speed": log_uniform(rng, 0.005, 0.02)
    }
