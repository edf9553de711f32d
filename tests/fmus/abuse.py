"""Every kind of misuse of an FMU, each of which must end in an FMI error with one message that says
why.

``python abuse.py INFO CASE`` runs one case and exits with 0 if the FMU behaved; INFO is JSON (see
`Raw`).
"""

from __future__ import annotations

import ctypes
import json
import math
import random
import sys
from collections.abc import Callable
from ctypes import c_double, c_size_t, c_void_p
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from raw import ERROR, OK, STATE, Raw

CASES: dict[str, Callable[[Raw], None]] = {}


def case(function: Callable[[Raw], None]) -> Callable[[Raw], None]:
    CASES[function.__name__] = function
    return function


def refused(raw: Raw, status: int, *words: str) -> None:
    """The call returned an error and logged exactly one message, of the declared category, with
    these words.
    """
    assert status == ERROR, (status, raw.messages)
    assert len(raw.messages) == 1, raw.messages
    level, category, text = raw.messages.pop()
    assert (level, category) == (ERROR, b"logStatusError")
    for word in words:
        assert word in text.decode(), (word, text)


def alive(raw: Raw, handle: int) -> None:
    """A refused call has changed nothing: the instance goes on as one that was never abused."""
    fresh = raw.running()
    for instance in (handle, fresh):
        assert raw.set(instance, "u", 3.0) == OK
        assert raw.step(instance, 0.0, 1e-3) == OK
    assert raw.get(handle, "theta", "v") == raw.get(fresh, "theta", "v")
    assert raw.messages == []
    raw.free(fresh)


# -- values ----------------------------------------------------------------------------------------


@case
def input_not_finite(raw: Raw) -> None:
    handle = raw.running()
    for bad in (math.nan, math.inf, -math.inf):
        refused(raw, raw.set(handle, "u", bad), "u = ", "finite")
    alive(raw, handle)


@case
def initialization_without_an_experiment(raw: Raw) -> None:
    handle = raw.instantiate()
    if raw.fmi == 2:  # FMI 3 gives the times with the call itself
        refused(raw, raw.call("EnterInitializationMode", handle), "fmi2SetupExperiment")
    assert raw.start(handle) == OK
    alive(raw, handle)


@case
def input_outside_its_limits(raw: Raw) -> None:
    handle = raw.running()
    refused(raw, raw.set(handle, "load_scale", -0.1), "load_scale = -0.1", "[0, ")
    alive(raw, handle)


@case
def unknown_value_reference(raw: Raw) -> None:
    handle = raw.running()
    for bad in (len(raw.vr) + 1000, 2**32 - 1, 2**31):
        refused(raw, raw.read(handle, bad)[0], str(bad))
        refused(raw, raw.set(handle, bad, 1.0), str(bad))
    alive(raw, handle)


@case
def hidden_variables(raw: Raw) -> None:
    """What modelDescription.xml does not name can be neither read nor set."""
    handle = raw.running()
    hidden = [k for k in range(max(raw.vr.values()) + 200) if k not in raw.vr.values()]
    assert hidden
    for reference in hidden:
        refused(raw, raw.read(handle, reference)[0], str(reference))
        refused(raw, raw.set(handle, reference, 1.0), str(reference))
    alive(raw, handle)


@case
def wrong_type(raw: Raw) -> None:
    handle = raw.running()
    for name, own in (("theta", "Real"), ("law", "Integer"), ("true.Fc_valid", "Boolean")):
        for kind in ("Real", "Integer", "Boolean"):
            if kind == own:
                assert raw.read(handle, name, kind)[0] == OK
            else:
                refused(raw, raw.read(handle, name, kind)[0], name, "type")
    text = "GetString"
    count = (1,) if raw.fmi == 3 else ()
    refused(
        raw,
        raw.call(text, handle, raw.references("theta"), 1, ctypes.create_string_buffer(8), *count),
        "type",
    )
    alive(raw, handle)


