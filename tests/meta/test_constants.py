"""A constant has a name of its own: no two modules define the same name with different values. Each
number of the diagnosis has a line that says where it comes from.

The friction laws and effects in plant/ and the observers are files that stand alone by design; they
are left out.
"""

import ast
import re
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("common", "model", "fmus", "harness", "records", "diagnosis", "cli")
CALIBRATION = (ROOT / "docs" / "calibration.md").read_text(encoding="utf-8")
JUDGED = "## Other constants of the diagnosis"  # heading of the table of all without a calibration
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


def is_number(value):
    """Return whether an expression is a number, or several: it has one, and no text or object."""
    parts = list(ast.walk(ast.parse(value, mode="eval")))
    numbers = [each.value for each in parts if isinstance(each, ast.Constant)]
    made = [each.func.id for each in parts if getattr(getattr(each, "func", None), "id", "")]
    return (
        any(type(each) in (int, float) for each in numbers)
        and not any(isinstance(each, str) for each in numbers)
        and not any(name[0].isupper() for name in made)
    )


def rows(text):
    """Return the cells of the rows of all tables that name a constant in the first one."""
    cells = (re.split(r"(?<!\\)\|", line)[1:-1] for line in text.splitlines() if line[:1] == "|")
    return [[cell.strip() for cell in row] for row in cells if re.search(r"[A-Z]{3}", row[0])]


def numbers_of_the_diagnosis():
    """Return the constants of diagnosis/ that are numbers: name and expression."""
    return {
        name.lstrip("_"): value
        for path in sorted((ROOT / "diagnosis").rglob("*.py"))
        for name, value in constants(path).items()
        if is_number(value)
    }


def test_every_number_of_the_diagnosis_has_a_line_on_its_origin():
    """Of a constant that was calibrated, or follows from something: what was found; of any other,
    that it was judged.
    """
    numbers = numbers_of_the_diagnosis()
    assert len(numbers) > 100
    before, _, rest = CALIBRATION.partition(JUDGED)
    judged, _, after = rest.partition("\n## ")
    told = {
        name for row in rows(before + after) for name in re.findall(r"[A-Z][A-Z0-9_]{2,}", row[0])
    }
    expected = {name: f"`{value}`" for name, value in numbers.items() if name not in told}
    listed = {row[0].strip("`"): row[1] for row in rows(judged)}
    lines = [f"| `{name}` | {expected[name]} |" for name in sorted(expected)]
    missing = [line for line in lines if line.split("`")[1] not in listed]
    assert not missing, "no line in docs/calibration.md of:\n" + "\n".join(missing)
    assert listed == expected, "docs/calibration.md has old lines"
    assert all(row[2] for row in rows(judged))
