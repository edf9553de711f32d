"""Points of the libraries inside, of any platform: they are read, not loaded."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from pathlib import PurePosixPath

from bristle.fmus.conformance.registry import Package, Severity, point

FOLDERS = {  # of FMI 2: format and machines
    "win32": ("pe", {"x86"}),
    "win64": ("pe", {"x86_64"}),
    "linux32": ("elf", {"x86"}),
    "linux64": ("elf", {"x86_64"}),
    "darwin64": ("macho", {"x86_64", "aarch64"}),
}
# FMI 3
TUPLE = re.compile(
    r"(aarch32|aarch64|riscv32|riscv64|x86|x86_64|ppc32|ppc64)-(windows|linux|darwin)(-[a-z0-9]+)?"
)
FORMATS = {"windows": "pe", "linux": "elf", "darwin": "macho"}
SUFFIX_OF = {"pe": ".dll", "elf": ".so", "macho": ".dylib"}
PLAIN = {  # libraries that each system of the platform has, or that the C++ run time installs
    "elf": re.compile(
        r"(lib(c|m|dl|rt|pthread|util|resolv|gcc_s|stdc\+\+|atomic)\.so(\.\d+)*|ld-linux.*)"
    ),
    "pe": re.compile(
        r"(kernel(32|base)|user32|gdi(32|plus)|advapi32|shell32|ole32|oleaut32|ws2_32|wsock32|mswsock|shlwapi|shcore|rpcrt4|version"
        r"|winmm|ntdll|bcrypt(primitives)?|ncrypt|crypt32|psapi|pdh|dbghelp|imagehlp|iphlpapi|dnsapi|comdlg32|comctl32|setupapi"
        r"|cfgmgr32|secur32|netapi32|userenv|wininet|winhttp|mpr|powrprof|wtsapi32|opengl32|glu32|imm32|uxtheme|dwmapi|msimg32"
        r"|normaliz|mscoree|odbc32|avrt|synchronization|ucrtbase|msvc[rp]\w*|vcruntime\w*|concrt\d+|vcomp\d+|api-ms-win-.*"
        r"|ext-ms-.*)\.dll",
        re.IGNORECASE,
    ),
    "macho": re.compile(r"(/usr/lib/|/System/Library/).*"),
}
OWN_FOLDER = ("@rpath/", "@loader_path/", "$ORIGIN")  # how a library names what lies beside it
NEWEST_GLIBC = (2, 34)  # of the oldest distributions that are still common
PATHS = re.compile(rb"(?:/home/[\w.-]+/|/Users/[\w.-]+/|[A-Za-z]:\\Users\\)[\w./\\-]{3,60}")
FUNCTIONS_OF_MODEL_EXCHANGE = {
    "EnterEventMode",
    "NewDiscreteStates",
    "EnterContinuousTimeMode",
    "CompletedIntegratorStep",
    "SetTime",
    "SetContinuousStates",
    "GetDerivatives",
    "GetEventIndicators",
    "GetContinuousStates",
    "GetNominalsOfContinuousStates",
}
FUNCTIONS_OF_CO_SIMULATION = {
    "SetRealInputDerivatives",
    "GetRealOutputDerivatives",
    "DoStep",
    "CancelStep",
    "GetStatus",
    "GetRealStatus",
    "GetIntegerStatus",
    "GetBooleanStatus",
    "GetStringStatus",
}


@cache
def functions(fmi: int) -> tuple[str, ...]:
    """Return the names of all functions of an FMI version, which FMPy has as a header."""
    text = (files("fmpy") / "c-code" / f"fmi{fmi}Functions.h").read_text(encoding="utf-8")
    return tuple(
        sorted(set(re.findall(rf"#define fmi{fmi}\w+\s+fmi{fmi}FullName\((fmi{fmi}\w+)\)", text)))
    )


def demanded(package: Package) -> list[str]:
    """Return the functions that a library must have: in FMI 2 those of the interface types that are
    offered, in FMI 3 all.
    """
    if package.fmi == 3:
        return list(functions(3))
    absent = {
        "ModelExchange": FUNCTIONS_OF_MODEL_EXCHANGE,
        "CoSimulation": FUNCTIONS_OF_CO_SIMULATION,
    }
    left_out = {
        f"fmi2{name}"
        for kind, names in absent.items()
        if package.root.find(kind) is None
        for name in names
    }
    return [name for name in functions(2) if name not in left_out]


@point(
    "binary-folder",
    "each folder of binaries is one of FMI, and its libraries are for that system and machine",
)
def _folder(package: Package) -> Iterator[str]:
    for folder, names in package.binary_folders.items():
        kind, _ = _expected(folder)
        if not kind:
            yield f"binaries/{folder}: no platform of FMI {package.fmi}"
            continue
        others = {suffix for suffix in SUFFIX_OF.values() if suffix != SUFFIX_OF[kind]}
        for name in names:
            if PurePosixPath(name).suffix in others:
                yield f"{name}: a library of another system"
    yield from _machines(package)


def _machines(package: Package) -> Iterator[str]:
    """Give the libraries that are not for the system and machine of their folder."""
    for name in dict.fromkeys(library.name for library in package.libraries):
        # several, if it is for several machines
        parts = [library for library in package.libraries if library.name == name]
        kind, machines = _expected(parts[0].folder)
        found = sorted({library.machine for library in parts})
        if kind and (parts[0].format != kind or machines.isdisjoint(found)):
            form, machine = parts[0].format or "no library", ", ".join(found) or "no machine"
            yield f"{name}: {form} for {machine}"


def _expected(folder: str) -> tuple[str, set[str]]:
    found = TUPLE.fullmatch(folder)
    return FOLDERS.get(folder, ("", set())) if found is None else (FORMATS[found[2]], {found[1]})


@point("binary-functions", "each library has all functions of its interface types")
def _functions(package: Package) -> Iterator[str]:
    wanted = demanded(package)
    for library in package.libraries:
        if library.identifier in package.identifiers and library.format:
            missing = [name for name in wanted if name not in library.exported]
            if missing:
                yield f"{library.name}: {len(missing)} of {len(wanted)}, such as {missing[0]}"


@point(
    "binary-needs",
    "each library needs those of its platform alone, or what lies beside it",
    Severity.warning,
)
def _needs(package: Package) -> Iterator[str]:
    for library in package.libraries:
        beside = {
            PurePosixPath(name).name.lower() for name in package.binary_folders[library.folder]
        }
        for needed in library.needed:
            name = PurePosixPath(needed).name
            relative = needed == name or needed.startswith(OWN_FOLDER)
            if not PLAIN[library.format].fullmatch(needed) and not (
                relative and name.lower() in beside
            ):
                yield f"{library.name}: {needed}"


@point(
    "binary-search",
    "no library is looked for at an absolute path (RPATH, RUNPATH)",
    Severity.warning,
)
def _search(package: Package) -> Iterator[str]:
    for library in package.libraries:
        yield from (
            f"{library.name}: {path or 'an empty path'}"
            for path in library.searched
            if not path.startswith(("$", "@"))
        )


@point(
    "binary-stack",
    "no library asks for an executable stack, which glibc from 2.41 on refuses to load",
    Severity.warning,
)
def _stack(package: Package) -> Iterator[str]:
    yield from (library.name for library in package.libraries if library.executable_stack)


@point(
    "binary-text", "no library changes its own code when it is loaded (TEXTREL)", Severity.warning
)
def _text(package: Package) -> Iterator[str]:
    yield from (library.name for library in package.libraries if library.text_relocations)


@point(
    "binary-symbols", "each library says where its symbols come from, so that any host can load it"
)
def _symbols(package: Package) -> Iterator[str]:
    for library in package.libraries:
        if library.imports_python and not any(
            "python" in needed.lower() for needed in library.needed
        ):
            yield (
                f"{library.name}: {library.imports_python} is of Python, which the host must bring"
            )


@point(
    "binary-glibc",
    f"no library needs a glibc newer than {'.'.join(map(str, NEWEST_GLIBC))}",
    Severity.note,
)
def _glibc(package: Package) -> Iterator[str]:
    for library in package.libraries:
        if library.glibc > NEWEST_GLIBC:
            yield f"{library.name}: {'.'.join(map(str, library.glibc))}"


@point("binary-paths", "no library has paths of the machine that built it", Severity.note)
def _paths(package: Package) -> Iterator[str]:
    for library in package.libraries:
        found = PATHS.search(library.data)
        if found:
            yield f"{library.name}: {found[0].decode('ascii', 'replace')}"