@case
def null_arrays(raw: Raw) -> None:
    handle, null = raw.running(), c_void_p(None)
    count = (1,) if raw.fmi == 3 else ()
    for verb in ("Get", "Set"):
        for kind in ("Real", "Integer", "Boolean"):
            kind = {"Real": "Float64", "Integer": "Int64"}.get(kind, kind) if raw.fmi == 3 else kind
            refused(
                raw, raw.call(f"{verb}{kind}", handle, null, 1, (c_double * 1)(), *count), "NULL"
            )
            refused(
                raw, raw.call(f"{verb}{kind}", handle, raw.references("u"), 1, null, *count), "NULL"
            )
            assert raw.call(f"{verb}{kind}", handle, null, 0, null, *(0 for _ in count)) == OK
    alive(raw, handle)


@case
def computed_variables_set(raw: Raw) -> None:
    handle = raw.instantiate()
    refused(raw, raw.set(handle, "theta", 1.0), "theta", "computed")
    refused(raw, raw.set(handle, "true.alpha2", 1.0), "true.alpha2", "computed")
    refused(raw, raw.set(handle, "true.alpha2_valid", 1, "Boolean"), "computed")
    assert raw.start(handle) == OK
    refused(raw, raw.set(handle, "theta", 1.0), "theta", "computed")
    alive(raw, handle)


@case
def parameter_after_initialization(raw: Raw) -> None:
    handle = raw.running()
    refused(raw, raw.set(handle, "J", 0.002), "J", "parameter", "before")
    refused(raw, raw.set(handle, "law", 2, "Integer"), "law", "parameter", "before")
    alive(raw, handle)


@case
def parameter_outside_its_interval(raw: Raw) -> None:
    handle = raw.instantiate()
    refused(raw, raw.set(handle, "J", -1.0), "J = -1", "[1e-09, 1e+06]", "kg.m2")
    refused(raw, raw.set(handle, "J", math.nan), "J = ")
    assert raw.start(handle) == OK
    alive(raw, handle)


@case
def enumeration_outside_its_items(raw: Raw) -> None:
    handle = raw.instantiate()
    for bad in (0, -1, 99):
        refused(raw, raw.set(handle, "law", bad, "Integer"), "law", "outside [1, ")
    assert raw.start(handle) == OK
    alive(raw, handle)


@case
def several_values_one_wrong(raw: Raw) -> None:
    """A refused call sets none of its values."""
    handle = raw.running()
    values, count = (c_double * 2)(7.0, math.nan), ((2,) if raw.fmi == 3 else ())
    name = "SetReal" if raw.fmi == 2 else "SetFloat64"
    refused(raw, raw.call(name, handle, raw.references("tau_load", "u"), 2, values, *count), "u = ")
    assert raw.get(handle, "tau_load") == [0.0]
    alive(raw, handle)


# -- steps -----------------------------------------------------------------------------------------


@case
def step_size(raw: Raw) -> None:
    handle = raw.running()
    for bad in (0.0, -1e-3, math.nan, math.inf, -math.inf):
        refused(raw, raw.step(handle, 0.0, bad), "step size")
    alive(raw, handle)
    refused(raw, raw.step(handle, 1e-3, 1e-30), "too small")


@case
def communication_point(raw: Raw) -> None:
    handle = raw.running()
    for bad in (1e-3, -1e-3, 1e-8, math.nan, math.inf):
        refused(raw, raw.step(handle, bad, 1e-3), "communication point")
    alive(raw, handle)


@case
def beyond_the_stop_time(raw: Raw) -> None:
    handle = raw.instantiate()
    assert raw.start(handle, stop=0.002) == OK
    assert raw.step(handle, 0.0, 1e-3) == OK
    refused(raw, raw.step(handle, 1e-3, 2e-3), "stop time")
    assert raw.step(handle, 1e-3, 1e-3) == OK


