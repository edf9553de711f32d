"""The house: imports run downwards, packages are typed, and the wheel holds all of it and nothing
else.
"""

import ast
import importlib
import shutil
import subprocess
import sys
import tomllib
import zipfile
from collections import Counter, defaultdict
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES = PROJECT["tool"]["setuptools"]["packages"]
FOLDERS = PROJECT["tool"]["setuptools"]["package-dir"]
TEST_DATA = {ROOT / "scenarios" / "hidden"}  # records, which stay out of the wheel
ALLOWED = {
    "common": {"common"},
    "model": {"model", "common"},
    "plant": {"plant", "model", "common"},
    "observer": {"observer", "model", "common"},
    "records": {"records", "common"},
    "fmus": {"fmus", "plant", "observer", "model", "common"},
    "harness": {"harness", "fmus", "records", "model", "common"},
    "diagnosis": {"diagnosis", "fmus", "plant", "records", "model", "common"},
    "cli": {"cli", "harness", "diagnosis", "fmus", "plant", "observer", "model", "common"},
}
# of the harness: a room stands on those below it, and the applications on top know nothing of each
# other
APPLICATIONS = ("sweep", "suite", "baseline", "exchange", "coupling", "paper")
HARNESS_ROOMS: dict[str, set[str]] = {
    "cosim": {"cosim"},
    "scenario": {"scenario", "cosim"},
    "metrics": {"metrics", "scenario", "cosim"},
    "run": {"run", "metrics", "scenario", "cosim"},
    **{each: {each, "run", "metrics", "scenario", "cosim"} for each in APPLICATIONS},
}
MOST_FILES = 9  # of a room, besides its __init__.py
# what of the ground floor the harness may use: it knows FMUs, not equations
HARNESS_MODEL = {"bristle.model.compiler"}


