"""`bristle new`: what it writes installs, is found, passes its own tests and runs; nothing is
replaced.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

NAMES = {"law": "fresh_law", "effect": "fresh_effect", "observer": "fresh_observer"}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a package of each kind."""
    folder = tmp_path_factory.mktemp("new")
    for kind, name in NAMES.items():
        run(folder, "-m", "bristle", "new", kind, name)
    return folder


@pytest.fixture(scope="module")
def installed(written: Path) -> Path:
    """The folder into which the packages are installed, without a network."""
    site = written / "site"
    options = [
        "--quiet",
        "--disable-pip-version-check",
        "--no-deps",
        "--no-build-isolation",
        "--no-index",
        "--target",
        str(site),
    ]
    run(written, "-m", "pip", "install", *options, *(f"./{name}" for name in NAMES.values()))
    return site


def run(folder: Path, *arguments: str, site: Path | None = None) -> str:
    """Return what Python prints in a folder."""
    environment = os.environ | ({} if site is None else {"PYTHONPATH": str(site)})
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_what_is_installed_is_listed(written, installed):
    listed = run(written, "-m", "bristle", "list", site=installed)
    assert all(f"  {name} " in listed for name in NAMES.values())
    assert not any(f"  {name} " in run(written, "-m", "bristle", "list") for name in NAMES.values())


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(NAMES))
def test_a_new_package_passes_its_own_tests_of_which_its_scenario_is_one(written, installed, kind):
    said = run(
        written / NAMES[kind], "-m", "pytest", "-p", "no:cacheprovider", "-v", site=installed
    )
    assert f"{NAMES[kind]}.toml::{NAMES[kind]} PASSED" in said
    assert "FAILED" not in said


@pytest.mark.slow
def test_the_three_run_in_one_scenario_and_are_built(written, installed):
    scenario = written / "together.toml"
    text = (written / "fresh_effect" / "fresh_effect.toml").read_text(encoding="utf-8")
    text = text.replace('law = "modified"', 'law = "fresh_law"').replace(
        'method = "rls"', 'method = "fresh_observer"'
    )
    scenario.write_text(text.replace('sensor = "encoder"', 'sensor = "clean"'), encoding="utf-8")
    out = run(
        written,
        "-m",
        "bristle",
        "run",
        "together.toml",
        "--out",
        "out",
        "--fmi",
        "3",
        site=installed,
    )
    assert out.split()[:2] == ["together", "pass"]
    built = run(
        written,
        "-m",
        "bristle",
        "build",
        "observer",
        "--method",
        "fresh_observer",
        "--out",
        "fmus",
        site=installed,
    )
    assert built.strip() == "fmus/AdaptiveObserver_fresh_observer.fmu"


@pytest.mark.slow
def test_a_new_effect_is_named_by_a_diagnosis(written, installed):
    """Of a servo that has it, and a model that lacks it; beside it, those that a damper resembles
    are tried.
    """
    program = """
import numpy as np, sys
import bristle
from bristle.diagnosis.selection import stepwise
from bristle.model.native import Native
from bristle.plant.effects import effects
from bristle.plant.servo import servo_program
servo = {"J": 0.01, "a2": 0.02, "coulomb.Fc": 0.12, "b": 1.0, "fresh_effect.coefficient": 2e-4}
t, rng = 1e-3 * np.arange(12000), np.random.default_rng(1)
f = np.array([0.15, 0.37, 0.61, 0.93, 1.7, 2.9, 4.3, 7.1, 11.0])
u = 0.15 * np.sum(np.sin(2 * np.pi * f * t[:, None] + rng.uniform(0, 2 * np.pi, 9)), axis=1)
record, _ = Native(servo_program("coulomb", effects=("fresh_effect",), encoder=False), servo).run(
    1e-3, {"u": u, "tau_load": rng.normal(0, 0.01, 12000)}, ["theta"])
count = 2 * np.pi / 16384
theta = np.floor(record[:-1, 0] / count) * count
open("servo.toml", "w").write('''friction = "coulomb"
[parameters]
J = 0.012
a2 = 0.016
Fc = 0.1
[bounds]
J = [0.002, 0.05]
a2 = [0.0, 0.2]
Fc = [0.0, 0.6]
[time]
column = "t"
unit = "s"
[input]
column = "u"
kind = "torque"
unit = "N.m"
[output]
column = "theta"
kind = "position"
unit = "rad"
resolution = 3.834951969714103e-4
''')
tried = (
    *("fresh_effect", "quadratic_drag", "stribeck"),
    *("back_emf", "gravity", "hard_stop", "compliance"),
)
stepwise.all_effects = lambda: {name: effects()[name] for name in tried}
model = bristle.load_model("servo.toml")
records = bristle.records_from_arrays(model, [("run", t, u, theta)])
found = bristle.diagnose(model, records, "diagnosed")
print([effect.name for effect in found.effects])
"""
    assert run(written, "-c", program, site=installed).splitlines()[-1] == "['fresh_effect']"


@pytest.mark.sampled(4)
def test_a_package_has_what_pip_and_a_reader_need(written):
    for kind, name in NAMES.items():
        project = tomllib.loads((written / name / "pyproject.toml").read_text(encoding="utf-8"))
        [(group, points)] = project["project"]["entry-points"].items()
        assert (group, points) == (f"bristle.{kind}s", {name: f"bristle_{name}"})
        texts = [
            f"bristle_{name}.py",
            "README.md",
            "pyproject.toml",
            f"{name}.toml",
            f"tests/test_{name}.py",
        ]
        for file in texts:  # filled in completely
            assert "$" not in (written / name / file).read_text(encoding="utf-8"), file
        assert {path.name for path in (written / name).iterdir()} >= {
            *texts[:4],
            "scenario.schema.json",
            "tests",
        }


@pytest.mark.sampled(4)
def test_a_new_scenario_runs_as_it_is(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, said, _ = call("new", "scenario", "mine", "--out", "files")
    assert (code, said) == (0, "files/mine.toml  next: bristle run files/mine.toml --out out\n")
    assert (
        Path("files/mine.toml")
        .read_text(encoding="utf-8")
        .startswith("#:schema scenario.schema.json\n")
    )
    assert call("run", "files/mine.toml", "--out", "out")[0] == 0
    assert call("new", "scenario", "other", "--out", "files")[0] == 0
    assert sorted(os.listdir("files")) == ["mine.toml", "other.toml", "scenario.schema.json"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["scenario", "old"], "old.toml: exists; choose another name"),
        (["law", "old"], "old: exists; choose another name"),
        (["law", "Old law"], "name 'Old law': write lower-case letters"),
        (["law", "lugre"], "name 'lugre': bristle list has it already"),
        (["effect", "input_noise"], "name 'input_noise': bristle list has it already"),
        (["observer", "rls"], "name 'rls': bristle list has it already"),
        (["recipe", "cake"], "'recipe' is not one of"),
    ],
)
def test_what_cannot_be_written_is_one_line_and_writes_nothing(call, tmp_path, arguments, words):
    (tmp_path / "old.toml").write_text("", encoding="utf-8")
    (tmp_path / "old").mkdir()
    code, _, said = call("new", *arguments, "--out", tmp_path)
    assert code == 2
    assert words in said
    assert len(said.splitlines()) == 1
    assert sorted(os.listdir(tmp_path)) == ["old", "old.toml"]
