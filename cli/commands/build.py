"""`bristle build`: FMUs."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bristle.cli.app import DebugOption, Fmi, FmiOption, Kind, KindOption, app, path_of
from bristle.cli.completion import complete_effects, complete_law, complete_method
from bristle.cli.terminal import fraction

if TYPE_CHECKING:
    pass


class What(StrEnum):
    """Which FMU."""

    plant = "plant"
    observer = "observer"
    controller = "controller"
    all = "all"


@app.command()
def build(
    what: Annotated[What, typer.Argument(help="which FMU")] = What.all,
    out: Annotated[
        Path, typer.Option(help="folder for the .fmu files", metavar="FOLDER", parser=path_of)
    ] = Path(),
    fmi: FmiOption = Fmi.two,
    kind: KindOption = Kind.native,
    law: Annotated[
        str | None, typer.Option(help="a plant of one friction law", autocompletion=complete_law)
    ] = None,
    method: Annotated[
        str | None, typer.Option(help="an observer of one method", autocompletion=complete_method)
    ] = None,
    effects: Annotated[
        list[str] | None,
        typer.Option(
            help="effects of the plant, separated by commas",
            metavar="NAME,...",
            autocompletion=complete_effects,
        ),
    ] = None,
    encoder: Annotated[
        bool, typer.Option(help="without: Model Exchange for a plant of one smooth law")
    ] = True,
    platforms: Annotated[
        str,
        typer.Option(
            help="host, all, or names such as win64,linux64; others than host need bristle[cross]",
            metavar="NAME,...",
        ),
    ] = "host",
    debug: DebugOption = False,
) -> None:
    """Build FMUs."""
    from bristle.harness.scenario.catalogue import Choice, build_files

    added = tuple(name.strip() for names in effects or () for name in names.split(","))
    asked = Choice(law, method, added, encoder, platforms)
    choices = {what.value: asked}
    if what is What.all:
        plant, observer = (
            replace(asked, method=None),
            replace(asked, law=None, effects=(), encoder=True),
        )
        choices = {"plant": plant, "observer": observer, "controller": Choice(platforms=platforms)}
    with fraction("build") as tell:
        made = build_files(choices, out, fmi=int(fmi.value), kind=kind.value, tell=tell)
    print("\n".join(map(str, made)))
