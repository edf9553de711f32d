"""The compiler, and all that it starts, end with the process that runs it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bristle.common.errors import BristleError
from bristle.model import compiler
from bristle.model.compiler import compile_shared, find_compiler

pytestmark = pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="looks for processes in /proc")

COMPILE = """
import signal, sys
from pathlib import Path
from bristle.model.compiler import compile_shared
signal.signal(signal.SIGTERM, lambda *_: sys.exit(3))
compile_shared({"f.c": "int f(void);"}, Path("f.so"))
"""


@pytest.fixture
def endless(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A compiler that starts a process, and neither ends."""
    path = tmp_path / "endless"
    path.write_text(f"#!/bin/sh\ntail -f {path} >/dev/null &\nwait\n")
    path.chmod(0o755)
    monkeypatch.setenv("CC", str(path))
    monkeypatch.setenv("BRISTLE_CACHE", str(tmp_path / "cache"))
    for known in (find_compiler, compiler.compiler_identity):
        known.cache_clear()
    yield path
    for known in (find_compiler, compiler.compiler_identity):
        known.cache_clear()


def running(path: Path) -> list[str]:
    found = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = entry.read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        if str(path) in line:
            found.append(line)
    return found


def wait_until(condition: Callable[[], bool]) -> None:
    until = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.01)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGKILL, -signal.SIGKILL), (signal.SIGTERM, 3)])
def test_a_compiler_ends_with_us(endless: Path, tmp_path: Path, number: int, code: int) -> None:
    process = subprocess.Popen([sys.executable, "-c", COMPILE], cwd=tmp_path)
    wait_until(lambda: any(line.startswith("tail") for line in running(endless)))
    process.send_signal(number)
    assert process.wait(20) == code
    wait_until(lambda: not running(endless))


def test_a_compiler_that_takes_too_long_is_ended(endless: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiler, "TIMEOUT", 0.5)
    with pytest.raises(BristleError, match=r"did not end within 0\.5 s"):
        compile_shared({"f.c": "int f(void);"}, tmp_path / "f.so")
    wait_until(lambda: not running(endless))
    assert not list(tmp_path.glob("f.so*"))


def test_no_descriptor_stays_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BRISTLE_CACHE", str(tmp_path / "cache"))
    compile_shared({"f.c": "int f(void);\n"}, tmp_path / "first.so")
    before = len(os.listdir("/proc/self/fd"))
    compile_shared({"f.c": "int g(void);\n"}, tmp_path / "second.so")
    assert len(os.listdir("/proc/self/fd")) == before
