"""A command that is killed at any change of a file leaves the old result or the new one, and the
next one works.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bristle.common.output import check_writable
from bristle.common.work import OLD
from bristle.model.compiler import find_compiler

HERE = Path(__file__).parent
HIDDEN = HERE.parents[1] / "scenarios" / "hidden" / "07"
# keys of results that no two calls have in common
OF_THE_CALL = {"wall_s", "seconds", "date", "command", "times_s", "timing"}
RUN = ["run", "case.toml", "--out", "out"]
DIAGNOSE = ["diagnose", "model.toml", "--data", "a.npz", "--jobs", "1", "--out", "out"]
BUILD = ["build", "controller", "--out", "out"]

pytestmark = [
    pytest.mark.skipif(
        sys.platform != "linux", reason="puts functions in the place of those of the C library"
    ),
    pytest.mark.slow,
]


class Commands:
    """Commands in forks of one process."""

    def __init__(self, library: Path) -> None:
        environment = {**os.environ, "LD_PRELOAD": str(library)}
        command = [sys.executable, str(HERE / "crashes.py")]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, text=True
        )

    def __call__(
        self, arguments: Sequence[str], place: Path, point: int = -1, here: bool = False
    ) -> dict[str, Any]:
        """Return exit code and number of changes of a command in a folder; it is killed instead of
        its change `point`.
        """
        pipes = self._process
        assert pipes.stdin is not None
        assert pipes.stdout is not None
        (place / "tmp").mkdir(exist_ok=True)
        env = {"TMPDIR": str(place / "tmp")}
        if arguments == BUILD:
            env["BRISTLE_CACHE"] = str(place / "cache")
        job = {"arguments": arguments, "cwd": str(place), "env": env, "point": point, "here": here}
        print(json.dumps(job), file=pipes.stdin, flush=True)
        answer: dict[str, Any] = json.loads(pipes.stdout.readline())
        return answer

    def end(self) -> None:
        self._process.communicate()


@pytest.fixture(scope="module")
def commands(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Commands]:
    folder = tmp_path_factory.mktemp("crash")
    subprocess.run(
        [*find_compiler(), "-shared", "-fPIC", "-o", folder / "crash.so", HERE / "crash.c", "-ldl"],
        check=True,
    )
    made = Commands(folder / "crash.so")
    yield made
    made.end()


@pytest.fixture
def inputs(tmp_path: Path, case: Path) -> Path:
    """A folder with a scenario, a model and a record."""
    shutil.copy(HIDDEN / "model.toml", tmp_path)
    with np.load(HIDDEN / "a.npz") as record:
        np.savez(tmp_path / "a.npz", **{name: values[:4000] for name, values in record.items()})
    return case.parent


def without(tree: Any) -> Any:
    """Return the content of a JSON file without what no two calls have in common."""
    if isinstance(tree, dict):
        return {key: without(value) for key, value in tree.items() if key not in OF_THE_CALL}
    return [without(each) for each in tree] if isinstance(tree, list) else tree


def content(folder: Path) -> dict[str, Any]:
    """Return what is in a result folder, as far as two calls have it in common; each file must be
    complete.
    """
    found: dict[str, Any] = {}
    for path in sorted(
        each for each in folder.rglob("*") if each.is_file() and ".bristle-" not in str(each)
    ):
        data = path.read_bytes()
        if path.suffix == ".json":
            found[path.relative_to(folder).as_posix()] = without(json.loads(data))
        elif path.suffix == ".html":
            found[path.relative_to(folder).as_posix()] = data.rstrip().endswith(b"</html>")
        else:
            found[path.relative_to(folder).as_posix()] = data
    return found


def age(folder: Path) -> None:
    """Let all that is left of work in progress be two days old."""
    for path in folder.rglob(".bristle-*"):
        os.utime(path, (time.time() - 2 * OLD,) * 2)


def left(folder: Path) -> list[Path]:
    """Return what is left of work in progress."""
    return list(folder.rglob(".bristle-*"))


def prepared(inputs: Path, old: Path | None) -> Path:
    """Return a new folder with the inputs, and with the old result as `out`."""
    (place := inputs / "place").mkdir()
    for file in (each for each in inputs.iterdir() if each.is_file()):
        shutil.copy(file, place)
    if old is not None:
        shutil.copytree(old, place / "out")
    return place


def crash(
    commands: Commands, arguments: Sequence[str], inputs: Path, old: Path | None, number: int
) -> set[bool]:
    """Kill a command at so many of its changes, from the first to the last; return whether the new
    result was found afterwards.
    """
    place = prepared(inputs, old)
    whole = commands(arguments, place)
    assert whole["code"] == 0
    before, after = content(old) if old else {}, content(place / "out")
    assert before != after
    shutil.rmtree(place)
    seen, unreached = set(), 0
    for point in sorted(
        {int(point) for point in np.linspace(0, whole["seen"] - 1, min(number, whole["seen"]))}
    ):
        place = prepared(inputs, old)
        code = commands(arguments, place, point)["code"]
        if code == 0:  # a thread of it made fewer changes than before
            unreached += 1
        else:
            assert code == -signal.SIGKILL, point
        check_writable(place / "out")  # as the next command begins
        found = content(place / "out")
        assert found in (before, after), point
        seen.add(found == after)
        age(place)
        assert commands(arguments, place)["code"] == 0, point
        assert content(place / "out") == after, point
        assert not left(place), point
        shutil.rmtree(place)
    assert unreached <= 1
    return seen


NUMBER = pytest.mark.parametrize("number", [8, 60])


@NUMBER
def test_run(commands: Commands, inputs: Path, number: int) -> None:
    assert commands([*RUN, "--seed", "2"], inputs, here=True)["code"] == 0
    assert crash(commands, RUN, inputs, (inputs / "out").rename(inputs / "old"), number) == {
        False,
        True,
    }


@NUMBER
def test_diagnose(commands: Commands, inputs: Path, number: int) -> None:
    assert commands(DIAGNOSE, inputs, here=True)["code"] == 0
    (old := inputs / "old").mkdir()
    for name in ("diagnosis.json", "augmented.toml", "augmented.fmu"):
        (old / name).write_text('"old"')
    assert crash(commands, DIAGNOSE, inputs, old, number) == {False, True}


@pytest.mark.parametrize("number", [3, 8])
def test_build_into_an_empty_cache(commands: Commands, inputs: Path, number: int) -> None:
    assert crash(commands, BUILD, inputs, None, number) == {False, True}
