"""Play between the motor and the encoder, with no inertia behind it."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Parameter, State
from bristle.plant.effect import REVERSALS, Context, Effect, Evidence


def follow(c: Context, theta: ca.SX, v: ca.SX) -> dict[str, ca.SX]:
    """e = y - theta, held within half the play: the encoder stands still until the motor has
    crossed the play.

    Source: tao1996 (backlash characteristic at the sensor).
    """
    half = c.p.play / 2
    return {"lead": ca.fmin(ca.fmax(c.p.lead + c.theta - theta, -half), half)}


def output(c: Context) -> tuple[ca.SX, ca.SX]:
    """y = theta + e; y' = v where the motor takes the encoder along, else 0."""
    taken = ca.logic_and(ca.fabs(c.p.lead) >= c.p.play / 2, c.p.lead * c.v <= 0)
    return c.theta + c.p.lead, ca.if_else(taken, c.v, 0)


def starts(e: Evidence) -> list[dict[str, float]]:
    """Return plays from a few steps of the sensor upwards."""
    return [{"play": 4 * e.resolution * 2.0**k} for k in range(7)]


EFFECT = Effect(
    "encoder_play",
    "an encoder that follows the motor through play, without an inertia of its own",
    "tao1996",
    title="play before the encoder",
    group="encoder_play",
    equation="y = theta + e, e' = -v within |e| <= b/2",
    residual=("history",),
    excitation="reversals",
    needs=(REVERSALS,),
    confounded=("backlash", "presliding", "input_delay"),
    parameters=(
        Parameter(
            "encoder_play.play",
            "b",
            "rad",
            0.01,
            0.0,
            10.0,
            "play between motor and encoder",
            "tao1996",
        ),
    ),
    order=-1,
    states=(State("lead", "rad", "how far the encoder is ahead of the motor"),),
    follow=follow,
    output=output,
    off={"play": 0.0},
    starts=starts,
)
