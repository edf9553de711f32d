"""`bristle list`: laws, observers, effects and scenarios."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bristle.cli.app import app

if TYPE_CHECKING:
    pass


@app.command("list", short_help="List friction laws, observers, effects and scenarios.")
def list_command() -> None:
    """List friction laws, observer methods, effects and the scenarios that come with bristle."""
    from bristle.harness.catalogue import catalogue
    from bristle.plant.effects import effects
    from bristle.plant.signal_effects import SIGNAL_EFFECTS

    found = {name: f"{e.description} (class {e.group})" if e.group != name else e.description for name, e in effects().items()}
    signal = {name: e.description for name, e in SIGNAL_EFFECTS.items()}
    for title, entries in {**catalogue(), "effects": found, "effects on signals (not part of a diagnosis)": signal}.items():
        print(f"{title}:")
        width = max((len(name) for name in entries), default=0)
        for name, description in entries.items():
            print(f"  {name:<{width}}  {description}".rstrip())
