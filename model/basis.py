"""Basis functions of the velocity that shape the Stribeck curve; shared by plant and observer."""

from __future__ import annotations

import math

import casadi as ca

from bristle.model.variables import Parameter

SX = ca.SX
DEGREE = math.pi / 180.0
# number of basis functions of the shipped models; an argument of the laws and observers
BASIS_COUNT = 2


def width_parameter(prefix: str) -> Parameter:
    """Declare the factor by which centres and widths are larger than the nominal ones, under the
    name of a law or a method.
    """
    text = "centres and widths of the basis functions over the nominal ones"
    return Parameter(
        f"{prefix}.width", "w", "1", 1.0, 1e-6, 1e6, text, "dixit2008 eq. (24)", optional=True
    )


def gaussian(v: SX, count: int = BASIS_COUNT, even: SX | float = 1.0) -> list[SX]:
    """Return phi_i(v) = exp(-((|v| - v_i)/w_i)^2) for v in rad/s; for two functions centres 0, 20
    and widths 10, 20 deg/s.

    Of v / width they have `width` times these centres and widths. The paper prints v without the
    bars in the second function; the Stribeck curve is even, so they are meant. With `even` = 0 it
    is as printed. Source: dixit2008 eq. (24), with beta2 for the second beta1 and |v| for v.
    """
    speed = ca.fabs(v) + (1 - even) * (v - ca.fabs(v))
    return [ca.exp(-(((speed - centre) / width) ** 2)) for centre, width in _shapes(count)]


def _shapes(count: int) -> list[tuple[float, float]]:
    """Return centre and width of each function [rad/s]."""
    return [(20.0 * i * DEGREE, (10.0 if i == 0 else 20.0) * DEGREE) for i in range(count)]


def gaussian_end(share: SX, count: int = BASIS_COUNT) -> SX:
    """Return the speed [rad/s] above which the last function, the widest, stays below this share of
    its peak (at most 1).
    """
    centre, width = _shapes(count)[-1]
    return SX(centre + width * ca.sqrt(-ca.log(ca.fmin(share, 1))))


def polynomial(v: SX, count: int = BASIS_COUNT) -> list[SX]:
    """Return phi_i(v) = |v|^i for v in rad/s.

    Source: dixit2008 section III remark 6.
    """
    return [ca.fabs(v) ** i for i in range(1, count + 1)]
