"""Parameters that may be set between steps: they act as if they had been set before the start."""

import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave

from bristle.fmus.interface import Interface
from bristle.observer import methods
from bristle.plant.friction import laws

H = 1e-3
STEPS = 60
CASES = [
    *(("plant", "law", law) for law in laws()),
    *(("observer", "method", method) for method in methods()),
    ("controller", "", ""),
    ("effects", "", ""),
]
SELECTED = {"law": list(laws()), "method": list(methods())}
BUILT = {
    "plant": ("plant", {}),
    "observer": ("observer", {"fmi": 3}),
    "controller": ("controller", {"fmi": 3}),
    "effects": ("plant", {"law": "lugre", "effects": ("cogging", "bias")}),
}


def moved(fmu, variant):
    """Return each tunable parameter of a variant, or of none, with another value that is
    allowed.
    """
    found, others = {}, {name for names in SELECTED.values() for name in names} - {variant}
    for v in fmu.description.modelVariables:
        if v.variability == "tunable" and v.name.partition(".")[0] not in others:
            start, low, high = float(v.start), float(v.min), float(v.max)
            found[v.name] = (
                start * 1.25
                if low <= start * 1.25 <= high and start
                else start + 0.1 * (min(high, start + 1.0) - start)
            )
    return found


def rows(raw, fmu, handle):
    """Return all real outputs over some steps, as bytes."""
    inputs, outputs = (
        [n for n in fmu.names("input") if n not in ("load_scale", "reference_scale")],
        fmu.names("output"),
    )
    found = []
    for k in range(STEPS):
        for name in inputs:
            assert raw.set(handle, name, float(3.0 * np.sin(0.3 * k + len(name)))) == 0, (
                raw.messages
            )
        assert raw.step(handle, H * k, H) == 0, raw.messages
        found.append(raw.get(handle, *outputs))
    return np.array(found).tobytes()


@pytest.mark.sampled(5)
@pytest.mark.sampled(3, "observer")
@pytest.mark.parametrize("case", CASES, ids="-".join)
def test_a_value_set_between_steps_acts_like_one_set_before_the_start(built, Raw, case):
    what, selector, variant = case
    fmu = built(BUILT[what][0], **BUILT[what][1])
    raw, values = Raw(fmu.info), moved(fmu, variant)
    early, late, plain = raw.instantiate(), raw.instantiate(), raw.instantiate()
    for handle in (early, late, plain):
        if selector:
            assert (
                raw.set(handle, f"{selector}_index", SELECTED[selector].index(variant) + 1, "Int32")
                == 0
            ), raw.messages
    for name, value in values.items():
        assert raw.set(early, name, value) == 0, raw.messages
    for handle in (early, late, plain):
        assert raw.start(handle) == 0, raw.messages
    for name, value in values.items():
        assert raw.set(late, name, value) == 0, raw.messages
    expected = rows(raw, fmu, early)
    assert rows(raw, fmu, late) == expected
    if not selector:
        assert rows(raw, fmu, plain) != expected
    for handle in (early, late, plain):
        raw.free(handle)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("what", ["plant", "observer", "controller"])
def test_what_is_tunable_has_a_use_and_what_is_not_is_refused(built, Raw, what):
    fmu = built(what, fmi=3)
    tunable = {v.name for v in fmu.description.modelVariables if v.variability == "tunable"}
    fixed = {
        v.name
        for v in fmu.description.modelVariables
        if v.variability == "fixed" and v.causality == "parameter"
    }
    wanted = {
        "plant": {"u_max", "lugre.sigma1"},
        "observer": {"self_starting_ekf.memory"},
        "controller": {"kp", "ki"},
    }[what]
    assert wanted <= tunable
    assert "sample_time" in fixed
    raw = Raw(fmu.info)
    handle = raw.instantiate()
    assert raw.start(handle) == 0
    for v in fmu.description.modelVariables:
        if v.name in fixed and v.type == "Float64":
            assert raw.set(handle, v.name, float(v.start)) == 3, v.name
    raw.free(handle)


def test_a_python_fmu_tunes_what_the_native_one_does(built):
    fmu = built("controller", kind="python")
    native = {v.name: v.variability for v in built("controller").description.modelVariables}
    assert {v.name: v.variability for v in fmu.description.modelVariables} == native
    vr = {v.name: v.valueReference for v in fmu.description.modelVariables}
    slave = FMU2Slave(
        guid=fmu.description.guid,
        unzipDirectory=str(fmu.folder),
        instanceName="x",
        modelIdentifier="Controller",
    )
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    slave.setReal([vr["kp"]], [2.0])
    assert slave.getReal([vr["kp"]]) == [2.0]
    with pytest.raises(Exception, match="fmi2SetReal failed"):  # pythonfmu makes every error fatal
        slave.setReal([vr["sample_time"]], [1e-3])
    slave.freeInstance()


def test_a_size_that_a_true_parameter_follows_from_is_not_tunable():
    from bristle.fmus.build import program_of

    shown = Interface(program_of("plant", "coulomb"))
    fixed = {
        x.name for x in shown.variables if x.causality == "parameter" and x.variability == "fixed"
    }
    assert {"J", "a2"} <= fixed  # alpha2 = a2 / J
