"""Arms of seven joints, with effects hidden in three of them: which are named, and where none is.

    python benchmarks/arms.py --arms 10 --out DIR [--jobs 2] > benchmarks/results/arms.md

MuJoCo simulates each arm in its loop of computed torque (8 to 25 rad/s), with the rotors, friction
and hidden effects of this program, a disturbance of 3 to 10 % of the friction and encoders of 1e-5
to 1e-4 rad, from which the loop has its velocities too; two logs of 15 s at 1 kHz, in which all
joints move at once. What each joint carries is worked out from its URDF, by the same library: an
error of the URDF is no part of this. Each joint is diagnosed as `bristle diagnose arm.toml` does,
with nothing known of its friction.
An interrupted run continues with the joints that are missing in DIR.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parent / "blind"))

import numpy as np
from forms import class_of
from scene import Generator, log_uniform
from shared import write_json

from bristle.common.arguments import filled_path

JOINTS, HIDDEN = 7, 3
SAMPLES, PERIOD, PARTS = 15_000, 1e-3, 4  # of a log; sampling period [s]; steps in a period
SEEN = 1 - math.exp(-PERIOD / 3e-3)  # of a difference of positions, in the velocity of the loop
SWEEPS = 6  # over all joints, in which their dry friction is found
NEAR = 0.03  # of the friction: what counts as right

Array = np.ndarray[Any, np.dtype[np.float64]]
Json = dict[str, Any]
# torque [N.m] along the motion, of position, velocity and input; and the factor on the friction
Torque = Callable[[float, float, float], float]


@dataclass(frozen=True)
class Hidden:
    """An effect in a joint: its name, its strength, and what it does there."""

    name: str
    strength: float
    torque: Torque = lambda q, v, u: 0.0
    friction: Callable[[float, float], float] = lambda v, u: 0.0


def bias(rng: Generator, level: float) -> Hidden:
    torque = rng.choice([-1, 1]) * log_uniform(rng, 0.2, 0.6) * level
    return Hidden("bias", torque, lambda q, v, u: torque)


def cogging(rng: Generator, level: float) -> Hidden:
    torque, periods = log_uniform(rng, 0.2, 0.8) * level, float(rng.integers(8, 41))
    phase = rng.uniform(-3, 3)
    return Hidden("cogging", torque, lambda q, v, u: torque * math.sin(periods * q + phase))


def stribeck(rng: Generator, level: float) -> Hidden:
    excess, speed = log_uniform(rng, 0.3, 1.0), log_uniform(rng, 0.05, 0.2)
    return Hidden(
        "stribeck", excess, friction=lambda v, u: level * excess * math.exp(-((v / speed) ** 2))
    )


def load_friction(rng: Generator, level: float) -> Hidden:
    share = log_uniform(rng, 0.05, 0.2)
    return Hidden("load_friction", share, friction=lambda v, u: share * abs(u))


def quadratic_drag(rng: Generator, level: float) -> Hidden:
    drag = log_uniform(rng, 0.4, 1.2) * level
    return Hidden("quadratic_drag", drag, lambda q, v, u: -drag * v * abs(v))


EFFECTS = (bias, cogging, stribeck, load_friction, quadratic_drag)


@dataclass(frozen=True)
class Truth:
    """What an arm has that its URDF does not say, by joint."""

    rotor: Array  # kg.m2
    coulomb: Array  # N.m
    viscous: Array  # N.m.s/rad
    hidden: Mapping[int, Hidden]


def urdf(rng: Generator) -> str:
    """Return an arm whose joints turn about two axes by turns."""
    parts = ['<robot name="arm"><link name="base"/>']
    before, mass = "base", rng.uniform(3.0, 6.0)
    for k in range(1, JOINTS + 1):
        mass, length = mass * rng.uniform(0.7, 0.9), rng.uniform(0.15, 0.3)
        across = mass * length**2 / 12
        parts.append(
            f'<link name="link{k}"><inertial><origin xyz="0 0 {length / 2}"/>'
            f'<mass value="{mass}"/><inertia ixx="{across}" iyy="{across}" izz="{across / 3}"'
            ' ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        parts.append(
            f'<joint name="joint{k}" type="revolute"><parent link="{before}"/>'
            f'<child link="link{k}"/><origin xyz="0 0 {length}"/>'
            f'<axis xyz="{"0 0 1" if k % 2 else "0 1 0"}"/>'
            '<limit lower="-3" upper="3" effort="500" velocity="10"/></joint>'
        )
        before = f"link{k}"
    return "".join([*parts, "</robot>"])


def drawn(rng: Generator) -> Truth:
    """Return rotors and friction, and what is hidden in three of the joints."""
    size = np.array([1.0, 1.0, 0.6, 0.6, 0.25, 0.25, 0.12])
    coulomb = size * rng.uniform(3.0, 8.0, JOINTS)
    places = sorted(int(j) for j in rng.choice(JOINTS, HIDDEN, replace=False))
    kinds = rng.choice(len(EFFECTS), HIDDEN, replace=False)
    hidden = {j: EFFECTS[k](rng, float(coulomb[j])) for j, k in zip(places, kinds, strict=True)}
    viscous = coulomb * rng.uniform(0.5, 2.0, JOINTS)
    return Truth(size * rng.uniform(0.2, 0.6, JOINTS), coulomb, viscous, hidden)


def reference(rng: Generator) -> Callable[[float], tuple[Array, Array, Array]]:
    """Return positions, velocities and accelerations of all joints, of a time."""
    omega, size = rng.uniform(0.6, 4.0, (3, JOINTS)), rng.uniform(0.1, 0.35, (3, JOINTS))
    phase = rng.uniform(0, 2 * math.pi, (3, JOINTS))

    def at(t: float) -> tuple[Array, Array, Array]:
        wave, slope = size * np.sin(omega * t + phase), size * np.cos(omega * t + phase)
        return wave.sum(0), (omega * slope).sum(0), (-(omega**2) * wave).sum(0)

    return at


def friction(free: Array, yields: Array, level: Array, dry: Array) -> Array:
    """Return the dry friction of joints over a step: what stops them, up to its level [N.m].

    `free`: velocities (joints,) at the end of the step without it; `yields` (joints, joints): how
    they change with it; `dry`: of the step before. Source: moreau1988 (time stepping; each joint in
    turn).
    """
    torque, speed = dry.tolist(), (free - yields @ dry).tolist()
    columns, most = yields.T.tolist(), level.tolist()
    for _ in range(SWEEPS):
        for j in range(JOINTS):
            new = torque[j] + speed[j] / columns[j][j]
            new = min(max(new, -most[j]), most[j])
            change, torque[j] = new - torque[j], new
            if change:
                speed = [v - change * y for v, y in zip(speed, columns[j], strict=True)]
    return np.array(torque)


def log(rng: Generator, text: str, truth: Truth, step: float) -> tuple[Array, Array]:
    """Return the positions (samples, joints) that the encoders show, and the torques."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(text)
    data, goal = mujoco.MjData(model), reference(rng)
    model.opt.timestep = PERIOD / PARTS
    model.dof_armature[:] = truth.rotor
    loop, size = log_uniform(rng, 8.0, 25.0), rng.uniform(0.03, 0.1) * truth.coulomb
    shown, asked = np.empty((SAMPLES, JOINTS)), np.empty((SAMPLES, JOINTS))
    data.qpos[:], data.qvel[:] = goal(0.0)[:2]
    mass = np.empty((JOINTS, JOINTS))
    noise, dry, seen = np.zeros(JOINTS), np.zeros(JOINTS), goal(0.0)[1]
    keep = math.exp(-2 * math.pi * log_uniform(rng, 1.0, 20.0) * PERIOD)
    for k in range(SAMPLES):
        q, v, a = goal(k * PERIOD)
        mujoco.mj_forward(model, data)
        for row, unit in zip(mass, np.eye(JOINTS), strict=True):
            mujoco.mj_mulM(model, data, row, unit)
        yields = np.asarray(np.linalg.inv(mass) * (PERIOD / PARTS), dtype=float)
        shown[k] = step * np.floor(data.qpos / step)
        seen += SEEN * ((shown[k] - shown[max(k - 1, 0)]) / PERIOD - seen)
        wanted = a + 2 * loop * (v - seen) + loop**2 * (q - shown[k])
        u = asked[k] = data.qfrc_bias + mass @ wanted
        noise = keep * noise + math.sqrt(1 - keep**2) * size * rng.standard_normal(JOINTS)
        for _ in range(PARTS):
            now, level = data.qvel, truth.coulomb.copy()
            more = np.zeros(JOINTS)
            for j, each in truth.hidden.items():
                level[j] += each.friction(now[j], u[j])
                more[j] = each.torque(data.qpos[j], now[j], u[j])
            data.qfrc_applied[:] = u + noise + more - truth.viscous * now
            mujoco.mj_forward(model, data)
            dry = friction(now + PERIOD / PARTS * data.qacc, yields, level, dry)
            data.qfrc_applied[:] -= dry
            mujoco.mj_step(model, data)
    return shown, asked


