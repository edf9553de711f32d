"""The Dahl law: a spring that yields, independent of the speed."""

from __future__ import annotations

import casadi as ca

from bristle.model.variables import Namespace, Parameter, State
from bristle.plant.law import Friction, FrictionLaw


def equations(p: Namespace, v: ca.SX) -> Friction:
    """F = sigma0 z + a2 v, z' = v - sigma0 |v| z / Fc: along the path x, dF/dx = sigma0 (1 - F
    sgn(v) / Fc).

    Source: dahl1968, dahl1976 (slope of the force over the path, with exponent 1).
    """
    dz = v - p.sigma0 * ca.fabs(v) * p.z / p.Fc
    return Friction(
        force=p.sigma0 * p.z, rates={"z": dz}, true={"Fc": p.Fc / p.J, "a0": p.Fc / p.sigma0}
    )


LAW = FrictionLaw(
    "dahl",
    "Dahl friction",
    "dahl1968, dahl1976",
    equations,
    parameters=(
        Parameter(
            "dahl.sigma0", "sigma", "N.m/rad", 0.8, 1e-6, 1e9, "stiffness at rest", "dahl1968"
        ),
        Parameter("dahl.Fc", "Fc", "N.m", 0.004, 1e-9, 1e6, "Coulomb friction", "dahl1968"),
    ),
    states=(State("z", "rad", "elastic deflection", scale=lambda p: p.Fc / p.sigma0),),
)
