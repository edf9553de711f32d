"""The pythonfmu FMUs: the same digits as the native ones, and refusal of what is wrong."""

import gc
import importlib.util
import math
import sys

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave

from bristle.fmus.python_fmu import python_files
from bristle.plant.servo import servo_program

H = 1e-3
# s; plant and controller are also run together, for longer
RUNS = {"plant": 4.0, "controller": 20.0, "observer": 1.0}


class Slave:
    """An instance through FMPy, with variables by name."""

    def __init__(self, fmu, **start):
        d = fmu.description
        self.vr = {v.name: v.valueReference for v in d.modelVariables}
        self.kind = {v.name: v.type for v in d.modelVariables}
        self.fmu = FMU2Slave(
            guid=d.guid,
            unzipDirectory=str(fmu.folder),
            modelIdentifier=d.coSimulation.modelIdentifier,
            instanceName="one",
        )
        self.fmu.instantiate()
        self.begin(**start)

    def begin(self, **start):
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        for name, value in start.items():
            self.set(name, value)
        self.fmu.exitInitializationMode()

    def set(self, name, value):
        put = self.fmu.setInteger if self.kind[name] == "Enumeration" else self.fmu.setReal
        put([self.vr[name]], [value])

    def get(self, *names):
        return self.fmu.getReal([self.vr[name] for name in names])

    def free(self):
        self.fmu.freeInstance()


def selections(fmu):
    selector = [v for v in fmu.description.modelVariables if v.type == "Enumeration"]
    return [{selector[0].name: k} for k in range(1, int(selector[0].max) + 1)] if selector else [{}]


def signals(what, k):
    """The inputs at step k."""
    if what == "plant":
        voltage = 7.0 * math.sin(0.004 * k) + 2.0 * math.sin(0.05 * k)
        return {"u": voltage, "tau_load": 0.001 * (k > 700), "load_scale": 1.0 + 0.3 * (k > 400)}
    if what == "observer":
        return {
            "u": 8.0 * math.sin(0.02 * k),
            "y_v": 4.0 * math.sin(0.02 * k - 0.3),
            "y_theta": -0.2 * math.cos(0.02 * k - 0.3),
        }
    return {"y_v": 2.0 * math.sin(0.003 * k)}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("what", list(RUNS))
def test_native_and_python_agree(built, what):
    """1e-12 of each signal's range over the whole run, every law and method; NaN in the same
    places.
    """
    native, python = built(what), built(what, kind="python")
    outputs = native.names("output")
    assert {v.name: v.valueReference for v in native.description.modelVariables} == {
        v.name: v.valueReference for v in python.description.modelVariables
    }
    for start in selections(native):
        pair = [Slave(native, **start), Slave(python, **start)]
        rows = [[], []]
        for k in range(round(RUNS[what] / H / len(selections(native)))):
            for slave, row in zip(pair, rows, strict=True):
                for name, value in signals(what, k).items():
                    slave.set(name, value)
                slave.fmu.doStep(H * k, H)
                row.append(slave.get(*outputs))
        a, b = map(np.array, rows)
        assert np.array_equal(np.isnan(a), np.isnan(b))
        size = np.nanmax(np.abs(a), axis=0, initial=1e-300)
        assert np.nanmax(np.abs(a - b) / size) <= 1e-12, start
        for slave in pair:
            slave.free()


@pytest.mark.sampled(4)
def test_native_and_python_agree_in_closed_loop(built):
    """Controller and servo with LuGre friction over 20 s: the loop would amplify a difference."""
    ends = []
    for kind in ("native", "python"):
        controller, plant = (
            Slave(built("controller", kind=kind), seed=3.0, order=2.0),
            Slave(built("plant", kind=kind), law=2),
        )
        rows = []
        for k in range(20_000):
            [u], [v] = controller.get("u"), plant.get("v_enc")
            controller.set("y_v", v)
            plant.set("u", u)
            controller.fmu.doStep(H * k, H)
            plant.fmu.doStep(H * k, H)
            if k % 100 == 0:
                rows.append(plant.get("theta", "v", "F") + controller.get("u", "reference"))
        ends.append(np.array(rows))
        controller.free()
        plant.free()
    assert np.all(np.ptp(ends[0], axis=0) > 0.01)
    np.testing.assert_allclose(
        ends[1], ends[0], rtol=0, atol=1e-12 * np.abs(ends[0]).max(axis=0).max()
    )