def imports(path):
    """Return the modules of bristle that a file imports, wherever in the file."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found.add(node.module or "")
            if node.module == "bristle":
                found |= {f"bristle.{alias.name}" for alias in node.names}
    return found


@pytest.mark.parametrize("room", list(ALLOWED))
def test_imports_run_downwards(room):
    files = sorted((ROOT / room).rglob("*.py"))
    assert files
    for path in files:
        for module in imports(path):
            assert module.split(".")[0] not in ALLOWED, (
                f"{path.relative_to(ROOT)} imports {module}; write bristle.{module}"
            )
            if module.startswith("bristle."):
                assert module.split(".")[1] in ALLOWED[room], (
                    f"{path.relative_to(ROOT)} imports {module}"
                )
                if room == "harness" and module.split(".")[1] == "model":
                    assert module in HARNESS_MODEL, f"{path.relative_to(ROOT)} imports {module}"


def harness_modules():
    """Return the files of the harness by their modules."""
    found = {}
    for path in sorted((ROOT / "harness").rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(["bristle", *parts]).removesuffix(".__init__")] = path
    return found


def harness_arrows():
    """Return by module of the harness the others that it imports; `from PACKAGE import module`
    counts as one of the module.
    """
    modules = harness_modules()
    arrows = {}
    for module, path in modules.items():
        found = imports(path)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                found |= {f"{node.module}.{alias.name}" for alias in node.names}
        arrows[module] = (found & set(modules)) - {module}
    return arrows


def room_of(module):
    """Return the room of the harness that a module lies in; empty for the harness itself."""
    return ".".join(module.split(".")[2:3])


def test_rooms_of_the_harness_stand_on_those_below():
    rooms = {room_of(module) for module in harness_modules()} - {""}
    assert rooms == set(HARNESS_ROOMS)
    for module, found in harness_arrows().items():
        for other in found:
            assert room_of(other) in HARNESS_ROOMS[room_of(module)], f"{module} imports {other}"


def test_a_room_of_the_harness_can_be_overlooked():
    counts = Counter(room_of(module) for module in harness_modules())
    assert counts.pop("") == 1  # the harness itself
    too_many = {room: count - 1 for room, count in counts.items() if count - 1 > MOST_FILES}
    assert not too_many


def test_no_files_of_the_harness_import_each_other_in_a_circle():
    sorter = TopologicalSorter(harness_arrows())
    try:
        sorter.prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def shared_classes(paths):
    """Return the files that define a public class of the same name, by that name."""
    files = defaultdict(set)
    for path in paths:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                files[node.name].add(path)
    return {name: places for name, places in files.items() if len(places) > 1}


def test_no_two_public_classes_share_a_name():
    rooms = [*ALLOWED, "package"]
    assert not shared_classes(path for room in rooms for path in (ROOT / room).rglob("*.py"))


def test_a_shared_name_of_classes_is_seen(tmp_path):
    one, other = tmp_path / "one.py", tmp_path / "other.py"
    one.write_text("class Servo: ...\nclass _Own: ...\n", encoding="utf-8")
    other.write_text("class Servo: ...\nclass _Own: ...\nclass Drive: ...\n", encoding="utf-8")
    assert shared_classes([one, other]) == {"Servo": {one, other}}


@pytest.mark.parametrize("package", PACKAGES)
def test_every_package_is_there_and_typed(package):
    importlib.import_module(package)
    folder = ROOT / FOLDERS.get(package, package)
    assert (folder / "__init__.py").is_file()
    if package not in ("bristle.scenarios",):  # data only
        assert (folder / "py.typed").is_file(), f"{package}: add an empty py.typed"


def test_no_folder_with_code_is_forgotten():
    folders = {
        str(path.parent.relative_to(ROOT))
        for room in ALLOWED
        for path in (ROOT / room).rglob("__init__.py")
    }
    assert folders == {FOLDERS[p] for p in PACKAGES} - {"package", "scenarios"}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Build the wheel from a copy, so that nothing is left in the source tree."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    keep = {p.split("/")[0] for p in FOLDERS.values()} | {"pyproject.toml", "README.md", "LICENSE"}
    source.mkdir()
    for name in keep:
        path = ROOT / name
        if path.is_dir():
            shutil.copytree(path, source / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(path, source / name)
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--no-deps",
        "--no-build-isolation",
        "--quiet",
        "-w",
        str(folder),
        str(source),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    [built] = folder.glob("bristle-*.whl")
    return built


@pytest.mark.sampled(4)
def test_the_wheel_holds_every_file_of_every_room(wheel):
    """Modules, C templates, readmes, style sheets, scenarios: what is in a room's folder is in the
    wheel.
    """
    names = set(zipfile.ZipFile(wheel).namelist())
    expected = set()
    for room in [*ALLOWED, "scenarios"]:
        for path in (ROOT / room).rglob("*"):
            kept_out = (
                "__pycache__" in path.parts
                or path.name.startswith(".")
                or TEST_DATA & {*path.parents}
            )
            if path.is_file() and not kept_out:
                expected.add(f"bristle/{path.relative_to(ROOT).as_posix()}")
    assert {
        "bristle/model/c/core.c",
        "bristle/model/c/core.h",
        "bristle/model/c/batch.c",
    } <= expected
    assert expected <= names, (
        f"missing in the wheel, list them in pyproject.toml: {sorted(expected - names)}"
    )


def test_the_wheel_holds_nothing_else(wheel):
    tops = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"bristle"}
    assert len(tops) == 2
    assert not [name for name in zipfile.ZipFile(wheel).namelist() if name.endswith(".npz")]


@pytest.mark.slow
def test_every_module_of_the_wheel_imports_from_the_wheel(wheel, tmp_path):
    """A fresh interpreter that does not know the checkout imports each module out of the unpacked
    wheel.
    """
    zipfile.ZipFile(wheel).extractall(tmp_path)
    modules = [
        path.relative_to(tmp_path)
        .with_suffix("")
        .as_posix()
        .replace("/", ".")
        .removesuffix(".__init__")
        for path in (tmp_path / "bristle").rglob("*.py")
    ]
    assert len(modules) > 30
    code = f"""
import importlib, sys
known = {{f: getattr(f, "__module__", "") + repr(f) for f in sys.meta_path}}
sys.meta_path[:] = [f for f in sys.meta_path if "__editable__" not in known[f]]
sys.path.insert(0, {str(tmp_path)!r})
for name in {sorted(modules)!r}:
    module = importlib.import_module(name)
    assert module.__file__.startswith({str(tmp_path)!r}), module.__file__
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
