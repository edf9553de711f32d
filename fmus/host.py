"""FMUs as seen by a host: the modelDescription, and a loaded instance."""

from __future__ import annotations

import collections
import ctypes
import hashlib
import math
import re
import threading
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any

from bristle.common.errors import BristleError, suggest
from bristle.common.units import interval, parse_unit, quantity
from bristle.common.work import TemporaryFolder, no_room
from bristle.fmus.calls import WATCH, Call

Value = float | int | bool | str
Written = Callable[[str], tuple[str, float]]

MAX_UNPACKED = 1 << 30  # bytes an FMU may unpack to
MAX_ENTRIES = 20_000  # files in an FMU
# largest ratio of unpacked to packed size, checked from 64 MiB on (archive bombs)
MAX_RATIO, RATIO_FROM = 100, 1 << 26
IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")  # FMI: a modelIdentifier is a C identifier

_REAL, _ENUMERATION, _BOOLEAN = ("Real", "Float64"), ("Enumeration",), ("Boolean",)


@dataclass(frozen=True)
class Alias:
    """A variable of an FMU under another name: its own name, and how much one of its number is, in
    the unit of the other name.
    """

    name: str
    factor: float = 1.0
    unit: str | None = None


class Fmu:
    """An FMU file and its interface; nothing is unpacked or loaded yet.

    Parameters
    ----------
    path : Path
        The file.
    foreign : bool
        Whether it comes from elsewhere: it is then validated, and run in a process of its own.
    aliases : mapping of str to Alias, optional
        Names under which variables are known instead of their own; units, limits and values are
        then those of the alias.

    Raises
    ------
    BristleError
        If it is not a readable Co-Simulation FMU of FMI 2 or 3, or not safe to unpack.
    """

    def __init__(
        self, path: Path, foreign: bool = False, aliases: Mapping[str, Alias] | None = None
    ) -> None:
        if not isinstance(path, str | Path):
            raise BristleError(f"the FMU is a {type(path).__name__}; give the path of an .fmu file")
        self.path, self.foreign = Path(path), foreign
        self._check_archive()
        self.description = self._read()
        self.aliases = dict(aliases or {})
        own = {v.name: v for v in self.description.modelVariables}
        for alias, variable in self.aliases.items():
            if variable.name not in own:
                raise BristleError(
                    f"FMU {self.path}: no variable '{variable.name}' for"
                    f" {alias}{suggest(variable.name, list(own))}"
                )
        taken = {variable.name for variable in self.aliases.values()}
        self.variables = {name: v for name, v in own.items() if name not in taken}
        self.variables |= {alias: own[variable.name] for alias, variable in self.aliases.items()}

    def __reduce__(self) -> tuple[type[Fmu], tuple[Path, bool, dict[str, Alias]]]:
        return Fmu, (self.path, self.foreign, self.aliases)

    def factor(self, name: str) -> float:
        """Return how much one of the FMU's number is, in the unit of the variable."""
        return self.aliases[name].factor if name in self.aliases else 1.0

    def _check_archive(self) -> None:
        try:
            if not self.path.is_file() and self.path.exists():  # a pipe would be read for ever
                raise BristleError(f"FMU {self.path}: is not a file; give an .fmu file")
            packed = self.path.stat().st_size
            with zipfile.ZipFile(self.path) as archive:
                entries = archive.infolist()
            unpacked = sum(entry.file_size for entry in entries)
        except OSError as error:
            raise BristleError(f"FMU {self.path}: {error.strerror}; check the path") from None
        except zipfile.BadZipFile:
            raise BristleError(f"FMU {self.path}: not a zip archive; give an .fmu file") from None
        if len(entries) > MAX_ENTRIES:
            raise BristleError(
                f"FMU {self.path}: holds {len(entries)} files; allowed are {MAX_ENTRIES}: pack the"
                " resources it needs"
            )
        if unpacked > MAX_UNPACKED or (unpacked > RATIO_FROM and unpacked > MAX_RATIO * packed):
            raise BristleError(
                f"FMU {self.path}: {packed} bytes unpack to {unpacked}; allowed are {MAX_UNPACKED}"
                f" bytes and, from {RATIO_FROM} on, {MAX_RATIO} times the archive; this looks like"
                " an archive bomb"
            )

    def _read(self) -> Any:
        from fmpy.model_description import read_model_description

        try:
            description = read_model_description(str(self.path), validate=self.foreign)
        # FMPy passes on the exceptions of zipfile, lxml and its own parser
        except Exception as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            # an element or attribute is missing
            if isinstance(error, AttributeError | KeyError | TypeError):
                reason = (
                    "modelDescription.xml is not one of FMI, or lacks an attribute such as"
                    " fmiVersion"
                )
            raise BristleError(
                f"FMU {self.path}: cannot be read: {reason}; give a valid FMI 2 or FMI 3 file"
            ) from None
        kinds = self._kinds(description)
        if not kinds or description.fmiMajorVersion not in (2, 3):
            raise BristleError(
                f"FMU {self.path}: no Co-Simulation of FMI 2 or 3 inside; export it as"
                " Co-Simulation"
            )
        for identifier in (str(kind.modelIdentifier) for kind in kinds):
            if IDENTIFIER.fullmatch(identifier) is None:
                raise BristleError(
                    f"FMU {self.path}: modelIdentifier '{identifier}' is not a plain name; do not"
                    " trust this file"
                )
        return description

    @staticmethod
    def _kinds(description: Any) -> list[Any]:
        """Return the interface types that can be used."""
        return [] if description.coSimulation is None else [description.coSimulation]

    @property
    def fmi(self) -> int:
        """Major version of FMI."""
        return int(self.description.fmiMajorVersion)

    @cached_property
    def sha256(self) -> str:
        """Hash of the file."""
        return hashlib.sha256(self.path.read_bytes()).hexdigest()

    @cached_property
    def kind(self) -> str:
        """``python`` for an FMU that needs a Python host, else ``native``."""
        with zipfile.ZipFile(self.path) as archive:
            return (
                "python"
                if any(re.fullmatch(r"resources/[^/]+\.py", name) for name in archive.namelist())
                else "native"
            )

    @property
    def risky(self) -> bool:
        """Whether its library may harm the process that loads it: one of others, or pythonfmu's."""
        return self.foreign or self.kind == "python"

    def names(self, causality: str) -> list[str]:
        """Return the names of all variables of a causality."""
        return list(self._by_causality.get(causality, ()))

    @cached_property
    def _by_causality(self) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        for name, variable in self.variables.items():
            found.setdefault(str(variable.causality), []).append(name)
        return found

    def has(self, name: str, causality: str) -> bool:
        """Say whether there is such a variable."""
        return name in self.variables and self.variables[name].causality == causality

    def reference(self, name: str) -> int:
        """Return the value reference of a variable."""
        return int(self.variables[name].valueReference)

    def is_real(self, name: str) -> bool:
        """Say whether a variable is a floating-point number."""
        return self.variables[name].type in _REAL

    def unit(self, name: str) -> str:
        """Return the unit of a variable, ``1`` if it declares none."""
        variable, alias = self.variables[name], self.aliases.get(name)
        if alias is not None and alias.unit is not None:
            return alias.unit
        return str(variable.unit or (variable.declaredType and variable.declaredType.unit) or "1")

    def meaning(self, name: str) -> str:
        """Return the description of a variable, empty if it has none."""
        return str(self.variables[name].description or "")

    def choices(self, name: str) -> dict[str, int]:
        """Return the items of an Enumeration."""
        variable = self.variables.get(name)
        if variable is None or variable.declaredType is None:
            return {}
        return {str(item.name): int(item.value) for item in variable.declaredType.items}

    def interval(self, name: str) -> tuple[float, float]:
        """Return the closed interval of allowed values."""
        variable = self.variables[name]
        declared = variable.declaredType
        low = variable.min if variable.min is not None else declared.min if declared else None
        high = variable.max if variable.max is not None else declared.max if declared else None
        ends = (
            float(low) if low is not None else -math.inf,
            float(high) if high is not None else math.inf,
        )
        low, high = sorted(end * self.factor(name) for end in ends)
        return low, high

    def start(self, name: str) -> float:
        """Return the start value of a numeric variable."""
        start = self.variables[name].start
        return (
            float(start in ("true", "1"))
            if self.variables[name].type in _BOOLEAN
            else float(start) * self.factor(name)
        )

    def parameter(
        self, name: str, given: object, known: Sequence[str] = (), written: Written | None = None
    ) -> Value:
        """Check a parameter's value as a user writes it and return it in the FMU's unit.

        `known` are the names for the error message; all parameters by default. `written` returns,
        for a unit of the FMU, the one that a user writes, and what one of it is worth; by default
        the FMU's own.

        Raises
        ------
        BristleError
            If the parameter is unknown or the value does not fit; the message does not name the
            place in a file.
        """
        if not self.has(name, "parameter"):
            known = known or self.names("parameter")
            raise BristleError(
                f"no such parameter{suggest(name, known)}; known: {', '.join(known)}"
            )
        kind = self.variables[name].type
        if kind in _ENUMERATION:
            return self._choice(name, given)
        if kind in _BOOLEAN:
            if not isinstance(given, bool):
                raise BristleError("not a Boolean; write true or false")
            return given
        if kind == "String":
            return str(given)
        value = self.physical(name, given, written)
        if kind in _REAL:
            return value
        if value != int(value):
            raise BristleError("not a whole number; write one without a fraction")
        return int(value)

    def _choice(self, name: str, given: object) -> int:
        choices = self.choices(name)
        if isinstance(given, str) and given in choices:
            return choices[given]
        raise BristleError(
            f"not a choice{suggest(str(given), list(choices))}; choose one of: {', '.join(choices)}"
        )

    def physical(self, name: str, given: object, written: Written | None = None) -> float:
        """Read a value with its unit and check it against the interval of variable `name`;
        `written` as in `parameter`.
        """
        unit, worth = (self.unit(name), 1.0) if written is None else written(self.unit(name))
        if not isinstance(given, (str, int, float)):
            raise BristleError(f'not a quantity; write a number with a unit such as "1 {unit}"')
        value = quantity(given, unit) * worth
        low, high = self.interval(name)
        if not low <= value <= high:
            allowed = interval(low / worth, high / worth, unit)
            raise BristleError(f"outside {allowed}; choose a value in that interval")
        return value

    def check_si(self, name: str, *units: str) -> None:
        """Raise BristleError if a variable declares another unit than one of `units`; one without a
        unit is accepted.
        """
        have = self.unit(name)
        if have == "1":
            return
        try:
            given = parse_unit(have)
            same = any(
                (given.exponents, given.factor)
                == (parse_unit(unit).exponents, parse_unit(unit).factor)
                for unit in units
            )
        except BristleError:
            same = False
        if not same:
            raise BristleError(
                f"FMU {self.path}: variable '{name}' is in {have}; bristle connects it in"
                f" {units[0]}: export it in {units[0]}"
            )


