"""What is known of a servo at each sample: the torque of what it carries, and its inertia.

It joins a servo like the effects of `plant/effects`, with inputs of its own. A diagnosis takes both
from the records, and never names it.
"""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Variable, declaring
from bristle.plant.effect import Context, Effect

__all__ = ["KNOWN"]

SOURCE = "spong2006"
_parameter = declaring("known", f"{SOURCE} section 7.3")


def torque(c: Context) -> ca.SX:
    """-s tau, which acts against the motor.

    Source: spong2006 section 7.3 (equations of motion of an arm: what the other joints, gravity
    and their motion ask of one).
    """
    return ca.SX(-c.p.scale * c.p.torque)


def inertia(c: Context) -> ca.SX:
    """m + M/J, by which J is the inertia J m + M of the motor and what it carries.

    Source: spong2006 section 7.3 (M: diagonal element of the mass matrix).
    """
    return ca.SX(c.p.inertia_factor + c.p.inertia_added / c.p.J)


KNOWN = Effect(
    "known",
    "{torque} and inertia that are known at each sample",
    SOURCE,
    title="known {torque} and inertia",
    group="known",
    equation="(J m + M) v' = T - s tau",
    residual=("theta",),
    excitation="the motion of what the servo carries",
    confounded=(),
    parameters=(_parameter("scale", "s", "1", (1.0, -1e3, 1e3), "factor on the known {torque}"),),
    inputs=(
        Variable("torque", "N.m", "known torque against the motor", minimum=-1e9, maximum=1e9),
        Variable("inertia_factor", "1", "factor on J", 1.0, minimum=1e-9, maximum=1e9),
        Variable("inertia_added", "kg.m2", "inertia beside J", minimum=-1e9, maximum=1e9),
    ),
    load_side=True,
    torque=torque,
    inertia=inertia,
    without_truth=("alpha2", "b", "load"),
)
