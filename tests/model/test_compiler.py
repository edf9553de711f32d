"""The compiler, and all that it starts, end with the process that runs it."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from bristle.common.errors import BristleError
from bristle.model import compiler
from bristle.model.compiler import compile_shared, find_compiler

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/cmdline").exists(), reason="looks for processes in /proc"
)

SHOWN = '__attribute__((visibility("default")))'  # nothing else is
COMPILE = """
import signal, sys
from pathlib import Path
from bristle.model.compiler import compile_shared
signal.signal(signal.SIGTERM, lambda *_: sys.exit(3))
compile_shared({"f.c": "int f(void);", "g.c": "int g(void);", "h.c": "int h(void);"}, Path("f.so"))
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


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGKILL, -signal.SIGKILL), (signal.SIGTERM, 3)]
)
def test_a_compiler_ends_with_us(endless: Path, tmp_path: Path, number: int, code: int) -> None:
    process = subprocess.Popen([sys.executable, "-c", COMPILE], cwd=tmp_path)
    wait_until(lambda: any(line.startswith("tail") for line in running(endless)))
    process.send_signal(number)
    assert process.wait(20) == code
    wait_until(lambda: not running(endless))


# the signal comes when one compiler runs and the next is not submitted yet, or is and begins later
INTERRUPTED = """
import sys, time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from bristle.model import compiler
class Pool(ThreadPoolExecutor):
    def submit(self, *args):
        if self._threads:
            while not compiler._watched:
                time.sleep(0.01)
            if len(sys.argv) > 1:
                super().submit(*args)
            sys.exit(3)
        return super().submit(*args)
def slowly(sources, target, unit, made=compiler._made):
    time.sleep(0.5 * (unit == "g.c"))
    return made(sources, target, unit)
compiler.ThreadPoolExecutor, compiler._made = Pool, slowly
compiler.compile_shared({"f.c": "int f(void);", "g.c": "int g(void);"}, Path("f.so"))
"""


@pytest.mark.parametrize("more", [(), ("also",)], ids=["not submitted", "submitted"])
def test_a_signal_between_two_compilers_ends_what_runs(
    endless: Path, tmp_path: Path, more: tuple[str, ...]
) -> None:
    process = subprocess.Popen([sys.executable, "-c", INTERRUPTED, *more], cwd=tmp_path)
    try:
        assert process.wait(20) == 3
    finally:
        process.kill()
    wait_until(lambda: not running(endless))


def test_a_compiler_that_takes_too_long_is_ended(
    endless: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler, "TIMEOUT", 0.5)
    with pytest.raises(BristleError, match=r"did not end within 0\.5 s"):
        compile_shared({"f.c": "int f(void);"}, tmp_path / "f.so")
    wait_until(lambda: not running(endless))
    assert not list(tmp_path.glob("f.so*"))


def test_units_are_compiled_side_by_side_and_the_first_error_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of two compilers waits for the other: one after the other would never end."""
    compilers, real = tmp_path / "both", find_compiler()[0]
    wait = f"while [ $(ls {tmp_path}/begun.* | wc -l) -lt 2 ]; do sleep 0.05; done"
    compilers.write_text(
        f'#!/bin/sh\ncase "$*" in *-shared*) ;; *) touch {tmp_path}/begun.$$; {wait} ;; esac\nexec'
        f' {real} "$@"\n'
    )
    compilers.chmod(0o755)
    monkeypatch.setenv("BRISTLE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(compiler.os, "cpu_count", lambda: 2)
    with compiler.compiled_with(compiler.Toolchain("both", (str(compilers),))):
        compile_shared(
            {"f.c": "int f(void) { return 1; }\n", "g.c": f"{SHOWN} int g(void) {{ return 2; }}\n"},
            tmp_path / "both.so",
        )
        assert ctypes.CDLL(str(tmp_path / "both.so")).g() == 2
        with pytest.raises(BristleError, match="missing"):
            compile_shared(
                {"f.c": "int f(void) { return missing; }\n", "g.c": "int g(void) { return 3; }\n"},
                tmp_path / "no.so",
            )
    assert not list(tmp_path.glob("no.so*"))


def test_no_descriptor_stays_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BRISTLE_CACHE", str(tmp_path / "cache"))
    compile_shared({"f.c": "int f(void);\n"}, tmp_path / "first.so")
    before = len(os.listdir("/proc/self/fd"))
    compile_shared({"f.c": "int g(void);\n"}, tmp_path / "second.so")
    assert len(os.listdir("/proc/self/fd")) == before


def test_a_compiler_that_is_done_ends_no_other(tmp_path: Path) -> None:
    """A descriptor that is closed may be the next one's, in another thread."""
    done, pipe = compiler._pipe()
    number = pipe.fileno()
    compiler._end(pipe)
    os.close(done)
    other_done, other = compiler._pipe()
    assert other.fileno() in (number, done)
    compiler._end(pipe)
    os.fstat(other.fileno())
    compiler._end(other)
    os.close(other_done)
    with ThreadPoolExecutor(8) as pool:
        codes = list(
            pool.map(
                lambda k: compiler._run(["sleep", "0.05" if k % 4 else "0.3"], tmp_path).returncode,
                range(200),
            )
        )
    assert codes == [0] * 200


def test_what_has_not_begun_is_left_out_after_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler.os, "cpu_count", lambda: 1)
    begun: list[str] = []

    def make(unit: str) -> Path:
        begun.append(unit)
        if unit == "0":
            raise BristleError("wrong")
        time.sleep(0.2)
        return tmp_path

    with pytest.raises(BristleError, match="wrong"):
        compiler._each_of(make, [str(k) for k in range(20)])
    assert len(begun) < 4


def test_an_interrupt_ends_a_compiler_that_is_about_to_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler.os, "cpu_count", lambda: 2)
    ended: list[int] = []
    begun = threading.Event()

    def make(unit: str) -> Path:
        if unit == "interrupted":
            begun.wait()
            raise SystemExit
        begun.set()
        time.sleep(0.3)
        ended.append(compiler._run(["sleep", "60"], tmp_path).returncode)
        return tmp_path

    with pytest.raises(SystemExit):
        compiler._each_of(make, ["interrupted", "late"])
    assert len(ended) == 1
    assert ended[0] != 0
