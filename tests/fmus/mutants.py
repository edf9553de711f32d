"""A good FMU of FMI 2 and one of FMI 3, and the defects that can be put into them, each with the
points that have to find it.

A defect of behaviour is the value of the environment variable MUTANT, which the FMUs read
(mutant.c); one of the archive or the description is a function that changes the entries of the
archive.
"""

from __future__ import annotations

import re
import stat
import subprocess
import warnings
import zipfile
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

from bristle.model.compiler import find_compiler

HERE = Path(__file__).parent
SOURCE = HERE / "mutant.c"
ABILITIES = (
    'modelIdentifier="good" canGetAndSet{0}="true" canSerialize{0}="true"'
    ' providesDirectionalDerivative{1}="true"'
)
XML = {
    2: (
        f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="good" guid="{{good}}" numberOfEventIndicators="1">
<ModelExchange {ABILITIES.format("FMUstate", "")}/>
<CoSimulation {ABILITIES.format("FMUstate", "")} canHandleVariableCommunicationStepSize="true"/>
<UnitDefinitions><Unit name="V"><BaseUnit kg="1" m="2" s="-3" A="-1"/></Unit></UnitDefinitions>
<TypeDefinitions><SimpleType name="Mode"><Enumeration><Item name="one" value="1"/><Item name="two" value="2"/></Enumeration>
</SimpleType></TypeDefinitions>
<LogCategories><Category name="logAll"/><Category name="logStatusError"/></LogCategories>
<DefaultExperiment startTime="0" stopTime="1" stepSize="0.001"/>
<ModelVariables>
<ScalarVariable name="u" valueReference="1" causality="input"><Real start="0" unit="V" min="-10" max="10"/></ScalarVariable>
<ScalarVariable name="k" valueReference="2" causality="parameter" variability="fixed"><Real start="2"/></ScalarVariable>
<ScalarVariable name="v" valueReference="3" causality="output" initial="exact"><Real start="0"/></ScalarVariable>
<ScalarVariable name="dv" valueReference="4" causality="local" initial="calculated"><Real derivative="3"/></ScalarVariable>
<ScalarVariable name="w" valueReference="5" causality="output" initial="calculated"><Real min="-100" max="100"/></ScalarVariable>
<ScalarVariable name="q" valueReference="6" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="i" valueReference="10" causality="parameter" variability="fixed"><Integer start="3"/></ScalarVariable>
<ScalarVariable name="s" valueReference="11" causality="parameter" variability="fixed"><String start="text"/></ScalarVariable>
<ScalarVariable name="b" valueReference="12" causality="parameter" variability="fixed"><Boolean start="true"/></ScalarVariable>
</ModelVariables>
<ModelStructure>
<Outputs><Unknown index="3" dependencies=""/><Unknown index="5" dependencies="1 2 3"/></Outputs>
<Derivatives><Unknown index="4" dependencies="1 2 3"/></Derivatives>
<InitialUnknowns><Unknown index="4" dependencies="1 2 3"/><Unknown index="5" dependencies="1 2 3"/></InitialUnknowns>
</ModelStructure>
</fmiModelDescription>
"""
    ),
    3: (
        f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="good" instantiationToken="{{good}}">
<ModelExchange {ABILITIES.format("FMUState", "s")} providesAdjointDerivatives="true"/>
<CoSimulation {ABILITIES.format("FMUState", "s")} canHandleVariableCommunicationStepSize="true" hasEventMode="true"/>
<UnitDefinitions><Unit name="V"><BaseUnit kg="1" m="2" s="-3" A="-1"/></Unit></UnitDefinitions>
<LogCategories><Category name="logAll"/><Category name="logStatusError"/></LogCategories>
<DefaultExperiment startTime="0" stopTime="1" stepSize="0.001"/>
<ModelVariables>
<Float64 name="time" valueReference="0" causality="independent"/>
<Float64 name="u" valueReference="1" causality="input" start="0" unit="V" min="-10" max="10"/>
<Float64 name="k" valueReference="2" causality="parameter" variability="fixed" start="2"/>
<Float64 name="v" valueReference="3" causality="output" initial="exact" start="0"/>
<Float64 name="dv" valueReference="4" causality="local" initial="calculated" derivative="3"/>
<Float64 name="w" valueReference="5" causality="output" initial="calculated" min="-100" max="100"/>
<Float64 name="q" valueReference="6" causality="input" start="0"/>
<Float64 name="z" valueReference="7" causality="local"/>
<Int64 name="i" valueReference="10" causality="parameter" variability="fixed" start="3"/>
<String name="s" valueReference="11" causality="parameter" variability="fixed"><Start value="text"/></String>
<Boolean name="b" valueReference="12" causality="parameter" variability="fixed" start="true"/>
</ModelVariables>
<ModelStructure>
<Output valueReference="3" dependencies=""/>
<Output valueReference="5" dependencies="1 2 3"/>
<ContinuousStateDerivative valueReference="4" dependencies="1 2 3"/>
<InitialUnknown valueReference="4" dependencies="1 2 3"/>
<InitialUnknown valueReference="5" dependencies="1 2 3"/>
<EventIndicator valueReference="7"/>
</ModelStructure>
</fmiModelDescription>
"""
    ),
}

