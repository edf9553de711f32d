"""What a friction law is: its parameters, its states and its equations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State

SX = ca.SX


@dataclass(frozen=True)
class Friction:
    """The equations of a law at velocity v.

    `force` [N.m] opposes the motion and comes on top of the viscous a2 v; `rates` are the law's own states'; `bound`
    [N.m], where given, is set-valued dry friction in addition; `true` gives the normalised parameters that an observer
    can be compared with (only those the law has: alpha2 and b are the servo's).
    """

    force: SX
    rates: dict[str, SX] = field(default_factory=dict)
    bound: SX | None = None
    true: dict[str, SX] = field(default_factory=dict)


@dataclass(frozen=True)
class FrictionLaw:
    """A law by name; `equations(p, v)` sees its own parameters and states as p.sigma0, and the servo's as p.J."""

    name: str
    description: str
    source: str
    equations: Callable[[Namespace, SX], Friction]
    parameters: tuple[Parameter, ...] = ()
    states: tuple[State, ...] = ()
