"""An FMU under test and its instances, called as a host in C calls them: every status is seen,
nothing is caught in between.
"""

from __future__ import annotations

import ctypes
import os
import zipfile
from collections.abc import Sequence
from ctypes import byref, c_bool, c_char_p, c_double, c_float, c_int, c_size_t, c_uint, c_void_p
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

from bristle.common.errors import BristleError
from bristle.common.work import no_room
from bristle.fmus.conformance.registry import parsed
from bristle.fmus.host import Fmu

CO_SIMULATION, MODEL_EXCHANGE = "CoSimulation", "ModelExchange"
TAKEN = 1  # the highest status of a call that was done: warning
# status of a step, and the question whether it asks to end the simulation: fmi2Terminated
DISCARD, TERMINATED = 2, 3
STATUS_NAMES = ("OK", "warning", "discard", "error", "fatal", "pending")

STATE = {  # get, set, free, size, serialise, deserialise
    2: (
        "GetFMUstate",
        "SetFMUstate",
        "FreeFMUstate",
        "SerializedFMUstateSize",
        "SerializeFMUstate",
        "DeSerializeFMUstate",
    ),
    3: (
        "GetFMUState",
        "SetFMUState",
        "FreeFMUState",
        "SerializedFMUStateSize",
        "SerializeFMUState",
        "DeserializeFMUState",
    ),
}
# of a variable: the word in the names of the functions, and its C type
TYPES: dict[str, tuple[str, Any]] = {
    "Real": ("Real", c_double),
    "Integer": ("Integer", c_int),
    "Float32": ("Float32", c_float),
    "Float64": ("Float64", c_double),
    "String": ("String", c_char_p),
    **{
        name: (name, getattr(ctypes, f"c_{name.lower()}"))
        for name in ("Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64")
    },
}
REALS = ("Real", "Float32", "Float64")
LOGGER2 = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)
LOGGER3 = ctypes.CFUNCTYPE(None, c_void_p, c_int, c_char_p, c_char_p)


class CallFailed(BristleError):
    """A call of an FMU that the standard allows was not done."""


class Ended(BristleError):
    """An FMU asks to end the simulation, as it may."""


class Notes(Protocol):
    """Where the name of the call that is under way is written, for the case of a crash."""

    def __call__(self, function: str, /) -> None: ...


class Callbacks(ctypes.Structure):
    """fmi2CallbackFunctions."""

    _fields_ = [
        ("logger", c_void_p),
        ("allocate", c_void_p),
        ("free", c_void_p),
        ("finished", c_void_p),
        ("environment", c_void_p),
    ]


class Events2(ctypes.Structure):
    """fmi2EventInfo."""

    _fields_ = [
        ("again", c_int),
        ("terminate", c_int),
        ("nominals", c_int),
        ("values", c_int),
        ("next_defined", c_int),
        ("next", c_double),
    ]


