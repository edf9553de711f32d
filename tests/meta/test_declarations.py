"""Every declaration is complete: units are SI, sources exist, laws say what they are."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from bristle.common.units import parse_unit
from bristle.model.declarations import source_keys
from bristle.model.variables import Parameter
from bristle.observer import methods
from bristle.plant.effects import effects
from bristle.plant.friction import laws
from bristle.plant.servo import servo_program
from bristle.plant.signal_effects import SIGNAL_EFFECTS
from bristle.plant.wording import Wording

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("model", "plant", "observer", "fmus", "harness", "diagnosis", "cli")
KEY = re.compile(r"\b([a-z]+(?:19|20)\d\d[a-z]?)\b")
BIBLIOGRAPHY = (ROOT / "references.bib").read_text(encoding="utf-8")
ENTRIES = re.findall(r"^@(\w+)\{([^,\s]+),\n(.*?)^\}", BIBLIOGRAPHY, re.DOTALL | re.MULTILINE)
KEYS = [key for _, key, _ in ENTRIES]


@cache
def programs():
    """Return every program there is by name, and a servo with each effect."""
    augmented = {
        name: servo_program("coulomb", effects=(name,)) for name in [*effects(), *SIGNAL_EFFECTS]
    }
    return {"servo": servo_program(), **{name: servo_program(name) for name in laws()}, **augmented}


def parameters():
    """Return every parameter of laws, servo, effects and observers by name."""
    found = {
        p.name: p
        for program in programs().values()
        for a in program.variants
        for p in a.system.parameters.values()
    }
    return found | {p.name: p for method in methods().values() for p in method.parameters}


def files():
    return sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))


def known_sources():
    """Return the keys of the library and those of the folders of plug-ins."""
    return source_keys().union(KEYS)


def docstring_sources():
    """Return (file, name, text) of each 'Source:' in a docstring."""
    found = []
    pattern = re.compile(r"Source:(.*?)(?:\n\s*\n|\Z)", re.DOTALL)
    for path in files():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and (
                text := ast.get_docstring(node)
            ):
                name = getattr(node, "name", "(file)")
                found += [
                    (path.relative_to(ROOT), name, source) for source in pattern.findall(text)
                ]
    return found


def test_references_are_complete_and_unique():
    assert len(KEYS) >= 20
    assert sorted(KEYS) == KEYS
    assert len(set(KEYS)) == len(KEYS)
    assert len(KEYS) == BIBLIOGRAPHY.count("\n@") + 1
    for _, key, body in ENTRIES:
        fields = dict(re.findall(r"^\s*(\w+)\s*=\s*\{(.*)\},$", body, re.MULTILINE))
        assert {"author", "title", "year"} <= fields.keys(), key
        assert key.endswith(fields["year"]), key


@pytest.mark.parametrize("name", list(programs()))
def test_every_variable_has_a_unit_in_si_and_a_meaning(name):
    for slot in programs()[name].slots:
        unit = parse_unit(slot.variable.unit)
        assert unit.factor == pytest.approx(1.0, rel=1e-15), slot.name
        assert slot.variable.description.strip(), slot.name


def test_every_parameter_is_declared_in_full():
    assert len(parameters()) > 30
    for name, p in parameters().items():
        assert parse_unit(p.unit).factor == 1.0, name
        assert p.minimum <= p.default <= p.maximum, name
        assert p.minimum < p.maximum, name
        assert p.symbol, name
        assert p.description, name
        keys = KEY.findall(p.source)
        assert keys, f"{name}: source '{p.source}' names no key"
        assert p.source.startswith(keys[0]), name
        assert set(keys) <= known_sources(), f"{name}: {p.source}"


def test_a_parameter_has_one_default_everywhere():
    seen: dict[str, Parameter] = {}
    for program in programs().values():
        for a in program.variants:
            for p in a.system.parameters.values():
                assert seen.setdefault(p.name, p) == p


@pytest.mark.parametrize("name", list(laws()))
def test_every_law_says_what_it_is_and_where_it_comes_from(name):
    law = laws()[name]
    assert law.name == name
    assert len(law.description.split()) >= 2
    assert set(KEY.findall(law.source)) & known_sources()
    assert all(p.name.startswith(f"{name}.") for p in law.parameters)
    assert "Source:" in (law.equations.__doc__ or "")


@pytest.mark.parametrize("wording", [Wording(), Wording(linear=True, input_kind="force")])
def test_the_texts_of_effects_have_no_open_placeholder_and_no_torque_on_a_linear_axis(wording):
    for effect in effects(wording).values():
        texts = (
            effect.title,
            effect.description,
            effect.excitation,
            *(p.description for p in effect.parameters),
        )
        assert not any("{" in text for text in texts)
        if wording.linear:
            assert not any(
                word in text
                for text in texts
                for word in ("torque", "voltage", "periods in a turn")
            )


@pytest.mark.parametrize("name", list(effects()))
def test_every_effect_says_what_it_is_and_where_it_comes_from(name):
    effect = effects()[name]
    assert effect.name == name
    assert len(effect.description.split()) >= 2
    assert 2 <= len(effect.title.split()) <= 5
    assert set(KEY.findall(effect.source)) & known_sources()
    slots = (
        effect.command,
        effect.drive,
        effect.torque,
        effect.factor,
        effect.bound,
        effect.output,
        effect.coupling,
        effect.bristles,
        effect.rates,
        effect.follow,
    )
    assert any("Source:" in (slot.__doc__ or "") for slot in slots if slot)


@pytest.mark.parametrize("name", list(methods()))
def test_every_method_says_what_it_is(name):
    method = methods()[name]
    assert method.name == name
    assert len(method.description.split()) >= 2


@pytest.mark.sampled(4)
def test_every_source_in_a_docstring_is_in_the_references():
    sources = docstring_sources()
    assert len(sources) > 15
    for path, name, text in sources:
        keys = KEY.findall(text)
        assert keys, f"{path} {name}: Source names no key"
        assert set(keys) <= set(KEYS), f"{path} {name}: {text.strip()}"


def test_no_key_in_the_code_is_unknown():
    """Also in strings and comments: what looks like a key is one."""
    for path in [
        *files(),
        *sorted((ROOT / "tests").rglob("*.py")),
        *sorted((ROOT / "scenarios").glob("*.toml")),
    ]:
        unknown = set(KEY.findall(path.read_text(encoding="utf-8"))) - set(KEYS)
        assert not unknown, f"{path.relative_to(ROOT)}: {unknown}"
