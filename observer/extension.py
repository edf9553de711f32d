"""Kreisselmeier's regressor extension: one equation z = h' theta becomes as many as there are parameters.

    Phi' = -q Phi + h h',   Y' = -q Y + h z,   so that Phi theta = Y at any time: the last 1/q seconds of the record.

Two laws work on it: Kreisselmeier's gradient, and mixing (drem.py).
Source: kreisselmeier1977.
"""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State
from bristle.observer.method import stack, unstack, vector_states

SX = ca.SX


def states(n: int) -> tuple[State, ...]:
    """Declare Phi (its upper triangle) and Y."""
    return (
        *vector_states("phi", "1", "extended regressor, upper triangle", n * (n + 1) // 2),
        *vector_states("y", "1", "extended output", n),
    )


def parameter(prefix: str, q: float) -> Parameter:
    """Declare how fast it forgets."""
    return Parameter(f"{prefix}.fading", "q", "1/s", q, 1e-6, 1e3, "rate at which the extension forgets", "kreisselmeier1977")


def read(p: Namespace, n: int) -> tuple[SX, SX]:
    """Return (Phi, Y)."""
    packed = stack(p, "phi", n * (n + 1) // 2)
    place = {pair: k for k, pair in enumerate(_triangle(n))}
    rows = [[packed[place[min(i, j), max(i, j)]] for j in range(n)] for i in range(n)]
    return ca.vertcat(*(ca.horzcat(*row) for row in rows)), stack(p, "y", n)


def write(phi: SX, y: SX) -> dict[str, SX]:
    """Return Phi and Y as states."""
    return {**unstack("phi", ca.vertcat(*(phi[i, j] for i, j in _triangle(y.numel())))), **unstack("y", y)}


def extend(p: Namespace, h: SX, z: SX, period: SX) -> tuple[SX, SX]:
    """Advance Phi and Y over a sample with h and z held, exactly.

    Source: kreisselmeier1977.
    """
    phi, y = read(p, h.numel())
    kept = ca.exp(-p.fading * period)
    gain = (1 - kept) / p.fading
    return kept * phi + gain * h @ h.T, kept * y + gain * h * z


def _triangle(n: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(n) for j in range(i, n)]
