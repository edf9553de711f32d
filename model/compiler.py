"""The C compiler: the machine's own, or zig of the extra `cross`, also for other platforms."""

from __future__ import annotations

import importlib.util
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from io import FileIO
from pathlib import Path
from threading import Event, Lock

from bristle.common.cache import cache_folder, cached, digest
from bristle.common.errors import BristleError

# No fused multiply-add: all platforms and the generated Python then give the same digits. No check
# of array bounds: loops run to the number of states of a variant, which -O3 wrongly suspects to
# exceed the arrays.
FLAGS = (
    "-std=c99",
    "-O3",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fvisibility=hidden",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-Wno-array-bounds",
)
INCLUDE = re.compile(r'^[ \t]*#[ \t]*include[ \t]+"([^"]+)"', re.MULTILINE)
# environment variable: flags behind these for this machine's own libraries; -O1 compiles in half
# the time and gives the same digits
FLAGS_VARIABLE = "BRISTLE_CFLAGS"
TIMEOUT = 600  # s, of one compilation; the first one with zig takes a minute
ENDING_INTERVAL = 0.01  # s, in which compilers that an interrupt must end are looked for
# Shell: become the command, beside a process that ends the group of both when the standard input
# ends, with whoever holds it.
WATCHED = 'exec 3<&0 </dev/null; { read -r _ <&3; kill -KILL 0; } >/dev/null 2>&1 & exec "$@" 3<&-'


@dataclass(frozen=True)
class Target:
    """What a library is compiled for.

    Attributes
    ----------
    system : str
        As in `sys.platform`: linux, win32 or darwin.
    triple : str
        Name of the platform for zig; empty for this machine, which its own compiler compiles for.
    options : tuple of str
        Flags behind `FLAGS`.
    """

    system: str = sys.platform
    triple: str = ""
    options: tuple[str, ...] = ()

    @property
    def suffix(self) -> str:
        """Suffix of a shared library."""
        return {"win32": ".dll", "darwin": ".dylib"}.get(self.system, ".so")

    def flags(self) -> tuple[str, ...]:
        """Return the flags of a compilation; code for Windows is always position-independent."""
        return (
            (*FLAGS, *self.options) if self.system == "win32" else (*FLAGS, "-fPIC", *self.options)
        )

    def link_flags(self, name: str) -> tuple[str, ...]:
        """Return the flags that link a library of this name; nothing in it may depend on when or
        where that was.
        """
        if self.system == "darwin":
            return (f"-Wl,-install_name,@rpath/{name}{self.suffix}",)
        return () if self.system == "win32" else ("-Wl,--build-id=none", "-lm")


HOST = Target()
SUFFIX = HOST.suffix


@dataclass(frozen=True)
class Toolchain:
    """Another compiler, or other flags, than those that this machine's libraries are made with.

    Attributes
    ----------
    name : str
        How it is called in results.
    command : tuple of str
        Command of the compiler; empty: the one that `find_compiler` finds.
    flags : tuple of str
        Flags behind `FLAGS`, which they take precedence over.
    """

    name: str = ""
    command: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()


_watched: set[FileIO] = set()  # pipes of the compilers that run; each ends with its pipe
_toolchains: list[Toolchain] = []  # the last one is in use


@contextmanager
def compiled_with(toolchain: Toolchain) -> Iterator[None]:
    """Compile for this machine with a toolchain inside the context; it is part of the name of all
    that is cached.
    """
    _toolchains.append(toolchain)
    _forget()
    try:
        yield
    finally:
        _toolchains.pop()
        _forget()


def _forget() -> None:
    find_compiler.cache_clear()
    compiler_identity.cache_clear()


def _toolchain(triple: str) -> Toolchain:
    """Return what this machine's libraries are compiled with: nothing else for those of others."""
    if triple:
        return Toolchain()
    given = tuple(shlex.split(os.environ.get(FLAGS_VARIABLE, "")))
    return _toolchains[-1] if _toolchains else Toolchain(flags=given)


