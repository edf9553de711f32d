"""Arms: what a URDF says of the torque on each joint, and all joints of a log in one command."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import bristle.cli.commands  # noqa: F401 - imported so that the application has them
from bristle.cli.app import app
from bristle.common.errors import BristleError
from bristle.diagnosis.robot.arm import is_arm, joints_of, load_arm
from bristle.diagnosis.robot.rigid_body import RigidBodies

pytest.importorskip("mujoco", reason="the extra robot is not installed")

# a planar arm of two bars in a vertical plane, joints along y: length, mass, centre, inertia
L1, M1, C1, I1 = 0.5, 2.0, 0.25, 0.05
M2, C2, I2 = 1.2, 0.2, 0.03
G = 9.81
LINK = """<link name="{name}"><visual><geometry><mesh filename="package://none/{name}.stl"/></geometry></visual>
<inertial><origin xyz="{centre} 0 0"/><mass value="{mass}"/>
<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>
"""
JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{place} 0 0"/><axis xyz="0 -1 0"/>
<limit lower="-9" upper="9" effort="99" velocity="9"/>
<dynamics damping="3.0" friction="2.0"/></joint>
"""
URDF = (
    '<robot name="two"><link name="base"/>'
    + LINK.format(name="upper", centre=C1, mass=M1, inertia=I1)
    + LINK.format(name="lower", centre=C2, mass=M2, inertia=I2)
    + JOINT.format(name="shoulder", parent="base", child="upper", place=0)
    + JOINT.format(name="elbow", parent="upper", child="lower", place=L1)
    + "</robot>"
)
ARM = """
[robot]
urdf = "arm.urdf"
[time]
column = "t"
unit = "s"
[joints.shoulder]
input = { column = "tau1", kind = "torque", unit = "N.m" }
output = { column = "q1", kind = "position", unit = "rad", resolution = 1e-5 }
[joints.elbow]
input = { column = "tau2", kind = "torque", unit = "N.m" }
output = { column = "q2", kind = "position", unit = "rad", resolution = 1e-5 }
"""
H = 1e-3


def terms(q1, q2, v1, v2):
    """Return mass matrix and torques of gravity and of speeds, as textbooks have them (Spong,
    Hutchinson and Vidyasagar, section 7.4: planar elbow manipulator).
    """
    c2, s2 = np.cos(q2), np.sin(q2)
    m11 = M1 * C1**2 + M2 * (L1**2 + C2**2 + 2 * L1 * C2 * c2) + I1 + I2
    m12 = M2 * (C2**2 + L1 * C2 * c2) + I2
    m22 = M2 * C2**2 + I2
    k = -M2 * L1 * C2 * s2
    g2 = M2 * C2 * G * np.cos(q1 + q2)
    g1 = (M1 * C1 + M2 * L1) * G * np.cos(q1) + g2
    return m11, m12, m22, k * v2 * (2 * v1 + v2) + g1, -k * v1**2 + g2


def motion(n, seed=0.0):
    """Return angles, speeds and accelerations of both joints (n, 2)."""
    t = H * np.arange(n)
    w, size = np.array([[2.1, 3.3], [5.3, 7.1]]), np.array([[0.7, 0.8], [0.15, 0.2]])
    angle = t[:, None, None] * w + np.array([[0.0, 1.0], [2.0, 0.5]]) + seed
    return (
        (size * np.sin(angle)).sum(axis=1),
        (size * w * np.cos(angle)).sum(axis=1),
        -(size * w**2 * np.sin(angle)).sum(axis=1),
    )


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "arm.urdf").write_text(URDF)
    (tmp_path / "arm.toml").write_text(ARM)
    return tmp_path / "arm.toml"


def log(path, seconds=8.0, rotor=0.1, friction=(0.6, 0.3), seed=0.0):
    """Write what the drives of an arm log that follows a motion exactly: the inverse dynamics."""
    n = round(seconds / H)
    q, v, a = motion(n, seed)
    m11, m12, m22, h1, h2 = terms(*q.T, *v.T)
    rng = np.random.default_rng(round(10 * seed))
    noise = 0.02 * rng.normal(size=(n, 2))
    tau1 = m11 * a[:, 0] + m12 * a[:, 1] + h1
    tau2 = m12 * a[:, 0] + m22 * a[:, 1] + h2
    tau = np.column_stack([tau1, tau2]) + rotor * a + np.array(friction) * np.sign(v) + 0.2 * v
    table = np.column_stack([H * np.arange(n) + 20 * seed, q, tau + noise])
    np.savetxt(path, table, delimiter=",", header="t,q1,q2,tau1,tau2", comments="", fmt="%.7g")
    return path


