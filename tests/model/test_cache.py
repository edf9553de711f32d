"""The cache of compiled files: what is damaged, half-written or left over is made again, and never
used.
"""

import ctypes
import os
import subprocess
import sys
import time

import pytest

from bristle.common import cache, work
from bristle.common.cache import cached
from bristle.common.work import OLD
from bristle.model.compiler import SUFFIX, compile_shared


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("BRISTLE_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def maker(made, content=b"as it was made" * 1000):
    def make(out):
        made.append(out)
        out.write_bytes(content)

    return make


DAMAGE = {
    "empty": lambda data: b"",
    "cut": lambda data: data[: len(data) // 2],
    "longer": lambda data: data + b"x",
    "four bytes": lambda data: data[:500] + bytes(b ^ 0xFF for b in data[500:504]) + data[504:],
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_file_is_made_again(folder, damage):
    made = []
    path = cached("thing", maker(made))
    assert cached("thing", maker(made)) == path
    assert len(made) == 1
    good = path.read_bytes()
    path.write_bytes(DAMAGE[damage](good))
    os.utime(path, ns=(1, 1))
    cache._seen.clear()  # as another process sees it
    assert cached("thing", maker(made)).read_bytes() == good
    assert len(made) == 2


@pytest.mark.parametrize("sums", [None, b"", b"0" * 64, b"\xff\xfe"])
def test_a_file_without_its_hash_is_made_again(folder, sums):
    made = []
    cached("thing", maker(made))
    place = folder / ".sums" / "thing"
    place.unlink() if sums is None else place.write_bytes(sums)
    cache._seen.clear()
    cached("thing", maker(made))
    assert len(made) == 2


def test_what_fails_leaves_nothing_and_what_was_left_is_swept_when_it_is_old(folder):
    def fails(out):
        out.write_bytes(b"half")
        raise OSError(28, "No space left on device", str(out))

    with pytest.raises(ValueError, match="No space left"):
        cached("thing", fails)
    assert not list(folder.glob("thing"))
    for name, age in ((".bristle-old00000", 2 * OLD), (".bristle-new00000", 0.0)):
        (folder / name).mkdir()
        os.utime(folder / name, (time.time() - age,) * 2)
    work._swept.clear()  # as another process begins
    cached("thing", maker([]))
    assert [path.name for path in folder.glob(".bristle-*")] == [".bristle-new00000"]


def test_a_library_that_was_cut_does_not_kill_the_next_process(folder, tmp_path):
    """Without the comparison, loading or calling it ends the process: bus error, or file too
    short.
    """
    source = {
        "f.c": '__attribute__((visibility("default"))) double f(double x) { return 2 * x; }\n'
    }
    name = f"f{SUFFIX}"

    def make(out):
        compile_shared(source, out)

    path = cached(name, make)
    path.write_bytes(path.read_bytes()[:3000])
    code = (
        "import ctypes\nfrom bristle.common.cache import cached\nfrom bristle.model.compiler"
        f" import compile_shared\nlibrary = ctypes.CDLL(str(cached({name!r}, lambda out:"
        f" compile_shared({source!r}, out))))\nlibrary.f.restype, library.f.argtypes ="
        " ctypes.c_double, [ctypes.c_double]\nprint(library.f(21.0))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "42.0"), done.stderr
    assert ctypes.CDLL(str(path)) is not None