@lru_cache
def find_compiler(triple: str = "") -> tuple[str, ...]:
    """Return the command of a C compiler: $CC, cc, gcc, clang or zig; for a `triple`, that of
    another platform, zig.

    Raises
    ------
    BristleError
        If none is found.
    """
    if command := _toolchain(triple).command:
        return command
    zig = importlib.util.find_spec("ziglang") is not None
    if triple and not zig:
        raise BristleError(
            "other platforms need the compiler zig; run: pip install 'bristle[cross]'"
        )
    if triple:
        return (sys.executable, "-m", "ziglang", "cc", "-target", triple)
    if given := os.environ.get("CC"):
        command = tuple(shlex.split(given))
        if shutil.which(command[0]) is None:
            raise BristleError(f"CC={given}: no such program; unset CC or name a C compiler")
        return command
    for name in ("cc", "gcc", "clang"):
        if path := shutil.which(name):
            return (path,)
    if zig:
        return _zig()
    raise BristleError(
        "no C compiler found (cc, gcc, clang); install one, or run: pip install 'bristle[cross]'"
    )


def _zig() -> tuple[str, ...]:
    """Return the command of zig as the compiler of this machine."""
    machine = {"AMD64": "x86_64", "arm64": "aarch64"}.get(platform.machine(), platform.machine())
    system = {"win32": "windows-gnu", "darwin": "macos"}.get(sys.platform, "linux-gnu.2.17")
    return (sys.executable, "-m", "ziglang", "cc", "-target", f"{machine}-{system}")


def known_compilers() -> dict[str, tuple[str, ...]]:
    """Return the commands of those of gcc, clang and zig that this machine has, by name."""
    found = {name: (path,) for name in ("gcc", "clang") if (path := shutil.which(name))}
    return found | ({"zig": _zig()} if importlib.util.find_spec("ziglang") is not None else {})


@lru_cache
def compiler_identity(triple: str = "") -> str:
    """Return what identifies a compiler: the command, and version or size and date of the program
    behind it, and added flags.
    """
    command, flags = find_compiler(triple), " ".join(_toolchain(triple).flags)
    if "ziglang" in command:
        from importlib.metadata import version

        return f"{command[1:]} {version('ziglang')} {flags}".rstrip()
    status = os.stat(shutil.which(command[0]) or command[0])
    return f"{command} {status.st_size} {status.st_mtime_ns} {flags}".rstrip()


def _environment(folder: Path) -> dict[str, str]:
    """Return the environment of a compilation: zig keeps its cache in the cache folder and needs no
    home directory.

    Libraries for Windows hold the time at which they were linked, unless a fixed one is given.
    """
    zig = {f"ZIG_{which}_CACHE_DIR": str(cache_folder() / "zig") for which in ("GLOBAL", "LOCAL")}
    return zig | os.environ | {"TMPDIR": str(folder.resolve()), "SOURCE_DATE_EPOCH": "0"}


def _included(text: str, sources: Mapping[str, str], found: dict[str, str]) -> dict[str, str]:
    """Return those of the sources that a text includes, directly or through others; they are added
    to `found`.
    """
    for name in INCLUDE.findall(text):
        if name in sources and name not in found:
            found[name] = sources[name]
            _included(sources[name], sources, found)
    return found


def _compiler(triple: str, arguments: Sequence[str], folder: Path) -> None:
    """Run the compiler in a folder; raise `BristleError` if it fails."""
    found = find_compiler(triple)
    name = "zig" if "ziglang" in found else found[0]
    command = [*found, *arguments]
    try:
        done = _run(command, folder)
    except subprocess.TimeoutExpired:
        raise BristleError(
            f"C compiler {name} did not end within {TIMEOUT} s; check the compiler or set CC"
        ) from None
    if done.returncode != 0:
        complaint = next(
            (line for line in done.stderr.splitlines() if "error" in line),
            done.stderr.strip() or "no message",
        )
        raise BristleError(
            f"C compiler {name} failed: {complaint.strip()}; check the compiler or set CC"
        )


