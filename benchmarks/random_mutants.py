"""What the tests notice: random faults in the library, each with the tests that run its line.

pip install coverage
python benchmarks/random_mutants.py 100 --seed 1          # goes on where it was stopped
python benchmarks/random_mutants.py 100 --seed 1 --report > benchmarks/results/mutants.md

A mutant is one change of the code of a room, drawn evenly from all that there are: a comparison, an
operator, a number or a condition changed, a returned value dropped. It is put into a clone of the
last commit under build/mutants, and the test files that ran its line there when all was well (or,
for a line that is run by none, others of its file or folder) run against it: those of a share,
files that run few lines first and slow tests last, and if they pass, all tests of the five files
that run fewest lines, of which what takes longer than five minutes is not known. The clone is made
and its lines are recorded once, with the tests of one share: remove build/mutants to begin with
another commit. Tests that fail without a mutant do not count.
"""

from __future__ import annotations

import argparse
import ast
import copy
import importlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PLACE = ROOT / "build" / "mutants"
TREE, SITE, MAP = PLACE / "tree", PLACE / "site", PLACE / "map.json"
ROOMS = (
    *("model", "plant", "observer", "records", "fmus"),
    *("harness", "diagnosis", "cli", "common"),
)
RECORDED = "BRISTLE_MUTANTS"  # environment variable: the folder that a process records its lines in
# s, of one run of tests: a share takes less, so that one that never ends is caught
LONGEST = {"default": 900, "all": 300}
FIRST_FILES = 5  # run before all others, and with all tests: most mutants end there
NOTHING_RAN, NEVER_ENDS = 5, -1  # exit code of pytest, and in its place
REPLACED: dict[type, tuple[type, ...]] = {
    **{ast.Lt: (ast.LtE, ast.Gt), ast.LtE: (ast.Lt, ast.GtE)},
    **{ast.Gt: (ast.GtE, ast.Lt), ast.GtE: (ast.Gt, ast.LtE)},
    **{ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,)},
    **{ast.In: (ast.NotIn,), ast.NotIn: (ast.In,), ast.And: (ast.Or,), ast.Or: (ast.And,)},
    **{ast.Add: (ast.Sub,), ast.Sub: (ast.Add,), ast.Mult: (ast.Div,), ast.Div: (ast.Mult,)},
    **{ast.FloorDiv: (ast.Mult,), ast.Mod: (ast.Mult,), ast.Pow: (ast.Mult,)},
}


# -- mutants ---------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Mutant:
    """A change of one place of a file: bytes from `start` to `end` become `after`."""

    file: str
    line: int
    start: int
    end: int
    before: str
    after: str


def places(file: Path) -> Iterator[Mutant]:
    """Give all mutants of a file."""
    content = file.read_bytes()
    lengths = [0]
    for line in content.splitlines(keepends=True):
        lengths.append(lengths[-1] + len(line))
    for node in _nodes(ast.parse(content)):
        for old, new in _changes(node):
            start = lengths[old.lineno - 1] + old.col_offset
            end = lengths[old.end_lineno - 1] + old.end_col_offset
            text = ast.unparse(new) if isinstance(new, ast.stmt) else f"({ast.unparse(new)})"
            before = content[start:end].decode()
            yield Mutant(file.relative_to(TREE).as_posix(), old.lineno, start, end, before, text)


def _nodes(node: ast.AST) -> Iterator[Any]:
    """Give the statements and expressions below a node, but for annotations and formatted text."""
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if name in ("annotation", "returns") or not isinstance(child, ast.AST):
                continue
            if isinstance(child, ast.JoinedStr):
                continue
            if isinstance(child, (ast.stmt, ast.expr)):
                yield child
            yield from _nodes(child)


def _changes(node: Any) -> Iterator[tuple[Any, ast.AST]]:
    """Give each change of a node: what is replaced, and by what."""
    match node:
        case ast.Compare(ops=[operator]):
            for other in REPLACED[type(operator)]:
                yield node, _with(node, ops=[other()])
        case ast.BinOp(op=operator) | ast.BoolOp(op=operator):
            for other in REPLACED.get(type(operator), ()):
                yield node, _with(node, op=other())
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield node, operand
        case ast.Constant(value=bool()):
            return
        case ast.Constant(value=int() as number):
            yield node, ast.Constant(number + 1)
        case ast.Constant(value=float() as number):
            yield node, ast.Constant(2 * number or 1.0)
        case ast.Return(value=ast.expr()):
            yield node, ast.Return(ast.Constant(None))
        case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test):
            yield test, ast.UnaryOp(ast.Not(), test)