BAD = {
    "NaN input": lambda s: s.set("u", math.nan),
    "infinite input": lambda s: s.set("u", math.inf),
    "input outside its limits": lambda s: s.set("load_scale", -1.0),
    "parameter too late": lambda s: s.set("J", 0.002),
    "selector too late": lambda s: s.set("law", 1),
    "output set": lambda s: s.set("theta", 1.0),
    "unknown reference": lambda s: s.fmu.getReal([9999]),
    "hidden variable": lambda s: s.fmu.getReal([max(s.vr.values()) + 1]),
    "wrong type": lambda s: s.fmu.getBoolean([s.vr["theta"]]),
    "no such type": lambda s: s.fmu.getString([s.vr["theta"]]),
    "h = 0": lambda s: s.fmu.doStep(H, 0.0),
    "h < 0": lambda s: s.fmu.doStep(H, -H),
    "h NaN": lambda s: s.fmu.doStep(H, math.nan),
    "wrong point": lambda s: s.fmu.doStep(0.5, H),
    "wrong order": lambda s: s.fmu.enterInitializationMode(),
}


@pytest.mark.parametrize("bad", list(BAD))
def test_bad_input_raises_and_changes_nothing(built, bad):
    fmu = built("plant", kind="python")
    slave, fresh = Slave(fmu), Slave(fmu)
    slave.fmu.doStep(0.0, H)
    fresh.fmu.doStep(0.0, H)
    with pytest.raises(FMICallException):
        BAD[bad](slave)
    for each in (slave, fresh):
        each.set("u", 3.0)
        each.fmu.doStep(H, H)
    assert slave.get("theta", "v", "F") == fresh.get("theta", "v", "F")
    slave.free()
    fresh.free()


def test_parameters_outside_their_interval_raise(built):
    for name, value in (("J", -1.0), ("J", math.nan), ("law", 0), ("law", 99)):
        with pytest.raises(FMICallException):
            Slave(built("plant", kind="python"), **{name: value})


def test_a_step_with_too_many_internal_steps_fails_and_a_reset_revives(built):
    slave = Slave(built("plant", kind="python"), law=2)
    slave.set("u", 5.0)
    slave.fmu.doStep(0.0, H)
    before = slave.get("theta", "v", "F")
    with pytest.raises(FMICallException):
        slave.fmu.doStep(H, 1000.0)
    assert slave.get("theta", "v", "F") == before
    with pytest.raises(FMICallException):
        slave.fmu.doStep(H, H)
    slave.fmu.reset()
    slave.begin(law=2)
    slave.set("u", 5.0)
    slave.fmu.doStep(0.0, H)
    assert slave.get("theta", "v", "F") == before
    slave.free()


@pytest.mark.sampled(3)
@pytest.mark.parametrize("what", list(RUNS))
def test_states_continue_bitwise(built, what):
    fmu = built(what, kind="python")
    outputs = fmu.names("output")

    def go_on(slave):
        rows = []
        for k in range(100, 150):
            for name, value in signals(what, k).items():
                slave.set(name, value)
            slave.fmu.doStep(H * k, H)
            rows.append(slave.get(*outputs))
        return np.array(rows).tobytes()

    slave = Slave(fmu)
    for k in range(100):
        for name, value in signals(what, k).items():
            slave.set(name, value)
        slave.fmu.doStep(H * k, H)
    state = slave.fmu.getFMUstate()
    data = slave.fmu.serializeFMUstate(state)
    expected = go_on(slave)
    slave.fmu.setFMUstate(state)
    assert go_on(slave) == expected
    other = Slave(fmu)
    other.fmu.setFMUstate(other.fmu.deSerializeFMUstate(data))
    assert go_on(other) == expected
    for damaged in (
        data[:-3],
        b"",
        b"x" * len(data),
        data[:50] + bytes([data[50] ^ 1]) + data[51:],
    ):
        with pytest.raises(FMICallException):
            other.fmu.setFMUstate(other.fmu.deSerializeFMUstate(damaged))
    slave.free()
    other.free()


def test_many_instances_and_errors_do_not_exhaust_the_interpreter(built):
    """pythonfmu gives back references that are not its own; the script makes up for it."""
    fmu = built("controller", kind="python")
    gc.freeze()  # objects of other tests, which each collection would go through
    for _ in range(200):
        slave = Slave(fmu)
        for _ in range(3):
            with pytest.raises(FMICallException):
                slave.set("y_v", math.nan)
        slave.fmu.doStep(0.0, H)
        slave.free()
        gc.collect()
    gc.unfreeze()


def test_an_fmu_is_made_of_the_installed_pythonfmu_whatever_runs_beside(tmp_path, monkeypatch):
    """An FMU that runs in this process has its own copy imported, which has no libraries."""
    copy = tmp_path / "pythonfmu" / "__init__.py"
    copy.parent.mkdir()
    copy.write_text("")
    spec = importlib.util.spec_from_file_location(
        "pythonfmu", copy, submodule_search_locations=[str(copy.parent)]
    )
    monkeypatch.setitem(sys.modules, "pythonfmu", importlib.util.module_from_spec(spec))
    monkeypatch.syspath_prepend(tmp_path)
    program = servo_program("coulomb")
    content = python_files(program)
    assert len(content[f"binaries/linux64/{program.name}.so"]) > 10_000
    assert b"Fmi2Slave" in content["resources/pythonfmu/fmi2slave.py"]