def _run(command: Sequence[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder; where there is a shell, whatever it starts ends with this process,
    even if that is killed.
    """
    environment = _environment(folder)
    if sys.platform == "win32":
        return subprocess.run(
            command,
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=TIMEOUT,
        )
    watched, held = _pipe()
    try:
        with subprocess.Popen(
            ["/bin/sh", "-c", WATCHED, "sh", *command],
            stdin=watched,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=folder,
            env=environment,
            start_new_session=True,
        ) as process:
            try:
                said, complained = process.communicate(timeout=TIMEOUT)
            finally:
                _end(held)
        return subprocess.CompletedProcess(command, process.returncode, said, complained)
    finally:
        _end(held)
        os.close(watched)


def _pipe() -> tuple[int, FileIO]:
    """Return the end of a pipe that is read, and the one that a compiler lives by.

    That one is a file and no number: once closed, a number may be that of the pipe of another
    thread's compiler.
    """
    watched, held = os.pipe()
    file = FileIO(held, "w")
    _watched.add(file)
    return watched, file


def _end(pipe: FileIO) -> None:
    """Let go of the pipe that a compiler lives by, if nobody has: it ends, unless it is done."""
    _watched.discard(pipe)
    pipe.close()


@contextmanager
def _building(out: Path) -> Iterator[Path]:
    """Give a folder beside `out` to compile in; what is `result` there at the end becomes `out`."""
    folder = out.with_name(out.name + ".build")
    folder.mkdir()
    try:
        yield folder
        os.replace(folder / "result", out)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _compile_unit(unit: str, files: Mapping[str, str], target: Target, out: Path) -> None:
    with _building(out) as folder:
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8", newline="\n")
        flags = (*target.flags(), *_toolchain(target.triple).flags)
        _compiler(target.triple, [*flags, "-I.", "-c", unit, "-o", "result"], folder)


def compile_shared(sources: Mapping[str, str], out: Path, target: Target = HOST) -> None:
    """Compile C sources (file name -> text) into the shared library `out`.

    A unit is compiled once and kept in the cache by the text of all that it includes: the FMUs of
    both versions and the program in this process share the equations, which take nearly all the
    time. Several are compiled at a time, each in a folder of its own with relative names only, so
    that the result does not depend on where it is.

    Raises
    ------
    BristleError
        If the compiler fails; the first line of its error output is in the message.
    """
    units = sorted(file for file in sources if file.endswith(".c"))
    with _building(out) as folder:
        for unit, made in zip(units, _each_of(partial(_made, sources, target), units), strict=True):
            shutil.copyfile(made, folder / f"{Path(unit).stem}.o")
        objects = [f"{Path(unit).stem}.o" for unit in units]
        _compiler(
            target.triple,
            ["-shared", "-s", *objects, *target.link_flags(out.stem), "-o", "result"],
            folder,
        )


def _made(sources: Mapping[str, str], target: Target, unit: str) -> Path:
    """Return the object file of a unit, from the cache or compiled."""
    files = {unit: sources[unit]} | _included(sources[unit], sources, {})
    made_by = (*target.flags(), compiler_identity(target.triple))
    key = digest(*made_by, *(text for file in sorted(files.items()) for text in file))
    return cached(f"{Path(unit).stem}-{key[:24]}.o", partial(_compile_unit, unit, files, target))


def _each_of(make: Callable[[str], Path], units: Sequence[str]) -> list[Path]:
    """Return the results for all units, as many at a time as there are cores; raise the first error
    if some fail.
    """
    gate, busy, stopped = Lock(), set[str](), Event()

    def make_one(unit: str) -> Path:
        with gate:
            if stopped.is_set():
                raise CancelledError
            busy.add(unit)
        try:
            return make(unit)
        finally:
            busy.discard(unit)

    with ThreadPoolExecutor(os.cpu_count() or 1, "compilers") as pool:
        try:
            made = [pool.submit(make_one, unit) for unit in units]
            return [each.result() for each in made]
        except Exception:
            # what has not begun is not wanted any more
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        except (KeyboardInterrupt, SystemExit):  # they would be waited for
            with gate:
                stopped.set()
            pool.shutdown(wait=False, cancel_futures=True)
            while busy:  # also what was being submitted; one may be about to start its compiler
                for pipe in tuple(_watched):
                    _end(pipe)
                time.sleep(ENDING_INTERVAL)
            raise