def _with(node: ast.AST, **fields: Any) -> ast.AST:
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def drawn(number: int, seed: int) -> list[Mutant]:
    """Return so many mutants of all rooms, at random; each seed gives a sequence of its own."""
    files = sorted(file for room in ROOMS for file in (TREE / room).rglob("*.py"))
    every = [mutant for file in files for mutant in places(file)]
    random.Random(seed).shuffle(every)
    return every[:number]


# -- the clone, and which tests run which lines ----------------------------------------------------
def prepare() -> None:
    """Clone the last commit, and make a folder from which the clone imports as bristle."""
    shutil.rmtree(PLACE, ignore_errors=True)
    PLACE.mkdir(parents=True)
    subprocess.run(["git", "clone", "-q", str(ROOT), str(TREE)], check=True)
    settings = tomllib.loads((TREE / "pyproject.toml").read_text(encoding="utf-8"))
    packages = settings["tool"]["setuptools"]["package-dir"]
    shutil.copytree(TREE / "package", SITE / "bristle")
    for package, folder in packages.items():
        if package.count(".") == 1:
            (SITE / "bristle" / package.split(".")[1]).symlink_to(TREE / folder)


def run_tests(
    *arguments: str, longest: float = LONGEST["default"], **environment: str
) -> tuple[int, list[str]]:
    """Run tests in the clone; return pytest's exit code or NEVER_ENDS, and which tests failed."""
    data = os.environ.get("BRISTLE_DATA", str(ROOT.parent / "shared" / "data"))
    own = {
        "PYTHONPATH": str(SITE),
        "BRISTLE_CACHE": str(PLACE / "cache"),
        "BRISTLE_DATA": data,
        "BRISTLE_CFLAGS": "-O1",  # as shares have it, so that both find the same in the cache
    }
    command = [sys.executable, "-m", "pytest", "-q", "--tb=no", "-rfE", *arguments]
    running = subprocess.Popen(
        command,
        cwd=TREE,
        env=os.environ | own | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,  # so that no process of it outlives the time
    )
    try:
        said, _ = running.communicate(timeout=longest)
    except subprocess.TimeoutExpired:
        os.killpg(running.pid, signal.SIGKILL)
        running.communicate()
        return NEVER_ENDS, []
    told = [line.split(" - ")[0].split(maxsplit=1) for line in said.splitlines()]
    return running.returncode, [each[1] for each in told if each[:1] in (["FAILED"], ["ERROR"])]


def record_lines(share: str, processes: str) -> None:
    """Run a share of the tests and write which test files run which lines of the rooms."""
    found = PLACE / "lines"
    found.mkdir()
    path = os.pathsep.join((str(SITE), str(Path(__file__).parent)))
    options = ["-p", Path(__file__).stem, "-n", processes, "--share", share]
    code, failed = run_tests(
        *options, longest=4 * LONGEST["default"], PYTHONPATH=path, **{RECORDED: str(found)}
    )
    if code == NEVER_ENDS:
        sys.exit("the tests do not end without a mutant")
    data = importlib.import_module("coverage").CoverageData(str(found / "all"))
    for part in found.glob("of.*"):
        one = importlib.import_module("coverage").CoverageData(str(part))
        one.read()
        data.update(one)
    lines = {
        Path(file).relative_to(TREE).as_posix(): {
            line: sorted(filter(None, names))
            for line, names in data.contexts_by_lineno(file).items()
        }
        for file in data.measured_files()
    }
    MAP.write_text(json.dumps({"failed": failed, "lines": lines}), encoding="utf-8")


def pytest_configure() -> None:
    """As a plugin of pytest (-p random_mutants): record the lines that each test file runs."""
    global _recording
    if folder := os.environ.get(RECORDED):
        _recording = importlib.import_module("coverage").Coverage(
            data_file=str(Path(folder) / "of"),
            data_suffix=True,
            include=[f"{TREE / room}/*" for room in ROOMS],
            config_file=False,
        )
        _recording.start()


def pytest_runtest_setup(item: Any) -> None:
    if _recording:
        _recording.switch_context(item.nodeid.partition("::")[0])