@case
def too_many_internal_steps(raw: Raw) -> None:
    """The state is that of before the step; the instance has failed, and a saved state or
    a reset revives it.
    """
    for law in (1, 2, 3):
        handle = raw.instantiate()
        assert raw.set(handle, "law", law, "Integer") == OK
        assert raw.start(handle, u=5.0) == OK
        assert raw.step(handle, 0.0, 0.1) == OK
        before = raw.get(handle, "theta", "v", "F", "theta_enc", "v_enc")
        saved = raw.get_state(handle)[1]
        refused(raw, raw.step(handle, 0.1, 1000.0), "solver.max_steps")
        assert raw.get(handle, "theta", "v", "F", "theta_enc", "v_enc") == before
        refused(raw, raw.step(handle, 0.1, 1e-3), "failed")
        refused(raw, raw.set(handle, "u", 1.0), "failed")
        refused(raw, raw.call("Terminate", handle), "failed")
        assert raw.set_state(handle, saved) == OK
        assert raw.step(handle, 0.1, 1e-3) == OK
        raw.free_state(handle, saved)
        assert raw.call("Reset", handle) == OK
        assert raw.start(handle) == OK
        alive(raw, handle)


@case
def failure_half_way(raw: Raw) -> None:
    """Many internal steps have been done when the limit is met: all of them are taken back, hidden
    states included.
    """
    for law in (1, 2, 3):
        twins = [raw.instantiate(), raw.instantiate()]
        for handle in twins:
            assert raw.set(handle, "law", law, "Integer") == OK
            assert raw.start(handle, u=5.0, **{"solver.max_steps": 55.0}) == OK
            for k in range(100):
                assert raw.step(handle, 1e-3 * k, 1e-3) == OK
            assert raw.set(handle, "u", -5.0) == OK
        saved = raw.get_state(twins[0])[1]
        before = raw.get(twins[0], "theta", "v", "F", "theta_enc", "v_enc")
        assert raw.step(twins[0], 0.1, 0.05) == ERROR
        raw.messages.clear()
        assert raw.get(twins[0], "theta", "v", "F", "theta_enc", "v_enc") == before
        failed = raw.serialise(twins[0], raw.get_state(twins[0])[1])
        places = [
            k
            for k, (a, b) in enumerate(zip(failed, raw.serialise(twins[0], saved), strict=True))
            if a != b
        ]
        assert len(places) < 40  # the checksum, the mode, and that outputs are to be computed again
        assert raw.set_state(twins[0], saved) == OK
        for k in range(100, 120):
            assert [raw.step(handle, 1e-3 * k, 1e-3) for handle in twins] == [OK, OK]
        assert raw.get(twins[0], "theta", "v", "F") == raw.get(twins[1], "theta", "v", "F")


@case
def divergence(raw: Raw) -> None:
    """A model that cannot be integrated ends in an error, not in NaN."""
    handle = raw.instantiate()
    assert raw.set(handle, "law", 2, "Integer") == OK
    friction = {"lugre.sigma0": 1e9, "lugre.Fc": 1e-9, "lugre.Fs": 1e6, "lugre.vs": 1e-6}
    assert raw.start(handle, J=1e-9, b=1e6, a2=0.0, u_max=1e6, u=1e6, **friction) == OK
    for k in range(10000):
        status = raw.step(handle, 1e-3 * k, 1e-3)
        assert all(map(math.isfinite, raw.get(handle, "theta", "v", "F")))
        if status != OK:
            break
    else:
        raise AssertionError("it went well, so that this tests nothing")
    refused(raw, status)


# -- the order of calls ----------------------------------------------------------------------------


@case
def before_initialization(raw: Raw) -> None:
    handle = raw.instantiate()
    refused(raw, raw.step(handle, 0.0, 1e-3), "instantiated")
    refused(raw, raw.read(handle, "theta")[0], "instantiated")
    refused(raw, raw.call("ExitInitializationMode", handle), "instantiated")
    refused(raw, raw.call("Terminate", handle), "instantiated")
    assert raw.start(handle) == OK
    alive(raw, handle)


@case
def during_initialization(raw: Raw) -> None:
    handle = raw.instantiate()
    assert raw.enter(handle) == OK
    refused(raw, raw.step(handle, 0.0, 1e-3), "initialization")
    refused(raw, raw.enter(handle), "initialization")
    refused(raw, raw.call("Terminate", handle), "initialization")
    assert raw.call("ExitInitializationMode", handle) == OK
    alive(raw, handle)


