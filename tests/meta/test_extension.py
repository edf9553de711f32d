"""A law, an effect, an observer and a scenario are each one file: those of docs/extending.md, added in two ways."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from bristle.common.errors import BristleError
from bristle.common.plugins import PLUGINS_VARIABLE, plugin_folders
from bristle.plant.friction import laws

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r'^```\w+ title="([^"]+)"\n(.*?)^```', PAGE, re.DOTALL | re.MULTILINE))
CONSOLES = re.findall(r"^```console\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
ADDED = ("lorentzian", "cable_spring", "projection")
FOLDERS = {"laws": "plant/friction", "effects": "plant/effects", "observers": "observer", "scenarios": "scenarios"}
SECONDS = re.compile(r" *\d+\.\d s")


def shell(command: str, folder: Path, **environment: str) -> str:
    """Return what a command prints in a folder, with this Python first on the path."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=folder,
        env=os.environ | {"PATH": path} | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files of the page."""
    folder = tmp_path_factory.mktemp("extending")
    for name, text in FILES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def commands(block: str) -> list[tuple[str, str]]:
    """Return the commands of a console block, each with what it prints."""
    parts = re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]
    return [(part.partition("\n")[0], part.partition("\n")[2]) for part in parts]


def test_the_page_adds_one_file_of_each_kind():
    assert {name.split("/")[1] for name in FILES if name.startswith("my_models/")} == set(FOLDERS)


@pytest.mark.slow
def test_every_command_of_the_page_prints_what_it_shows(written):
    """Found, built as an FMU, run in a scenario, and named by a diagnosis: without a change of the installed package."""
    ran = 0
    for command, shown in (each for block in CONSOLES for each in commands(block)):
        if "pytest" not in command:
            printed = shell(command, written, **{PLUGINS_VARIABLE: str(written / "my_models")})
            assert SECONDS.sub(" s", printed) == SECONDS.sub(" s", shown), command
            ran += 1
    assert ran >= 7


PROPERTIES = (
    ("tests/plant/test_effects.py", "cable_spring or lorentzian or shipped or pairs or one_class"),
    ("tests/plant/test_friction_laws.py tests/plant/test_servo.py", "lorentzian or every_file"),
    ("tests/observer/test_methods.py", "projection"),
    ("tests/model/test_agreement.py tests/model/test_arrays.py", "lorentzian or cable_spring or projection"),
    ("tests/meta/test_declarations.py tests/meta/test_generated_docs.py", ""),
)


@pytest.mark.slow
@pytest.mark.parametrize(("files", "wanted"), PROPERTIES)
def test_the_tests_of_the_catalogue_pass_with_the_files(written, files, wanted):
    command = f"python -m pytest -q -n 0 -p no:cacheprovider {files}" + (f" -k '{wanted}'" if wanted else "")
    printed = shell(command, ROOT, **{PLUGINS_VARIABLE: str(written / "my_models")})
    assert re.search(r"\d+ passed|100%", printed), printed


@pytest.fixture(scope="module")
def copied(written: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A copy of the source tree with the files in its own folders, and a folder from which it imports as bristle."""
    tree, site = tmp_path_factory.mktemp("copy"), tmp_path_factory.mktemp("site")
    packages = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["package-dir"]
    rooms = {folder.split("/")[0] for folder in packages.values()} | {"tests", "docs"}
    for room in sorted(rooms):
        shutil.copytree(ROOT / room, tree / room, ignore=shutil.ignore_patterns("__pycache__", "hidden"))
    for name in ("pyproject.toml", "references.bib", "README.md"):
        shutil.copy(ROOT / name, tree)
    for name in FILES:
        if name.startswith("my_models/"):
            shutil.copy(written / name, tree / FOLDERS[name.split("/")[1]])
    shutil.copytree(tree / "package", site / "bristle")
    for package, folder in packages.items():
        if package.count(".") == 1:
            (site / "bristle" / package.split(".")[1]).symlink_to(tree / folder, target_is_directory=True)
    return tree, site


@pytest.mark.slow
def test_files_in_the_source_tree_count_and_fail_no_test(copied):
    tree, site = copied
    known = shell("bristle list", tree, PYTHONPATH=str(site))
    assert all(f"  {name} " in known for name in ADDED)
    tests = "tests/meta/test_declarations.py tests/meta/test_generated_docs.py tests/plant tests/observer/test_methods.py"
    wanted = (
        "page or shipped or every_file or pairs or one_class or every_law or every_effect or every_method or declared or source"
    )
    printed = shell(f"python -m pytest -q -n 0 -p no:cacheprovider {tests} -k '{wanted}'", tree, PYTHONPATH=str(site))
    assert "100%" in printed


def test_a_folder_that_is_not_there_is_refused(monkeypatch, tmp_path):
    monkeypatch.setenv(PLUGINS_VARIABLE, str(tmp_path / "nowhere"))
    with pytest.raises(BristleError, match=r"BRISTLE_PLUGINS: no folder .*nowhere"):
        plugin_folders("laws")


def test_a_file_that_does_not_load_is_refused_with_its_name(monkeypatch, tmp_path):
    (tmp_path / "laws").mkdir()
    (tmp_path / "laws" / "broken.py").write_text("import no_such_module\n", encoding="utf-8")
    (tmp_path / "laws" / "_helper.py").write_text("import no_such_module\n", encoding="utf-8")
    monkeypatch.setenv(PLUGINS_VARIABLE, str(tmp_path))
    with pytest.raises(BristleError, match=r"broken\.py: ModuleNotFoundError"):
        laws()
