"""The C compiler: the machine's own, or zig from the extra `cross`."""

from __future__ import annotations

import importlib.util
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache, partial
from pathlib import Path

from bristle.common.cache import cache_folder, cached, digest
from bristle.common.errors import BristleError

# No fused multiply-add: all platforms and the generated Python then give the same digits.
# No check of array bounds: loops run to the number of states of a variant, which -O3 wrongly suspects to exceed the arrays.
FLAGS = (
    "-std=c99", "-O3", "-fPIC", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden",
    "-Wall", "-Wextra", "-Werror", "-Wno-array-bounds",
)  # fmt: skip
INCLUDE = re.compile(r'^[ \t]*#[ \t]*include[ \t]+"([^"]+)"', re.MULTILINE)
TIMEOUT = 600  # s, of one compilation; the first one with zig takes a minute
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")


@lru_cache(maxsize=1)
def find_compiler() -> tuple[str, ...]:
    """Return the command of a C compiler: $CC, cc, gcc, clang or zig.

    Raises
    ------
    BristleError
        If none is found.
    """
    if given := os.environ.get("CC"):
        command = shlex.split(given)
        if shutil.which(command[0]) is None:
            raise BristleError(f"CC={given}: no such program; unset CC or name a C compiler")
        return tuple(command)
    for name in ("cc", "gcc", "clang"):
        if path := shutil.which(name):
            return (path,)
    if importlib.util.find_spec("ziglang"):
        machine = {"AMD64": "x86_64", "arm64": "aarch64"}.get(platform.machine(), platform.machine())
        system = {"win32": "windows-gnu", "darwin": "macos"}.get(sys.platform, "linux-gnu.2.17")
        return (sys.executable, "-m", "ziglang", "cc", "-target", f"{machine}-{system}")
    raise BristleError("no C compiler found (cc, gcc, clang); install one, or run: pip install 'bristle[cross]'")


@lru_cache(maxsize=1)
def compiler_identity() -> str:
    """Return what identifies a compiler: the command, and version or size and date of the program behind it."""
    command = find_compiler()
    if "ziglang" in command:
        from importlib.metadata import version

        return f"{command} {version('ziglang')}"
    status = os.stat(shutil.which(command[0]) or command[0])
    return f"{command} {status.st_size} {status.st_mtime_ns}"


def _environment(folder: Path) -> dict[str, str]:
    """Return the environment of a compilation: zig keeps its cache in the cache folder and needs no home directory."""
    zig = {f"ZIG_{which}_CACHE_DIR": str(cache_folder() / "zig") for which in ("GLOBAL", "LOCAL")}
    return zig | os.environ | {"TMPDIR": str(folder.resolve())}


def _included(text: str, sources: Mapping[str, str], found: dict[str, str]) -> dict[str, str]:
    """Return those of the sources that a text includes, directly or through others; they are added to `found`."""
    for name in INCLUDE.findall(text):
        if name in sources and name not in found:
            found[name] = sources[name]
            _included(sources[name], sources, found)
    return found


def _compiler(arguments: Sequence[str], folder: Path) -> None:
    """Run the compiler in a folder; raise `BristleError` if it fails."""
    name = "zig" if "ziglang" in find_compiler() else find_compiler()[0]
    command = [*find_compiler(), *arguments]
    try:
        done = subprocess.run(
            command, cwd=folder, env=_environment(folder), capture_output=True, text=True, check=False, timeout=TIMEOUT
        )
    except subprocess.TimeoutExpired:
        raise BristleError(f"C compiler {name} did not end within {TIMEOUT} s; check the compiler or set CC") from None
    if done.returncode != 0:
        complaint = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr.strip() or "no message")
        raise BristleError(f"C compiler {name} failed: {complaint.strip()}; check the compiler or set CC")


@contextmanager
def _building(out: Path) -> Iterator[Path]:
    """Give a folder to compile in, of its own beside `out`; what is `result` there at the end becomes `out`."""
    folder = out.with_name(out.name + ".build")
    folder.mkdir()
    try:
        yield folder
        os.replace(folder / "result", out)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _compile_unit(unit: str, files: Mapping[str, str], out: Path) -> None:
    with _building(out) as folder:
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8", newline="\n")
        _compiler([*FLAGS, "-I.", "-c", unit, "-o", "result"], folder)


def compile_shared(sources: Mapping[str, str], out: Path) -> None:
    """Compile C sources (file name -> text) into the shared library `out`.

    A unit is compiled once and kept in the cache by the text of all that it includes: the FMUs of both versions and the program
    in this process share the equations, which take nearly all the time. Each run of the compiler is in a folder of its own with
    relative names only, so that the result does not depend on where it is.

    Raises
    ------
    BristleError
        If the compiler fails; the first line of its error output is in the message.
    """
    with _building(out) as folder:
        objects = []
        for unit in sorted(file for file in sources if file.endswith(".c")):
            files = {unit: sources[unit]} | _included(sources[unit], sources, {})
            key = digest(*FLAGS, compiler_identity(), *(text for file in sorted(files.items()) for text in file))
            made = cached(f"{Path(unit).stem}-{key[:24]}.o", partial(_compile_unit, unit, files))
            objects.append(f"{Path(unit).stem}.o")
            shutil.copyfile(made, folder / objects[-1])
        elf = [] if sys.platform in ("win32", "darwin") else ["-Wl,--build-id=none", "-lm"]
        _compiler(["-shared", "-s", *objects, *elf, "-o", "result"], folder)