def arm_file(step: float) -> str:
    """Return the file of an arm."""
    lines = ['[robot]\nurdf = "arm.urdf"\n[time]\ncolumn = "t"\nunit = "s"']
    for k in range(1, JOINTS + 1):
        lines.append(
            f'[joints.joint{k}]\ninput = {{ column = "u{k}", kind = "torque", unit = "N.m" }}\n'
            f'output = {{ column = "q{k}", kind = "position", unit = "rad", resolution = {step} }}'
        )
    return "\n".join(lines) + "\n"


def write_arm(seed: int, number: int, folder: Path) -> Truth:
    """Draw an arm and write what its owner has: URDF, file of the arm and two logs."""
    rng = np.random.default_rng([seed, number])
    text, truth, step = urdf(rng), drawn(rng), log_uniform(rng, 1e-5, 1e-4)
    folder.mkdir(parents=True, exist_ok=True)
    names = ["t", *(f"{c}{k}" for c in "qu" for k in range(1, JOINTS + 1))]
    for k in range(2):
        shown, asked = log(rng, text, truth, step)
        time_ = 30.0 * k + PERIOD * np.arange(SAMPLES)
        table = np.column_stack([time_, shown, asked])
        columns = dict(zip(names, table.T, strict=True))
        np.savez_compressed(folder / f"log{k}.npz", **columns)
    (folder / "arm.urdf").write_text(text, encoding="utf-8")
    (folder / "arm.toml").write_text(arm_file(step), encoding="utf-8")
    return truth


