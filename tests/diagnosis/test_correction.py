"""A plant without an effect, fed through its correction, moves like the plant that has it."""

from __future__ import annotations

import os
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from fmpy import read_model_description
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu

from bristle.common.errors import BristleError
from bristle.diagnosis.report.correction import correction_program, refusal
from bristle.fmus import obtain
from bristle.fmus.build import program_files
from bristle.fmus.pack import write_archive
from bristle.model.native import Native
from bristle.plant.effects import effects
from bristle.plant.servo import servo_program

H, N = 1e-3, 800
TIME = H * np.arange(N)
INPUT = 3.5 * np.sin(8.0 * TIME) + np.sin(44.0 * TIME)
VALUES = {
    "cogging.amplitude": 0.01,
    "gravity.amplitude": 0.02,
    "bias.torque": 0.002,
    "hard_stop.upper": 0.3,
    "gain_asymmetry.share": 0.2,
    "saturation.limit": 3.0,
    "disturbance_step.onset": 0.3005,
    "back_emf.constant": 0.1,
    "dead_zone.width": 0.5,
    "quadratic_drag.coefficient": 3e-4,
}
# constant over a period, as the plant's input is
EXACT = {"bias", "dead_zone", "gain_asymmetry", "input_delay", "saturation"}
POSSIBLE = sorted(name for name in effects() if refusal(name) is None)


def of(names):
    return {key: value for key, value in VALUES.items() if key.split(".")[0] in names}


def built(names, folder, fmi=2):
    return write_archive(
        Path(folder) / "correction.fmu", program_files(correction_program(names, of(names)), fmi)
    )


class Part:
    """An FMU at work, by variable names."""

    def __init__(self, path, folder):
        ZipFile(path).extractall(folder)
        description = read_model_description(str(path))
        self.refs = {v.name: v.valueReference for v in description.modelVariables}
        model = description.coSimulation.modelIdentifier
        home = os.getcwd()
        self.fmu = FMU2Slave(
            guid=description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=model,
            instanceName=model,
        )
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        os.chdir(home)

    def set(self, **values):
        known = {name: value for name, value in values.items() if name in self.refs}
        self.fmu.setReal([self.refs[name] for name in known], list(known.values()))

    def get(self, *names):
        return self.fmu.getReal([self.refs[name] for name in names])

    def step(self, time):
        self.fmu.doStep(currentCommunicationPoint=time, communicationStepSize=H)

    def close(self):
        self.fmu.terminate()
        self.fmu.freeInstance()


def corrected(names, folder, late=False):
    """Co-simulate a plant without the effects and their correction; return theta and v, shape (N +
    1, 2).
    """
    (folder / "plant").mkdir()
    (folder / "correction").mkdir()
    plant = Part(obtain("plant", law="coulomb"), folder / "plant")
    correction = Part(built(names, folder), folder / "correction")
    seen, before = np.zeros((N + 1, 2)), 0.0
    for k, u in enumerate(INPUT):
        time = float(TIME[k])
        correction.set(u=u, theta=seen[k, 0], v=seen[k, 1])
        [value] = correction.get("u_corrected")
        plant.set(u=before if late else value)
        before = value
        plant.step(time)
        correction.step(time)
        seen[k + 1] = plant.get("theta", "v")
    plant.close()
    correction.close()
    return seen


def reference(names):
    """Return the same of the plant with the effects."""
    program = servo_program("coulomb", effects=names)
    known = {key: value for key, value in of(names).items() if key in program.index}
    return Native(program, known).run(H, {"u": INPUT}, ["theta", "v"])[0]


def miss(names, folder, late=False):
    """Return the largest error of theta and v, in absolute terms and over what the effects do."""
    wanted = reference(names)
    error = np.max(np.abs(corrected(names, folder, late) - wanted), axis=0)
    return error, error / np.max(np.abs(reference(()) - wanted), axis=0)


@pytest.mark.sampled(5)
@pytest.mark.parametrize("name", POSSIBLE)
def test_a_corrected_plant_moves_as_if_it_had_the_effect(name, tmp_path):
    error, share = miss((name,), tmp_path)
    if name in EXACT:
        assert np.all(error < 1e-9)
    else:  # the input is held over a period, the torque is not
        assert np.all(share < (0.02 if name == "electrical_pole" else 0.004)), share


def test_several_effects_act_in_their_order(tmp_path):
    names = ("gravity", "dead_zone", "electrical_pole", "gain_asymmetry")
    _, share = miss(names, tmp_path)
    assert np.all(share < 0.004)


def test_a_correction_a_sample_late_is_seen(tmp_path):
    """The comparison above is sharp enough to notice."""
    _, share = miss(("hard_stop",), tmp_path, late=True)
    assert np.all(share > 0.008), share


def test_these_effects_can_act_through_the_input():
    maps = {
        "back_emf",
        "dead_zone",
        "electrical_pole",
        "gain_asymmetry",
        "input_delay",
        "saturation",
        "torque_ripple",
    }
    torques = {
        "asymmetric_viscous",
        "bias",
        "cogging",
        "disturbance_step",
        "gravity",
        "hard_stop",
        "quadratic_drag",
        "return_spring",
    }
    assert set(POSSIBLE) == maps | torques


@pytest.mark.parametrize("name", sorted(set(effects()) - set(POSSIBLE)))
def test_the_others_are_refused_with_a_reason(name):
    reason = refusal(name)
    assert reason is not None
    assert reason.startswith(f"{name} ")
    assert "\n" not in reason
    with pytest.raises(BristleError, match=f"no correction: {name} "):
        correction_program([name])


def test_what_stands_between_input_and_effect_is_a_reason_too():
    assert "behind the coupling of compliance" in refusal("gravity", ["gravity", "compliance"])
    assert refusal("cogging", ["cogging", "compliance"], ["cogging", "compliance"]) is None
    assert "pass through dead_zone" in refusal("gravity", ["dead_zone", "gravity"], ["gravity"])
    assert refusal("gravity", ["dead_zone", "gravity"], ["dead_zone", "gravity"]) is None


def test_a_correction_needs_an_effect_and_a_drive():
    with pytest.raises(BristleError, match="name one"):
        correction_program([])
    with pytest.raises(BristleError, match="give b"):
        correction_program(["bias"], {"b": 0.0})
    with pytest.raises(BristleError, match=r"dead_zone\.width"):
        correction_program(["dead_zone"], {"dead_zone.width": -1.0})


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("names", "inputs"),
    [(("gravity", "input_delay"), ["u", "theta", "v"]), (("electrical_pole",), ["u"])],
)
@pytest.mark.parametrize("fmi", [2, 3])
def test_it_is_a_valid_fmu_with_the_inputs_it_reads(names, inputs, fmi, tmp_path):
    path = built(names, tmp_path, fmi)
    assert validate_fmu(str(path)) == []
    description = read_model_description(str(path))
    assert [v.name for v in description.modelVariables if v.causality == "input"] == inputs
    [output] = description.outputs
    assert {v.name for v in output.dependencies} >= set(inputs)  # passed on within the step
