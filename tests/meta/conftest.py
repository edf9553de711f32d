"""Shared by the meta tests: the modules of the library."""

from __future__ import annotations

import importlib
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def modules() -> dict[str, ModuleType]:
    """Every module of every package of the library, by name."""
    setuptools = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "setuptools"
    ]
    names = {
        package if path.stem == "__init__" else f"{package}.{path.stem}"
        for package in setuptools["packages"]
        for path in (ROOT / setuptools["package-dir"].get(package, package)).glob("*.py")
    }
    return {name: importlib.import_module(name) for name in sorted(names)}
