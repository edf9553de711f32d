"""Ctrl-C at any time is one line and exit code 2, from the first import of a command to its end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

INTERRUPTED_AT = """
import os, signal, sys

class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == module:
            os.kill(os.getpid(), number)

module, number = sys.argv[1], int(sys.argv[2])
sys.argv = ["bristle", *sys.argv[3:]]
sys.meta_path.insert(0, Interrupting())
import bristle.cli.main
bristle.cli.main.main()
"""
COMMANDS = {
    "list": ["list"],
    "build": ["build", "controller", "--out", "out"],
    "run": ["run", "case.toml", "--out", "out"],
    "test": ["test", "case.toml", "--out", "out"],
    "export": ["export", "case.toml", "--out", "out"],
    "coupling": ["coupling", "case.toml", "--out", "out"],
    "reproduce": ["reproduce", "--out", "out"],
    "schema": ["schema", "scenario"],
    "init": ["init", "a.csv", "--out", "m.toml"],
    "diagnose": ["diagnose", "m.toml", "--data", "a.csv", "--out", "out"],
    "validate": ["validate", "m.toml", "--data", "a.csv", "--out", "out"],
    "diff": ["diff", "a.fmu", "b.fmu", "--json", "x"],
    "check": ["check", "a.fmu", "--json", "x"],
}
FIRST_USED = {
    "schema": "bristle.harness.scenario.scenario",
    "diff": "bristle.fmus.difference",
    "check": "bristle.fmus.conformance",
}

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")


def interrupted(
    folder: Path, module: str, arguments: Sequence[str], number: int = signal.SIGINT
) -> None:
    before = sorted(os.listdir(folder))
    command = [sys.executable, "-c", INTERRUPTED_AT, module, str(int(number)), *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", "bristle: interrupted\n")
    assert sorted(os.listdir(folder)) == before


def test_little_is_imported_before_ctrl_c_is_handled() -> None:
    script = (
        "import sys; before = set(sys.modules); import bristle.cli.main;"
        " print(*sorted(set(sys.modules) - before))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    tops = {
        name
        for name in done.stdout.split()
        if name.partition(".")[0] not in sys.stdlib_module_names
    }
    common = {"bristle.common", "bristle.common.arguments", "bristle.common.errors"}
    assert tops - common == {"bristle", "bristle.cli", "bristle.cli.main"}


@pytest.mark.parametrize("module", ["bristle.cli.commands", "typer", "bristle.cli.commands.check"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_during_the_first_imports(case: Path, tmp_path: Path, module: str, number: int) -> None:
    interrupted(tmp_path, module, COMMANDS["run"], number)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", COMMANDS)
def test_at_the_beginning_of_each_command(case: Path, tmp_path: Path, name: str) -> None:
    interrupted(tmp_path, FIRST_USED.get(name, "numpy"), COMMANDS[name])
