"""A program as a native FMU: C99 sources, compiled for this machine or for others."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files

from bristle.common.errors import BristleError
from bristle.fmus.description import build_description, description_2, description_3
from bristle.fmus.documentation import documentation
from bristle.fmus.interface import Interface, c_tables
from bristle.fmus.platforms import Platform, binaries
from bristle.fmus.terminals import terminal_files
from bristle.model.program import Program
from bristle.model.sources import c_sources

FMU_SOURCES = ("handles.h", "handles.c", "instance.h", "instance.c")
FMI_HEADERS = {
    2: ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    3: ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}


def fmi_headers(fmi: int) -> dict[str, str]:
    """Return the standard's own headers, which ship with FMPy."""
    folder = files("fmpy") / "c-code"
    try:
        return {name: (folder / name).read_text(encoding="utf-8") for name in FMI_HEADERS[fmi]}
    except OSError:
        raise BristleError(f"FMPy's C headers are missing in {folder}; reinstall fmpy") from None


def fmu_sources(interface: Interface, fmi: int) -> dict[str, str]:
    """Return file name -> text of all C sources of the FMU; they compile as they are."""
    folder = files("bristle.fmus") / "c"
    own = {
        name: (folder / name).read_text(encoding="utf-8") for name in (*FMU_SOURCES, f"fmi{fmi}.c")
    }
    return c_sources(interface.program) | c_tables(interface, fmi) | own | fmi_headers(fmi)


def common_files(interface: Interface, fmi: int) -> dict[str, bytes]:
    """Return the files that every kind of FMU holds."""
    text = (files("bristle.fmus") / "c" / "LICENSE.txt").read_bytes()
    page = documentation(interface).encode()
    pages = {"documentation/index.html": page, "documentation/licenses/license.txt": text}
    return pages | terminal_files(interface, fmi)


def native_files(program: Program, fmi: int, platforms: Sequence[Platform]) -> dict[str, bytes]:
    """Return the content of the FMU."""
    interface = Interface(program)
    sources = fmu_sources(interface, fmi)
    units = sorted(name for name in sources if name.endswith(".c"))
    content = common_files(interface, fmi) | {
        f"sources/{name}": text.encode() for name, text in sources.items()
    }
    if fmi == 2:
        content["modelDescription.xml"] = description_2(interface, units)
    else:
        content["modelDescription.xml"] = description_3(interface)
        content["sources/buildDescription.xml"] = build_description(interface, units)
    return content | binaries(program.name, sources, fmi, platforms)