def test_the_terms_are_those_of_the_textbook(arm):
    n = 1500
    q, v, a = motion(n)
    bodies = RigidBodies(arm.parent / "arm.urdf")
    assert bodies.joints == ["shoulder", "elbow"]
    found = bodies.carried({"shoulder": q[:, 0], "elbow": q[:, 1]}, H)
    m11, m12, m22, h1, h2 = terms(*q.T, *v.T)
    inside = slice(50, -50)
    np.testing.assert_allclose(found["shoulder"].inertia[inside], m11[inside], rtol=1e-4)
    np.testing.assert_allclose(found["elbow"].inertia, m22, rtol=1e-9)
    for name, expected in (("shoulder", h1 + m12 * a[:, 1]), ("elbow", h2 + m12 * a[:, 0])):
        np.testing.assert_allclose(found[name].torque[inside], expected[inside], atol=0.02)
    # a joint that is not logged rests at 0
    alone = bodies.carried({"shoulder": q[:, 0]}, H)["shoulder"]
    np.testing.assert_allclose(alone.inertia, terms(0.0, 0.0, 0.0, 0.0)[0], rtol=1e-9)


def test_a_file_of_an_arm_is_told_from_a_model(arm, tmp_path):
    other = tmp_path / "model.toml"
    other.write_text('friction = "coulomb"\n')
    assert is_arm(arm)
    assert not is_arm(other)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("joints.elbow", "joints.elbo", "did you mean 'elbow'"),
        ("arm.urdf", "none.urdf", "No such file"),
        ('kind = "position"', 'kind = "velocity"', "position"),
        ("[robot]", "[robot]\nmesh = 1", "unknown key"),
    ],
)
def test_mistakes_are_one_line(arm, old, new, said):
    arm.write_text(ARM.replace(old, new))
    if new.endswith('"velocity"'):
        arm.write_text(arm.read_text().replace('unit = "rad"', 'unit = "rad/s"'))
    with pytest.raises(BristleError) as error:
        load_arm(arm)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_a_urdf_that_is_none_is_one_line(arm):
    negative = URDF.replace(f'value="{M2}"', 'value="-1"')
    for text, said in (
        ("<a", "no XML"),
        ("<a/>", "<robot>"),
        ("<robot/>", "no joint that moves"),
        (negative, "'lower': mass '-1' must be"),
        (URDF.replace(f' value="{M2}"', ""), "'lower': mass None must be"),
    ):
        (arm.parent / "arm.urdf").write_text(text)
        with pytest.raises(BristleError, match=said):
            load_arm(arm)


def test_each_joint_has_what_the_rest_of_the_arm_asks_of_it(arm):
    path = log(arm.parent / "log.csv", seconds=4.0)
    found = joints_of(load_arm(arm), [path])
    assert list(found) == ["shoulder", "elbow"]
    model, [record] = found["elbow"]
    assert model.effects == {"known": {"scale": 1.0}}
    # what is left of the torque is the rotor's inertia, friction and noise
    _, v, a = motion(len(record))
    # (the inertia of a planar arm's last bar does not change)
    assert np.ptp(record.known["known.inertia_added"]) < 1e-9
    own = record.known["known.torque"] + (M2 * C2**2 + I2) * a[:, 1]
    left = record.u - own - 0.1 * a[:, 1] - 0.3 * np.sign(v[:, 1]) - 0.2 * v[:, 1]
    assert float(np.sqrt(np.mean(left[50:-50] ** 2))) < 0.05


def test_a_rotor_may_be_far_more_than_what_its_joint_carries(arm):
    """Rough values follow from the torque that is left, not from the arm."""
    path = log(arm.parent / "log.csv", seconds=4.0, rotor=5.0)
    model, _ = joints_of(load_arm(arm), [path])["elbow"]
    low, high = model.bounds["J"]
    carried = M2 * C2**2 + I2
    assert 0.7 * carried < low < carried
    assert 1.0 < model.parameters["J"] < 5.0 + carried < high


@pytest.mark.long
def test_all_joints_of_a_log_in_one_command(arm):
    folder = arm.parent
    paths = [log(folder / f"log{k}.csv", 8.0, seed=float(k)) for k in (0, 1)]
    out = folder / "out"
    given = ["diagnose", str(arm), "--data", *map(str, paths), "--out", str(out)]
    result = CliRunner().invoke(app, given)
    assert result.exit_code == 0, result.output
    joints = json.loads((out / "diagnosis.json").read_text())["joints"]
    for name, friction in (("shoulder", 0.6), ("elbow", 0.3)):
        found = joints[name]["parameters"]
        assert found["coulomb.Fc"]["value"] == pytest.approx(friction, rel=0.05)
        assert found["known.scale"]["value"] == pytest.approx(1.0, rel=0.02)
    for name in joints:
        assert (out / name / "augmented.toml").exists()
        assert f'href="{name}/report.html"' in (out / "report.html").read_text()
