"""`bristle list`: laws, observers, effects and scenarios."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bristle.cli.app import app

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bristle.model.declarations import Part


@app.command("list", short_help="List friction laws, observers, effects and scenarios.")
def list_command() -> None:
    """List friction laws, observer methods, effects and scenarios, also those of plug-in folders
    and installed packages.
    """
    from bristle.harness.scenario.catalogue import scenarios
    from bristle.observer import methods
    from bristle.plant.effects import effects
    from bristle.plant.friction import laws
    from bristle.plant.signal_effects import SIGNAL_EFFECTS

    found = {
        name: f"{e.description} (class {e.group})" if e.group != name else e.description
        for name, e in effects().items()
    }
    listed = {
        "friction laws": _described(laws(packages=True)),
        "observer methods": _described(methods(packages=True)),
        "scenarios": scenarios(),
        "effects": found,
        "effects on signals (not part of a diagnosis)": _described(SIGNAL_EFFECTS),
    }
    for title, entries in listed.items():
        print(f"{title}:")
        width = max((len(name) for name in entries), default=0)
        for name, description in entries.items():
            print(f"  {name:<{width}}  {description}".rstrip())


def _described(parts: Mapping[str, Part]) -> dict[str, str]:
    return {name: part.description for name, part in parts.items()}
