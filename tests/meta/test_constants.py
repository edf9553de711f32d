"""A constant has a name of its own: no two modules define the same name with different values.

The friction laws and effects in plant/ and the observers are files that stand alone by design; they
are left out.
"""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("common", "model", "fmus", "harness", "records", "diagnosis", "cli")
LARGEST_FOLDER = 9  # modules of a folder of diagnosis/, besides __init__


def constants(path):
    """Return {name: expression} of the constants in capitals that a module defines; a name for
    another name is none.
    """
    found = {}
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        pairs = []
        if isinstance(node, ast.Assign):
            for target in node.targets:
                if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                    pairs += zip(target.elts, node.value.elts, strict=True)
                elif isinstance(target, ast.Tuple):
                    pairs += [(each, node.value) for each in target.elts]
                else:
                    pairs.append((target, node.value))
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            pairs.append((node.target, node.value))
        for target, value in pairs:
            alias = isinstance(value, (ast.Name, ast.Attribute))
            if (
                isinstance(target, ast.Name)
                and target.id.lstrip("_").isupper()
                and len(target.id) > 2
                and not alias
            ):
                found[target.id] = ast.unparse(value)
    return found


def test_no_constant_has_two_meanings():
    places = defaultdict(dict)
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            for name, value in constants(path).items():
                places[name][path.relative_to(ROOT).as_posix()] = value
    assert len(places) > 100
    twice = {name: where for name, where in places.items() if len(set(where.values())) > 1}
    assert not twice, "\n".join(f"{name}: {where}" for name, where in sorted(twice.items()))


def test_the_diagnosis_has_small_folders():
    folders = [path.parent for path in (ROOT / "diagnosis").rglob("__init__.py")]
    assert len(folders) >= 6
    for folder in folders:
        modules = [path for path in folder.glob("*.py") if path.stem != "__init__"]
        assert len(modules) <= LARGEST_FOLDER, f"{folder.relative_to(ROOT)}: {len(modules)} modules"
