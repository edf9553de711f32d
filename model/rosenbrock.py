"""RODAS: an L-stable, stiffly accurate Rosenbrock step of order 4 with an embedded error estimate
of order 3.
"""

from __future__ import annotations

import casadi as ca

from bristle.model.linear import Elimination
from bristle.model.switching import passed
from bristle.model.system import System

SX = ca.SX

# Coefficients: hairer1996, code RODAS, method 1. Stages 5 and 6 add the stage before to the same
# point.
GAMMA = 0.25
STAGE_TIME = (0.0, 0.386, 0.21, 0.63, 1.0, 1.0)  # where in the step each stage stands
TIME_GAMMA = (0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0)  # weight of h df/dt in each stage
A = (  # stage point = x + sum A u
    (),
    (1.544,),
    (0.9466785280815826, 0.2557011698983284),
    (3.314825187068521, 2.896124015972201, 0.9986419139977817),
    (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950),
    (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0),
)
C = (  # stage equation gets sum C u / h
    (),
    (-5.6688,),
    (-2.430093356833875, -0.2063599157091915),
    (-0.1073529058151375, -9.594562251023355, -20.47028614809616),
    (7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160),
    (
        8.083246795921522,
        -7.981132988064893,
        -31.52159432874371,
        16.31930543123136,
        -6.058818238834054,
    ),
)


def rodas(system: System, h: SX) -> tuple[SX, SX]:
    """Return (x after a step of length h, error norm), both symbolic; the step is acceptable if the
    norm is <= 1.

    The Jacobian is exact; the linear systems are solved symbolically, so that the step is one
    straight line of arithmetic that can be differentiated and printed in any language. The last
    stage is the estimate of the error.

    Source: hairer1996 section IV.7, stage equations in the form (7.25).
    """
    x, t = system.vector(list(system.states)), system.time
    f = system.rate_vector()
    rest = ca.vertcat(*(s for name, s in system.symbols.items() if name not in system.states))
    rates = ca.Function("rates", [x, t, rest], [f])
    factors = Elimination(SX.eye(x.shape[0]) / (GAMMA * h) - ca.jacobian(f, x))
    f_t = ca.jacobian(f, t)
    stages: list[SX] = []
    point = x
    for i, (a, c) in enumerate(zip(A, C, strict=True)):
        point = x + sum(weight * u for weight, u in zip(a, stages, strict=True)) if a else x
        history = sum(
            (weight * u for weight, u in zip(c, stages, strict=True)), SX.zeros(x.shape[0])
        )
        value = rates(point, t + STAGE_TIME[i] * h, rest)
        stages.append(factors.solve(value + history / h + TIME_GAMMA[i] * h * f_t))
    scale = ca.vertcat(*(SX(state.scale) for state in system.states.values()))
    size = ca.fabs(stages[-1]) / scale
    norm = size[0]
    for i in range(1, x.shape[0]):
        norm = ca.fmax(norm, size[i])
    end = point + stages[-1]
    for late in passed(system, end, h):
        norm = ca.fmax(norm, late)
    return end, norm / system.symbols["solver.tolerance"]