def diagnose_arm(seed: int, number: int, out: Path) -> None:
    """Diagnose the joints of an arm that have no answer yet."""
    from bristle.diagnosis import diagnose
    from bristle.diagnosis.robot.arm import joints_of, load_arm

    left = [k for k in range(JOINTS) if not (out / f"{number:02d}_{k + 1}.json").exists()]
    if not left:
        return
    folder = out / f"arm{number:02d}"
    truth = write_arm(seed, number, folder)
    begun = time.perf_counter()
    joints = joints_of(load_arm(folder / "arm.toml"), sorted(folder.glob("log*.npz")))
    shared = (time.perf_counter() - begun) / JOINTS
    for k in left:
        begun = time.perf_counter()
        model, records = joints[f"joint{k + 1}"]
        answer = diagnose(model, records).to_dict()
        own = truth.hidden.get(k)
        facts = {
            "hidden": own.name if own else "",
            "strength": own.strength / truth.coulomb[k] if own else 0.0,
            "Fc": float(truth.coulomb[k]),
            "a2": float(truth.viscous[k]),
            "seconds": shared + time.perf_counter() - begun,
            "answer": {
                key: answer[key]
                for key in ("verdict", "effects", "suspects", "ties", "parameters", "remains")
            },
        }
        write_json(out / f"{number:02d}_{k + 1}.json", facts, indent=1)
        named = [e["name"] for e in answer["effects"]]
        print(number, k + 1, facts["hidden"], named, f"{facts['seconds']:.0f} s", file=sys.stderr)


def main() -> None:
    """Diagnose the arms, and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--arms", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=filled_path, required=True)
    given = parser.parse_args()
    with ProcessPoolExecutor(given.jobs, mp_context=get_context("spawn")) as pool:
        calls = [pool.submit(diagnose_arm, given.seed, k, given.out) for k in range(given.arms)]
        for call in calls:
            call.result()
    facts = [json.loads(p.read_text(encoding="utf-8")) for p in sorted(given.out.glob("*.json"))]
    print("# Arms of seven joints\n")
    print(f"`python benchmarks/arms.py --arms {given.arms} --seed {given.seed}`:", end=" ")
    print(" ".join((__doc__ or "").split("\n\n")[2].split("\n")) + "\n")
    report(facts)


def report(facts: list[Json]) -> None:
    """Print the tables."""
    print("| hidden | joints | named right | another name too | only suspected | no name |")
    print("|---|---|---|---|---|---|")
    for name in [*(e.__name__ for e in EFFECTS), ""]:
        own = [f for f in facts if f["hidden"] == name]
        kinds = [_kind(f) for f in own]
        row = [kinds.count(kind) for kind in ("right", "wrong", "suspected", "none")]
        print(f"| {name or 'nothing'} | {len(own)} | " + " | ".join(map(str, row)) + " |")
    print("\nOf a joint in which nothing is hidden no name is right.\n")
    print("| friction | joints | within 3 % | median error | intervals that cover |")
    print("|---|---|---|---|---|")
    for name, key in (("Fc", "coulomb.Fc"), ("a2", "a2")):
        print(friction_row(facts, name, key))
    seconds = [f["seconds"] for f in facts]
    print(f"\nA joint took {np.median(seconds):.0f} s in the median, {max(seconds):.0f} s at most.")


def friction_row(facts: list[Json], name: str, key: str) -> str:
    """Return how near one parameter of the friction comes in all joints."""
    # an answer to records that cannot be fitted has no parameters
    seen = [(f["answer"]["parameters"].get(key), f[name]) for f in facts]
    found = [(estimate, true) for estimate, true in seen if estimate]
    errors = [abs(p["value"] / true - 1) for p, true in found]
    covered = sum(bool(p["ci95"]) and p["ci95"][0] <= true <= p["ci95"][1] for p, true in found)
    within, usual = sum(error < NEAR for error in errors), 100 * np.median(errors)
    return f"| {name} | {len(found)} | {within} | {usual:.1f} % | {covered} |"


def _kind(facts: Json) -> str:
    """Return what a joint's answer is: right, wrong, suspected or none."""
    named = {class_of(e["name"]) for e in facts["answer"]["effects"]}
    hidden = {class_of(facts["hidden"])} - {""}
    if named - hidden:
        return "wrong"
    if not hidden or not named:
        doubted = {class_of(e["name"]) for e in facts["answer"]["suspects"]}
        return "suspected" if doubted & hidden else "none"
    return "right"


if __name__ == "__main__":
    main()
