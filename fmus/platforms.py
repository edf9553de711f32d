"""The platforms that an FMU can be compiled for, and their binaries.

Linux: any with glibc from 2.17 on. Where FMI 2 has one folder for two machines (darwin64), the
library holds both.
"""

from __future__ import annotations

import platform
import struct
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bristle.common.errors import BristleError, suggest
from bristle.common.work import TemporaryFolder
from bristle.model.compiler import HOST, Target, compile_shared

MACHINES = {"amd64": "x86_64", "x86_64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}
SYSTEMS = {"win32": "windows", "darwin": "darwin"}

# of a Mach-O file for several machines; each begins at a multiple of 2**14
FAT_MAGIC, FAT_ALIGNMENT = 0xCAFEBABE, 14
# CPU_TYPE_X86_64, CPU_TYPE_ARM64, and their subtypes
CPU_TYPES = {"x86_64": (0x01000007, 3), "aarch64": (0x0100000C, 0)}


@dataclass(frozen=True)
class Platform:
    """A platform: its machine, what FMI calls it, and what its libraries are compiled for."""

    machine: str
    system: str  # linux, windows or darwin
    target: Target

    @property
    def name(self) -> str:
        """Its folder in FMI 3, such as x86_64-linux."""
        return f"{self.machine}-{self.system}"

    def folder(self, fmi: int) -> str:
        """Return where the standard looks for its binary; FMI 2 has no name for Linux on ARM, so
        that of FMI 3 is used.
        """
        short = "win" if self.system == "windows" else self.system
        return (
            f"{short}64"
            if fmi == 2 and (self.machine == "x86_64" or self.system == "darwin")
            else self.name
        )


ALL = (
    Platform("x86_64", "linux", Target("linux", "x86_64-linux-gnu.2.17")),
    Platform("aarch64", "linux", Target("linux", "aarch64-linux-gnu.2.17")),
    Platform("x86_64", "windows", Target("win32", "x86_64-windows-gnu")),
    Platform("x86_64", "darwin", Target("darwin", "x86_64-macos")),
    Platform("aarch64", "darwin", Target("darwin", "aarch64-macos")),
)
NAMES = tuple(dict.fromkeys(name for each in ALL for name in (each.name, each.folder(2))))


def host() -> Platform:
    """Return this machine, with its own compiler."""
    machine = platform.machine().lower()
    return Platform(MACHINES.get(machine, machine), SYSTEMS.get(sys.platform, "linux"), HOST)


def find_platforms(text: str) -> tuple[Platform, ...]:
    """Return the platforms of a text: ``host``, ``all``, or names of FMI 2 or 3 between commas.

    Raises
    ------
    BristleError
        If a name is unknown.
    """
    found: dict[str, Platform] = {}
    for name in (part.strip() for part in text.split(",")):
        if name == "host":
            some: Sequence[Platform] = [host()]
        else:
            some = [each for each in ALL if name in ("all", each.name, each.folder(2))]
        if not some:
            raise BristleError(
                f"unknown platform '{name}'{suggest(name, NAMES)}; known: host, all,"
                f" {', '.join(NAMES)}"
            )
        for each in some:
            found.setdefault(each.name, each)
    return tuple(found.values())


def binaries(
    name: str, sources: Mapping[str, str], fmi: int, chosen: Sequence[Platform]
) -> dict[str, bytes]:
    """Return the binaries of an FMU by their places in it.

    Parameters
    ----------
    name : str
        The modelIdentifier.
    sources : mapping of str to str
        File name -> text.
    fmi : int
        2 or 3.
    chosen : sequence of Platform
        What to compile for.

    Raises
    ------
    BristleError
        If a compiler is missing or fails.
    """
    places: dict[str, list[Platform]] = {}
    for each in chosen:
        places.setdefault(f"binaries/{each.folder(fmi)}/{name}{each.target.suffix}", []).append(
            each
        )
    made = {
        place: {each.machine: _compiled(name, sources, each.target) for each in some}
        for place, some in places.items()
    }
    return {
        place: next(iter(some.values())) if len(some) == 1 else fat(some)
        for place, some in made.items()
    }


def _compiled(name: str, sources: Mapping[str, str], target: Target) -> bytes:
    with TemporaryFolder("library") as folder:
        library = Path(folder) / f"{name}{target.suffix}"
        compile_shared(sources, library, target)
        return library.read_bytes()


def fat(libraries: Mapping[str, bytes]) -> bytes:
    """Return one Mach-O file that holds the libraries of several machines (machine -> library).

    The layout is that of <mach-o/fat.h> of macOS.
    """
    step = 1 << FAT_ALIGNMENT
    head, body = struct.pack(">II", FAT_MAGIC, len(libraries)), b""
    for machine, library in libraries.items():
        offset = step + len(body)
        head += struct.pack(">5I", *CPU_TYPES[machine], offset, len(library), FAT_ALIGNMENT)
        body += library + b"\0" * (-len(library) % step)
    return head.ljust(step, b"\0") + body
