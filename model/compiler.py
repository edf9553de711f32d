"""The C compiler: the machine's own, or zig from the extra `cross`."""

from __future__ import annotations

import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path

from bristle.common.errors import BristleError

# No fused multiply-add: all platforms and the generated Python then give the same digits.
# No check of array bounds: loops run to the number of states of a variant, which -O3 wrongly suspects to exceed the arrays.
FLAGS = (
    "-std=c99", "-O3", "-fPIC", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden",
    "-Wall", "-Wextra", "-Werror", "-Wno-array-bounds",
)  # fmt: skip
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
    from bristle.common.cache import cache_folder

    zig = {f"ZIG_{which}_CACHE_DIR": str(cache_folder() / "zig") for which in ("GLOBAL", "LOCAL")}
    return zig | os.environ | {"TMPDIR": str(folder.resolve())}


def compile_shared(sources: Mapping[str, str], out: Path, *, include: Sequence[Path] = (), define: Sequence[str] = ()) -> None:
    """Compile C sources (file name -> text) into the shared library `out`.

    The build runs in a folder of its own with relative names only, so that the result does not depend on where it is.

    Raises
    ------
    BristleError
        If the compiler fails; the first line of its error output is in the message.
    """
    folder = out.with_name(out.name + ".build")
    folder.mkdir()
    try:
        for file, text in sources.items():
            (folder / file).write_text(text, encoding="utf-8", newline="\n")
        units = sorted(file for file in sources if file.endswith(".c"))
        options = [*FLAGS, *(f"-D{d}" for d in define), *(f"-I{path}" for path in include), "-I."]
        link = ["-shared", "-s", *([] if sys.platform in ("win32", "darwin") else ["-Wl,--build-id=none", "-lm"])]
        name = "zig" if "ziglang" in find_compiler() else find_compiler()[0]
        command = [*find_compiler(), *options, *units, *link, "-o", "result"]
        done = subprocess.run(
            command, cwd=folder, env=_environment(folder), capture_output=True, text=True, check=False, timeout=TIMEOUT
        )
        if done.returncode != 0:
            complaint = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr.strip() or "no message")
            raise BristleError(f"C compiler {name} failed: {complaint.strip()}; check the compiler or set CC")
        os.replace(folder / "result", out)
    except subprocess.TimeoutExpired:
        raise BristleError(f"C compiler {name} did not end within {TIMEOUT} s; check the compiler or set CC") from None
    finally:
        shutil.rmtree(folder, ignore_errors=True)
