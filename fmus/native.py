"""A program as a native FMU: C99 sources, compiled for this machine."""

from __future__ import annotations

import platform
import sys
import tempfile
from importlib.resources import files
from pathlib import Path

from bristle.common.errors import BristleError
from bristle.fmus.description import build_description, description_2, description_3
from bristle.fmus.documentation import documentation
from bristle.fmus.interface import Interface, c_tables
from bristle.model.compiler import SUFFIX, compile_shared
from bristle.model.program import Program
from bristle.model.sources import c_sources

FMU_SOURCES = ("handles.h", "handles.c", "instance.h", "instance.c")
FMI_HEADERS = {
    2: ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    3: ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
MACHINE_NAMES = {"amd64": "x86_64", "x86_64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}
SYSTEM_NAMES = {"win32": ("win", "windows"), "darwin": ("darwin", "darwin")}


def platform_folder(fmi: int) -> str:
    """Return where the standard looks for the binary of this machine, such as linux64 or x86_64-linux."""
    machine = MACHINE_NAMES.get(platform.machine().lower(), platform.machine().lower())
    short, long = SYSTEM_NAMES.get(sys.platform, ("linux", "linux"))
    if fmi == 3:
        return f"{machine}-{long}"
    return f"{short}64" if machine == "x86_64" or short == "darwin" else f"{machine}-{long}"


def _fmi_headers(fmi: int) -> dict[str, str]:
    """Return the standard's own headers, which ship with FMPy."""
    folder = files("fmpy") / "c-code"
    try:
        return {name: (folder / name).read_text(encoding="utf-8") for name in FMI_HEADERS[fmi]}
    except OSError:
        raise BristleError(f"FMPy's C headers are missing in {folder}; reinstall fmpy") from None


def fmu_sources(interface: Interface, fmi: int) -> dict[str, str]:
    """Return file name -> text of all C sources of the FMU; they compile as they are."""
    folder = files("bristle.fmus") / "c"
    own = {name: (folder / name).read_text(encoding="utf-8") for name in (*FMU_SOURCES, f"fmi{fmi}.c")}
    return c_sources(interface.program) | c_tables(interface, fmi) | own | _fmi_headers(fmi)


def _compiled(sources: dict[str, str]) -> bytes:
    with tempfile.TemporaryDirectory(prefix="bristle-") as folder:
        library = Path(folder) / "library"
        compile_shared(sources, library)
        return library.read_bytes()


def common_files(interface: Interface) -> dict[str, bytes]:
    """Return the files that every kind of FMU holds."""
    text = (files("bristle.fmus") / "c" / "LICENSE.txt").read_bytes()
    page = documentation(interface).encode()
    return {"documentation/index.html": page, "documentation/licenses/license.txt": text}


def native_files(program: Program, fmi: int) -> dict[str, bytes]:
    """Return the content of the FMU."""
    interface = Interface(program)
    sources = fmu_sources(interface, fmi)
    units = sorted(name for name in sources if name.endswith(".c"))
    content = common_files(interface) | {f"sources/{name}": text.encode() for name, text in sources.items()}
    if fmi == 2:
        content["modelDescription.xml"] = description_2(interface, units)
    else:
        content["modelDescription.xml"] = description_3(interface)
        content["sources/buildDescription.xml"] = build_description(interface, units)
    content[f"binaries/{platform_folder(fmi)}/{program.name}{SUFFIX}"] = _compiled(sources)
    return content
