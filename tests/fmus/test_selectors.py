"""The integer beside the enumeration that chooses law or method, and the output that tells which
one runs.
"""

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave

from bristle.observer import methods
from bristle.plant.friction import laws

H = 1e-3
NUMBERED = {"plant": ("law", list(laws())), "observer": ("method", list(methods()))}
NATIVE = [(what, fmi) for what in NUMBERED for fmi in (2, 3)]
KIND = {False: "Integer", True: "Int32"}  # of the enumeration, of the integer beside it


def chosen(raw, name, number):
    """Return an instance whose law or method is chosen by the variable `name`."""
    handle = raw.instantiate()
    assert raw.set(handle, name, number, KIND[name.endswith("_index")]) == 0, raw.messages
    assert raw.start(handle) == 0, raw.messages
    return handle


def driven(fmu):
    """Return the inputs that may have either sign."""
    return [name for name in fmu.names("input") if name != "load_scale"]


def rows(raw, handle, fmu, first=0, last=8):
    """Return all real outputs after each step, as bytes."""
    outputs, inputs = fmu.names("output"), driven(fmu)
    found = []
    for k in range(first, last):
        for name in inputs:
            assert raw.set(handle, name, float(3.0 * np.sin(0.2 * k + len(name)))) == 0
        assert raw.step(handle, H * k, H) == 0, raw.messages
        found.append(raw.get(handle, *outputs))
    return np.array(found).tobytes()


def running(raw, handle, selector):
    return raw.read(handle, f"{selector}_running", "Int32")


@pytest.mark.sampled(3)
@pytest.mark.parametrize("case", NATIVE, ids=str)
def test_the_integer_chooses_as_the_enumeration_does(built, Raw, case):
    what, fmi = case
    selector, names = NUMBERED[what]
    fmu = built(what, fmi=fmi)
    raw, seen = Raw(fmu.info), set()
    for number in range(1, len(names) + 1):
        one, two = chosen(raw, selector, number), chosen(raw, f"{selector}_index", number)
        assert running(raw, one, selector) == running(raw, two, selector) == (0, number)
        expected = rows(raw, one, fmu)
        assert rows(raw, two, fmu) == expected, names[number - 1]
        seen.add(expected)
        raw.free(one)
        raw.free(two)
    assert len(seen) > 0.3 * len(names)  # many methods differ only later


@pytest.mark.sampled(3)
@pytest.mark.parametrize("case", NATIVE, ids=str)
def test_a_choice_that_cannot_be_is_refused_and_never_the_default(built, Raw, case):
    """One message, at initialisation, also where a host ignores the status of the calls before."""
    what, fmi = case
    selector, names = NUMBERED[what]
    raw = Raw(built(what, fmi=fmi).info)
    for index, enumeration in (
        (-1, None),
        (len(names) + 1, None),
        (2**31 - 1, None),
        (-(2**31), None),
        (3, 4),
        (4, 3),
    ):
        handle = raw.instantiate()
        raw.set(handle, f"{selector}_index", index, "Int32")
        if enumeration:
            raw.set(handle, selector, enumeration, "Integer")
        assert raw.enter(handle) == 0
        assert raw.messages == []
        assert raw.call("ExitInitializationMode", handle) == 3
        [(_, _, text)] = raw.messages
        assert f"{selector}_index = ".encode() in text
        assert (
            f"[0, {len(names)}]"
            if enumeration is None
            else f"contradicts {selector} = {enumeration}"
        ).encode() in text
        assert raw.step(handle, 0.0, H) == 3
        assert running(raw, handle, selector)[0] == 3
        raw.messages.clear()
        raw.free(handle)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("case", NATIVE, ids=str)
def test_both_may_say_the_same_and_zero_says_nothing(built, Raw, case):
    what, fmi = case
    selector, _ = NUMBERED[what]
    raw = Raw(built(what, fmi=fmi).info)
    for enumeration, index in ((3, 3), (3, 0)):
        handle = raw.instantiate()
        assert raw.set(handle, selector, enumeration, "Integer") == 0
        assert raw.set(handle, f"{selector}_index", index, "Int32") == 0
        assert raw.start(handle) == 0
        assert running(raw, handle, selector) == (0, 3)
        assert raw.set(handle, f"{selector}_index", 5, "Int32") == 3  # fixed from now on
        assert raw.set(handle, f"{selector}_running", 5, "Int32") == 3
        assert running(raw, handle, selector) == (0, 3)
        raw.messages.clear()
        raw.free(handle)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("case", NATIVE, ids=str)
