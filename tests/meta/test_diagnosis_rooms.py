"""The rooms of the diagnosis: who may import whom, no circle of files, and sentences in the report
alone.
"""

import ast
import re
from collections import Counter
from pathlib import Path

import pytest

from bristle.diagnosis.answer import Reason
from bristle.diagnosis.report.text.said import SENTENCES, WITH_CONDITIONS

ROOT = Path(__file__).resolve().parents[2] / "diagnosis"
GROUND = {"modelfile", "answer"}
FITS = {"free_parameter", "sliding"}
# room, a folder or a file of `diagnosis/`: the rooms that it may import beside itself; none of them
# imports it back, since each stands below it in this order
MAY_IMPORT = {
    "modelfile": set(),
    "answer": {"modelfile"},
    "free_parameter": set(),
    "sliding": {"free_parameter"},
    "slow": set(),
    "estimation": {*GROUND, *FITS},
    "checks": {*GROUND, *FITS, "estimation"},
    "localisation": {"answer", *FITS, "estimation"},
    "selection": {"answer", *FITS, "checks", "estimation", "localisation"},
    "stages": {*GROUND, *FITS, "checks", "estimation", "localisation", "selection"},
    # side by side: none imports another
    "experiment": {"answer", "checks", "sliding", "estimation", "selection", "stages"},
    "validation": {*GROUND, *FITS, "estimation", "stages"},
    "following": {*GROUND, *FITS, "checks", "estimation", "validation"},
    "init": {*GROUND, *FITS, "checks", "following"},
    "robot": {*GROUND, *FITS, "checks"},
    "between": {*GROUND, *FITS},
    "fmu": {*GROUND, *FITS, "checks", "estimation"},
    # on top: sentences, figures and pages, and the order of the work
    "report": {*GROUND, "slow"},
    "workflow": {
        *GROUND,
        *("checks", "experiment", "selection", "stages", "validation", "following", "fmu"),
        "between",
    },
    "__init__": {*GROUND, "checks", "selection", "slow", "fmu", "robot", "report", "workflow"},
}
MOST_FILES = 9  # of a folder
ERRORS = {"BristleError", "IncompleteError", "RestartError"}
LABELS = {"tell", "Step"}  # calls that name what is under way
FEWEST_WORDS = 4  # of a sentence
# hold messages of errors that are put together before they are raised
MESSAGES = {"modelfile.py", "fmu/model.py", "robot/arm.py"}


def files():
    return sorted(ROOT.rglob("*.py"))


def module_of(path):
    """Return the module of a file, and its room."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts), parts[0]


def imported(path):
    """Return the modules of the diagnosis that a file imports, as `module_of` names them."""
    prefix, found = "bristle.diagnosis.", set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(prefix):
            module = node.module.removeprefix(prefix)
            inner = {f"{module}.{alias.name}" for alias in node.names}
            known = {module_of(each)[0] for each in files()}
            found |= inner & known or {module}
        elif isinstance(node, ast.Import):
            found |= {a.name.removeprefix(prefix) for a in node.names if a.name.startswith(prefix)}
    return found


def test_rooms_are_listed_from_the_ground_up():
    rooms = list(MAY_IMPORT)
    assert {module_of(path)[1] for path in files()} == set(rooms)
    for k, room in enumerate(rooms):
        assert MAY_IMPORT[room] <= set(rooms[:k]), room


@pytest.mark.parametrize("room", list(MAY_IMPORT))
def test_a_room_imports_what_lies_below_it(room):
    for path in files():
        if module_of(path)[1] == room:
            others = {module.split(".")[0] for module in imported(path)} - {room}
            assert others <= MAY_IMPORT[room], f"{path.relative_to(ROOT)}"


def test_no_circle_of_files():
    below = {module_of(path)[0]: imported(path) for path in files()}
    while below:
        leaves = {name for name, others in below.items() if not others & set(below)}
        assert leaves, f"a circle among {sorted(below)}"
        below = {name: others for name, others in below.items() if name not in leaves}


def test_a_folder_holds_few_files():
    counts = Counter(path.parent for path in files() if path.name != "__init__.py")
    assert {str(folder): n for folder, n in counts.items() if n > MOST_FILES} == {}


def said_elsewhere(node):
    """Return the docstrings in the body of a node, or all of a call with an error or a label."""
    if isinstance(node, ast.Call):
        called = getattr(node.func, "id", getattr(node.func, "attr", ""))
        return list(ast.walk(node)) if called in ERRORS | LABELS else []
    body = getattr(node, "body", None)
    lines = [each for each in body if isinstance(each, ast.Expr)] if isinstance(body, list) else []
    return [each.value for each in lines if isinstance(each.value, ast.Constant)]


def texts(tree):
    """Give line and text of each string of a module that is no docstring, no message of an error
    and no label of progress; an f-string as one text.
    """
    skipped = {id(part) for node in ast.walk(tree) for part in said_elsewhere(node)}
    for node in ast.walk(tree):
        if id(node) in skipped:
            continue
        if isinstance(node, ast.JoinedStr):
            skipped |= {id(part) for part in ast.walk(node)}
            parts = [p.value if isinstance(p, ast.Constant) else " X " for p in node.values]
            yield node.lineno, "".join(parts)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value


def is_sentence(text):
    return " " in text and len(re.findall(r"[A-Za-z]{2,}(?=[\s,.;:?]|$)", text)) >= FEWEST_WORDS


def test_sentences_stand_in_the_report_alone():
    for path in files():
        name, room = path.relative_to(ROOT).as_posix(), module_of(path)[1]
        if room == "report" or name in MESSAGES:
            continue
        found = texts(ast.parse(path.read_text(encoding="utf-8")))
        sentences = [f"{name}:{line}: {text}" for line, text in found if is_sentence(text)]
        assert sentences == []


def test_each_reason_has_its_words_once():
    unnamed = {Reason.NO_FUNCTION, Reason.FUNCTION_NO_BETTER, Reason.FUNCTION_TOO_WEAK}
    worded = [*SENTENCES, *WITH_CONDITIONS, *unnamed]
    assert sorted(worded) == sorted(Reason)