class _Messages(threading.local):
    """The last messages of the FMUs that run in a thread."""

    def __init__(self) -> None:
        self.kept: collections.deque[str] = collections.deque(maxlen=20)

    def add(self, message: bytes) -> None:
        """Keep one more."""
        self.kept.append(message.decode("utf-8", "replace"))

    def pop(self) -> str:
        """Return and remove the last one in one line; nothing if there is none."""
        return " ".join(self.kept.pop().split()) if self.kept else ""


_messages = _Messages()
_loading = threading.Lock()  # FMPy changes the working directory while it loads a library
_callbacks: Any = None


def _callbacks2() -> Any:
    """Return the FMI 2 callbacks that collect messages; one set, because FMPy's formatting proxy
    serves one logger.
    """
    global _callbacks
    if _callbacks is None:
        from fmpy import calloc, fmi2, free

        def log(
            _environment: object, _name: bytes, status: int, _category: bytes, message: bytes
        ) -> None:
            if status > fmi2.fmi2OK and message:
                _messages.add(message)

        made = fmi2.fmi2CallbackFunctions()
        made.logger = fmi2.fmi2CallbackLoggerTYPE(log)
        made.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
        made.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
        keep = made.logger
        if hasattr(fmi2, "addLoggerProxy"):
            fmi2.addLoggerProxy(ctypes.byref(made))
        made._keep = keep  # the proxy calls it; ctypes must not collect it
        _callbacks = made
    return _callbacks


