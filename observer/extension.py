"""Kreisselmeier's regressor extension: one equation z = h' theta becomes as many as there are
parameters.

    Phi' = -q Phi + h h',   Y' = -q Y + h z,
so that Phi theta = Y at any time: the last 1/q seconds of the record.

Two laws work on it: Kreisselmeier's gradient, and mixing (drem.py).
Source: kreisselmeier1977.
"""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State
from bristle.observer.method import (
    stack,
    stack_symmetric,
    symmetric_states,
    unstack,
    unstack_symmetric,
    vector_states,
)

SX = ca.SX


def states(n: int) -> tuple[State, ...]:
    """Declare Phi (its lower triangle) and Y."""
    return (
        *symmetric_states("phi", "1", "extended regressor", n),
        *vector_states("y", "1", "extended output", n),
    )


def parameter(prefix: str, q: float) -> Parameter:
    """Declare the rate of forgetting."""
    return Parameter(
        f"{prefix}.fading",
        "q",
        "1/s",
        q,
        1e-6,
        1e3,
        "rate at which the extension forgets",
        "kreisselmeier1977",
    )


def read(p: Namespace, n: int) -> tuple[SX, SX]:
    """Return (Phi, Y)."""
    return stack_symmetric(p, "phi", n), stack(p, "y", n)


def write(phi: SX, y: SX) -> dict[str, SX]:
    """Return Phi and Y as states."""
    return unstack_symmetric("phi", phi) | unstack("y", y)


def extend(p: Namespace, h: SX, z: SX, period: SX, left: float | SX = 1.0) -> tuple[SX, SX]:
    """Advance Phi and Y, of which the share `left` counts still, over a sample with h and z held,
    exactly.

    Source: kreisselmeier1977.
    """
    phi, y = read(p, h.numel())
    kept = ca.exp(-p.fading * period)
    gain = (1 - kept) / p.fading
    return left * kept * phi + gain * h @ h.T, left * kept * y + gain * h * z
