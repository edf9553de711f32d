"""Definition of a friction law: its parameters, states and equations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import casadi as ca

from bristle.model.system import Directed
from bristle.model.variables import Namespace, Parameter, State

__all__ = [
    "Friction",
    "FrictionLaw",
    "stribeck_curve",
    "stribeck_end",
    "stribeck_parameters",
    "stribeck_truth",
]

SX = ca.SX
# of sigma1
BRISTLE_DAMPING = (
    "bristle damping; above N(v)/v, the level over the speed, friction leads where it should lag"
)
# share of Coulomb friction: Stribeck effect that may remain at the speeds that step 1 uses
NEGLIGIBLE = 0.05


@dataclass(frozen=True)
class Friction:
    """The equations of a law at velocity v.

    `force` [N.m] opposes the motion and comes on top of the viscous a2 v; `rates` are the law's own
    states'; `bound` [N.m], where given, is set-valued dry friction in addition; `true` gives the
    normalised parameters that an observer can be compared with (only those the law has: alpha2 and
    b are the servo's). `switches` gives for each mode of the law its next value, how far past its
    switching point it is and, if need be, the same by direction (as of `System.margin`).

    All is at nominal load. The servo multiplies the forces by the load and leaves the states as
    they are: stiffness, damping and levels grow in proportion to the load, deflections and the
    distances over which they relax do not change.

    Source: canudas1999 (friction of bristles per unit of normal load).
    """

    force: SX
    rates: dict[str, SX] = field(default_factory=dict)
    bound: SX | None = None
    true: dict[str, SX] = field(default_factory=dict)
    switches: dict[str, tuple[SX, SX] | tuple[SX, SX, Directed]] = field(default_factory=dict)


@dataclass(frozen=True)
class FrictionLaw:
    """A law by name; `equations(p, v)` has its own parameters, states and modes as p.sigma0, and
    the servo's as p.J.

    `file` is that of a plug-in, for errors in its equations.
    """

    name: str
    description: str
    source: str
    equations: Callable[[Namespace, SX], Friction]
    parameters: tuple[Parameter, ...] = ()
    states: tuple[State, ...] = ()
    modes: tuple[State, ...] = ()
    file: str = field(default="", compare=False)


def stribeck_curve(p: Namespace, v: SX) -> SX:
    """Return the friction level [N.m] falling from Fs to Fc: Fc + (Fs - Fc) exp(-(v/vs)^2).

    Source: armstrong1994 (Stribeck curve, Gaussian form).
    """
    return SX(p.Fc + (p.Fs - p.Fc) * ca.exp(-((v / p.vs) ** 2)))


def stribeck_truth(p: Namespace, stiffness: SX | None = None) -> dict[str, SX]:
    """Return the true normalised parameters of the curve; with a stiffness also its levels as
    deflections.

    Source: dixit2008 eq. (10), where a0 and a1 are displacements.
    """
    levels = {} if stiffness is None else {"a0": p.Fc / stiffness, "a1": (p.Fs - p.Fc) / stiffness}
    return {"Fc": p.Fc / p.J, "v0": p.vs, "vc": stribeck_end(p), **levels}


def stribeck_end(p: Namespace) -> SX:
    """Return the speed above which the curve exceeds Fc by less than `NEGLIGIBLE` of it."""
    return SX(p.vs * ca.sqrt(ca.log(ca.fmax((p.Fs - p.Fc) / (NEGLIGIBLE * p.Fc), 1))))


def stribeck_parameters(law: str, source: str) -> tuple[Parameter, ...]:
    """Return the parameters of the curve for the table of a law."""
    return (
        Parameter(f"{law}.Fc", "Fc", "N.m", 0.004, 1e-9, 1e6, "Coulomb friction", source),
        Parameter(f"{law}.Fs", "Fs", "N.m", 0.0072, 1e-9, 1e6, "static friction", source),
        Parameter(
            f"{law}.vs", "vs", "rad/s", 0.4363323129985824, 1e-6, 1e3, "Stribeck velocity", source
        ),
    )
