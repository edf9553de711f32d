"""Levant's robust exact differentiators, by which a method may differentiate its measurements.

Both are exact in finite time for a signal whose next derivative is bounded by `limit`; sampled at
the period h they leave errors of the size limit h^2 (first order, of f'), limit h^2 and limit h
(second order, of f' and f'').
"""

from __future__ import annotations

import casadi as ca

SX = ca.SX


def _root(x: SX, power: float) -> SX:
    return ca.sign(x) * ca.fabs(x) ** power


def first_order(z: SX, f: SX, limit: SX, h: SX) -> SX:
    """Advance the estimates z = (f, f') over one sample by Euler's rule; |f''| <= limit.

    z0' = -1.5 limit^(1/2) |z0 - f|^(1/2) sgn(z0 - f) + z1,   z1' = -1.1 limit sgn(z0 - f).
    Source: levant1998.
    """
    e = z[0] - f
    return ca.vertcat(
        z[0] + h * (z[1] - 1.5 * ca.sqrt(limit) * _root(e, 1 / 2)),
        z[1] - h * 1.1 * limit * ca.sign(e),
    )


def second_order(z: SX, f: SX, limit: SX, h: SX) -> SX:
    """Advance the estimates z = (f, f', f'') over one sample, with the Taylor term of z2 in z0;
    |f'''| <= limit.

    z0' = v0 = -2 limit^(1/3) |z0 - f|^(2/3) sgn(z0 - f) + z1,
    z1' = v1 = -1.5 limit^(1/2) |z1 - v0|^(1/2) sgn(z1 - v0) + z2,   z2' = -1.1 limit sgn(z2 - v1).
    Source: levant2003; the Taylor term livne2014, without which z1 is off by z2 h / 2.
    """
    correction = -2.0 * limit ** (1 / 3) * _root(z[0] - f, 2 / 3)  # v0 - z1
    second = 1.5 * ca.sqrt(limit) * _root(correction, 1 / 2)  # v1 - z2
    return ca.vertcat(
        z[0] + h * (z[1] + correction) + h**2 / 2 * z[2],
        z[1] + h * (z[2] + second),
        z[2] + h * 1.1 * limit * ca.sign(second),
    )
