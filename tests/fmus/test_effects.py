"""The FMU of a plant with effects: valid, and the same digits as in this process."""

import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu

from bristle.common.errors import BristleError
from bristle.fmus import obtain
from bristle.fmus.build import program_of
from bristle.model.native import Native

H = 1e-3


@pytest.mark.parametrize(
    ("law", "effects", "fmi", "kind"),
    [
        ("coulomb", ("input_delay", "asymmetric_coulomb", "gravity"), 2, "native"),
        ("coulomb", ("compliance", "presliding"), 3, "native"),
        ("lugre", ("cogging", "disturbance_step"), 2, "native"),
        ("coulomb", ("input_delay", "load_friction"), 2, "python"),
    ],
)
def test_an_augmented_plant_is_a_valid_fmu_with_the_same_digits(law, effects, fmi, kind):
    path = str(obtain("plant", law=law, effects=effects, fmi=fmi, kind=kind))
    assert validate_fmu(path) == []
    expected, _ = Native(program_of("plant", law, effects)).run(H, {"u": np.full(100, 5.0)}, ["theta", "v"])
    found = simulate_fmu(
        path, fmi_type="CoSimulation", stop_time=0.1, output_interval=H, step_size=H, start_values={"u": 5.0}, output=["theta", "v"]
    )
    assert np.max(np.abs(expected[:, 1])) > 0.1
    for k, name in enumerate(("theta", "v")):
        np.testing.assert_allclose(found[name], expected[:, k], rtol=1e-9, atol=1e-12)


def test_effects_belong_to_the_plant_of_one_law():
    with pytest.raises(BristleError, match="the observer has no effects to add"):
        obtain("observer", effects=("bias",))
    with pytest.raises(BristleError, match="joins one friction law; choose a law"):
        program_of("plant", effects=("bias",))
