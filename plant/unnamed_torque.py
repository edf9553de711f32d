"""Unnamed torques: what no effect of the catalogue explains, as a function of one variable that was
fitted to records.

They join a servo like the effects of `plant/effects`, but say nothing about a cause: a diagnosis
never names them.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from bristle.model.variables import Parameter
from bristle.plant.effect import Context, Effect

__all__ = ["UNNAMED_KNOTS", "UNNAMED_TORQUES"]

UNNAMED_KNOTS = 13  # values over the range, evenly spaced
VARIABLES = {
    "v": ("velocity", "rad/s"),
    "theta": ("position", "rad"),
    "u": ("input", "V"),
    "t": ("time", "s"),
}


def _curve(c: Context, x: ca.SX) -> ca.SX:
    """T = f(x), linear between evenly spaced values from low to high, constant beyond.

    Source: eilers1996 (B-splines of first degree).
    """
    place = (UNNAMED_KNOTS - 1) * ca.fmin(ca.fmax((x - c.p.low) / (c.p.high - c.p.low), 0), 1)
    values = [getattr(c.p, f"value{k + 1}") for k in range(UNNAMED_KNOTS)]
    return sum(
        (value * ca.fmax(0, 1 - ca.fabs(place - k)) for k, value in enumerate(values)), ca.SX(0)
    )


def _through_drive(c: Context) -> ca.SX:
    """u + f(u)/b: the torque as a change of the input after the limit of the drive.

    Source: eilers1996 (B-splines of first degree).
    """
    return ca.SX(c.u + _curve(c, c.u) / c.p.b)


def _unnamed(variable: str, of: Callable[[Context], ca.SX]) -> Effect:
    """Return the unnamed torque over one of `VARIABLES`."""
    name, (word, unit) = f"unnamed_torque_{variable}", VARIABLES[variable]
    ends = (("low", "x0", -1.0, "least"), ("high", "x1", 1.0, "greatest"))
    return Effect(
        name,
        f"a {{torque}} of unknown cause, a function of the {word} that was fitted to records, valid"
        " only in the range seen there",
        "eilers1996",
        title=f"unnamed {{torque}} over the {word}",
        group=name,
        equation=f"T = f({variable}), linear between {UNNAMED_KNOTS} values",
        residual=(variable,),
        excitation=f"the whole range of the {word}",
        confounded=(),
        parameters=(
            *(
                Parameter(
                    f"{name}.{end}",
                    symbol,
                    unit,
                    start,
                    -1e9,
                    1e9,
                    f"{which} {word} seen, constant beyond",
                    "eilers1996",
                )
                for end, symbol, start, which in ends
            ),
            *(
                Parameter(
                    f"{name}.value{k}",
                    f"f{k}",
                    "N.m",
                    0.0,
                    -1e6,
                    1e6,
                    f"{{torque}} at place {k} of the range",
                    "eilers1996",
                )
                for k in range(1, UNNAMED_KNOTS + 1)
            ),
        ),
        without_truth=("load",),
        torque=None if variable == "u" else lambda c: _curve(c, of(c)),
        drive=_through_drive if variable == "u" else None,
    )


UNNAMED_TORQUES = {
    each.name: each
    for each in (
        _unnamed("v", lambda c: c.v),
        _unnamed("theta", lambda c: c.theta),
        _unnamed("u", lambda c: c.u),
        _unnamed("t", lambda c: c.time),
    )
}
