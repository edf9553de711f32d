"""The modified LuGre law with several elements side by side, linear in its parameters once the
distances 1/c_i are given.
"""

from __future__ import annotations

import casadi as ca

from bristle.model.basis import BASIS_COUNT, gaussian, width_parameter
from bristle.model.variables import Namespace, Parameter, State
from bristle.plant.law import Friction, FrictionLaw

SX = ca.SX

PARALLEL_ELEMENTS = 3
DISTANCES = (50.0, 150.0, 450.0)  # c_i, 1/rad
ELEMENT_SHARES = (0.4, 0.3, 0.3)  # of the friction level
# rad/s2: Coulomb friction, then the weights of the basis functions over c
ELEMENT_LEVELS = (4.0, 16.0 / 3.0, 2.0)
CITATION = "dixit2008 eq. (17); iwan1966 (elements side by side)"
PLACES = range(1, PARALLEL_ELEMENTS + 1)


def equations(p: Namespace, v: SX) -> Friction:
    """F = J sum w_i + a2 v, w_i' = [sigma_i0 + sum_j sigma_ij phi_j(v)] v - c_i |v| w_i.

    Elements of different distances relax one after the other, as the slip of one Maxwell element
    after the other does; and sum w_i is linear in all sigma_ij, since w_i is. Source: dixit2008 eq.
    (17), an element; albender2005, what they approximate.
    """
    basis = [SX(1), *gaussian(v / p.width)]
    rates = {
        f"w{i}": sum(p[f"sigma{i}_{j}"] * phi for j, phi in enumerate(basis)) * v
        - p[f"c{i}"] * ca.fabs(v) * p[f"w{i}"]
        for i in PLACES
    }
    level = sum(p[f"sigma{i}_0"] / p[f"c{i}"] for i in PLACES)
    return Friction(
        force=p.J * sum(p[f"w{i}"] for i in PLACES),
        rates=rates,
        true={"Fc": level, "width": p.width, **{f"sigma0_{i}": p[f"sigma{i}_0"] for i in PLACES}},
    )


def _parameters() -> tuple[Parameter, ...]:
    found = []
    for i, (c, share) in enumerate(zip(DISTANCES, ELEMENT_SHARES, strict=True), start=1):
        name = f"modified_parallel.c{i}"
        found.append(
            Parameter(
                name,
                f"c{i}",
                "1/rad",
                c,
                1e-6,
                1e9,
                f"inverse presliding distance of element {i}",
                CITATION,
            )
        )
        for j in range(BASIS_COUNT + 1):
            low, what = (
                (1e-6, "stiffness over inertia")
                if j == 0
                else (-1e9, f"weight of basis function {j}")
            )
            name = f"modified_parallel.sigma{i}_{j}"
            found.append(
                Parameter(
                    name,
                    f"sigma{i}{j}",
                    "1/s2",
                    share * c * ELEMENT_LEVELS[j],
                    low,
                    1e9,
                    f"{what}, element {i}",
                    CITATION,
                )
            )
    return (*found, width_parameter("modified_parallel"))


LAW = FrictionLaw(
    "modified_parallel",
    f"modified LuGre friction, {PARALLEL_ELEMENTS} elements side by side",
    CITATION,
    equations,
    parameters=_parameters(),
    states=tuple(
        State(
            f"w{i}",
            "rad/s2",
            f"friction acceleration of element {i}",
            scale=lambda p, i=i: p[f"sigma{i}_0"] / p[f"c{i}"],
        )
        for i in PLACES
    ),
)