def _log3(_environment: object, status: int, _category: bytes, message: bytes) -> None:
    if status > 0 and message:
        _messages.add(message)


class Slave:
    """A loaded and instantiated FMU; a context manager that frees it and removes what it unpacked.

    `beside`: another instance of the same file, of whose library this is one more; it must be
    closed after this one.
    """

    def __init__(self, fmu: Fmu, name: str, beside: Slave | None = None) -> None:
        self.fmu, self.name = fmu, name
        # removed at the interpreter's end even if an interrupt comes before `close` can be called
        self._temporary = TemporaryFolder("fmu")
        self._folder: str = self._temporary.name if beside is None else beside._folder
        self.instance: Any = None
        try:
            self._load()
        except BaseException:
            self.close()
            raise

    def _load(self) -> None:
        from fmpy import extract, fmi2, fmi3, platform, platform_tuple

        binaries = f"binaries/{platform if self.fmu.fmi == 2 else platform_tuple}/"
        description = self.fmu.description
        arguments = {
            "guid": description.guid,
            "modelIdentifier": description.coSimulation.modelIdentifier,
            "unzipDirectory": self._folder,
            "instanceName": self.name,
        }
        try:
            if self._folder == self._temporary.name:
                extract(
                    str(self.fmu.path),
                    self._folder,
                    lambda name: name.startswith((binaries, "resources/")),
                )
            if not list(Path(self._folder).glob(f"{binaries}*")):
                raise BristleError(
                    f"FMU {self.fmu.path}: no binary for this machine ({binaries}); export one"
                    " for it"
                )
            Path(self._folder, "resources").mkdir(exist_ok=True)
            if self.fmu.fmi == 2:
                WATCH.begin(self.fmu.path, Call.load)
                with _loading:
                    self.instance = fmi2.FMU2Slave(**arguments)
                WATCH.begin(self.fmu.path, Call.instantiate)
                self.instance.instantiate(callbacks=_callbacks2(), loggingOn=not self.fmu.foreign)
            else:
                WATCH.begin(self.fmu.path, Call.load)
                with _loading:
                    self.instance = fmi3.FMU3Slave(libraryPath=self._library(binaries), **arguments)
                WATCH.begin(self.fmu.path, Call.instantiate)
                self.instance.instantiate(logMessage=_log3, loggingOn=not self.fmu.foreign)
        except BristleError:
            raise
        except Exception as error:
            other = BristleError(
                f"FMU {self.fmu.path}: cannot be loaded: {self._why(error)}; rebuild or replace it"
            )
            raise no_room(error) or other from None

    def _library(self, binaries: str) -> str:
        from fmpy import sharedLibraryExtension

        return str(
            Path(
                self._folder,
                binaries,
                self.fmu.description.coSimulation.modelIdentifier + sharedLibraryExtension,
            )
        )

    @staticmethod
    def _why(error: BaseException) -> str:
        """Return the last message of the FMU, else that of the exception, in one line."""
        return _messages.pop() or " ".join((str(error) or type(error).__name__).split())

    def last_message(self) -> str:
        """Return and remove the last message that the FMU logged."""
        return _messages.pop() or "no message"

    def close(self) -> None:
        """Free the instance and the library, remove the unpacked files."""
        if self.instance is not None:
            loaded, self.instance = self.instance, None
            WATCH.begin(self.fmu.path, Call.free)
            if loaded.component:
                loaded.freeInstance()
            else:
                loaded.freeLibrary()
            WATCH.end()
        self._temporary.cleanup()

    def __enter__(self) -> Slave:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def set_value(self, name: str, value: Value) -> None:
        """Set one variable by name."""
        vr, kind, instance = (
            [self.fmu.reference(name)],
            self.fmu.variables[name].type,
            self.instance,
        )
        if kind == "String":
            instance.setString(vr, [value])
        elif kind == "Boolean":
            instance.setBoolean(vr, [value])
        elif kind in _REAL:
            number = float(value) / self.fmu.factor(name)
            (instance.setReal if self.fmu.fmi == 2 else instance.setFloat64)(vr, [number])
        elif self.fmu.fmi == 2:
            instance.setInteger(vr, [value])
        else:
            getattr(instance, "setInt64" if kind == "Enumeration" else f"set{kind}")(vr, [value])

    def get_value(self, name: str) -> float:
        """Read one number or Boolean by name."""
        vr, instance = [self.fmu.reference(name)], self.instance
        if self.fmu.variables[name].type == "Boolean":
            return float(instance.getBoolean(vr)[0])
        return float(
            (instance.getReal if self.fmu.fmi == 2 else instance.getFloat64)(vr)[0]
        ) * self.fmu.factor(name)

    def initialise(self, values: Mapping[str, Value], time: float = 0.0) -> None:
        """Set start values and go through initialisation at a start time [s]."""
        instance = self.instance
        _messages.kept.clear()
        WATCH.begin(self.fmu.path, Call.initialise)
        try:
            for name, value in values.items():
                self.set_value(name, value)
            if self.fmu.fmi == 2:
                instance.setupExperiment(startTime=time)
                instance.enterInitializationMode()
            else:
                instance.enterInitializationMode(startTime=time)
            instance.exitInitializationMode()
            WATCH.end()
        except Exception as error:
            raise BristleError(
                f"{self.name} ({self.fmu.path.name}): initialisation refused: {self._why(error)};"
                " check its parameters"
            ) from None

    def reset(self) -> None:
        """Return it to the state in which it was loaded, before its start values were set."""
        self.instance.reset()

    def address(self, function: str) -> int:
        """Return the address of one of its functions."""
        return ctypes.cast(getattr(self.instance.dll, function), ctypes.c_void_p).value or 0
