"""RODAS3: an L-stable, stiffly accurate Rosenbrock step of order 3 with an embedded error estimate of order 2."""

from __future__ import annotations

import casadi as ca

from bristle.model.linear import Elimination
from bristle.model.system import System

SX = ca.SX

GAMMA = 0.5
STAGE_TIME = (0.0, 0.0, 1.0, 1.0)  # where in the step each stage stands
TIME_GAMMA = (0.5, 1.5, 0.0, 0.0)  # weight of h df/dt in each stage
A = ((), (0.0,), (2.0, 0.0), (2.0, 0.0, 1.0))  # stage point = x + sum A u
C = ((), (4.0,), (1.0, -1.0), (1.0, -1.0, -8.0 / 3.0))  # stage equation gets sum C u / h
M = (2.0, 0.0, 1.0, 1.0)  # x_new = x + sum M u
E = (0.0, 0.0, 0.0, 1.0)  # error = sum E u


def rodas3(system: System, h: SX) -> tuple[SX, SX]:
    """Return (x after a step of length h, error norm), both symbolic; the step is acceptable if the norm is <= 1.

    The Jacobian is exact; the linear systems are solved symbolically, so that the step is one straight line of
    arithmetic that can be differentiated and printed in any language.

    Source: sandu1997, coefficients in the form of hairer1996 eq. IV.(7.25).
    """
    x, t = system.vector(list(system.states)), system.time
    f = system.rate_vector()
    rest = ca.vertcat(*(s for name, s in system.symbols.items() if name not in system.states))
    rates = ca.Function("rates", [x, t, rest], [f])
    factors = Elimination(SX.eye(x.shape[0]) / (GAMMA * h) - ca.jacobian(f, x))
    f_t = ca.jacobian(f, t)
    stages: list[SX] = []
    value = f
    for i in range(4):
        if any(A[i]):
            point = x + sum(a * u for a, u in zip(A[i], stages, strict=True) if a)
            value = rates(point, t + STAGE_TIME[i] * h, rest)
        history = sum((c * u for c, u in zip(C[i], stages, strict=True)), SX.zeros(x.shape[0]))
        stages.append(factors.solve(value + history / h + TIME_GAMMA[i] * h * f_t))
    x_new = x + sum(m * u for m, u in zip(M, stages, strict=True) if m)
    error = sum(e * u for e, u in zip(E, stages, strict=True) if e)
    scale = ca.vertcat(*(SX(state.scale) for state in system.states.values()))
    size = ca.fabs(error) / scale
    norm = size[0]
    for i in range(1, x.shape[0]):
        norm = ca.fmax(norm, size[i])
    return x_new, norm / system.symbols["solver.tolerance"]
