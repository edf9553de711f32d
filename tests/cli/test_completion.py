"""What Tab offers is what the catalogues have, at once: nothing of them is imported, and a wrong
plug-in does not disturb.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import typer

import bristle.cli.commands  # noqa: F401 - imported so that the application has them
from bristle.cli.app import app
from bristle.cli.completion import (
    complete_effect,
    complete_effects,
    complete_law,
    complete_method,
    complete_scenario,
)
from bristle.harness.scenario.catalogue import find_scenario, scenarios
from bristle.observer import methods
from bristle.plant.effects import effects
from bristle.plant.friction import laws
from bristle.plant.signal_effects import SIGNAL_EFFECTS

# to import between Tab and its answer
TOO_LATE = ("numpy", "casadi", "scipy", "bristle.model.declarations", "bristle.harness")
COMPLETE = f"""
import sys
import bristle.cli.main
sys.argv = ["bristle"]
try:
    bristle.cli.main.main()
finally:
    assert not [name for name in {TOO_LATE} if name in sys.modules]
"""
# parameters that take a name of a catalogue
NAMED = {"law", "method", "effects", "choose", "scenario", "scenarios"}


def tab(line: str, folder: Path) -> list[str]:
    """Return what a shell offers in a folder, where the last word of a line is not complete."""
    words = {
        "COMP_WORDS": line.replace(" ", "\n"),
        "COMP_CWORD": str(line.count(" ")),
        "_BRISTLE_COMPLETE": "complete_bash",
    }
    environment = {**os.environ, **words}
    command = [sys.executable, "-c", COMPLETE]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.split()


def test_all_names_of_the_catalogues_are_offered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert complete_law("") == list(laws(packages=True))
    assert complete_method("") == list(methods(packages=True))
    assert complete_effect("") == list(effects())
    assert set(complete_effects("")) == {*effects(), *SIGNAL_EFFECTS}
    assert complete_scenario("") == list(scenarios())


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("bristle run qu", ["quick"]),
        ("bristle accept quick self", ["self_starting"]),
        ("bristle sweep --seeds 1-9 qu", ["quick"]),
        ("bristle build plant --law lugre_", ["lugre_velocity_damping"]),
        ("bristle build observer --method=rl", ["rls"]),
        ("bristle diagnose m.toml --data a.csv b.csv --choose cogg", ["cogging"]),
        (
            "bristle build --effects backlash,input_",
            ["backlash,input_delay", "backlash,input_noise"],
        ),
    ],
)
def test_a_command_completes_names_and_imports_little(
    tmp_path: Path, line: str, offered: list[str]
) -> None:
    assert tab(line, tmp_path) == offered


def test_every_parameter_that_takes_a_name_completes_it() -> None:
    seen = set()
    for name, command in typer.main.get_command(app).commands.items():  # type: ignore[attr-defined]  # a group, which has them
        for parameter in command.params:
            if parameter.name in NAMED or parameter.metavar == "SCENARIO":
                assert parameter._custom_shell_complete is not None, (
                    f"bristle {name}: {parameter.name}"
                )
                seen.add((name, parameter.name))
    assert {
        ("build", "law"),
        ("build", "method"),
        ("build", "effects"),
        ("diagnose", "choose"),
    } <= seen
    assert {name for name, parameter in seen if parameter.startswith("scenario")} == {
        "run",
        "test",
        "accept",
        "sweep",
        "export",
        "coupling",
    }


def test_files_stand_beside_scenarios_and_alone_are_left_to_the_shell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("quicker.toml", "quiet.csv", "mine.toml"):
        (tmp_path / name).touch()
    (tmp_path / "quantities").mkdir()
    assert complete_scenario("qu") == ["quick", "quantities/", "quicker.toml"]
    assert complete_scenario("mi") == []
    assert complete_scenario("sub/qu") == []


def test_scenarios_of_the_paper_are_offered_by_their_folder() -> None:
    offered = complete_scenario("reproduce/")
    assert "reproduce/printed" in offered
    assert all(find_scenario(Path(name)).is_file() for name in offered)


def test_an_effect_is_offered_once() -> None:
    assert "cogging,bias" in complete_effects("cogging,")
    assert "cogging,cogging" not in complete_effects("cogging,")


def test_plug_ins_are_offered_by_the_name_they_declare(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for kind in ("laws", "scenarios"):
        (tmp_path / kind).mkdir()
    (tmp_path / "laws" / "a_file.py").write_text(
        'LAW: FrictionLaw = FrictionLaw(\n    "tyre",\n)\n'
    )
    (tmp_path / "laws" / "of_a_call.py").write_text("raise SystemExit\nLAW = made()\n")
    (tmp_path / "laws" / "_helpers.py").write_text('LAW = FrictionLaw("hidden")\n')
    (tmp_path / "scenarios" / "belt.toml").touch()
    monkeypatch.setenv("BRISTLE_PLUGINS", str(tmp_path))
    assert complete_law("t") == ["tyre"]
    assert complete_law("of") == ["of_a_call"]
    assert complete_law("h") == []
    assert complete_scenario("bel") == ["belt"]


def test_a_package_is_offered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    info = tmp_path / "away-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: away\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[bristle.observers]\nfar_away = no_such_module\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert complete_method("far") == ["far_away"]


def test_a_wrong_plug_in_folder_leaves_the_own_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BRISTLE_PLUGINS", str(tmp_path / "nowhere"))
    assert tab("bristle run qu", tmp_path) == ["quick"]
    assert tab("bristle build --law dah", tmp_path) == ["dahl"]
