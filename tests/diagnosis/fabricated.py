"""Diagnoses made up for the tests of what is written about them: one of each verdict, with records
that look like some.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis.answer import (
    CandidateEffect,
    Diagnosis,
    Estimate,
    Excitation,
    Gap,
    Named,
    RecordTrace,
    ResidualView,
    Round,
    Undetected,
    Unexplained,
)
from bristle.diagnosis.modelfile import Model

Array = NDArray[np.float64]

STEP, SEGMENT = 2e-3, 200  # s, samples
J, A2, FC = 0.01, 0.02, 0.12


def model(**changes: Any) -> Model:
    """Return a model as its file gives it."""
    table = {
        "friction": "coulomb",
        "parameters": {"J": 0.011, "a2": 0.015, "Fc": 0.1},
        "bounds": {"J": [0.003, 0.03], "a2": [0.0, 0.2], "Fc": [0.0, 0.6]},
        "time": {"column": "t", "unit": "s"},
        "input": {"column": "u", "kind": "torque", "unit": "N.m"},
        "output": {
            "column": "theta",
            "kind": "position",
            "unit": "rad",
            "resolution": 3.834951969714103e-4,
        },
    }
    return Model.from_dict(table | changes)


def linear_model() -> Model:
    """Return the model of a linear axis."""
    return model(
        parameters={"J": "2 kg", "a2": "8 N.s/m", "Fc": "3 N"},
        bounds={"J": [0.5, 6.0]},
        input={"column": "F", "kind": "force", "unit": "N"},
        output={"column": "x", "kind": "position", "unit": "mm", "resolution": 0.001},
    )


def estimate(value: float, unit: str, percent: float = 3.0, at_bound: bool = False) -> Estimate:
    half = abs(value) * percent / 100
    return Estimate(value, unit, None if at_bound else (value - half, value + half), at_bound)


def simulate(
    u: Array,
    start: tuple[float, float],
    missing: Callable[[float, float], float],
    time: float = 0.0,
    last: int | None = None,
) -> Array:
    """Return positions by semi-implicit Euler with a friction that sticks."""
    theta, v = start
    out = np.empty(len(u))
    for k, torque in enumerate(u):
        out[k] = theta
        free = v + STEP / J * (torque + missing(theta, time + k * STEP) - A2 * v)
        v = np.sign(free) * max(abs(free) - STEP / J * FC, 0.0)
        theta += STEP * v
    return out


def trace(
    name: str,
    seed: int,
    missing: Callable[[float, float], float],
    explained: bool = True,
    seconds: float = 12.0,
) -> RecordTrace:
    """Return a record with simulated segments; every third is held out."""
    rng = np.random.default_rng(seed)
    time = STEP * np.arange(round(seconds / STEP))
    u = 0.35 * np.sin(2 * np.pi * 0.5 * time + seed) + 0.15 * np.sin(2 * np.pi * 1.7 * time)
    truth = simulate(u, (0.0, 0.0), missing)
    speed = np.gradient(truth, STEP)
    measured = truth + rng.normal(0, 3e-4, len(time))
    before, after = np.full_like(truth, np.nan), np.full_like(truth, np.nan)
    held_out = np.zeros(len(time), dtype=bool)
    for number, first in enumerate(range(0, len(time) - SEGMENT, SEGMENT)):
        part = slice(first, first + SEGMENT)
        before[part] = simulate(u[part], (truth[first], speed[first]), lambda theta, t: 0.0)
        after[part] = simulate(
            u[part],
            (truth[first], speed[first]),
            missing if explained else lambda theta, t: 0.0,
            time[first],
        )
        held_out[part] = number % 3 == 2
    return RecordTrace(name, time, u, measured, before, after, held_out)


def cogging(theta: float, time: float) -> float:
    return float(0.06 * np.sin(7 * theta + 0.4))


def position_view(amplitude: float, share: float, after: float = 0.01) -> ResidualView:
    centres = np.linspace(-2.0, 2.0, 41)
    rng = np.random.default_rng(3)
    curve = amplitude * np.sin(7 * centres + 0.4)
    noise = rng.normal(0, 0.05 * abs(amplitude) + 1e-3, (4, 41))
    return ResidualView(
        "theta",
        share,
        0.001,
        after,
        0.4,
        centres=centres,
        before=np.array([curve, curve]) + noise[:2],
        after=0.3 * noise[2:],
        lines=("forward", "backward"),
    )


def velocity_view(share: float) -> ResidualView:
    centres = np.linspace(-6.0, 6.0, 25)
    rng = np.random.default_rng(4)
    return ResidualView(
        "v",
        share,
        0.02,
        0.008,
        0.6,
        centres=centres,
        before=rng.normal(0.008 * np.sign(centres), 3e-3)[None],
        after=rng.normal(0, 2e-3, (1, 25)),
    )


CANDIDATES = (
    CandidateEffect("cogging", 412.0, 9.8),
    CandidateEffect("gravity", 96.0, 9.8),
    CandidateEffect("position_friction", 88.2, 9.8),
    CandidateEffect("hard_stop", 41.0, 9.8, "stiffness at its bound"),
    CandidateEffect("eccentric_encoder", 30.5, 9.8),
    CandidateEffect("stribeck", 12.1, 9.8),
    CandidateEffect("bias", 6.0, 9.8),
    CandidateEffect("asymmetric_coulomb", 5.7, 9.8),
    CandidateEffect("quadratic_drag", 3.1, 9.8),
    CandidateEffect("dead_zone", 2.2, 9.8),
    CandidateEffect("input_delay", 1.4, 9.8),
    CandidateEffect("friction_drift", float("nan"), 9.8, "did not converge"),
)
LIMITS = tuple(
    Undetected(name, text)
    for name, text in {
        "stribeck": "excess 0.18 at speed 0.3 rad/s",
        "input_delay": "1.1 ms",
        "gravity": "0.004 N.m",
        "hard_stop": "cannot be seen: the records stay within ±2.0 rad",
        "backlash": "0.002 rad",
        "back_emf": "cannot be seen: with a torque input it equals viscous friction",
    }.items()
)
EXCITATION = Excitation(
    {
        "records": 2,
        "samples": 12000,
        "duration": {"value": 24.0, "unit": "s"},
        "sampling_period": {"value": STEP, "unit": "s"},
        "input_range": {"lowest": -0.5, "highest": 0.5, "unit": "N.m"},
        "input_bandwidth": {"value": 9.2, "unit": "Hz"},
        "speed_range": {"lowest": -6.1, "highest": 5.9, "unit": "rad/s"},
        "range_travelled": {"value": 4.0, "unit": "rad"},
        "reversals": 58,
        "rest_share": 0.04,
        "forward_share": 0.47,
        "backward_share": 0.49,
        "turns_travelled": 0.63,
    },
    caveats=(
        "Less than one turn: what repeats once in a turn is hardly seen.",
        "Little rest: bias and asymmetric friction look alike.",
    ),
)


COGGING = {
    "amplitude": estimate(0.06, "N.m"),
    "phase": estimate(0.4, "rad"),
    "periods": estimate(7.0, "1", 0.1),
    "amplitude2": estimate(0.0006, "N.m", 150),
    "phase2": estimate(1.2, "rad", 90),
}
COGGING_STATEMENT = (
    "Cogging explains the difference: a torque of 0.060 N·m that repeats 7 times in a turn.",
    "On data that took no part in the search the gap shrank by 99.8 %. Nothing else stands out.",
)


def named() -> Diagnosis:
    """Cogging, found in two records."""
    second = tuple(replace(c, gain=c.gain / 60) for c in CANDIDATES[1:])
    return Diagnosis(
        verdict="named",
        leads=COGGING_STATEMENT,
        effects=(Named("cogging", "cogging", COGGING, 388.0, 0.001),),
        ties=(),
        where=(position_view(0.06, 0.61), velocity_view(0.05)),
        remains=Unexplained(False, None, 0.03),
        gap=Gap(8.2e-6, 1.1e-7, 9.4e-8, "rad"),
        excited=EXCITATION,
        notes=(
            "run_2.csv: 3 samples were missing at 4.21 s; the segments around them are left out.",
        ),
        base={
            "J": estimate(0.0103, "kg.m2"),
            "a2": estimate(0.031, "N.m.s/rad", 12),
            "coulomb.Fc": estimate(0.127, "N.m"),
        },
        fitted={
            "J": estimate(J, "kg.m2", 0.5),
            "a2": estimate(A2, "N.m.s/rad"),
            "coulomb.Fc": estimate(FC, "N.m", 0.7),
        },
        rounds=(
            Round(
                CANDIDATES,
                9.8,
                0.001,
                "added",
                "cogging added: far above chance, no other within 15 %",
                "cogging",
            ),
            Round(second, 9.1, 0.7, "none", "stopped: nothing above chance"),
        ),
        limits=LIMITS,
        traces=(trace("run_1.csv", 1, cogging), trace("run_2.csv", 2, cogging)),
        model=model(),
        seconds=38.0,
    )


def tie() -> Diagnosis:
    """Bias or asymmetric Coulomb friction."""
    parameters = {
        "J": estimate(J, "kg.m2"),
        "a2": estimate(0.02, "N.m.s/rad"),
        "coulomb.Fc": estimate(0.121, "N.m"),
    }
    candidates = tuple(
        replace(
            c, gain={"bias": 61.0, "asymmetric_coulomb": 60.4}.get(c.name, min(c.gain, 21.0) * 0.4)
        )
        for c in CANDIDATES
    )
    return replace(
        named(),
        verdict="tie",
        leads=(
            (
                "A constant torque or friction that differs between the directions: these records"
                " show only their sum."
            ),
        ),
        effects=(),
        ties=(("bias", "asymmetric_coulomb"),),
        where=(ResidualView("direction", 0.34, 0.001, 0.01, 0.5), velocity_view(0.22)),
        gap=Gap(1.9e-6, 1.9e-6, 1.0e-7, "rad"),
        rounds=(
            Round(
                candidates,
                9.5,
                0.001,
                "tie",
                "bias and asymmetric_coulomb tie: 1 % between their gains",
                "bias",
                ties=("asymmetric_coulomb",),
            ),
        ),
        fitted={},
        choices={
            "bias": {"torque": estimate(0.02, "N.m", 2)},
            "asymmetric_coulomb": {"share": estimate(0.165, "1", 3)},
        },
        choice_parameters={"bias": parameters, "asymmetric_coulomb": parameters},
        traces=(trace("run_1.csv", 1, lambda theta, t: 0.02, explained=False),),
    )


def none() -> Diagnosis:
    """A tone in time that no effect of the catalogue explains."""
    candidates = tuple(replace(c, gain=min(c.gain, 30) * 0.2) for c in CANDIDATES)
    view = ResidualView(
        "t",
        0.41,
        0.001,
        0.41,
        0.001,
        centres=np.linspace(0, 12, 60),
        before=0.03 * np.sin(np.arange(60) * 1.1)[None],
        after=0.03 * np.sin(np.arange(60) * 1.1)[None],
    )
    return replace(
        named(),
        verdict="none",
        leads=(
            "No effect of the 22 explains the difference.",
            "Something remains: it follows time, not the motion.",
        ),
        effects=(),
        where=(view,),
        remains=Unexplained(True, "t", 0.41),
        gap=Gap(9.0e-7, 9.0e-7, 1.0e-7, "rad"),
        rounds=(Round(candidates, 9.8, 0.31, "none", "stopped: nothing above chance"),),
        fitted={},
        notes=(),
        traces=(
            trace("run_1.csv", 1, lambda theta, t: float(0.04 * np.sin(12 * t)), explained=False),
        ),
    )


def not_identifiable() -> Diagnosis:
    """A linear axis that hardly moves."""
    slow = trace("slow.csv", 3, lambda theta, t: 0.0, seconds=6.0)
    scaled = replace(
        slow, measured=slow.measured * 5e-3, before=slow.before * 5e-3, after=slow.after * 5e-3
    )
    return replace(
        named(),
        verdict="not_identifiable",
        leads=(
            (
                "The axis moved 3 mm at one speed: mass, viscous and dry friction cannot be"
                " distinguished."
            ),
        ),
        effects=(),
        where=(),
        remains=Unexplained(False, None, 0.02),
        gap=Gap(4.0e-11, 4.0e-11, None, "m"),
        base={
            "J": estimate(6.0, "kg", at_bound=True),
            "a2": estimate(7.0, "N.s/m", 80),
            "coulomb.Fc": estimate(3.4, "N", 40),
        },
        fitted={},
        rounds=(),
        limits=(),
        excited=Excitation(
            {
                "range_travelled": {"value": 0.003, "unit": "m"},
                "reversals": 2,
                "speed_range": {"lowest": 0.010, "highest": 0.011, "unit": "m/s"},
            },
            caveats=("Two reversals only.",),
        ),
        notes=(),
        traces=(scaled,),
        model=linear_model(),
        seconds=4.0,
    )


def proposals() -> Diagnosis:
    """An input with the wrong sign."""
    return replace(
        none(),
        verdict="not_identifiable",
        remains=Unexplained(False, None, 0.0),
        leads=("The input does not fit the motion, so nothing was searched.",),
        corrections=(
            (
                "run_1.csv, column u: the acceleration answers to −u (correlation −0.94); turn its"
                " sign, or that of theta."
            ),
            (
                "run_1.csv, column theta: speeds of 344 rad/s from 0.4 N.m; it looks like degrees:"
                ' write unit = "deg".'
            ),
        ),
        where=(),
        rounds=(),
        limits=(),
        base={},
        gap=Gap(4.1, 4.1, None, "rad"),
    )


CASES: dict[str, Callable[[], Diagnosis]] = {
    "named": named,
    "tie": tie,
    "none": none,
    "not_identifiable": not_identifiable,
    "proposals": proposals,
}