# value of MUTANT, version of FMI, point that has to find it
BEHAVIOUR_MUTANTS: list[tuple[str, int, str]] = [
    *(
        (name, 2, point)
        for name, point in {
            "start": "run-starts",
            "startinteger": "run-starts",
            "startstring": "run-starts",
            "nan": "run-finite",
            "range": "run-range",
            "locked": "run-readable",
            "nullstring": "run-readable",
            "unset": "run-settable",
            "initialq": "run-dependencies",
            "stepq": "run-feedthrough",
            "slope": "run-derivatives",
            "noslope": "run-derivatives",
            "again": "run-again",
            "reset": "run-reset",
            "shared": "run-two",
            "reload": "run-reload",
            "unload": "run-reload",
            "threads": "run-threads",
            "leak": "run-memory",
            "leakinstance": "run-freed",
            "leakword": "run-freed",
            "leakstate": "run-states-freed",
            "jump": "run-jump",
            "resetinput": "run-reset",
            "othertype": "run-unknown",
            "lastknown": "exchange-derivatives",
            "handles": "run-handles",
            "startthread": "run-handles",
            "chdir": "run-environment",
            "rounding": "run-environment",
            "signal": "run-environment",
            "mask": "run-environment",
            "file": "run-files",
            "ownfile": "run-files",
            "folder": "run-folder",
            "loud": "run-quiet",
            "loudout": "run-quiet",
            "state": "run-state",
            "stateonce": "run-state-again",
            "stateafter": "run-state-again",
            "refill": "run-state-again",
            "bytes": "run-bytes",
            "pointer": "run-process",
            "table": "run-process",
            "failing": "run-experiment",
            "latenan": "run-experiment",
            "percall": "run-convergence",
            "ownstep": "run-convergence",
            "firststep": "run-split",
            "noise": "run-noise",
            "later": "run-later",
            "back": "run-back",
            "zero": "run-zero",
            "zeronan": "run-zero",
            "odd": "run-odd",
            "hugehang": "run-huge",
            "hugenan": "run-huge",
            "large": "run-large",
            "naninput": "run-nan",
            "version": "run-version",
            "platform": "run-version",
            "token": "run-token",
            "name": "run-name",
            "nullfree": "run-null",
            "nullarray": "run-null",
            "nullstate": "run-null",
            "unknown": "run-unknown",
            "early": "run-early",
            "late": "run-late",
            "twice": "run-twice",
            "exit": "run-twice",
            "fixed": "run-fixed",
            "computed": "run-computed",
            "resetearly": "run-legal",
            "ended": "run-legal",
            "freenew": "run-legal",
            "logsame": "run-log-same",
            "logoff": "run-log-off",
            "logcategory": "run-log-categories",
            "logset": "run-log-set",
            "crash": "run-life",
            "uninitialised": "run-uninitialised",
            "setone": "run-many",
            "getone": "run-many",
            "forgets": "run-kept",
            "order": "exchange-order",
            "resetparameter": "run-reset",
            "stateinput": "run-state",
            "stateparameter": "run-bytes",
            "sharedparameter": "run-two",
            "endless": "exchange-life",
            "completed": "exchange-life",
            "exchangenan": "exchange-finite",
            "indicators": "exchange-finite",
            "float": "exchange-states",
            "nominals": "exchange-nominals",
            "impure": "exchange-pure",
            "exchangereset": "exchange-again",
            "exchangeq": "exchange-dependencies",
            "exchangeslope": "exchange-derivatives",
            "exchangehalf": "exchange-agrees",
        }.items()
    ),
    *(
        (name, 3, point)
        for name, point in {
            "state": "exchange-state",
            "last": "run-last-time",
            "early return": "run-last-time",
            "noevents": "run-events",
            "endless": "run-events",
            "nostates": "exchange-counts",
            "noindicators": "exchange-counts",
            "nulllog": "run-null",
            "sizes": "run-sizes",
            "adjoint": "exchange-adjoint",
            "start": "run-starts",
            "reset": "run-reset",
            "bytes": "run-bytes",
            "threads": "run-threads",
            "slope": "run-derivatives",
            "exchangeslope": "exchange-derivatives",
            "pointer": "run-process",
            "firststep": "run-split",
        }.items()
    ),
]


