"""`bristle new`: a scenario, or a package of an observer, a law or an effect, to begin with."""

from __future__ import annotations

import shlex
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from bristle.cli.app import PASS, DebugOption, app, path_of
from bristle.common.errors import BristleError


class NewKind(StrEnum):
    """scenario: one file; the others: a package that pip installs."""

    scenario = "scenario"
    observer = "observer"
    law = "law"
    effect = "effect"


@app.command(
    short_help="Write a new scenario, observer, law or effect to begin with.",
    epilog=(
        "A scenario is FOLDER/NAME.toml, a package FOLDER/NAME, for pip install -e FOLDER/NAME."
        " Nothing is replaced. Exit code 0: it is written; 2: an error."
    ),
)
def new(
    kind: Annotated[
        NewKind, typer.Argument(help="scenario, observer, law or effect", metavar="KIND")
    ],
    name: Annotated[
        str, typer.Argument(help="its name: lower-case letters, digits and _", metavar="NAME")
    ],
    out: Annotated[
        Path, typer.Option(help="folder in which it is written", metavar="FOLDER", parser=path_of)
    ] = Path(),
    debug: DebugOption = False,
) -> int:
    """Write a scenario file with comments, or a small package with a module, an entry point, a test
    and a scenario.
    """
    from bristle.cli.commands.schema import FileKind, schema_of
    from bristle.cli.scaffold import SCAFFOLDS, write_package, write_scenario
    from bristle.model.declarations import NAME

    if NAME.fullmatch(name) is None:
        raise BristleError(
            f"name '{name}': write lower-case letters, digits and _, with a letter first"
        )
    schema = schema_of(FileKind.scenario)
    if kind is NewKind.scenario:
        [path, *_] = write_scenario(name, out, schema)
        print(f"{path}  next: {shlex.join(['bristle', 'run', str(path), '--out', 'out'])}")
        return PASS
    if name in _taken(SCAFFOLDS[kind.value].group):
        raise BristleError(f"name '{name}': bristle list has it already; choose another")
    write_package(kind.value, name, out, schema)
    install, run = (
        ["pip", "install", "-e", str(out / name)],
        ["bristle", "run", str(out / name / f"{name}.toml"), "--out", "out"],
    )
    print(f"{out / name}  next: {shlex.join(install)}, then {shlex.join(run)}")
    return PASS


def _taken(group: str) -> set[str]:
    """Return the names of laws, effects or observers that there are."""
    from bristle.common.packages import offered
    from bristle.observer import methods
    from bristle.plant.effects import effects
    from bristle.plant.friction import laws
    from bristle.plant.signal_effects import SIGNAL_EFFECTS

    own = {
        "laws": [*laws()],
        "observers": [*methods()],
        "effects": [*effects(packages=False), *SIGNAL_EFFECTS],
    }
    return {*own[group], *offered(group)}