class Subject(Fmu):
    """An FMU under test, also one of Model Exchange alone.

    Parameters
    ----------
    path : Path
        The file.
    folder : Path, optional
        Where it is unpacked.
    note : function, optional
        Called with the name of each function before it is called.

    Raises
    ------
    BristleError
        If it is no readable FMU of FMI 2 or 3.
    """

    def __init__(self, path: Path, folder: Path | None = None, note: Notes | None = None) -> None:
        super().__init__(path)
        self.folder, self.note = folder or Path(), note or (lambda function: None)

    @staticmethod
    def _kinds(description: Any) -> list[Any]:
        return [
            kind
            for kind in (description.coSimulation, description.modelExchange)
            if kind is not None
        ]

    def interface(self, kind: str) -> Any:
        """Return what the description says of an interface type, None if it is not offered."""
        return (
            self.description.coSimulation
            if kind == CO_SIMULATION
            else self.description.modelExchange
        )

    @cached_property
    def _attributes(self) -> dict[str, dict[str, str]]:
        """Attributes of each interface type; FMPy does not keep all of them."""
        with zipfile.ZipFile(self.path) as archive:
            root = parsed(archive.read("modelDescription.xml"))
        return {
            kind: dict(element.attrib)
            for kind in (CO_SIMULATION, MODEL_EXCHANGE)
            for element in root.iterfind(kind)
        }

    def claims(self, *abilities: str, kind: str = CO_SIMULATION) -> bool:
        """Say whether the description claims one of some abilities."""
        return any(
            self._attributes.get(kind, {}).get(ability) in ("true", "1") for ability in abilities
        )

    @property
    def binaries(self) -> str:
        """Folder of the libraries for this machine."""
        from fmpy import platform, platform_tuple

        return f"binaries/{platform if self.fmi == 2 else platform_tuple}"

    def check_binary(self) -> None:
        """Raise BristleError if it has no library for this machine."""
        with zipfile.ZipFile(self.path) as archive:
            if not any(name.startswith(f"{self.binaries}/") for name in archive.namelist()):
                raise BristleError(
                    f"FMU {self.path}: no binary for this machine ({self.binaries}); export one"
                    " for it"
                )

    def unpack(self) -> None:
        """Unpack it into its folder.

        Raises
        ------
        BristleError
            If it cannot be unpacked.
        """
        from fmpy import extract

        try:
            extract(str(self.path), str(self.folder))
        except Exception as error:  # FMPy passes on what it meets
            other = BristleError(
                f"FMU {self.path}: cannot be unpacked: {' '.join(str(error).split())}; pack it"
                " again"
            )
            raise no_room(error) or other from None
        (self.folder / "resources").mkdir(exist_ok=True)

    def library_path(self, kind: str = CO_SIMULATION) -> Path:
        """Return the path of the library of an interface type."""
        from fmpy import sharedLibraryExtension

        return (
            self.folder
            / self.binaries
            / f"{self.interface(kind).modelIdentifier}{sharedLibraryExtension}"
        )

    def load(self, kind: str = CO_SIMULATION) -> ctypes.CDLL:
        """Return the library of an interface type."""
        self.note("loading its library")
        try:  # on Windows, what it needs is also looked for beside it
            return ctypes.CDLL(str(self.library_path(kind)), winmode=8)
        except OSError as error:
            raise CallFailed(
                f"its library cannot be loaded: {str(error).replace(str(self.folder), '')}"
            ) from None

    @cached_property
    def library(self) -> ctypes.CDLL:
        """The library of its Co-Simulation."""
        return self.load()

    def count(self, name: str) -> int:
        """Return how many numbers a variable has."""
        number = 1
        for dimension in self.variables[name].dimensions or ():
            number *= int(
                dimension.start if dimension.start is not None else dimension.variable.start
            )
        return number

    def scalars(self, *causalities: str, kinds: Sequence[str] = REALS) -> list[str]:
        """Return the variables of some causalities that are single numbers of some types."""
        return [
            name
            for name, v in self.variables.items()
            if v.causality in causalities and v.type in kinds and not v.dimensions and not v.clocks
        ]

    def typed(self, kind: str) -> tuple[str, Any]:
        """Return the word in the names of the functions, and the C type, of a variable's type."""
        if kind == "Boolean":
            return kind, c_int if self.fmi == 2 else c_bool
        return TYPES[{2: "Integer", 3: "Int64"}[self.fmi] if kind == "Enumeration" else kind]

    def is_accessible(self, name: str) -> bool:
        """Say whether a variable can be read at any time."""
        v = self.variables[name]
        return v.type not in ("Binary", "Clock") and not v.clocks


@dataclass(frozen=True)
class Options:
    """How an instance is made; the token is that of the description where it is None."""

    kind: str = CO_SIMULATION
    name: bytes | None = b"one"
    token: bytes | None = None
    logging: bool = False
    logger: bool = True
    resources: Path | None = None
    event_mode: bool = False


USUAL = Options()


