"""What all commands share: the application, exit codes, kinds of options."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from bristle.cli.completion import complete_scenario
from bristle.common.arguments import filled_path
from bristle.common.errors import BristleError

PASS, FAIL, ERROR = 0, 1, 2

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


class Kind(StrEnum):
    """native: compiled C99; python: for hosts that run in Python."""

    native = "native"
    python = "python"


class Fmi(StrEnum):
    """Version of FMI."""

    two = "2"
    three = "3"


def path_of(given: str | Path) -> Path:
    """Return the path of an option or argument."""
    try:
        return filled_path(given)
    except BristleError as error:
        raise typer.BadParameter(str(error)) from None  # the parser adds which option it is


KindOption = Annotated[
    Kind, typer.Option(help="native: compiled; python: for hosts that run in Python")
]
FmiOption = Annotated[Fmi, typer.Option(help="version of FMI")]
TimeoutOption = Annotated[
    float | None,
    typer.Option(
        help=(
            "seconds that a simulation of an FMU from elsewhere may take; else a minute for a call"
        ),
        min=0.001,
        metavar="S",
    ),
]


def scenario_argument(text: str) -> Any:
    """Return the argument of a command that is one scenario or several; `text` is its help."""
    return typer.Argument(
        help=text, metavar="SCENARIO", parser=path_of, autocompletion=complete_scenario
    )


ScenarioArgument = Annotated[Path, scenario_argument("file, or name from bristle list")]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="PATH=VALUE", help="override a value of the file"),
]
SeedOption = Annotated[int | None, typer.Option(help="seed of the controller's reference")]
DebugOption = Annotated[bool, typer.Option("--debug", help="show the traceback of an error")]


def _print_version(wanted: bool) -> None:
    if wanted:
        import bristle as library

        print(f"bristle {library.__version__}")
        raise typer.Exit(PASS)


@app.callback()
def bristle(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="print the version"),
    ] = False,
) -> None:
    """Servo friction and the adaptive observers that identify it, as FMUs, co-simulated over
    scenario files.
    """
