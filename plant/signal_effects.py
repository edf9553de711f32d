"""Effects on the signals between the servo and the other units: noise of the input, delay of the
measurement.

They join a servo like the effects of `plant/effects`, but a diagnosis does not look for them.
"""

from __future__ import annotations

import casadi as ca

from bristle.common.errors import BristleError, suggest
from bristle.common.packages import offered
from bristle.model.generator import MODULUS, normal, scrambled
from bristle.model.variables import Namespace, Parameter, State
from bristle.plant.effect import LONGEST_DELAY, Context, Extension
from bristle.plant.effects import BESIDE, effect, effects

__all__ = ["SIGNAL_EFFECTS", "extension"]

# added to the seed of the noise, so that a controller of the same seed draws other numbers (1)
NOISE_STREAM = 1_000_000_000


def _generator(p: Namespace) -> ca.SX:
    """Return the start state of the generator of the noise."""
    return scrambled(p.seed + NOISE_STREAM)


def noisy(c: Context) -> ca.SX:
    """u + n, with n nearly Gaussian, white, held over a sampling period.

    Source: park1988 section 2 (generator).
    """
    return ca.SX(c.u + c.p.noise)


def next_noise(c: Context) -> dict[str, ca.SX]:
    """Draw the noise of the interval that begins."""
    value, random = normal(c.p.random)
    return {"random": random, "noise": c.p.sd * value}


def samples(c: Context) -> ca.SX:
    """y(t - d Ts), linearly interpolated between the samples on either side.

    Source: laakso1996 (fractional delay of order one).
    """
    return ca.SX(c.p.samples)


INPUT_NOISE = Extension(
    "input_noise",
    "noise on the input of the servo, which the observer does not see",
    "park1988",
    parameters=(
        Parameter(
            "input_noise.sd",
            "sigma",
            "V",
            0.1,
            0.0,
            1e6,
            "standard deviation of the noise",
            "park1988",
        ),
        Parameter(
            "input_noise.seed",
            "seed",
            "1",
            1.0,
            1.0,
            MODULUS - 1.0,
            "whole number that chooses the noise",
            "park1988",
        ),
    ),
    order=-1,
    sampled=(
        State("random", "1", "state of the random generator", initial=_generator),
        State("noise", "V", "noise of the present interval"),
    ),
    updates=next_noise,
    command=noisy,
)

MEASUREMENT_DELAY = Extension(
    "measurement_delay",
    f"outputs that show the servo as it was before (at most {LONGEST_DELAY} sampling periods)",
    "laakso1996",
    parameters=(
        Parameter(
            "measurement_delay.samples",
            "d",
            "1",
            1.0,
            0.0,
            LONGEST_DELAY,
            "delay in sampling periods, also a fraction",
            "laakso1996",
        ),
    ),
    delay=samples,
)

SIGNAL_EFFECTS = {each.name: each for each in (INPUT_NOISE, MEASUREMENT_DELAY)}


def extension(name: str) -> Extension:
    """Return the effect `name`: of `plant/effects`, of this file or what a model may have beside;
    raise `BristleError` for an unknown one.
    """
    known = {**effects(packages=False), **SIGNAL_EFFECTS}
    if name in known:
        return known[name]
    if name in BESIDE or name in offered("effects"):
        return effect(name)
    names = [*known, *offered("effects")]
    raise BristleError(f"unknown effect '{name}'{suggest(name, names)}; known: {', '.join(names)}")
