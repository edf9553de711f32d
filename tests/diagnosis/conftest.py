"""What the tests of a diagnosis share: made-up answers, one of each verdict."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from bristle.diagnosis.result import Diagnosis


def _load(name: str) -> ModuleType:
    """Import a neighbouring file; tests are no package."""
    full = f"bristle_tests_diagnosis_{name}"
    if full not in sys.modules:
        spec = importlib.util.spec_from_file_location(full, Path(__file__).parent / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        sys.modules[full] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[full])
    return sys.modules[full]


@pytest.fixture(scope="session")
def fabricated() -> ModuleType:
    """The module fabricated.py."""
    return _load("fabricated")


@pytest.fixture
def answer(fabricated: ModuleType) -> Callable[[str], Diagnosis]:
    """Return a maker of diagnoses by case: named, tie, none, not_identifiable, proposals."""
    return lambda case: fabricated.CASES[case]()
