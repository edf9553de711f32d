"""`bristle schema`: the JSON schema of a file, for editors."""

from __future__ import annotations

import json
from enum import StrEnum
from typing import Annotated, Any

import typer

from bristle.cli.app import PASS, DebugOption, app


class FileKind(StrEnum):
    """scenario: of bristle run; model: of bristle diagnose."""

    scenario = "scenario"
    model = "model"


@app.command(short_help="Print the JSON schema of scenario or model files, for editors.")
def schema(
    kind: Annotated[FileKind, typer.Argument(help="scenario or model", metavar="KIND")],
    debug: DebugOption = False,
) -> int:
    """Print a JSON schema; an editor that knows TOML checks and completes files with it."""
    print(json.dumps(schema_of(kind), indent=2))
    return PASS


def schema_of(kind: FileKind) -> dict[str, Any]:
    """Return the JSON schema of a kind of file."""
    from bristle.diagnosis.modelfile import ModelTable
    from bristle.harness.scenario.scenario import Scenario

    found = (Scenario if kind is FileKind.scenario else ModelTable).model_json_schema()
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **found,
        "title": f"{kind} file of bristle",
    }
