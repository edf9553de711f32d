"""Start values other than the defaults: the FMU as it stands is the program with these
parameters.
"""

import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu

from bristle.common.errors import BristleError
from bristle.fmus import obtain
from bristle.fmus.build import program_of
from bristle.model.native import Native

H = 1e-3
GIVEN = {
    "J": 0.002,
    "coulomb.Fc": 0.006,
    "theta_start": 0.3,
    "cogging.amplitude": 0.02,
    "sample_time": 2e-3,
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("fmi", "kind"), [(2, "native"), (3, "native"), (2, "python")])
def test_the_fmu_starts_with_what_was_given(fmi, kind):
    path = str(
        obtain("plant", law="coulomb", effects=("cogging",), fmi=fmi, kind=kind, parameters=GIVEN)
    )
    assert validate_fmu(path) == []
    starts = {
        v.name: v.start
        for v in read_model_description(path).modelVariables
        if v.causality == "parameter"
    }
    assert {name: float(starts[name]) for name in GIVEN} == GIVEN
    program = program_of("plant", "coulomb", ["cogging"])
    expected, _ = Native(program, GIVEN).run(H, {"u": np.full(100, 9.0)}, ["theta", "v"])
    default, _ = Native(program).run(H, {"u": np.full(100, 9.0)}, ["theta", "v"])
    found = simulate_fmu(
        path,
        fmi_type="CoSimulation",
        stop_time=0.1,
        output_interval=H,
        step_size=H,
        start_values={"u": 9.0},
        output=["theta", "v"],
    )
    assert np.max(np.abs(expected - default)) > 0.1
    for k, name in enumerate(("theta", "v")):
        np.testing.assert_allclose(found[name], expected[:, k], rtol=1e-9, atol=1e-12)


def test_start_values_are_checked():
    with pytest.raises(BristleError, match=r"J = -1 kg\.m2 is outside"):
        obtain("plant", law="coulomb", parameters={"J": -1.0})
    with pytest.raises(BristleError, match="'honey' is no parameter of ServoPlant_coulomb"):
        obtain("plant", law="coulomb", parameters={"honey": 1.0})
    with pytest.raises(BristleError, match="'u' is no parameter"):
        program_of("plant", "coulomb").preset({"u": 1.0})


def test_other_start_values_make_another_file_and_token():
    """A host must not take one for the other."""
    program = program_of("plant", "coulomb")
    other = program.preset({"J": 0.002})
    assert program.token != other.token
    assert program.starts[program.index["J"]] == 0.001  # the first one is as it was
    assert obtain("plant", law="coulomb") != obtain("plant", law="coulomb", parameters={"J": 0.002})
