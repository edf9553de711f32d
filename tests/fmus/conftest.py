"""What the tests of the FMUs share: built FMUs, unpacked, and their libraries called without a
layer in between.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from types import ModuleType
from typing import Any
from zipfile import ZipFile

import pytest
from fmpy import read_model_description

from bristle.fmus import obtain
from bristle.fmus.platforms import host
from bristle.model.compiler import SUFFIX

HERE = Path(__file__).parent


def load(name: str) -> ModuleType:
    """Import a neighbouring file; tests are no package."""
    spec = importlib.util.spec_from_file_location(f"bristle_tests_fmus_{name}", HERE / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@dataclass(frozen=True)
class Built:
    """An FMU file and where it is unpacked."""

    path: Path
    folder: Path

    @cached_property
    def description(self) -> Any:
        return read_model_description(str(self.path), validate=False)

    @cached_property
    def fmi(self) -> int:
        return int(self.description.fmiVersion[0])

    @cached_property
    def info(self) -> dict[str, Any]:
        """What `Raw` needs to know."""
        name = self.description.coSimulation.modelIdentifier
        library = self.folder / "binaries" / host().folder(self.fmi) / f"{name}{SUFFIX}"
        vr = {v.name: v.valueReference for v in self.description.modelVariables}
        return {"library": str(library), "fmi": self.fmi, "token": self.description.guid, "vr": vr}

    def names(self, causality: str, kinds: tuple[str, ...] = ("Real", "Float64")) -> list[str]:
        return [
            v.name
            for v in self.description.modelVariables
            if v.causality == causality and v.type in kinds
        ]


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Built]:
    """Return a function that gives an FMU, built and unpacked once; arguments as of `obtain`."""

    @cache
    def give(what: str, **options: Any) -> Built:
        path = obtain(what, **options)
        folder = tmp_path_factory.mktemp(path.stem)
        ZipFile(path).extractall(folder)
        return Built(path, folder)

    return give


@pytest.fixture(scope="session")
def Raw() -> Any:
    """The class of raw.py."""
    return load("raw").Raw


@pytest.fixture(scope="session")
def abuse() -> dict[str, Any]:
    """The cases of abuse.py by name."""
    cases: dict[str, Any] = load("abuse").CASES
    return cases
