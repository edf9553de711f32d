"""The modified LuGre law, linear in its parameters: one law for each family of basis functions."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from bristle.model.basis import BASIS_COUNT, gaussian, gaussian_end, width_parameter
from bristle.model.variables import Namespace, Parameter, State, declaring
from bristle.plant.law import NEGLIGIBLE, Friction, FrictionLaw

SX = ca.SX

CITATION = "dixit2008 eq. (17)"
_TAU = (
    "bristle damping over stiffness; above 1/(c v), v the speed, friction leads where it should lag"
)
# sigma0, sigma1, sigma2
_DEFAULTS = {"gaussian": (600.0, 800.0, 300.0), "polynomial": (1000.0, -60.0, 2.0)}


def modified(
    name: str, family: str, basis: Callable[[SX, int], list[SX]], count: int = BASIS_COUNT
) -> FrictionLaw:
    """Return the law with `count` functions of a family.

    w is the friction acceleration F/J without the viscous part; tau adds bristle damping, tau = 0
    is the paper's law.
    """

    def equations(p: Namespace, v: SX) -> Friction:
        """F = J (w + tau w') + a2 v, w' = [sigma0 + sum sigma_i phi_i(v)] v - c |v| w.

        Source: dixit2008 eq. (15) and (17); tau extends remark 5.
        """
        scaled = v / p.width if family == "gaussian" else v
        k = p.sigma0 + sum(
            p[f"sigma{i}"] * phi for i, phi in enumerate(basis(scaled, count), start=1)
        )
        dw = k * v - p.c * ca.fabs(v) * p.w
        true = {f"sigma{i}": p[f"sigma{i}"] for i in range(count + 1)} | {"c": p.c, "tau": p.tau}
        # the functions vanish at high speed, so that Coulomb friction is sigma0/c
        if family == "gaussian":
            true |= {"Fc": p.sigma0 / p.c, "width": p.width}
            last = ca.fmax(ca.fabs(p[f"sigma{count}"]), 1e-12 * p.sigma0)
            true["vc"] = p.width * gaussian_end(NEGLIGIBLE * p.sigma0 / last, count)
        else:  # sigma_i of another basis are other quantities than an observer's estimates
            true = {"c": p.c, "tau": p.tau, "sigma0": p.sigma0}
        return Friction(force=p.J * (p.w + p.tau * dw), rates={"w": dw}, true=true)

    def weight(i: int) -> Parameter:
        meaning = f"weight of basis function {i}"
        return own(f"sigma{i}", f"sigma{i}", "1/s2", (values[i], -1e9, 1e9), meaning)

    own, lagging = declaring(name, CITATION), declaring(name, "dixit2008 eq. (11)")
    values = (*_DEFAULTS[family], *[0.0] * count)
    meaning = "friction acceleration without the viscous part"
    return FrictionLaw(
        name,
        f"modified LuGre friction, {family} basis",
        "dixit2008 eq. (13)-(17)",
        equations,
        parameters=(
            own("sigma0", "sigma0", "1/s2", (values[0], 1e-6, 1e9), "stiffness over inertia"),
            *(weight(i) for i in range(1, count + 1)),
            own("c", "c", "1/rad", (150.0, 1e-6, 1e9), "inverse presliding distance"),
            lagging("tau", "tau", "s", (0.0, 0.0, 10.0), _TAU),
            *([width_parameter(name)] if family == "gaussian" else []),
        ),
        states=(State("w", "rad/s2", meaning, scale=lambda p: p.sigma0 / p.c),),
    )


LAW = modified("modified", "gaussian", gaussian)