@case
def after_initialization(raw: Raw) -> None:
    handle = raw.running()
    refused(raw, raw.enter(handle), "step mode")
    refused(raw, raw.call("ExitInitializationMode", handle), "step mode")
    alive(raw, handle)
    assert raw.call("Terminate", handle) == OK
    assert raw.read(handle, "theta")[0] == OK
    refused(raw, raw.step(handle, 1e-3, 1e-3), "terminated")
    refused(raw, raw.set(handle, "u", 1.0), "terminated")
    refused(raw, raw.call("Terminate", handle), "terminated")
    refused(raw, raw.enter(handle), "terminated")


@case
def start_time(raw: Raw) -> None:
    handle = raw.instantiate()
    for bad in (math.nan, math.inf):
        refused(raw, raw.enter(handle, bad), "start time")
    for bad in (math.nan, -1.0):
        refused(raw, raw.enter(handle, 0.0, bad), "stop time")
    assert raw.start(handle) == OK
    alive(raw, handle)


@case
def model_exchange_functions(raw: Raw) -> None:
    handle = raw.running()
    array = (c_double * 8)()
    derivatives = "GetDerivatives" if raw.fmi == 2 else "GetContinuousStateDerivatives"
    refused(raw, raw.call("EnterEventMode", handle), "Co-Simulation")
    refused(raw, raw.call("EnterContinuousTimeMode", handle), "step mode")
    refused(raw, raw.call("SetTime", handle, 1.0), "step mode")
    for name in (
        "GetContinuousStates",
        derivatives,
        "SetContinuousStates",
        "GetNominalsOfContinuousStates",
    ):
        refused(raw, raw.call(name, handle, array, 3), "Co-Simulation")
    alive(raw, handle)
    assert raw.instantiate("me") == 0
    refused(raw, ERROR, "Model Exchange")


# functions and types of things that our FMUs do not have
ABSENT = {
    2: """
        CancelStep GetStatus GetIntegerStatus GetStringStatus SetRealInputDerivatives
        GetRealOutputDerivatives
    """,
    3: """
        GetClock SetClock GetIntervalDecimal GetIntervalFraction GetShiftDecimal GetShiftFraction
        SetIntervalDecimal SetIntervalFraction SetShiftDecimal SetShiftFraction
        ActivateModelPartition EvaluateDiscreteStates EnterStepMode EnterConfigurationMode
        ExitConfigurationMode GetOutputDerivatives GetNumberOfVariableDependencies
        GetVariableDependencies GetAdjointDerivative
    """,
}
ABSENT_TYPES = {2: "String", 3: "Float32 Int8 UInt8 Int16 UInt16 Int32 UInt32 UInt64"}


@case
def what_is_not_there(raw: Raw) -> None:
    """Functions of things that this FMU does not have."""
    handle, references = raw.running(), raw.references("u")
    buffer = ctypes.create_string_buffer(256)
    for name in ABSENT[raw.fmi].split():
        refused(
            raw,
            raw.call(name, handle, references, 1, buffer, buffer, buffer, 1, buffer, 1),
            f"fmi{raw.fmi}{name}",
        )
    for name in ABSENT_TYPES[raw.fmi].split():
        for verb in ("Get", "Set"):
            refused(raw, raw.call(f"{verb}{name}", handle, references, 1, buffer, 1), "type")
    refused(raw, raw.call("GetEventIndicators", handle, buffer, 1), "event indicators")
    refused(raw, raw.derivative(handle, ["F"], ["u"], [1.0])[0], "derivatives")
    alive(raw, handle)


# -- instances -------------------------------------------------------------------------------------


