"""What the integrator's tests share: the independent references, and our plants driven by the same
feedback.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from bristle.model.native import Native
from bristle.model.program import Program
from bristle.plant.servo import servo_program

REFERENCE = Path(__file__).parents[2] / "benchmarks" / "integration" / "reference.py"


@pytest.fixture(scope="session")
def reference() -> ModuleType:
    """The independent right-hand sides, scenarios and solver of benchmarks/integration."""
    spec = importlib.util.spec_from_file_location("bristle_integration_reference", REFERENCE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@cache
def _program(law: str) -> Program:
    return servo_program(law)


@pytest.fixture(scope="session")
def program() -> Callable[[str], Program]:
    """Return the servo of one law, made once."""
    return _program


@pytest.fixture(scope="session")
def closed_loop(program):
    """Return a function that simulates a plant under a feedback computed at each step: states at
    0..n.
    """

    def run(plant, feedback, n, h=1e-3, **parameters):
        servo = program(plant.law)
        native = Native(
            servo, plant.parameters | {f"solver.{k}": value for k, value in parameters.items()}
        )
        states = [
            servo.index[name]
            for name in (f"{plant.law}.theta", f"{plant.law}.v", plant.friction_state)
        ]
        u = servo.index["u"]
        x = np.zeros((n + 1, 3))
        v = native.values
        for k in range(n):
            v[u] = feedback(k, x[k, 0], x[k, 1])
            native.write(v)
            native.advance(h)
            v = native.values
            x[k + 1] = v[states]
        return x, native.steps

    return run
