"""A plant FMU as the model of a diagnosis: what its modelDescription says, where no model file is
given beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bristle.common.errors import BristleError
from bristle.diagnosis.modelfile import Model
from bristle.fmus.host import Fmu
from bristle.fmus.playback import INPUT
from bristle.plant.controller import CONTROLLER
from bristle.plant.effects import effects
from bristle.plant.friction import law_names
from bristle.records.layout import INPUT_UNITS, SETPOINT

INPUT_KINDS = ("Real", "Float64", "Enumeration")  # of a start value that is a number
ADVICE = "give a model file beside the FMU"


def fmu_model(path: Path) -> Model:
    """Return the model that an FMU with the variables of ServoPlant describes, at its start values.

    Records have the columns t [s], u and theta or, if the FMU has none, v, in the units that the
    FMU declares: V, A, N.m or N for u, rad or m for theta, rad/s or m/s for v.

    Parameters
    ----------
    path : Path
        Plant FMU with the parameters J, a2 and, where its input is a voltage or a current, b.

    Raises
    ------
    BristleError
        If the FMU cannot be read or does not say enough.
    """
    starts, outputs, chosen = _read(path)
    fmu = Fmu(path)
    unit = fmu.unit(INPUT) if fmu.has(INPUT, "input") else "V"
    controller = _controller_of(starts)
    kind = next((kind for kind, own in INPUT_UNITS.items() if own == unit), "voltage")
    kind = SETPOINT if controller else kind
    gained = ("J", "a2", "b") if kind in ("voltage", "current") else ("J", "a2")
    for name in gained:
        if name not in starts:
            raise BristleError(f"FMU {path}: no parameter '{name}' to scale by; {ADVICE}")
    if not {"theta", "v"} & outputs:
        raise BristleError(f"FMU {path}: no output 'theta' or 'v'; {ADVICE}")
    law = chosen or _law_of(starts)
    tree = {
        "friction": law,
        "parameters": {
            name: x for name, x in starts.items() if name in gained or name.startswith(f"{law}.")
        },
        "effects": _effects_of(starts),
        "output": _output_of(fmu, "theta" if "theta" in outputs else "v"),
        "time": {"column": "t", "unit": "s"},
        "input": {"column": INPUT, "kind": kind, "unit": INPUT_UNITS.get(kind, unit)},
    } | ({"controller": controller} if controller else {})
    return Model.from_dict(tree, f"FMU {path}")


def _law_of(starts: Mapping[str, float]) -> str:
    """Return the first law that the FMU has a parameter of."""
    owners = {name.partition(".")[0] for name in starts if "." in name}
    return next((name for name in law_names() if name in owners), "viscous")


def _effects_of(starts: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Return the effects that the FMU has parameters of, with these."""
    by_effect: dict[str, dict[str, float]] = {}
    for name, x in starts.items():
        effect, _, parameter = name.partition(".")
        if parameter and effect in effects():
            by_effect.setdefault(effect, {})[parameter] = x
    return {effect: by_effect[effect] for effect in effects() if effect in by_effect}


def _controller_of(starts: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters of the controller that follows a setpoint; empty without one."""
    prefix = f"{CONTROLLER.name}."
    return {k.removeprefix(prefix): x for k, x in starts.items() if k.startswith(prefix)}


def _output_of(fmu: Fmu, shown: str) -> dict[str, Any]:
    """Return what the records hold of an output."""
    linear = fmu.unit(shown).startswith("m")
    if shown == "v":
        return {"column": "v", "kind": "velocity", "unit": "m/s" if linear else "rad/s"}
    return {"column": "theta", "kind": "position", "unit": "m" if linear else "rad"}


def _read(path: Path) -> tuple[dict[str, float], set[str], str | None]:
    """Return the start values of the parameters, the names of the outputs, and the law that is
    chosen where there are several.

    The law goes by the name the FMU gives it: an FMU of another release may number the laws
    otherwise.
    """
    variables = Fmu(path).description.modelVariables
    parameters = [
        v
        for v in variables
        if v.causality == "parameter" and v.start is not None and v.type in INPUT_KINDS
    ]
    selectors = [v for v in parameters if v.name == "law" and v.declaredType is not None]
    chosen = [
        item.name
        for v in selectors
        for item in v.declaredType.items
        if int(item.value) == int(v.start)
    ]
    starts = {v.name: float(v.start) for v in parameters}
    return starts, {v.name for v in variables if v.causality == "output"}, next(iter(chosen), None)