@case
def instantiation(raw: Raw) -> None:
    for token in (b"wrong", b"", raw.token[:-1], raw.token + b"x", None):
        assert raw.instantiate(token=token) == 0
        refused(raw, ERROR, "GUID", raw.token.decode())
    for name in (b"", None):
        assert raw.instantiate(name=name) == 0
        refused(raw, ERROR, "name")
    assert raw.instantiate(token=b"wrong", logging=False) == 0
    assert raw.messages == []


@case
def no_callbacks(raw: Raw) -> None:
    handle = raw.instantiate(callbacks=None)
    if raw.fmi == 2:  # the standard asks for a logger
        assert handle == 0
        raw.callbacks.logger = None
        assert raw.instantiate() == 0
    else:
        assert raw.start(handle) == OK
        assert raw.set(handle, "u", math.nan) == ERROR
        assert raw.instantiate(token=b"wrong", callbacks=None) == 0


@case
def scheduled_execution(raw: Raw) -> None:
    if raw.fmi == 3:
        function = raw.library.fmi3InstantiateScheduledExecution
        function.restype = c_size_t
        nulls = [c_void_p(None)] * 3
        assert not function(
            b"a",
            raw.token,
            b"",
            False,
            True,
            c_void_p(None),
            ctypes.cast(raw.logger, c_void_p),
            *nulls,
        )
        refused(raw, ERROR, "Scheduled Execution")


@case
def event_mode_and_intermediate_variables(raw: Raw) -> None:
    if raw.fmi == 3:
        function, logger, null = (
            raw.library.fmi3InstantiateCoSimulation,
            ctypes.cast(raw.logger, c_void_p),
            c_void_p(None),
        )
        function.restype = c_size_t
        assert not function(b"a", raw.token, b"", 0, 1, 1, 0, null, c_size_t(0), null, logger, null)
        refused(raw, ERROR, "event mode")
        assert not function(
            b"a", raw.token, b"", 0, 1, 0, 0, raw.references("u"), c_size_t(1), null, logger, null
        )
        refused(raw, ERROR, "intermediate")


def functions(raw: Raw) -> list[str]:
    """Return all functions that take an instance."""
    header = Path(sys.argv[3]).read_text(encoding="utf-8")
    prefix = f"fmi{raw.fmi}"
    names = {
        word.removesuffix("TYPE").removeprefix(prefix)
        for word in header.replace("(", " ").split()
        if word.endswith("TYPE")
    }
    names = {name for name in names if hasattr(raw.library, prefix + name)}
    expected = {2: 44, 3: 75}[raw.fmi]
    assert len(names) == expected, (len(names), sorted(names))
    return sorted(
        name
        for name in names
        if not name.startswith(("Instantiate", "GetVersion", "GetTypesPlatform"))
    )


def every_function_refuses(raw: Raw, handles: list[int]) -> None:
    for name in functions(raw):
        for handle in handles:
            status = raw.call(name, handle, *[0] * 12)
            assert name == "FreeInstance" or status == ERROR, (name, handle, status)


@case
def invented_handles(raw: Raw) -> None:
    living = raw.running()
    generator = random.Random(1)
    near = [living + k for k in (-8, -1, 1, 8, 64)]
    every_function_refuses(
        raw, [0, 1, 8, 4096, 2**64 - 1, *near, *(generator.getrandbits(64) for _ in range(50))]
    )
    alive(raw, living)


@case
def stale_handle(raw: Raw) -> None:
    old = raw.running()
    raw.free(old)
    every_function_refuses(raw, [old])
    others = [raw.running() for _ in range(3)]  # one of them has the freed place
    assert old not in others
    every_function_refuses(raw, [old])
    raw.free(old)
    for handle in others:
        alive(raw, handle)


@case
def foreign_handle(raw: Raw) -> None:
    """Instances of the same FMU loaded from another file, and states in the place of instances."""
    other = Raw({"library": sys.argv[4], "fmi": raw.fmi, "token": raw.token.decode(), "vr": raw.vr})
    assert other.library._handle != raw.library._handle
    foreign, own = other.running(), raw.running()
    state = raw.get_state(own)[1]
    every_function_refuses(raw, [foreign, state.value or 0])
    refused(raw, raw.set_state(own, other.get_state(foreign)[1]), "no FMU state")
    refused(raw, raw.set_state(own, c_size_t(own)), "no FMU state")
    alive(raw, own)


