"""The file of an arm: a URDF, and which columns belong to which joint."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, ValidationError

from bristle.common.errors import BristleError, suggest
from bristle.common.metrics import rms
from bristle.common.toml import Section, first_mistake, mistake, read_toml
from bristle.diagnosis.checks.records import load_records
from bristle.diagnosis.modelfile import Model, ModelTable
from bristle.diagnosis.robot.rigid_body import RigidBodies
from bristle.diagnosis.sliding.stretches import smooth
from bristle.plant.known import KNOWN
from bristle.plant.servo import J
from bristle.records.layout import InputTable, OutputTable, TimeTable
from bristle.records.record import Record

# of a joint of which nothing is given: what its rotor, its dry and its viscous friction each give
# of the torque that the arm leaves of the input
SHARE_LEFT = 0.5
SMOOTHED = 0.02  # s: half-width of the parabola that gives velocity and acceleration for that
ARM_BOUND = 100.0  # factor by which they may move
OWN_ERROR = 0.2  # of the inertia of the bodies: by which a URDF may be wrong
LEAST_LEFT = 1.05  # of what is taken off J at most: least J
TORQUE, ADDED = f"{KNOWN.name}.torque", f"{KNOWN.name}.inertia_added"


class RobotTable(Section):
    """The rigid bodies of the arm."""

    urdf: str
    """URDF file, beside the file of the arm."""


class JointTable(Section):
    """A joint, under its name in the URDF."""

    input: InputTable
    """Column of its input."""
    output: OutputTable
    """Column of its position."""
    parameters: dict[str, Any] | None = None
    """Nominal values, in the place of those of all joints; without any they are estimated."""
    bounds: dict[str, Any] | None = None
    """[least, greatest] of each parameter that may change."""


class ArmTable(Section):
    """The file of an arm."""

    friction: str = "coulomb"
    """Friction law of the joints."""
    robot: RobotTable
    """The rigid bodies."""
    time: TimeTable
    """Column of the time, or the sampling rate."""
    joints: dict[str, JointTable] = Field(min_length=1)
    """The joints that were logged."""
    parameters: dict[str, Any] | None = None
    """Nominal values of every joint that has none of its own."""
    bounds: dict[str, Any] | None = None
    """[least, greatest] of each parameter that may change."""


@dataclass(frozen=True)
class Arm:
    """An arm: its rigid bodies, and what is known of each joint.

    `tables` hold a model file of each joint, by its name, perhaps without parameters.
    """

    path: Path
    bodies: RigidBodies
    tables: Mapping[str, dict[str, Any]]


def is_arm(path: Path) -> bool:
    """Return whether a TOML file is that of an arm."""
    return path.is_file() and path.suffix == ".toml" and "robot" in read_toml(path, "model file")[1]


def load_arm(path: Path) -> Arm:
    """Read and check the file of an arm; raise `BristleError` with one line."""
    _, tree = read_toml(path, "file of an arm")
    try:
        table = ArmTable.model_validate(tree)
    except ValidationError as error:
        raise first_mistake(path, ArmTable, error) from None
    bodies = RigidBodies(path.parent / table.robot.urdf)
    tables = {}
    for name, joint in table.joints.items():
        if name not in bodies.joints:
            said = f"no joint of the URDF that moves{suggest(name, bodies.joints)}; there are:"
            raise mistake(path, f"joints.{name}", None, f"{said} {', '.join(bodies.joints)}")
        if joint.output.kind != "position" or joint.input.kind == "setpoint":
            said = "the dynamics of an arm need a torque or force and the position of each joint"
            raise mistake(path, f"joints.{name}", None, said)
        own = joint.model_dump(exclude_none=True)
        for key in ("parameters", "bounds"):
            if (given := own.get(key, getattr(table, key))) is not None:
                own[key] = given
        time = table.time.model_dump(exclude_none=True)
        tables[name] = {"friction": table.friction, "time": time} | own
    return Arm(path, bodies, tables)


def joints_of(arm: Arm, paths: Sequence[Path]) -> dict[str, tuple[Model, list[Record]]]:
    """Return the model of each joint, and its records with what the rest of the arm asks of it."""
    read = {name: load_records(_model(arm, name), paths) for name in arm.tables}
    first = next(iter(read.values()))
    if any([r.name for r in records] != [r.name for r in first] for records in read.values()):
        raise BristleError(
            f"{arm.path}: the records of the joints differ in their gaps or rates; cut them to the"
            " samples that all joints have"
        )
    carried = []
    for k, record in enumerate(first):
        positions = {
            name: np.interp(record.time, records[k].time, records[k].y)
            for name, records in read.items()
        }
        carried.append(arm.bodies.carried(positions, record.h))
    found = {}
    for name, records in read.items():
        mean = float(np.mean(np.concatenate([each[name].inertia for each in carried])))
        own = []
        for k, record in enumerate(records):
            torque, inertia = (
                np.interp(record.time, first[k].time, x)
                for x in (carried[k][name].torque, carried[k][name].inertia - mean)
            )
            own.append(replace(record, known={TORQUE: torque, ADDED: inertia}))
        found[name] = _model(arm, name, mean, own), own
    return found


def _model(arm: Arm, name: str, carried: float = 0.0, records: Sequence[Record] = ()) -> Model:
    """Return the model of a joint, what is not known of it from its records; `carried`: the mean
    inertia [kg.m2] of what it carries, which is part of J here.
    """
    table = dict(arm.tables[name])
    if "parameters" not in table:
        table |= _rough(carried, records)
    where = f"{arm.path}: joints.{name}"
    model = Model.from_dict({k: x for k, x in table.items() if k in ModelTable.model_fields}, where)
    least = LEAST_LEFT * max([0.0, *(-float(np.min(r.known[ADDED])) for r in records)])
    parameters = {**model.parameters, J.name: max(model.parameters[J.name] + carried, least)}
    bounds = dict(model.bounds)
    if J.name in bounds:
        low, high = bounds[J.name]
        bounds[J.name] = (max(low + carried - OWN_ERROR * carried, least), high + carried)
    known = {KNOWN.name: {"scale": 1.0}}
    effects = {**model.effects, **known}
    return replace(model, parameters=parameters, bounds=bounds, effects=effects)


def _rough(carried: float, records: Sequence[Record]) -> dict[str, dict[str, Any]]:
    """Return parameters and bounds of a joint of which nothing is known."""
    torque, speed, acceleration = 1.0, 1.0, 1.0
    if records:
        v, a = (
            np.concatenate([smooth(r.y, r.h, SMOOTHED, order) for r in records]) for order in (1, 2)
        )
        left = np.concatenate([r.u - r.known[TORQUE] for r in records]) - carried * a
        torque, speed, acceleration = (rms(x) or 1.0 for x in (SHARE_LEFT * left, v, a))
    values = {"J": torque / acceleration, "a2": torque / speed, "Fc": torque}
    short = {key: float(f"{x:.3g}") for key, x in values.items() if math.isfinite(x)}
    bounds = {key: [0.0, ARM_BOUND * x] for key, x in short.items()}
    return {"parameters": short, "bounds": bounds | {"J": [1e-9, ARM_BOUND * short["J"]]}}
