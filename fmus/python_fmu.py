"""A program as a pythonfmu FMU (FMI 2.0 Co-Simulation), for hosts that run in Python."""

from __future__ import annotations

from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path

from bristle.common.cache import digest
from bristle.common.errors import BristleError
from bristle.fmus.description import description_2
from bristle.fmus.interface import Exposed, Interface
from bristle.fmus.native import common_files
from bristle.model.program import Program
from bristle.model.python import python_source


def _row(x: Exposed) -> str:
    minimum, maximum = x.checked
    low = "-math.inf" if minimum is None else repr(float(minimum))
    high = "math.inf" if maximum is None else repr(float(maximum))
    until = "always" if x.settable_late else "start" if x.settable else "never"
    return f"    {x.reference}: ({x.name!r}, {x.type!r}, {until!r}, {low}, {high}),"


def _tables(interface: Interface) -> str:
    """Return the generated module: equations, and the variables by value reference."""
    rows = [_row(x) for x in interface.variables if x.causality != "independent"]
    return python_source(interface.program) + "\n".join(
        [
            f"TOKEN = {interface.program.token!r}",
            "VARIABLES = {  # name, type, when it may be set, limits",
            *rows,
            "}",
            "",
        ]
    )


def _script(interface: Interface, package: str) -> str:
    """Return the file that pythonfmu looks for; it takes the class with most base classes."""
    name, description = interface.program.name, interface.program.description
    return f"""\"\"\"{name}: {description} (generated).\"\"\"

import ctypes

from {package} import slave, tables

# pythonfmu 0.7 runs this file for every instance and then gives back one reference to its globals
# too many.
ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))


class {name}(slave.PythonSlave):
    tables = tables
"""


def _package(interface: Interface) -> dict[str, str]:
    """Return the FMU's own Python package: file name -> text."""
    slave = (files("bristle.fmus") / "slave.py").read_text(encoding="utf-8")
    return {
        "__init__.py": "",
        "slave.py": slave.replace("from bristle.model.runtime import", "from .runtime import"),
        "runtime.py": (files("bristle.model") / "runtime.py").read_text(encoding="utf-8"),
        "tables.py": _tables(interface),
    }


def _pythonfmu() -> Path:
    """Return the folder of the installed package; an FMU loaded in this process imports its own
    copy, without libraries.
    """
    return Path(str(distribution("pythonfmu").locate_file("pythonfmu")))


def _library(folder: Path, suffix: str, model: str) -> bytes:
    found = sorted(folder.glob(f"*{suffix}"))
    if len(found) != 1:
        raise BristleError(
            f"pythonfmu: no single *{suffix} for {model} in {folder}; reinstall pythonfmu"
        )
    return found[0].read_bytes()


def _pythonfmu_licence() -> dict[str, bytes]:
    """Return pythonfmu's licence, which must accompany its files."""
    found = [
        path
        for path in distribution("pythonfmu").files or ()
        if path.name.upper().startswith("LICENSE")
    ]
    return {"documentation/licenses/pythonfmu.txt": found[0].read_binary()} if found else {}


def python_files(program: Program) -> dict[str, bytes]:
    """Return the content of the FMU; names and value references are those of the native one."""
    interface = Interface(program, native=False)
    package = _package(interface)
    # FMUs in one process share sys.modules: different contents need different names
    parts = (part for pair in package.items() for part in pair)
    script = f"bristle_{program.name.lower()}_{digest(*parts)[:16]}"
    content = common_files(interface, 2) | {"modelDescription.xml": description_2(interface, ())}
    content |= {f"resources/{script}_parts/{name}": text.encode() for name, text in package.items()}
    content[f"resources/{script}.py"] = _script(interface, f"{script}_parts").encode()
    content["resources/slavemodule.txt"] = script.encode()
    content |= _pythonfmu_licence()
    pythonfmu = _pythonfmu()
    content |= {
        f"resources/pythonfmu/{file.name}": file.read_bytes()
        for file in sorted(pythonfmu.glob("*.py"))
    }
    for folder, suffix in (("linux64", ".so"), ("win64", ".dll")):
        binary = _library(pythonfmu / "resources" / "binaries" / folder, suffix, program.name)
        content[f"binaries/{folder}/{program.name}{suffix}"] = binary
    return content
