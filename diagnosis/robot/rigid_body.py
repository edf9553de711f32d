"""The rigid bodies of an arm, from its URDF: torque and inertia that each joint carries."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bristle.common.errors import BristleError
from bristle.common.table import Array
from bristle.diagnosis.sliding.stretches import smooth

# s: half-widths of the parabola that gives accelerations: the shortest is taken whose noise is less
# than this share of them
HALF_WIDTHS = (0.003, 0.005, 0.01, 0.02, 0.04)
NOISE_SHARE = 0.02
MOVING_JOINTS = ("revolute", "continuous", "prismatic")
DRAWN_PARTS = ("visual", "collision")  # parts of a link that have no mass
# what a body without an inertia is given, so that the library takes it: it moves nothing
LEAST_MASS, LEAST_BODY = 1e-9, 1e-12  # kg, kg.m2


@dataclass(frozen=True)
class Carried:
    """What a joint carries, sample by sample: torque against its motor [N.m] without that of its
    own acceleration, and inertia [kg.m2].
    """

    torque: Array
    inertia: Array


class RigidBodies:
    """The rigid bodies of an arm.

    `path`: URDF file; masses and inertias count, pictures do not. Raise `BristleError` where it
    cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            import mujoco
        except ImportError:
            raise BristleError(
                f"{path}: the dynamics of an arm need MuJoCo; run: pip install 'bristle[robot]'"
            ) from None
        self._library: Any = mujoco
        text, self.joints = _without_pictures(path)
        try:
            self._model = mujoco.MjModel.from_xml_string(text)
        except ValueError as error:
            raise BristleError(f"URDF {path}: {str(error).splitlines()[0]}") from None
        self._model.dof_damping[:] = 0.0
        self._model.dof_frictionloss[:] = 0.0
        self._data = mujoco.MjData(self._model)
        places = {}
        for name in self.joints:
            number = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_JOINT, name)
            places[name] = int(self._model.jnt_dofadr[number]), int(self._model.jnt_qposadr[number])
        self._places = places

    def carried(self, positions: Mapping[str, Array], h: float) -> dict[str, Carried]:
        """Return what each joint carries, from the positions (n,) of joints [rad or m] at a
        sampling period [s]; joints that are not given rest at 0.

        Source: spong2006 section 7.3 (equations of motion).
        """
        n = len(next(iter(positions.values())))
        width = self._model.nv
        q, v, a = np.zeros((n, self._model.nq)), np.zeros((n, width)), np.zeros((n, width))
        for name, x in positions.items():
            dof, at = self._places[name]
            half = _half_width(x, h)
            q[:, at], v[:, dof], a[:, dof] = (smooth(x, h, half, order) for order in (0, 1, 2))
        torque, inertia = np.empty((n, width)), np.empty((n, width))
        mass, ones = np.empty((width, width)), np.eye(width)
        library, data = self._library, self._data
        for k in range(n):
            data.qpos[:], data.qvel[:] = q[k], v[k]
            library.mj_fwdPosition(self._model, data)
            library.mj_fwdVelocity(self._model, data)
            for row, unit in zip(mass, ones, strict=True):
                library.mj_mulM(self._model, data, row, unit)
            inertia[k] = np.diag(mass)
            torque[k] = data.qfrc_bias + mass @ a[k] - inertia[k] * a[k]
        return {
            name: Carried(torque[:, self._places[name][0]], inertia[:, self._places[name][0]])
            for name in positions
        }


def _half_width(x: Array, h: float) -> float:
    """Return the half-width [s] of the parabola that gives the acceleration of a position (n,)."""
    usual = float(np.sqrt(np.mean(np.square(smooth(x, h, HALF_WIDTHS[-1], 2)))))
    noise = float(np.std(x - smooth(x, h, 2 * h)))
    for half in HALF_WIDTHS:
        # the deviation of the second derivative of a parabola through so many noisy samples
        count = 2 * max(2, round(half / h)) + 1
        if noise * np.sqrt(720.0 / count**5) / h**2 < NOISE_SHARE * usual:
            return half
    return HALF_WIDTHS[-1]


def _check_mass(path: Path, link: str, given: str | None) -> None:
    """Refuse a mass that none can be."""
    try:
        possible = 0.0 <= float(given or "") < math.inf
    except ValueError:
        possible = False
    if not possible:
        raise BristleError(
            f"URDF {path}: link '{link}': mass {given!r} must be a number of 0 kg or more"
        )


def _without_pictures(path: Path) -> tuple[str, list[str]]:
    """Return the text of a URDF without what is only drawn, and the names of its moving joints."""
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except OSError as error:
        raise BristleError(f"URDF {path}: {error.strerror}; check robot.urdf") from None
    except ElementTree.ParseError as error:
        raise BristleError(f"URDF {path}: is no XML ({error}); check robot.urdf") from None
    if root.tag != "robot":
        raise BristleError(f"URDF {path}: begins with <{root.tag}>, not <robot>; check robot.urdf")
    for link in root.iter("link"):
        for name in DRAWN_PARTS:
            for part in link.findall(name):
                link.remove(part)
        for mass in link.findall("inertial/mass"):
            _check_mass(path, str(link.get("name")), mass.get("value"))
    joints = [
        str(joint.get("name"))
        for joint in root.findall("joint")
        if joint.get("type") in MOVING_JOINTS
    ]
    if not joints:
        raise BristleError(f"URDF {path}: has no joint that moves; check robot.urdf")
    options = ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler")
    options.set("fusestatic", "false")
    options.set("boundmass", repr(LEAST_MASS))
    options.set("boundinertia", repr(LEAST_BODY))
    return ElementTree.tostring(root, encoding="unicode"), joints
