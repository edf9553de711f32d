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

from bristle.model.errors import BristleError

# No fused multiply-add: every platform and the Python twin then give the same digits.
FLAGS = ("-std=c99", "-O2", "-fPIC", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden", "-Wall", "-Wextra", "-Werror")
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


def compile_shared(sources: Mapping[str, str], out: Path, *, include: Sequence[Path] = (), define: Sequence[str] = ()) -> None:
    """Compile C sources (file name -> text) into the shared library `out`.

    The build runs in a folder of its own with relative names only, so that the result does not depend on where it is.

    Raises
    ------
    BristleError
        If the compiler fails; the first line of its complaint is in the message.
    """
    folder = out.with_name(out.name + ".build")
    folder.mkdir()
    try:
        for name, text in sources.items():
            (folder / name).write_text(text, encoding="utf-8", newline="\n")
        units = sorted(name for name in sources if name.endswith(".c"))
        options = [*FLAGS, *(f"-D{d}" for d in define), *(f"-I{path}" for path in include), "-I."]
        link = ["-shared", "-s", *([] if sys.platform in ("win32", "darwin") else ["-Wl,--build-id=none", "-lm"])]
        command = [*find_compiler(), *options, *units, *link, "-o", "result"]
        inside = os.environ | {"TMPDIR": str(folder.resolve())}  # so that nothing is left elsewhere if we are interrupted
        done = subprocess.run(command, cwd=folder, env=inside, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            complaint = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr.strip() or "no message")
            raise BristleError(f"C compiler {command[0]} failed: {complaint.strip()}; check the compiler or set CC")
        os.replace(folder / "result", out)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