# -- states of the whole instance ------------------------------------------------------------------


@case
def invented_states(raw: Raw) -> None:
    handle = raw.running()
    freed = raw.get_state(handle)[1]
    stale = c_void_p(freed.value)
    assert raw.free_state(handle, freed) == OK
    assert freed.value is None
    assert raw.free_state(handle, freed) == OK  # NULL is ignored
    for bad in (stale.value or 0, 1, 4096, 2**64 - 1):
        state = c_void_p(bad)
        refused(raw, raw.set_state(handle, state), "no FMU state")
        refused(raw, raw.free_state(handle, c_void_p(bad)), "no FMU state")
        refused(raw, raw.get_state(handle, c_void_p(bad))[0], "no FMU state")
        refused(
            raw,
            raw.call(STATE[raw.fmi][3], handle, state, ctypes.byref(c_size_t())),
            "no FMU state",
        )
        refused(
            raw,
            raw.call(STATE[raw.fmi][4], handle, state, ctypes.create_string_buffer(9), 9),
            "no FMU state",
        )
    refused(raw, raw.set_state(handle, c_void_p(None)), "no FMU state")
    refused(raw, raw.call(STATE[raw.fmi][0], handle, c_void_p(None)), "NULL")
    refused(raw, raw.call(STATE[raw.fmi][2], handle, c_void_p(None)), "NULL")
    alive(raw, handle)


@case
def damaged_bytes(raw: Raw) -> None:
    handle = raw.running()
    state = raw.get_state(handle)[1]
    data = raw.serialise(handle, state)
    refused(
        raw,
        raw.call(
            STATE[raw.fmi][4], handle, state, ctypes.create_string_buffer(len(data)), len(data) - 1
        ),
        "bytes",
    )
    for size in (0, 1, 8, len(data) // 2, len(data) - 1):
        refused(raw, raw.deserialise(handle, data[:size])[0], "wrong size")
    refused(raw, raw.deserialise(handle, data + b"\0")[0], "wrong size")
    for k in range(len(data)):
        damaged = bytearray(data)
        damaged[k] ^= 1 << (k % 8)
        refused(raw, raw.deserialise(handle, bytes(damaged))[0], "damaged")
    null = c_void_p(None)
    refused(raw, raw.call(STATE[raw.fmi][5], handle, null, len(data), ctypes.byref(null)), "NULL")
    refused(raw, raw.call(STATE[raw.fmi][5], handle, data, len(data), c_void_p(None)), "NULL")
    assert raw.deserialise(handle, data)[0] == OK
    alive(raw, handle)


# -- logging ---------------------------------------------------------------------------------------


@case
def logging_is_filtered(raw: Raw) -> None:
    handle, null = raw.instantiate(logging=False), c_void_p(None)
    assert raw.start(handle) == OK

    def messages() -> int:
        assert raw.set(handle, "u", math.nan) == ERROR
        count = len(raw.messages)
        raw.messages.clear()
        return count

    category = (ctypes.c_char_p * 1)(b"logStatusError")
    assert messages() == 0
    assert raw.call("SetDebugLogging", handle, True, 0, null) == OK
    assert messages() == 1
    assert raw.call("SetDebugLogging", handle, False, 0, null) == OK
    assert messages() == 0
    assert raw.call("SetDebugLogging", handle, True, 1, category) == OK
    assert messages() == 1
    refused(
        raw,
        raw.call("SetDebugLogging", handle, True, 1, (ctypes.c_char_p * 1)(b"logEverything")),
        "category",
    )
    refused(
        raw, raw.call("SetDebugLogging", handle, True, 1, (ctypes.c_char_p * 1)(None)), "category"
    )
    refused(raw, raw.call("SetDebugLogging", handle, True, 1, null), "NULL")


if __name__ == "__main__":
    CASES[sys.argv[2]](Raw(json.loads(sys.argv[1])))