def functions(fmi: int) -> list[str]:
    """Return the names of all functions of an FMI version."""
    text = (files("fmpy") / "c-code" / f"fmi{fmi}Functions.h").read_text(encoding="utf-8")
    return sorted(set(re.findall(rf"#define (fmi{fmi}\w+)\s+fmi{fmi}FullName\(", text)))


def compile_good(fmi: int, folder: Path, *flags: str) -> Path:
    """Compile the good library of an FMI version and return its path."""
    source = SOURCE.read_text(encoding="utf-8")
    there = set(re.findall(rf"\b(fmi{fmi}\w+)\(", source)) | {
        f"fmi{fmi}{name}" for name in re.findall(r"\bF\((\w+)\)", source)
    }
    word = "FMUstate" if fmi == 2 else "FMUState"
    there |= {f"fmi{fmi}{verb}{word}" for verb in ("Get", "Set", "Free", "Serialize")} | {
        f"fmi{fmi}Serialized{word}Size"
    }
    there |= {f"fmi2DeSerialize{word}", f"fmi3Deserialize{word}"}
    stubs = "".join(
        f"E int {name}(void) {{ return ERROR; }}\n" for name in functions(fmi) if name not in there
    )
    unit, library = folder / f"good{fmi}.c", folder / f"good{fmi}.so"
    unit.write_text(f"#define FMI {fmi}\n{source}{stubs}", encoding="utf-8")
    command = [
        *find_compiler(),
        "-std=gnu99",
        "-O0",
        "-w",
        "-shared",
        "-fPIC",
        "-fvisibility=hidden",
        str(unit),
    ]
    subprocess.run([*command, "-o", str(library), "-lm", *flags], check=True)
    return library


def good_entries(fmi: int, folder: Path) -> dict[str, bytes]:
    """Return the entries of a good FMU."""
    from fmpy import platform, platform_tuple, sharedLibraryExtension

    place = f"binaries/{platform if fmi == 2 else platform_tuple}/good{sharedLibraryExtension}"
    return {
        "modelDescription.xml": XML[fmi].encode(),
        "documentation/index.html": b"<p>a test</p>",
        place: compile_good(fmi, folder).read_bytes(),
    }