def pytest_sessionfinish() -> None:
    if _recording:
        _recording.stop()
        _recording.save()


_recording: Any = None


# -- runs ------------------------------------------------------------------------------------------
def tests_of(mutant: Mutant, lines: dict[str, dict[str, list[str]]]) -> list[str]:
    """Return the test files that run the line of a mutant, else those that run its file, else those
    that run others of its folder (what runs in processes of its own is not recorded); first those
    that run fewest lines of all, which are likely to be about it.
    """
    names = set(lines.get(mutant.file, {}).get(str(mutant.line), []))
    for place in (mutant.file, *map(str, Path(mutant.file).parents)):
        if not names:
            names = {
                name
                for file, of_file in lines.items()
                if file.startswith(place)
                for those in of_file.values()
                for name in those
            }
    number = Counter(name for file in lines.values() for each in file.values() for name in each)
    return sorted(names, key=lambda name: (number[name], name))


def judged(mutant: Mutant, known: dict[str, Any], share: str, processes: str) -> dict[str, Any]:
    """Return what catches a mutant: "default", "all", "nothing" or, where all tests take too long,
    "not known"; and the first test that failed.
    """
    file = TREE / mutant.file
    content = file.read_bytes()
    files = tests_of(mutant, known["lines"])
    first, rest = files[:FIRST_FILES], files[FIRST_FILES:]
    options = ["-x", "-n", processes, *(f"--deselect={name}" for name in known["failed"])]
    quick, slow = (["--share", share, "-m", marked] for marked in ("not slow", "slow"))
    runs = [("default", quick, first), ("default", quick, rest), ("default", slow, files)]
    runs += [("all", ["--all"], first)]
    try:
        changed = content[: mutant.start] + mutant.after.encode() + content[mutant.end :]
        file.write_bytes(changed)
        for name, run, those in runs:
            if not those:
                continue
            code, failed = run_tests(*run, *options, *those, longest=LONGEST[name])
            if code == NEVER_ENDS and name == "all":
                return asdict(mutant) | {"caught": "not known", "by": []}
            if code not in (0, NOTHING_RAN):
                return asdict(mutant) | {"caught": name, "by": failed[:1]}
    finally:
        file.write_bytes(content)
    return asdict(mutant) | {"caught": "nothing", "by": []}


def report(results: list[dict[str, Any]]) -> str:
    """Return the table of the results, and what was not caught."""
    rows = Counter((each["file"].split("/")[0], each["caught"]) for each in results)
    lines = ["# Random faults that the tests notice", "", __doc__.split("\n\n")[2].strip(), ""]
    lines += [
        "| room | mutants | caught by a share | or by all tests of five files | not known |",
        "|---|---|---|---|---|",
    ]
    every = ("default", "all", "nothing", "not known")
    for room in (*ROOMS, "all"):
        numbers = [
            sum(count for (r, c), count in rows.items() if room in (r, "all") and c in caught)
            for caught in (every, ("default",), ("default", "all"), ("not known",))
        ]
        lines.append(f"| {room} | {' | '.join(map(str, numbers))} |")
    lines += ["", "Not caught by the share, and whether by all tests of five files:", ""]
    lines += [
        f"- {each['file']}:{each['line']}: `{' '.join(each['before'].split())}` -> "
        f"`{each['after']}` ({each['caught']})"
        for each in results
        if each["caught"] != "default"
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("number", type=int, help="how many mutants")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-n", dest="processes", default="auto", help="processes of pytest")
    parser.add_argument("--report", action="store_true", help="print the results that there are")
    given = parser.parse_args()
    state, share = PLACE / f"seed{given.seed}.jsonl", f"mutants{given.seed}"
    done = []
    if state.exists():
        done = [json.loads(line) for line in state.read_text(encoding="utf-8").splitlines()]
    if given.report:
        print(report(done))
        return
    if not MAP.exists():
        prepare()
        record_lines(share, given.processes)
    known = json.loads(MAP.read_text(encoding="utf-8"))
    for mutant in drawn(given.number, given.seed)[len(done) :]:
        result = judged(mutant, known, share, given.processes)
        with state.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(result) + "\n")
        print(f"{result['file']}:{result['line']} {result['caught']} {result['by']}", flush=True)


if __name__ == "__main__":
    main()
