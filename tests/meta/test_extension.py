"""A law, an effect, an observer and a scenario are each one file: those of docs/extending.md, added
in two ways.
"""

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
from bristle.harness.scenario.catalogue import scenarios
from bristle.harness.scenario.parts import build_fmus
from bristle.harness.scenario.reading import load
from bristle.observer import methods, observer_program
from bristle.plant import effects as effect_package
from bristle.plant.effects import effects
from bristle.plant.friction import laws
from bristle.plant.servo import servo_program

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r'^```\w+ title="([^"]+)"\n(.*?)^```', PAGE, re.DOTALL | re.MULTILINE))
CONSOLES = re.findall(r"^```console\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
LAW_FILE = "my_models/laws/lorentzian.py"
ADDED = ("lorentzian", "cubic_damper", "projection")
FOLDERS = {
    "laws": "plant/friction",
    "effects": "plant/effects",
    "observers": "observer",
    "scenarios": "scenarios",
}
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


@pytest.mark.long
def test_every_command_of_the_page_prints_what_it_shows(written):
    """Found, built as an FMU, run in a scenario, and named by a diagnosis: without a change of the
    installed package.
    """
    ran = 0
    for command, shown in (each for block in CONSOLES for each in commands(block)):
        if not command.startswith("scripts/test"):
            printed = shell(command, written, **{PLUGINS_VARIABLE: str(written / "my_models")})
            assert SECONDS.sub(" s", printed) == SECONDS.sub(" s", shown), command
            ran += 1
    assert ran >= 7


PROPERTIES = (
    ("tests/plant/test_effects.py", "cubic_damper or lorentzian or shipped or pairs or one_class"),
    ("tests/plant/test_friction_laws.py tests/plant/test_servo.py", "lorentzian or every_file"),
    ("tests/observer/test_methods.py", "projection"),
    (
        "tests/model/test_agreement.py tests/model/test_arrays.py",
        "lorentzian or cubic_damper or projection",
    ),
    ("tests/meta/test_declarations.py tests/meta/test_generated_docs.py", ""),
)


@pytest.mark.slow
@pytest.mark.parametrize(("files", "wanted"), PROPERTIES)
def test_the_tests_of_the_catalogue_pass_with_the_files(written, files, wanted):
    command = f"python -m pytest -q -n 0 -p no:cacheprovider {files}" + (
        f" -k '{wanted}'" if wanted else ""
    )
    printed = shell(command, ROOT, **{PLUGINS_VARIABLE: str(written / "my_models")})
    assert re.search(r"\d+ passed|100%", printed), printed


@pytest.mark.slow
def test_the_tests_of_declarations_pass_with_a_source_of_the_folder(written, tmp_path):
    (tmp_path / "laws").mkdir()
    text = (written / LAW_FILE).read_text(encoding="utf-8")
    assert text.count("armstrong1994") >= 3  # of the law, of its parameters, of the equation
    own = f"rig{2026}"  # put together: no key of ours
    ours = text.replace("armstrong1994", own)
    (tmp_path / "laws" / "lorentzian.py").write_text(ours, encoding="utf-8")
    entry = f"@misc{{{own},\n  author = {{A Lab}},\n  title = {{A rig}},\n  year = {{2026}},\n}}\n"
    (tmp_path / "references.bib").write_text(entry, encoding="utf-8")
    command = "python -m pytest -q -n 0 -p no:cacheprovider tests/meta/test_declarations.py"
    wanted = "'declared_in_full or every_law or sources or references'"
    printed = shell(f"{command} -k {wanted}", ROOT, **{PLUGINS_VARIABLE: str(tmp_path)})
    assert "100%" in printed, printed


@pytest.fixture(scope="module")
def copied(written: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A copy of the source tree with the files in its own folders, and a folder from which it
    imports as bristle.
    """
    tree, site = tmp_path_factory.mktemp("copy"), tmp_path_factory.mktemp("site")
    packages = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "setuptools"
    ]["package-dir"]
    rooms = {folder.split("/")[0] for folder in packages.values()} | {"tests", "docs"}
    for room in sorted(rooms):
        shutil.copytree(
            ROOT / room, tree / room, ignore=shutil.ignore_patterns("__pycache__", "hidden")
        )
    for name in ("pyproject.toml", "references.bib", "README.md"):
        shutil.copy(ROOT / name, tree)
    for name in FILES:
        if name.startswith("my_models/"):
            shutil.copy(written / name, tree / FOLDERS[name.split("/")[1]])
    shutil.copytree(tree / "package", site / "bristle")
    for package, folder in packages.items():
        if package.count(".") == 1:
            (site / "bristle" / package.split(".")[1]).symlink_to(
                tree / folder, target_is_directory=True
            )
    return tree, site


@pytest.mark.slow
def test_files_in_the_source_tree_count_and_fail_no_test(copied):
    tree, site = copied
    known = shell("bristle list", tree, PYTHONPATH=str(site))
    assert all(f"  {name} " in known for name in ADDED)
    tests = (
        "tests/meta/test_declarations.py tests/meta/test_generated_docs.py tests/plant"
        " tests/observer/test_methods.py"
    )
    wanted = (
        "page or shipped or every_file or every_law or every_effect or every_method or (declared"
        " and not output) or source"
    )
    wanted += " or projection"  # properties of one observer depend on no other
    printed = shell(
        f"python -m pytest -q -n 0 -p no:cacheprovider {tests} -k '{wanted}'",
        tree,
        PYTHONPATH=str(site),
    )
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


@pytest.mark.sampled(4)
def test_a_scenario_takes_the_fmu_of_a_plugin_alone(written, monkeypatch):
    """The observers that are shipped take a minute to compile, and would again with each change of
    the file.
    """
    monkeypatch.setenv(PLUGINS_VARIABLE, str(written / "my_models"))
    fmus = build_fmus(load(written / "my_models" / "scenarios" / "lorentzian.toml"))
    assert "projection" in fmus["observer"].path.name
    assert "lorentzian" in fmus["plant"].path.name
    assert fmus["observer"].choices("method") == fmus["plant"].choices("law") == {}


LAW, EFFECT, METHOD = "laws/lorentzian.py", "effects/cubic_damper.py", "observers/projection.py"
DECLARED = {"laws": laws, "effects": effects, "observers": methods}
KINDS_OF_FILE = pytest.mark.parametrize("file", [LAW, EFFECT, METHOD])


@pytest.fixture
def plugin(monkeypatch, tmp_path):
    """Return what writes a file of the page into a plug-in folder, changed, and returns its path;
    effects are read anew.
    """
    monkeypatch.setenv(PLUGINS_VARIABLE, str(tmp_path))

    def write(file: str, old: str, new: str, name: str = "") -> Path:
        text = FILES[f"my_models/{file}"]
        assert old in text
        path = tmp_path / Path(file).with_stem(name or Path(file).stem)
        path.parent.mkdir()
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
        return path

    effect_package._catalogue.cache_clear()
    yield write
    effect_package._catalogue.cache_clear()


@KINDS_OF_FILE
def test_the_files_of_the_page_are_accepted(plugin, file):
    plugin(file, "", "")
    assert Path(file).stem in DECLARED[file.split("/")[0]]()


UNKNOWN_KEY = f"armstrong{1997}"
MISTAKES = [
    (LAW, '"N.m", 0.004', '"N.mm", 0.004', "parameter 'lorentzian.Fc': unit 'N.mm'"),
    (LAW, '"N.m", 0.004', '"mN.m", 0.004', "unit 'mN.m' is 0.001 of the SI unit"),
    (LAW, '"N.m", 0.004', '"N.q", 0.004', "'q' is not known"),
    (LAW, '"N.m", 0.004', "None, 0.004", "LAW is malformed: AttributeError"),
    (LAW, "0.004, 1e-9", "0.004, 1e-2", "default 0.004 is outside [0.01, 1e+06] N.m"),
    (
        LAW,
        '"armstrong1994 (L',
        f'"{UNKNOWN_KEY} (L',
        f"'{UNKNOWN_KEY}' is no key (did you mean 'armstrong1994'?)",
    ),
    (
        LAW,
        'friction", "armstrong1994"',
        'friction", "my rig"',
        "parameter 'lorentzian.Fc': source 'my rig': names no key",
    ),
    (LAW, '"lorentzian.Fc", "Fc"', '"Fc", "Fc"', "parameter 'Fc' must be called 'lorentzian.…'"),
    (
        LAW,
        '    "lorentzian",',
        '    "Lorentz law",',
        "name 'Lorentz law': write lower-case letters",
    ),
    (LAW, "LAW =", "OTHER =", "no LAW that is a FrictionLaw"),
    (LAW, "LAW =", "LAW = 3\nOTHER =", "no LAW that is a FrictionLaw"),
    (
        EFFECT,
        'off={"coefficient"',
        'off={"coefficent"',
        "off: 'coefficent' is no parameter of the effect (did you mean",
    ),
    (
        EFFECT,
        "    load_side",
        '    periods="turns",\n    load_side',
        "periods or free_play: 'turns' is no parameter",
    ),
    (
        EFFECT,
        '    "cubic_damper",',
        '    "cubic-damper",',
        "name 'cubic-damper': write lower-case letters",
    ),
    (EFFECT, '"v",)', '"velocity",)', "residual: 'velocity' is no view"),
    (
        EFFECT,
        '"stribeck")',
        '"stribek")',
        "confounded: 'stribek' is no effect (did you mean 'stribeck'?)",
    ),
    (EFFECT, 'group="cubic_damper"', 'group="bias"', "group 'bias' lacks 'cubic_damper'"),
    (
        EFFECT,
        "    load_side",
        '    without_truth=("alpha",),\n    load_side',
        "without_truth: 'alpha' is no normalised parameter",
    ),
    (EFFECT, '"{torque} of', '"{tork} of', "EFFECT is malformed: KeyError: 'tork'"),
    (EFFECT, '"N.m.s3/rad3"', '"Nm"', "did you mean 'N.m'?"),
    (
        METHOD,
        '"vc",\n            "rad/s",',
        '"vc",\n            "rads",',
        "parameter 'projection.vc': unit 'rads'",
    ),
    (
        METHOD,
        '"ljung1999 section 11.2",\n    "y_v"',
        '"ljung section 11.2",\n    "y_v"',
        "names no key",
    ),
    (METHOD, 'State("v", "rad/s"', 'State("v", "rad/h"', "state 'v': unit 'rad/h'"),
]


@pytest.mark.parametrize(("file", "old", "new", "words"), MISTAKES)
def test_a_mistake_in_a_declaration_is_told_with_the_file_when_it_is_loaded(
    plugin, message, file, old, new, words
):
    path = plugin(file, old, new)
    text = message(DECLARED[file.split("/")[0]])
    assert text.startswith(f"{path}: ")
    assert words in text


@pytest.mark.parametrize("name", ["", "aaa", "zzz"])
@pytest.mark.parametrize(("file", "shipped"), [(LAW, "dahl"), (EFFECT, "bias"), (METHOD, "rls")])
def test_a_plugin_called_like_something_shipped_is_the_one_to_blame(
    plugin, message, file, shipped, name
):
    """Whatever the order of the two files."""
    path = plugin(file, f'    "{Path(file).stem}",', f'    "{shipped}",', name or shipped)
    text = message(DECLARED[file.split("/")[0]])
    assert text.startswith(f"{path}: ")
    assert f"is called '{shipped}', as in " in text
    assert f"{shipped}.py; give it a name of its own" in text


def test_a_folder_may_have_its_own_references(plugin, tmp_path):
    plugin(LAW, '"armstrong1994 (L', f'"{UNKNOWN_KEY} (L')
    (tmp_path / "references.bib").write_text(
        f"@misc{{{UNKNOWN_KEY},\n  title = {{A rig}},\n}}\n", encoding="utf-8"
    )
    assert laws()["lorentzian"].source.startswith(UNKNOWN_KEY)


COMPOSED = {
    LAW: lambda: servo_program("lorentzian"),
    EFFECT: lambda: servo_program("coulomb", effects=("cubic_damper", "bias")),
    METHOD: lambda: observer_program("projection"),
}
EQUATIONS = [
    (LAW, "p.Fs - p.Fc", "p.Fs - p.Fd", "line 16: AttributeError: no symbol 'Fd'"),
    (LAW, "return Friction(", "return dict(", "AttributeError: 'dict' object"),
    (LAW, "force=ca.SX(0)", 'force=ca.SX(0), rates={"z": v}', "'z' needs both a state and a rate"),
    (EFFECT, "return ca.SX(-c.p", "return (1 / 0) * ca.SX(-c.p", "line 16: ZeroDivisionError"),
    (EFFECT, "return ca.SX(-c.p", "return None and ca.SX(-c.p", "TypeError: "),
    (
        METHOD,
        "def adapt(",
        "def adapt(*_):\n    raise ValueError('two\\nlines')\n\n\ndef unused(",
        "ValueError: two lines",
    ),
    (METHOD, "return Update(", "return (", "AttributeError: 'tuple' object"),
]


@pytest.mark.parametrize(("file", "old", "new", "words"), EQUATIONS)
def test_an_error_in_equations_is_told_with_the_file(plugin, message, file, old, new, words):
    path = plugin(file, old, new)
    text = message(COMPOSED[file])
    assert text.startswith(f"{path}: ")
    assert words in text
    assert text.endswith("; correct the equations")


def test_parts_that_do_not_fit_blame_no_file(plugin, message):
    plugin(EFFECT, "", "")
    assert message(
        lambda: servo_program("viscous", effects=("cubic_damper", "stribeck"))
    ).startswith("effect 'stribeck'")


def test_a_scenario_that_is_no_toml_is_told_with_its_file(plugin, message):
    path = plugin("scenarios/lorentzian.toml", "[plant]", "[plant")
    assert message(scenarios).startswith(f"{path}: not valid TOML")
