"""The functions of an FMU's library called as a host in C would call them: no checks in between,
nothing imported but ctypes.

Run as a script it executes one case of abuse.py (see there), so that a crash ends a process and not
the tests.
"""

from __future__ import annotations

import ctypes
from ctypes import c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from typing import Any

OK, ERROR = 0, 3
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
LOGGER = {
    2: ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p),
    3: ctypes.CFUNCTYPE(None, c_void_p, c_int, c_char_p, c_char_p),
}


class Callbacks(ctypes.Structure):
    """fmi2CallbackFunctions."""

    _fields_ = [
        ("logger", c_void_p),
        ("allocate", c_void_p),
        ("free", c_void_p),
        ("finished", c_void_p),
        ("environment", c_void_p),
    ]


def convert(argument: Any) -> Any:
    """Pass Python numbers as a C compiler would; arrays and pointers stay."""
    if isinstance(argument, bool):
        return c_int(argument)
    if isinstance(argument, int):
        return c_size_t(argument)
    if isinstance(argument, float):
        return c_double(argument)
    return argument


class Raw:
    """A loaded library: `info` holds library, fmi, token and the value references by name."""

    def __init__(self, info: dict[str, Any]) -> None:
        self.library = ctypes.CDLL(info["library"])
        self.fmi, self.token, self.vr = info["fmi"], info["token"].encode(), info["vr"]
        self.messages: list[tuple[int, bytes, bytes]] = []
        log2 = LOGGER[2](
            lambda environment, name, status, category, text: self.messages.append(
                (status, category, text)
            )
        )
        log3 = LOGGER[3](
            lambda environment, status, category, text: self.messages.append(
                (status, category, text)
            )
        )
        self.logger = log2 if self.fmi == 2 else log3
        self.callbacks = Callbacks(ctypes.cast(self.logger, c_void_p), None, None, None, None)

    def call(self, name: str, *arguments: Any) -> int:
        """Call a function, without the prefix fmi2 or fmi3, and return its status."""
        function = getattr(self.library, f"fmi{self.fmi}{name}")
        function.restype = c_int
        return int(function(*map(convert, arguments)))

    def instantiate(
        self,
        kind: str = "cs",
        name: Any = b"one",
        token: Any = ...,
        logging: bool = True,
        callbacks: Any = ...,
    ) -> int:
        """Return a handle, or 0."""
        token = self.token if token is ... else token
        if self.fmi == 2:
            function, given = (
                self.library.fmi2Instantiate,
                ctypes.byref(self.callbacks) if callbacks is ... else callbacks,
            )
            arguments = (name, 1 if kind == "cs" else 0, token, b"", given, 0, int(logging))
        else:
            function = (
                self.library.fmi3InstantiateCoSimulation
                if kind == "cs"
                else self.library.fmi3InstantiateModelExchange
            )
            logger = ctypes.cast(self.logger, c_void_p) if callbacks is ... else callbacks
            middle = (False, False, None, 0) if kind == "cs" else ()
            end = (None,) if kind == "cs" else ()
            arguments = (name, token, b"", False, logging, *middle, None, logger, *end)
        function.restype = c_size_t
        return int(function(*(c_void_p(None) if a is None else convert(a) for a in arguments)))

    def enter(self, handle: int, start: float = 0.0, stop: float | None = None) -> int:
        """Go to initialization mode."""
        times = (start, stop is not None, stop or 0.0)
        if self.fmi == 2:
            status = self.call("SetupExperiment", handle, False, 0.0, *times)
            return status or self.call("EnterInitializationMode", handle)
        return self.call("EnterInitializationMode", handle, False, 0.0, *times)

    def start(
        self, handle: int, start: float = 0.0, stop: float | None = None, **values: float
    ) -> int:
        """Go through initialization with some values set."""
        status = self.enter(handle, start, stop)
        for name, value in values.items():
            status = status or self.set(handle, name, value)
        return status or self.call("ExitInitializationMode", handle)

    def running(self, **values: float) -> int:
        """Return a handle of an instance that is ready to step."""
        handle = self.instantiate()
        assert handle
        assert self.start(handle, **values) == OK
        return handle

    def references(self, *names: str | int) -> Any:
        return (c_uint * len(names))(*(self.vr[n] if isinstance(n, str) else n for n in names))

    def _typed(self, kind: str) -> tuple[str, Any]:
        if kind == "Real":
            return ("Real" if self.fmi == 2 else "Float64"), c_double
        if kind == "Boolean":
            return "Boolean", (c_int if self.fmi == 2 else ctypes.c_bool)
        if kind == "Int32":
            return ("Integer" if self.fmi == 2 else "Int32"), c_int
        return ("Integer" if self.fmi == 2 else "Int64"), (
            c_int if self.fmi == 2 else ctypes.c_int64
        )

    def _access(
        self, verb: str, handle: int, kind: str, references: Any, values: Any, n: int
    ) -> int:
        count = (n,) if self.fmi == 3 else ()
        return self.call(f"{verb}{self._typed(kind)[0]}", handle, references, n, values, *count)

    def set(self, handle: int, name: str | int, value: float, kind: str = "Real") -> int:
        values = (self._typed(kind)[1] * 1)(value)
        return self._access("Set", handle, kind, self.references(name), values, 1)

    def read(self, handle: int, name: str | int, kind: str = "Real") -> tuple[int, float]:
        """Return (status, value)."""
        values = (self._typed(kind)[1] * 1)()
        return self._access("Get", handle, kind, self.references(name), values, 1), values[0]

    def get(self, handle: int, *names: str | int) -> list[float]:
        values = (c_double * len(names))()
        assert (
            self._access("Get", handle, "Real", self.references(*names), values, len(names)) == OK
        ), self.messages
        return list(values)

    def step(self, handle: int, point: float, h: float) -> int:
        if self.fmi == 2:
            return self.call("DoStep", handle, point, h, True)
        flags, last = (ctypes.c_bool * 3)(), c_double()
        pointers = [ctypes.byref(flags, k) for k in range(3)]
        return self.call("DoStep", handle, point, h, True, *pointers, ctypes.byref(last))

    def free(self, handle: int) -> None:
        self.call("FreeInstance", handle)

    # -- states of the whole instance --------------------------------------------------------------

    def get_state(self, handle: int, state: c_void_p | None = None) -> tuple[int, c_void_p]:
        state = c_void_p(None) if state is None else state
        return self.call(STATE[self.fmi][0], handle, ctypes.byref(state)), state

    def set_state(self, handle: int, state: Any) -> int:
        return self.call(STATE[self.fmi][1], handle, state)

    def free_state(self, handle: int, state: Any) -> int:
        return self.call(STATE[self.fmi][2], handle, ctypes.byref(state))

    def serialise(self, handle: int, state: Any) -> bytes:
        size = c_size_t()
        assert self.call(STATE[self.fmi][3], handle, state, ctypes.byref(size)) == OK
        buffer = ctypes.create_string_buffer(size.value)
        assert self.call(STATE[self.fmi][4], handle, state, buffer, size.value) == OK
        return buffer.raw

    def deserialise(self, handle: int, data: bytes) -> tuple[int, c_void_p]:
        state = c_void_p(None)
        return self.call(STATE[self.fmi][5], handle, data, len(data), ctypes.byref(state)), state

    def derivative(
        self, handle: int, unknowns: list[str], knowns: list[str], seed: list[float]
    ) -> tuple[int, list[float]]:
        """Return (status, directional derivative)."""
        out = (c_double * len(unknowns))()
        seeds = (c_double * len(knowns))(*seed)
        given = (self.references(*unknowns), len(unknowns), self.references(*knowns), len(knowns))
        vectors = (seeds, len(knowns), out, len(unknowns)) if self.fmi == 3 else (seeds, out)
        return self.call("GetDirectionalDerivative", handle, *given, *vectors), list(out)
