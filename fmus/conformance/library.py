"""What is read from a shared library of any platform, without loading it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import Any

SUFFIXES = (".so", ".dll", ".dylib")
MACHINE_WORDS = {  # words of LIEF, by format
    "X86_64": "x86_64",
    "AMD64": "x86_64",
    "I386": "x86",
    "X86": "x86",
    "AARCH64": "aarch64",
    "ARM64": "aarch64",
    "ARM": "aarch32",
    "ARMNT": "aarch32",
}
# 64 bits, 32 bits, several machines
MACHO = (b"\xcf\xfa\xed\xfe", b"\xce\xfa\xed\xfe", b"\xca\xfe\xba\xbe")
GLIBC = re.compile(r"GLIBC_(\d+)\.(\d+)")
PYTHON = re.compile(r"_?(Py[A-Z_]|_Py_)\w+")


@dataclass(frozen=True)
class Library:
    """A library: its entry, folder and stem, format (elf, pe, macho; empty for none of them) and
    what its headers say.
    """

    name: str
    folder: str
    identifier: str
    data: bytes
    format: str = ""
    machine: str = ""
    exported: frozenset[str] = frozenset()
    needed: tuple[str, ...] = ()
    searched: tuple[str, ...] = ()
    executable_stack: bool = False
    text_relocations: bool = False
    imports_python: str = ""
    glibc: tuple[int, int] = (0, 0)


def libraries(name: str, data: bytes) -> Iterator[Library]:
    """Give the library of an entry of the archive; of a Mach-O file for several machines, each."""
    import lief

    lief.logging.disable()
    place = PurePosixPath(name)
    plain = Library(name, place.parent.name, place.stem, data)
    parts: list[tuple[str, Any]] = []
    if data.startswith(b"\x7fELF"):
        parts = [("elf", lief.ELF.parse(data))]
    elif data.startswith(b"MZ"):
        parts = [("pe", lief.PE.parse(data))]
    elif data[:4] in MACHO:
        whole = lief.MachO.parse(data)  # its parts live no longer than this
        parts = [("macho", each) for each in whole or ()]
    parts = [(kind, part) for kind, part in parts if part is not None]
    if not parts:
        yield plain
    for kind, part in parts:
        yield replace(plain, format=kind, **{"elf": _elf, "pe": _pe, "macho": _macho}[kind](part))


def _machine(word: Any) -> str:
    name = str(word).rpartition(".")[2]
    return MACHINE_WORDS.get(name, name)


def _python(names: Iterator[Any]) -> str:
    return next((str(name) for name in names if PYTHON.fullmatch(str(name))), "")


def _elf(part: Any) -> dict[str, Any]:
    import lief

    tag = lief.ELF.DynamicEntry.TAG
    searched = [e for e in part.dynamic_entries if e.tag in (tag.RPATH, tag.RUNPATH)]
    stack = [s for s in part.segments if s.type == lief.ELF.Segment.TYPE.GNU_STACK]
    return {
        "machine": _machine(part.header.machine_type),
        "exported": frozenset(s.name for s in part.exported_symbols),
        "needed": tuple(part.libraries),
        "searched": tuple(path for e in searched for path in e.paths),
        "executable_stack": not stack or any(s.has(lief.ELF.Segment.FLAGS.X) for s in stack),
        "text_relocations": _relocates(part),
        "imports_python": _python(s.name for s in part.dynamic_symbols if not s.shndx),
        "glibc": _glibc(part),
    }


def _relocates(part: Any) -> bool:
    """Return whether a library changes its code when it is loaded."""
    import lief

    tag, flag = lief.ELF.DynamicEntry.TAG, lief.ELF.DynamicEntryFlags.FLAG.TEXTREL
    flags = (e for e in part.dynamic_entries if e.tag == tag.FLAGS)
    return part.has(tag.TEXTREL) or any(flag in e for e in flags)


def _glibc(part: Any) -> tuple[int, int]:
    """Return the newest version of glibc that a library needs."""
    needed = (r.get_auxiliary_symbols() for r in part.symbols_version_requirement)
    versions = (GLIBC.fullmatch(each.name) for symbols in needed for each in symbols)
    return max(((int(v[1]), int(v[2])) for v in versions if v), default=(0, 0))


def _pe(part: Any) -> dict[str, Any]:
    exported = [e.name for e in part.get_export().entries] if part.has_exports else []
    return {
        "machine": _machine(part.header.machine),
        "exported": frozenset(exported),
        "needed": tuple(part.libraries),
    }


def _macho(part: Any) -> dict[str, Any]:
    import lief

    own = (lief.MachO.LoadCommand.TYPE.ID_DYLIB,)
    return {
        "machine": _machine(part.header.cpu_type),
        "exported": frozenset(s.name.removeprefix("_") for s in part.exported_symbols),
        "needed": tuple(each.name for each in part.libraries if each.command not in own),
        "searched": tuple(each.path for each in part.rpaths),
    }
