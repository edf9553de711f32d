"""New scenarios, and new packages of an observer, a law or an effect, from the templates beside
this file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from string import Template

from bristle.common.errors import BristleError
from bristle.common.output import output_folder, replace_files

SCHEMA_FILE = "scenario.schema.json"  # that the first line of a scenario names


@dataclass(frozen=True)
class Scaffold:
    """What is written for a kind of part: group of the entry point, words, how it is built, and its
    scenario.
    """

    group: str
    what: str
    build: str
    scenario: Mapping[str, str]


FIRST_SCENARIO = {
    "law": "modified",
    "effects": "",
    "values": "",
    "method": "rls",
    "sensor": "encoder",
    "limit": "2.0",
}
# a damper that leaves the servo its motion
WEAK_DAMPER = '"$name.coefficient" = "0.00000001 N.m.s3/rad3"\n'
SCAFFOLDS = {
    "law": Scaffold(
        "laws", "friction law", "plant --law $name", {**FIRST_SCENARIO, "law": "$name"}
    ),
    "effect": Scaffold(
        "effects",
        "effect",
        "plant --law lugre --effects $name",
        {**FIRST_SCENARIO, "effects": '"$name"', "values": WEAK_DAMPER},
    ),
    "observer": Scaffold(
        "observers",
        "observer",
        "observer --method $name",
        {**FIRST_SCENARIO, "method": "$name", "sensor": "clean"},
    ),
}


def write_scenario(name: str, out: Path, schema: Mapping[str, object]) -> list[Path]:
    """Write a commented scenario file, and beside it the schema it names, unless that is there.

    Raises
    ------
    BristleError
        If the file exists, or the folder cannot be written. Nothing is written then.
    """
    written = {
        f"{name}.toml": _filled(
            "scenario", {"name": name, "title": f"Scenario {name}", **FIRST_SCENARIO}
        )
    }
    if not (out / SCHEMA_FILE).exists():
        written[SCHEMA_FILE] = _schema_text(schema)
    return _write(out, written, f"{name}.toml")


def write_package(kind: str, name: str, out: Path, schema: Mapping[str, object]) -> list[Path]:
    """Write a package of one law, effect or observer into the new folder `out/name`: module, entry
    point, test, scenario, readme.

    Raises
    ------
    BristleError
        If the folder exists, or cannot be written. Nothing is written then.
    """
    scaffold, module = SCAFFOLDS[kind], f"bristle_{name}"
    words = {
        "name": name,
        "module": module,
        "distribution": module.replace("_", "-"),
        "title": f"The {scaffold.what} {name}",
    }
    words |= {
        "group": scaffold.group,
        "what": scaffold.what,
        "build": Template(scaffold.build).substitute(words),
    }
    words |= {key: Template(text).substitute(words) for key, text in scaffold.scenario.items()}
    written = {
        f"{name}/pyproject.toml": _filled("pyproject", words),
        f"{name}/README.md": _filled("README", words),
        f"{name}/{module}.py": _filled(kind, words),
        f"{name}/tests/test_{name}.py": _filled(f"test_{kind}", words),
        f"{name}/{name}.toml": _filled("scenario", words),
        f"{name}/{SCHEMA_FILE}": _schema_text(schema),
    }
    return _write(out, written, name)


def _filled(template: str, words: Mapping[str, str]) -> bytes:
    text = (files("bristle.cli") / "templates" / f"{template}.txt").read_text(encoding="utf-8")
    return Template(text).substitute(words).encode()


def _schema_text(schema: Mapping[str, object]) -> bytes:
    return f"{json.dumps(schema, indent=2)}\n".encode()


def _write(out: Path, content: Mapping[str, bytes], new: str) -> list[Path]:
    """Write files into a folder, in which there is nothing called `new`."""
    if (out / new).exists():
        raise BristleError(
            f"{out / new}: exists; choose another name, or another folder with --out"
        )
    with output_folder(out):
        return replace_files(out, content, list(content))