def pack(path: Path, entries: dict[str, bytes]) -> Path:
    """Write an FMU, all entries of one time."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in entries.items():
            archive.writestr(zipfile.ZipInfo(name, (2000, 1, 1, 0, 0, 0)), data)
    return path


# -- defects of the archive and the description ----------------------------------------------------

Entries = dict[str, bytes]
Change = Callable[[Entries], None]
LIBRARY = {2: "binaries/linux64/good.so", 3: "binaries/x86_64-linux/good.so"}
TERMINALS = b"""<fmiTerminalsAndIcons fmiVersion="3.0"><Terminals><Terminal name="t" matchingRule="bus">
<TerminalMemberVariable variableName="nobody" memberName="m" variableKind="signal"/>
</Terminal></Terminals></fmiTerminalsAndIcons>"""
SOURCES = '<SourceFiles><File name="m.c"/></SourceFiles>'
BUILD = b"""<fmiBuildDescription fmiVersion="3.0"><BuildConfiguration modelIdentifier="good"><SourceFileSet>
<SourceFile name="model.c"/></SourceFileSet></BuildConfiguration></fmiBuildDescription>"""


def swap(old: str, new: str) -> Change:
    """Change the description."""

    def change(entries: Entries) -> None:
        text = entries["modelDescription.xml"].decode()
        assert old in text, old
        entries["modelDescription.xml"] = text.replace(old, new, 1).encode()

    return change


def rename(old: str, new: str) -> Change:
    """Rename an entry."""

    def change(entries: Entries) -> None:
        entries[new] = entries.pop(old)

    return change


def add(name: str, data: bytes = b"") -> Change:
    """Add an entry."""
    return lambda entries: entries.update({name: data})


def library(edit: Callable[[bytes], bytes], fmi: int = 2) -> Change:
    """Change the bytes of the library."""

    def change(entries: Entries) -> None:
        before = entries[LIBRARY[fmi]]
        entries[LIBRARY[fmi]] = edit(before)
        assert entries[LIBRARY[fmi]] != before

    return change


def edited(edit: Callable[[Any], None]) -> Change:
    """Change the library as an object of LIEF."""

    def change(data: bytes) -> bytes:
        import lief

        part = lief.ELF.parse(data)
        edit(part)
        return bytes(part.write_to_bytes())

    return library(change)


def _executable_stack(part: Any) -> None:
    import lief

    for segment in part.segments:
        if segment.type == lief.ELF.Segment.TYPE.GNU_STACK:
            segment.add(lief.ELF.Segment.FLAGS.X)


def _entry(kind: str, *given: Any) -> Callable[[Any], None]:
    def edit(part: Any) -> None:
        import lief

        tag = lief.ELF.DynamicEntry.TAG
        made = {
            "rpath": lambda: lief.ELF.DynamicEntryRpath(*given),
            "runpath": lambda: lief.ELF.DynamicEntryRunPath(*given),
            "textrel": lambda: lief.ELF.DynamicEntry(tag.TEXTREL, 0),
        }[kind]()
        part.add(made)

    return edit


def _for_arm(part: Any) -> None:
    import lief

    part.header.machine_type = lief.ELF.ARCH.AARCH64


# of FMPy: they need another library, and the one for macOS looks for it where it was built
CVODE = {
    "windows": "sundials/x86_64-windows/sundials_cvode.dll",
    "darwin": "sundials/aarch64-darwin/sundials_cvode.dylib",
}
# point that has to find it, version of FMI, change
STATIC_MUTANTS: list[tuple[str, int, Change]] = [
    ("archive-description", 3, rename("modelDescription.xml", "m/modelDescription.xml")),
    ("archive-description", 3, swap("</ModelVariables>", "")),
    ("archive-paths", 3, rename("documentation/index.html", "../index.html")),
    ("archive-paths", 3, rename("documentation/index.html", "documentation\\index.html")),
    ("archive-documentation", 3, lambda entries: entries.pop("documentation/index.html")),
    ("archive-binary", 3, rename(LIBRARY[3], "binaries/x86_64-linux/other.so")),
    ("archive-case", 3, add("Documentation/index.html")),
    ("archive-sources", 2, swap('StepSize="true"/>', f'StepSize="true">{SOURCES}</CoSimulation>')),
    ("archive-sources", 3, add("sources/buildDescription.xml", BUILD)),
    ("archive-sources", 3, add("sources/buildDescription.xml", b"<a>")),
    ("archive-terminals", 3, add("terminalsAndIcons/terminalsAndIcons.xml", TERMINALS)),
    ("archive-terminals", 3, add("terminalsAndIcons/terminalsAndIcons.xml", b"<a>")),
    ("binary-folder", 2, rename(LIBRARY[2], "binaries/linux46/good.so")),
    ("binary-folder", 2, rename(LIBRARY[2], "binaries/linux32/good.so")),
    ("binary-folder", 2, rename(LIBRARY[2], "binaries/win64/good.dll")),
    ("binary-folder", 2, add("binaries/linux64/good.dll")),
    ("binary-folder", 2, edited(_for_arm)),
    (
        "binary-functions",
        2,
        library(lambda data: data.replace(b"fmi2CancelStep", b"fmi2CancelStop")),
    ),
    (
        "binary-functions",
        3,
        library(lambda data: data.replace(b"fmi3GetClock", b"fmi3GotClock"), 3),
    ),
    ("binary-needs", 2, edited(lambda part: part.add_library("libgfortran.so.5"))),
    ("binary-needs", 2, edited(lambda part: part.add_library("/opt/tool/libc.so.6"))),
    (
        "binary-needs",
        2,
        lambda entries: entries.update({"binaries/win64/a.dll": of_fmpy(CVODE["windows"])}),
    ),
    (
        "binary-needs",
        2,
        lambda entries: entries.update({"binaries/darwin64/a.dylib": of_fmpy(CVODE["darwin"])}),
    ),
    (
        "binary-search",
        2,
        lambda entries: entries.update({"binaries/darwin64/a.dylib": of_fmpy(CVODE["darwin"])}),
    ),
    (
        "binary-folder",
        2,
        lambda entries: entries.update(
            {"binaries/win64/a.dll": of_fmpy("logging/win32/logging.dll")}
        ),
    ),
    ("binary-search", 2, edited(_entry("rpath", "/opt/tool/lib"))),
    ("binary-search", 2, edited(_entry("runpath", "$ORIGIN:/opt/tool/lib"))),
    ("binary-stack", 2, edited(_executable_stack)),
    ("binary-text", 2, edited(_entry("textrel"))),
    ("binary-symbols", 2, library(lambda data: data.replace(b"pthread_create", b"PyObject_Hash0"))),
    ("binary-glibc", 2, library(lambda data: re.sub(rb"GLIBC_2\.\d\d\b", b"GLIBC_2.99", data))),
    ("binary-paths", 2, library(lambda data: data + b"/home/someone/build/model.c\0")),
    ("description-validator", 3, swap('<Output valueReference="3" dependencies=""/>', "")),
    ("description-validator", 3, swap('causality="parameter"', 'causality="output"')),
    ("description-validator", 2, swap('<Real start="2"/>', "<Real/>")),
    ("description-range", 3, swap('min="-10" max="10"', 'max="two"')),
    ("description-range", 3, swap('start="0" unit="V"', 'start="11" unit="V"')),
    ("description-range", 3, swap('start="0" unit="V"', 'start="NaN" unit="V"')),
    ("description-identifier", 3, swap('modelIdentifier="good"', 'modelIdentifier="../good"')),
    ("description-token", 3, swap('instantiationToken="{good}"', 'instantiationToken=""')),
    ("description-names", 3, swap('name="k"', 'name="u"')),
    ("description-units", 3, swap('unit="V"', 'unit="h"')),
    ("description-experiment", 3, swap(' stopTime="1"', "")),
    ("description-si", 2, swap('<BaseUnit kg="1" m="2" s="-3" A="-1"/>', "")),
    ("description-limits", 2, swap('min="-10" max="10"', 'min="10" max="-10"')),
    ("description-limits", 2, swap('min="-10" max="10"', 'nominal="0"')),
    ("description-integers", 2, swap('<Integer start="3"/>', '<Integer start="3000000000"/>')),
    ("description-integers", 3, swap('fixed" start="3"', 'fixed" start="3.5"')),
    ("description-items", 2, swap('value="2"', 'value="1"')),
    (
        "description-items",
        2,
        swap('<Integer start="3"/>', '<Enumeration declaredType="Mode" start="3"/>'),
    ),
    (
        "description-references",
        2,
        swap('name="q" valueReference="6"', 'name="q" valueReference="1"'),
    ),
    ("description-states", 2, swap('derivative="3"', 'derivative="9"')),
    ("description-states", 3, swap('derivative="3"', 'derivative="99"')),
    ("description-abilities", 2, swap('canGetAndSetFMUstate="true"', "")),
    ("description-times", 2, swap('stopTime="1"', 'stopTime="0"')),
    ("description-times", 2, swap('stepSize="0.001"', 'stepSize="-1"')),
]


def of_fmpy(path: str) -> bytes:
    """Return a library that FMPy brings, for one platform or another."""
    return (files("fmpy") / path).read_bytes()


def pack_badly(point: str, path: Path, entries: Entries) -> Path:
    """Write an FMU whose archive has the defect that a point has to find, where entries alone
    cannot have it.
    """
    if point == "archive-method":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as archive:
            for name, data in entries.items():
                archive.writestr(name, data)
        return path
    pack(path, entries)
    with zipfile.ZipFile(path, "a") as archive:
        extra = zipfile.ZipInfo(
            {"archive-twice": "modelDescription.xml"}.get(point, "resources/extra"),
            (2000, 1, 1, 0, 0, 0),
        )
        if point == "archive-links":
            extra.external_attr = (stat.S_IFLNK | 0o777) << 16
        if point == "archive-times":
            extra.date_time = (2020, 2, 2, 2, 2, 2)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            archive.writestr(extra, b"/etc")
    if point == "archive-whole":
        path.write_bytes(path.read_bytes().replace(b"/etc", b"/usr"))
    return path


PACKING_MUTANTS = (
    "archive-method",
    "archive-twice",
    "archive-links",
    "archive-times",
    "archive-whole",
)
