"""A plant FMU of any origin under the names and units of the records."""

from __future__ import annotations

from pathlib import Path

from bristle.common.errors import BristleError, suggest
from bristle.diagnosis.answer import Finding, Reason, finding
from bristle.diagnosis.modelfile import Model
from bristle.fmus.alias import alias
from bristle.fmus.host import Fmu
from bristle.fmus.playback import INPUT


def plant_fmu(path: Path, model: Model) -> Fmu:
    """Return a plant FMU under the names that the model gives its variables.

    Raises
    ------
    BristleError
        If the FMU cannot be read, or lacks the variables that the records speak of.
    """
    units = {
        name: model.unit_in_fmu(name, unit)
        for name, unit in (("u", "V"), ("theta", "rad"), ("v", "rad/s"))
    }
    aliases = {}
    for key, given in model.variables.items():
        where = f"{model.path or 'model'}: variables.{key}"
        if key not in units:
            raise BristleError(
                f"{where}: no variable of the records{suggest(key, list(units))}; known:"
                f" {', '.join(units)}"
            )
        try:
            aliases[key] = alias(given, [units[key]])
        except BristleError as error:
            raise BristleError(f"{where}: {error}") from None
    return _checked_plant(Fmu(path, True, aliases), model)


def _checked_plant(fmu: Fmu, model: Model) -> Fmu:
    """Refuse an FMU without the variables that the records speak of."""
    output, unit = ("v", "rad/s") if model.output_kind == "velocity" else ("theta", "rad")
    for name, causality in ((INPUT, "input"), (output, "output")):
        if not fmu.has(name, causality) or not fmu.is_real(name):
            known = ", ".join(fmu.names(causality)) or "none"
            raise BristleError(
                f"FMU {fmu.path}: no real {causality} '{name}' (there are: {known}); name the one"
                " that is meant "
                f'in the model file: [variables] {name} = "..."'
            )
    if not model.linear:
        fmu.check_si(output, unit)
    return fmu


def unit_notes(fmu: Fmu, model: Model) -> list[Finding]:
    """Return a note if the FMU declares another unit for its input than the records have, and was
    given their numbers.

    (Plants of ours have their input in V; one with b = 1 N.m/V stands for a plant that takes a
    torque.)
    """
    unit = fmu.unit(INPUT)
    if unit in ("1", model.input_unit) or (
        fmu.has("b", "parameter") and float(fmu.start("b")) == 1.0
    ):
        return []
    units = {"unit": unit, "of_records": model.input_unit}
    return [finding(Reason.FMU_INPUT_UNIT, input=INPUT, fmu=fmu.path.name, **units)]