class Instance:
    """An instance of an FMU.

    Parameters
    ----------
    subject : Subject
        The FMU.
    options : Options
        How it is made.
    library : CDLL, optional
        The library; by default that of the subject, once loaded.

    Raises
    ------
    CallFailed
        If it is not made.
    """

    def __init__(
        self, subject: Subject, options: Options = USUAL, library: ctypes.CDLL | None = None
    ) -> None:
        self.subject, self.fmi, self.kind = subject, subject.fmi, options.kind
        self.messages: list[tuple[int, str, str]] = []
        same = options.kind == CO_SIMULATION
        self.library = library or (subject.library if same else subject.load(options.kind))
        self.handle = self._instantiate(options)
        if not self.handle:
            raise CallFailed(f"fmi{self.fmi}Instantiate gives no instance{self.last_message()}")

    def _instantiate(self, options: Options) -> int | None:
        from fmpy import calloc, free

        log2 = LOGGER2(lambda _, name, status, category, text: self._log(status, category, text))
        log3 = LOGGER3(lambda _, status, category, text: self._log(status, category, text))
        # the FMU calls it; ctypes must not collect it
        self._logger = log2 if self.fmi == 2 else log3
        logger = ctypes.cast(self._logger, c_void_p) if options.logger else c_void_p(None)
        given = self.subject.description
        token = (
            str(given.guid or given.instantiationToken).encode()
            if options.token is None
            else options.token
        )
        where = options.resources or self.subject.folder / "resources"
        if self.fmi == 2:
            memory = (ctypes.cast(each, c_void_p) for each in (calloc, free))
            self._callbacks = Callbacks(logger, *memory, None, None)
            kind = 1 if options.kind == CO_SIMULATION else 0
            arguments = (
                options.name,
                kind,
                token,
                where.as_uri().encode(),
                byref(self._callbacks),
                0,
                options.logging,
            )
            return self._handle("fmi2Instantiate", *arguments)
        resources = str(where).encode() + os.sep.encode()
        middle = (options.event_mode, False, None, 0) if options.kind == CO_SIMULATION else ()
        end = (None,) if options.kind == CO_SIMULATION else ()
        arguments3 = (
            options.name,
            token,
            resources,
            False,
            options.logging,
            *middle,
            None,
            logger,
            *end,
        )
        return self._handle(f"fmi3Instantiate{options.kind}", *arguments3)

    def _handle(self, name: str, *arguments: Any) -> int | None:
        self.subject.note(name)
        function = self.function(name)
        function.restype = c_void_p
        handle: int | None = function(*map(converted, arguments))
        return handle

    def _log(self, status: int, category: bytes | None, text: bytes | None) -> None:
        self.messages.append(
            (
                status,
                (category or b"").decode("utf-8", "replace"),
                (text or b"").decode("utf-8", "replace"),
            )
        )

    def last_message(self) -> str:
        """Return the last message that it logged, after a colon, or nothing."""
        return f": {' '.join(self.messages[-1][2].split())}" if self.messages else ""

    def function(self, name: str) -> Any:
        """Return a function of the library."""
        try:
            return getattr(self.library, name)
        except AttributeError:
            raise CallFailed(f"its library has no function {name}") from None

    def call(self, name: str, *arguments: Any) -> int:
        """Call a function, without its prefix fmi2 or fmi3, and return its status."""
        function = self.function(f"fmi{self.fmi}{name}")
        function.restype = c_int
        self.subject.note(f"fmi{self.fmi}{name}")
        return int(function(c_void_p(self.handle), *map(converted, arguments)))

    def do(self, name: str, *arguments: Any) -> None:
        """Call a function that the standard allows here.

        Raises
        ------
        CallFailed
            If its status says that it was not done.
        """
        status = self.call(name, *arguments)
        if status > TAKEN or status < 0:
            word = (
                STATUS_NAMES[status]
                if status in range(len(STATUS_NAMES))
                else "which FMI does not have"
            )
            raise CallFailed(
                f"fmi{self.fmi}{name} has status {status} ({word}){self.last_message()}"
            )

    # -- states of its life ------------------------------------------------------------------------

    def enter(self, start: float = 0.0) -> None:
        """Go to initialisation mode."""
        if self.fmi == 2:
            self.do("SetupExperiment", False, 0.0, start, False, 0.0)
            self.do("EnterInitializationMode")
        else:
            self.do("EnterInitializationMode", False, 0.0, start, False, 0.0)

    def leave(self) -> None:
        """Leave initialisation mode."""
        self.do("ExitInitializationMode")

    def step_status(self, t: float, h: float) -> int:
        """Do a step and return its status."""
        if self.fmi == 2:
            return self.call("DoStep", t, h, True)
        self.flags, self.last = (c_bool * 3)(), c_double(t + h)  # events, terminate, early return
        pointers = [byref(self.flags, k) for k in range(3)]
        return self.call("DoStep", t, h, True, *pointers, byref(self.last))

    def step(self, t: float, h: float) -> None:
        """Do a step.

        Raises
        ------
        CallFailed
            If its status says that it was not done.
        Ended
            If it asks to end the simulation.
        """
        status = self.step_status(t, h)
        if self.asks_to_end(status):
            raise Ended(f"it asks to end the simulation in the step from {t:g} s")
        if status > TAKEN:
            raise CallFailed(
                f"the step from {t:g} s to {t + h:g} s has status {status}"
                f" ({STATUS_NAMES[status % 6]}){self.last_message()}"
            )

    def asks_to_end(self, status: int) -> bool:
        """Say whether it asked to end the simulation in the last step, which had this status."""
        if self.fmi == 3:
            return bool(self.flags[1])
        answer = c_int(0)
        return (
            status == DISCARD
            and self.call("GetBooleanStatus", TERMINATED, byref(answer)) <= TAKEN
            and bool(answer.value)
        )

    def free(self) -> None:
        """Free it."""
        if self.handle:
            function = self.function(f"fmi{self.fmi}FreeInstance")
            function.restype = None
            self.subject.note(f"fmi{self.fmi}FreeInstance")
            handle, self.handle = self.handle, None
            function(c_void_p(handle))

    def __enter__(self) -> Instance:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:  # one that was left by an error may be in any state; its process ends
            self.free()

    # -- values ------------------------------------------------------------------------------------

    def access(self, verb: str, reference: int, kind: str, values: Any) -> int:
        """Call the getter or setter of a type for one variable and return its status; `values` is
        an array of C.
        """
        word = self.subject.typed(kind)[0]
        count = (len(values),) if self.fmi == 3 else ()
        return self.call(f"{verb}{word}", byref(c_uint(reference)), 1, values, *count)

    def read(self, name: str) -> tuple[int, list[Any]]:
        """Return status and values of a variable."""
        subject = self.subject
        kind = subject.variables[name].type
        values = (subject.typed(kind)[1] * subject.count(name))()
        return self.access("Get", subject.reference(name), kind, values), list(values)

    def write(self, name: str, given: Sequence[Any]) -> int:
        """Set a variable and return the status."""
        kind = self.subject.variables[name].type
        values = (self.subject.typed(kind)[1] * len(given))(*given)
        return self.access("Set", self.subject.reference(name), kind, values)

    def many(self, verb: str, names: Sequence[str], values: Any) -> int:
        """Call the getter or setter of real numbers for several variables; return its status."""
        word = "Real" if self.fmi == 2 else "Float64"
        count = (len(values),) if self.fmi == 3 else ()
        return self.call(f"{verb}{word}", self.references(names), len(names), values, *count)

    def references(self, names: Sequence[str]) -> Any:
        """Return the value references of some variables as an array of C."""
        return (c_uint * len(names))(*map(self.subject.reference, names))

    def get(self, name: str) -> list[Any]:
        """Return the values of a variable.

        Raises
        ------
        CallFailed
            If it cannot be read.
        """
        status, values = self.read(name)
        if status > TAKEN:
            raise CallFailed(
                f"{name} cannot be read: status {status}"
                f" ({STATUS_NAMES[status % 6]}){self.last_message()}"
            )
        return values

    def number(self, name: str) -> float:
        """Return the value of a variable that is a single number."""
        return float(self.get(name)[0])

    def vector(self, name: str, n: int) -> list[float]:
        """Return the n numbers that a function for continuous states or event indicators gives."""
        values = (c_double * n)()
        self.do(name, values, n)
        return list(values)

    # -- its whole state ---------------------------------------------------------------------------

    def get_state(self, state: c_void_p | None = None) -> c_void_p:
        """Return its state, in an old one if that is given."""
        state = c_void_p(None) if state is None else state
        self.do(STATE[self.fmi][0], byref(state))
        return state

    def set_state(self, state: c_void_p) -> None:
        """Go back to a state."""
        self.do(STATE[self.fmi][1], state)

    def free_state(self, state: c_void_p) -> None:
        """Free a state."""
        self.do(STATE[self.fmi][2], byref(state))

    def serialise(self, state: c_void_p) -> bytes:
        """Return a state as bytes."""
        size = c_size_t()
        self.do(STATE[self.fmi][3], state, byref(size))
        buffer = ctypes.create_string_buffer(size.value)
        self.do(STATE[self.fmi][4], state, buffer, size.value)
        return buffer.raw

    def deserialise(self, data: bytes) -> c_void_p:
        """Return the state of some bytes."""
        state = c_void_p(None)
        self.do(
            STATE[self.fmi][5],
            ctypes.create_string_buffer(data, len(data)),
            len(data),
            byref(state),
        )
        return state

    def directional(
        self, unknowns: Sequence[str], knowns: Sequence[str], seed: Sequence[float]
    ) -> list[float]:
        """Return the directional derivative of some variables; `seed` has one number per known."""
        return self._derivative("GetDirectionalDerivative", unknowns, knowns, seed, len(unknowns))

    def adjoint(
        self, unknowns: Sequence[str], knowns: Sequence[str], seed: Sequence[float]
    ) -> list[float]:
        """Return the adjoint derivative by some variables, in FMI 3; `seed` has a number for each
        unknown one.
        """
        return self._derivative("GetAdjointDerivative", unknowns, knowns, seed, len(knowns))

    def _derivative(
        self,
        name: str,
        unknowns: Sequence[str],
        knowns: Sequence[str],
        seed: Sequence[float],
        n: int,
    ) -> list[float]:
        seeds, out = (c_double * len(seed))(*seed), (c_double * n)()
        given = (self.references(unknowns), len(unknowns), self.references(knowns), len(knowns))
        self.do(name, *given, *((seeds, len(seed), out, n) if self.fmi == 3 else (seeds, out)))
        return list(out)


def converted(argument: Any) -> Any:
    """Pass Python's numbers as a C compiler passes them; arrays and pointers stay."""
    if argument is None:
        return c_void_p(None)
    if isinstance(argument, bool):
        return c_int(argument)
    if isinstance(argument, int):
        return c_size_t(argument)
    return c_double(argument) if isinstance(argument, float) else argument
