"""Laws, effects and observers of installed packages: found by name, checked, told by package where
they are wrong.
"""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import pytest

from bristle.common.packages import code_offered, offered
from bristle.fmus import obtain
from bristle.observer import methods, observer_program
from bristle.plant import effects as effect_package
from bristle.plant.effects import effect, effects
from bristle.plant.friction import law, law_names, laws
from bristle.plant.servo import servo_program

TEMPLATES = Path(__file__).resolve().parents[2] / "cli" / "templates"
GROUPS = {"law": "laws", "effect": "effects", "observer": "observers"}
KNOWN = {
    "law": lambda: laws(packages=True),
    "effect": effects,
    "observer": lambda: methods(packages=True),
}
SHIPPED = {"law": laws, "effect": lambda: effects(packages=False), "observer": methods}
ASKED = {"law": law, "effect": effect, "observer": observer_program}
KINDS = pytest.mark.parametrize("kind", list(GROUPS))


def forget():
    """Let effects be read anew."""
    effect_package._catalogue.cache_clear()
    effect_package._packaged.cache_clear()


@pytest.fixture
def package(monkeypatch, tmp_path):
    """Return what installs a package of one module, from the template of its kind, changed; effects
    are read anew.
    """
    monkeypatch.syspath_prepend(str(tmp_path))
    made = []

    def install(
        kind: str, name: str, old: str = "", new: str = "", entry: str = "", title: str = ""
    ) -> Path:
        module, text = (
            f"outside_{name}_{len(made)}",
            (TEMPLATES / f"{kind}.txt").read_text(encoding="utf-8").replace("$name", name),
        )
        assert old in text
        made.append(module)
        path = tmp_path / f"{module}.py"
        path.write_text(text.replace(old, new, 1) if old else text, encoding="utf-8")
        info = tmp_path / f"{title or 'my_' + name}-1.2.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {title or 'my_' + name}\nVersion: 1.2\n",
            encoding="utf-8",
        )
        (info / "entry_points.txt").write_text(
            f"[bristle.{GROUPS[kind]}]\n{entry or name} = {module}\n", encoding="utf-8"
        )
        forget()
        return path

    yield install
    forget()
    for module in made:
        sys.modules.pop(module, None)


@KINDS
def test_a_part_of_a_package_is_known_by_name_and_in_nothing_that_is_shipped(package, kind):
    before = list(SHIPPED[kind]())
    package(kind, "outside")
    assert ASKED[kind]("outside") is not None
    assert list(KNOWN[kind]()) == [*before, "outside"]
    assert list(SHIPPED[kind]()) == before


@pytest.mark.sampled(3, "observer")
def test_the_fmus_of_all_laws_and_methods_are_the_same_with_and_without_packages(package):
    """From the cache: their keys have no part of a package."""
    before = [obtain(what) for what in ("plant", "observer")]
    package("law", "outside_law")
    package("observer", "outside_observer")
    assert [obtain(what) for what in ("plant", "observer")] == before
    assert "outside_law" in law_names()
    assert not [each for each in servo_program().variants if each.system.name == "outside_law"]


def test_an_entry_point_may_name_the_declaration_itself(package, tmp_path):
    path = package("law", "outside")
    entries = tmp_path / "my_outside-1.2.dist-info" / "entry_points.txt"
    entries.write_text(f"[bristle.laws]\noutside = {path.stem}:LAW\n", encoding="utf-8")
    assert law("outside").name == "outside"


