"""Friction laws, observers and scenarios by name, and FMUs as files."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from pathlib import Path

from bristle.common.output import output_folder
from bristle.common.plugins import plugin_files
from bristle.fmus.host import Fmu


def scenarios() -> dict[str, str]:
    """Return the titles of the scenarios that come with bristle, and of those in plug-in folders, by name."""
    own = [entry for entry in files("bristle.scenarios").iterdir() if entry.name.endswith(".toml")]
    found = sorted([*own, *plugin_files("scenarios", ".toml")], key=lambda entry: entry.name)
    titles = (tomllib.loads(entry.read_text(encoding="utf-8")).get("title", "") for entry in found)
    return {entry.name.removesuffix(".toml"): str(title) for entry, title in zip(found, titles, strict=True)}


def _choices(what: str, selector: str) -> dict[str, str]:
    """Return the items of an FMU's selector with their descriptions."""
    from bristle.fmus import obtain

    fmu = Fmu(obtain(what))
    declared = fmu.variables[selector].declaredType
    return {str(item.name): str(item.description or "") for item in declared.items}


def catalogue() -> dict[str, dict[str, str]]:
    """Return laws, methods and scenarios with a line about each, from the FMUs and the scenario files."""
    return {
        "friction laws": _choices("plant", "law"),
        "observer methods": _choices("observer", "method"),
        "scenarios": scenarios(),
    }


def build_file(what: str, out: Path, *, fmi: int, kind: str, law: str | None, method: str | None) -> Path:
    """Build an FMU into the folder `out`, named after what it is."""
    from bristle.fmus import build

    names = {"plant": "ServoPlant", "observer": "AdaptiveObserver", "controller": "Controller"}
    variant = law or method
    stem = names.get(what, what) + (f"_{variant}" if variant else "")
    with output_folder(out):
        return build(what, out / f"{stem}.fmu", fmi=fmi, kind=kind, law=law, method=method)
