"""The FMUs that a scenario names: those of bristle are built, those from elsewhere are checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from bristle.common.errors import BristleError, suggest
from bristle.fmus.alias import Mapped, alias
from bristle.fmus.host import Alias, Fmu
from bristle.harness.cosim.ports import PORTS
from bristle.harness.scenario.reading import Loaded
from bristle.harness.scenario.scenario import PartTable

Kind = Literal["native", "python"]


def build_fmus(loaded: Loaded, fmi: int = 2, kind: Kind = "native") -> dict[str, Fmu]:
    """Return the FMUs a scenario needs, building those of bristle that are not in the cache."""
    scenario = loaded.scenario
    parts: dict[str, PartTable | None] = {"observer": scenario.observer}
    if scenario.plant is not None:
        parts = {
            "controller": None if scenario.open_loop else scenario.controller,
            "plant": scenario.plant,
            **parts,
        }
    fmus = {}
    for name, part in parts.items():
        if part is None:
            continue
        if part.fmu is None and part.variables:
            raise loaded.error(
                f"{name}.variables",
                None,
                f"names those of an FMU of your own; give {name}.fmu, or remove it",
            )
        if part.fmu is not None:
            fmus[name] = _foreign(loaded, name, part.fmu, part.variables)
        else:
            fmus[name] = _own(loaded, name, part, fmi, kind)
    return fmus


def _own(loaded: Loaded, name: str, part: PartTable, fmi: int, kind: Kind) -> Fmu:
    """Return an FMU of bristle, of the chosen law or method alone: no other is compiled."""
    from bristle.fmus.build import obtain

    selector, effects = PORTS[name].selector, getattr(part, "effects", [])
    choice = getattr(part, selector, None)
    law, method = (choice if selector == option else None for option in ("law", "method"))
    try:
        return Fmu(obtain(name, fmi=fmi, kind=kind, law=law, method=method, effects=effects))
    except BristleError as error:
        raise _not_built(loaded, name, choice, bool(effects), error) from None


def _not_built(
    loaded: Loaded, name: str, choice: str | None, effects: bool, error: BristleError
) -> BristleError:
    """Return the error of an FMU that cannot be built, with the place in the scenario that it is
    about; one that is about the machine stays as it is.
    """
    from bristle.fmus.build import is_packaged, plugins_of, variant_names

    if choice is None:
        return error
    key = f"{name}.{PORTS[name].selector}"
    if is_packaged(name, choice):
        return loaded.error(key, choice, str(error))
    if effects or plugins_of(name):
        return loaded.error(name, None, str(error))
    known = variant_names(name)
    if choice in known:
        return error
    message = f"unknown {PORTS[name].selector}{suggest(choice, known)}"
    return loaded.error(key, choice, f"{message}; choose one of: {', '.join(known)}")


def _foreign(loaded: Loaded, name: str, file: str, variables: Mapping[str, Mapped]) -> Fmu:
    aliases = {key: _alias(loaded, name, key, given) for key, given in variables.items()}
    try:
        fmu = Fmu(loaded.beside(file), True, aliases)
    except BristleError as error:
        raise loaded.error(f"{name}.fmu", file, str(error)) from None
    ports = PORTS[name]
    for needed in ports.needed:
        side = "input" if needed in ports.inputs else "output"
        if not fmu.has(needed, side) or not fmu.is_real(needed):
            have = ", ".join(fmu.names(side)) or "none"
            advice = f'name the one that is meant: [{name}.variables] {needed} = "..."'
            raise loaded.error(
                f"{name}.fmu",
                file,
                f"has no Real {side} '{needed}' (its {side}s: {have}); {advice}",
            )
    try:
        for variable in ports.units:
            if variable in fmu.variables:
                fmu.check_si(variable, *ports.allowed_units(variable))
    except BristleError as error:
        raise loaded.error(f"{name}.fmu", file, str(error)) from None
    return fmu


def _alias(loaded: Loaded, name: str, key: str, given: Mapped) -> Alias:
    """Return the FMU's variable that a port of the bus, or an observer's estimate, is to be."""
    where, ports = f"{name}.variables.{key}", PORTS[name]
    estimated = name == "observer" and key.rpartition("_")[2] in ("hat", "valid", "sd")
    if key not in ports.units and not estimated:
        known = list(ports.units)
        message = f"no variable of the bus{suggest(key, known)}; known: {', '.join(known)}"
        raise loaded.error(where, given, message)
    try:
        return alias(given, ports.allowed_units(key))
    except BristleError as error:
        raise loaded.error(where, given, str(error)) from None