BROKEN = [
    (
        "law",
        "import casadi",
        "import no_such_module\nimport casadi",
        "ModuleNotFoundError: No module named 'no_such_module'",
    ),
    ("law", "import casadi", "raise SystemExit(3)\nimport casadi", "SystemExit: 3"),
    ("law", "LAW =", "OTHER =", "no LAW that is a FrictionLaw"),
    ("law", '"N.m", 0.004', '"mN.m", 0.004', "unit 'mN.m' is 0.001 of the SI unit"),
    (
        "law",
        '    "outside",',
        '    "inside",',
        "declares 'inside', its entry point is called 'outside'",
    ),
    ("effect", '"v",)', '"velocity",)', "residual: 'velocity' is no view"),
    ("effect", '"{torque} of', '"{tork} of', "EFFECT is malformed: KeyError: 'tork'"),
    (
        "observer",
        '"ljung1999 section 11.2",\n    "y_v"',
        '"my rig",\n    "y_v"',
        "source 'my rig': names no key",
    ),
]


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_package_is_named_and_stops_nothing_else(package, message, caplog, case):
    kind, old, new, words = case
    before = list(SHIPPED[kind]())
    package(kind, "outside", old, new)
    text = message(lambda: ASKED[kind]("outside"))
    assert text.startswith("package my_outside 1.2: ")
    assert words in text
    assert not caplog.records
    with caplog.at_level(logging.WARNING, "bristle"):
        assert list(KNOWN[kind]()) == before
    assert [record.getMessage() for record in caplog.records] == [f"left out: {text}"]
    assert ASKED[kind](before[0]) is not None


@pytest.mark.parametrize(
    ("kind", "taken"), [("law", "dahl"), ("effect", "bias"), ("observer", "rls")]
)
def test_a_name_that_bristle_has_is_refused_and_bristle_keeps_it(package, caplog, kind, taken):
    before = list(SHIPPED[kind]())
    package(kind, taken)
    with caplog.at_level(logging.WARNING, "bristle"):
        assert list(KNOWN[kind]()) == before
    [record] = caplog.records
    assert record.getMessage().startswith(f"left out: package my_{taken} 1.2: ")
    assert f"is called '{taken}', as one that bristle has already" in record.getMessage()
    assert ASKED[kind](taken) is not None
    assert f"outside_{taken}_0" not in sys.modules


def test_two_packages_with_one_name_are_both_named(package, message):
    package("law", "outside")
    package("law", "outside", title="other")
    text = message(lambda: law("outside"))
    assert text.startswith(
        "package my_outside 1.2 and package other 1.2: both offer bristle.laws 'outside'"
    )


def test_an_error_in_equations_names_package_and_line(package, message):
    path = package("law", "outside", "p.Fs - p.Fc", "p.Fs - p.Fd")
    text = message(lambda: servo_program("outside"))
    assert text.startswith(f"package my_outside 1.2: {path}: line ")
    assert "no symbol 'Fd'" in text


@pytest.mark.sampled(4)
def test_the_key_of_an_fmu_depends_on_the_code_of_the_package(package):
    path = package("effect", "outside")
    first, plain = (
        obtain("plant", law="viscous", effects=("outside",)),
        obtain("plant", law="viscous"),
    )
    path.write_text(path.read_text(encoding="utf-8") + "\n# another one\n", encoding="utf-8")
    assert obtain("plant", law="viscous", effects=("outside",)) != first
    assert obtain("plant", law="viscous") == plain


def test_all_files_of_a_package_count_and_nothing_is_imported(package, tmp_path):
    path = package("law", "outside")
    folder = tmp_path / "outside_folder"
    folder.mkdir()
    (folder / "__init__.py").write_text("", encoding="utf-8")
    path.rename(folder / "mine.py")
    entries = tmp_path / "my_outside-1.2.dist-info" / "entry_points.txt"
    entries.write_text("[bristle.laws]\noutside = outside_folder.mine\n", encoding="utf-8")
    before = code_offered("laws", "outside")
    (folder / "helper.py").write_text("LEVEL = 2\n", encoding="utf-8")
    assert code_offered("laws", "outside") != before
    assert "outside_folder" not in sys.modules
    assert code_offered("laws", "dahl") == []
    assert list(offered("laws")) == ["outside"]


def test_a_package_may_have_references_of_its_own(package, tmp_path):
    key = f"armstrong{1997}"
    package("law", "outside", '"armstrong1994 (Lorentzian form)"', f'"{key}"')
    (tmp_path / "references.bib").write_text(
        f"@misc{{{key},\n  title = {{A rig}},\n}}\n", encoding="utf-8"
    )
    assert law("outside").source == key
