"""`bristle schema`: every file that comes with the library agrees with it, and mistakes do not."""

import json
import tomllib
from importlib.resources import files
from pathlib import Path

import jsonschema
import pytest

SHIPPED = Path(str(files("bristle.scenarios")))
FILES = sorted([*SHIPPED.glob("*.toml"), *SHIPPED.glob("hidden/*/*.toml")])


@pytest.fixture
def schema(call):
    def give(kind):
        code, out, _ = call("schema", kind)
        assert code == 0
        found = json.loads(out)
        jsonschema.Draft202012Validator.check_schema(found)
        return jsonschema.Draft202012Validator(found)

    return give


def test_files_agree_with_the_schema(schema):
    validators = {kind: schema(kind) for kind in ("scenario", "model")}
    count = dict.fromkeys(validators, 0)
    for path in FILES:
        tree = tomllib.loads(path.read_text(encoding="utf-8"))
        kind = "scenario" if "observer" in tree else "model"
        errors = [error.message for error in validators[kind].iter_errors(tree)]
        assert errors == [], path
        count[kind] += 1
    assert count["scenario"] > 12
    assert count["model"] > 12


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('duration = "20 s"', "duration = 20"),
        ('duration = "20 s"', 'duration = "20s"'),
        ('law = "modified"', 'lawe = "modified"'),
        ('sensor = "encoder"', 'sensor = "eye"'),
        ("max_abs = 2.0", 'max_abs = "much"'),
    ],
)
def test_mistakes_do_not(schema, old, new):
    text = (SHIPPED / "quick.toml").read_text(encoding="utf-8")
    assert old in text
    assert not schema("scenario").is_valid(tomllib.loads(text.replace(old, new)))


def test_an_unknown_kind_is_one_line(call):
    code, _, err = call("schema", "recipe")
    assert code == 2
    assert len(err.strip().splitlines()) == 1