def test_what_runs_is_part_of_the_state(built, Raw, case):
    """A state put into an instance of another law: the output tells the law of the state, and its
    digits follow.
    """
    what, fmi = case
    selector, _ = NUMBERED[what]
    fmu = built(what, fmi=fmi)
    raw = Raw(fmu.info)
    first, other = chosen(raw, f"{selector}_index", 5), chosen(raw, f"{selector}_index", 2)
    rows(raw, first, fmu)
    _, state = raw.get_state(first)
    expected = rows(raw, first, fmu, 8, 20)
    status, restored = raw.deserialise(other, raw.serialise(first, state))
    assert status == raw.set_state(other, restored) == 0
    assert running(raw, other, selector) == (0, 5)
    assert rows(raw, other, fmu, 8, 20) == expected
    assert raw.call("Reset", other) == 0
    assert raw.set(other, f"{selector}_index", 3, "Int32") == 0
    assert raw.start(other) == 0
    assert running(raw, other, selector) == (0, 3)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("what", list(NUMBERED))
def test_the_description_numbers_the_variants(built, what, fmi):
    selector, names = NUMBERED[what]
    variables = {v.name: v for v in built(what, fmi=fmi).description.modelVariables}
    index, now = variables[f"{selector}_index"], variables[f"{selector}_running"]
    table = ", ".join(f"{number} {name}" for number, name in enumerate(names, start=1))
    assert index.type == now.type == ("Integer" if fmi == 2 else "Int32")
    assert (
        index.causality,
        index.variability,
        int(index.start),
        int(index.min),
        int(index.max),
    ) == (
        "parameter",
        "fixed",
        0,
        0,
        len(names),
    )
    assert (now.causality, now.variability, int(now.min), int(now.max)) == (
        "output",
        "discrete",
        1,
        len(names),
    )
    assert table in index.description
    assert table in now.description


# -- the pythonfmu FMU -----------------------------------------------------------------------------


class Slave:
    """An instance of a pythonfmu FMU; `values` are set in initialization mode, which is left."""

    def __init__(self, fmu, **values):
        d = fmu.description
        self.vr = {v.name: v.valueReference for v in d.modelVariables}
        self.outputs = [self.vr[name] for name in fmu.names("output")]
        self.inputs = [self.vr[name] for name in driven(fmu)]
        self.fmu = FMU2Slave(
            guid=d.guid,
            unzipDirectory=str(fmu.folder),
            modelIdentifier=d.coSimulation.modelIdentifier,
            instanceName="one",
        )
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        for name, value in values.items():
            self.fmu.setInteger([self.vr[name]], [value])
        self.fmu.exitInitializationMode()

    def running(self, selector):
        return self.fmu.getInteger([self.vr[f"{selector}_running"]])[0]

    def rows(self):
        found = []
        for k in range(4):
            self.fmu.setReal(self.inputs, [3.0 * np.sin(0.2 * k)] * len(self.inputs))
            self.fmu.doStep(H * k, H)
            found.append(self.fmu.getReal(self.outputs))
        return np.array(found).tobytes()


@pytest.mark.sampled(3)
@pytest.mark.parametrize("what", list(NUMBERED))
def test_the_python_twin_chooses_alike(built, what):
    selector, names = NUMBERED[what]
    fmu = built(what, kind="python")
    for number in (1, 3):
        one, two = Slave(fmu, **{selector: number}), Slave(fmu, **{f"{selector}_index": number})
        assert one.running(selector) == two.running(selector) == number
        assert one.rows() == two.rows()
        state = two.fmu.getFMUState()
        other = Slave(fmu, **{f"{selector}_index": 2})
        other.fmu.setFMUState(state)
        assert other.running(selector) == number
        for slave in (one, two, other):
            slave.fmu.freeInstance()
    for refused in (
        {f"{selector}_index": -1},
        {f"{selector}_index": len(names) + 1},
        {f"{selector}_index": 3, selector: 4},
    ):
        with pytest.raises(FMICallException):
            Slave(fmu, **refused)
