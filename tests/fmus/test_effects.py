"""The FMU of a plant with effects: valid, and the same digits as in this process."""

import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu

from bristle.common.errors import BristleError
from bristle.fmus import obtain
from bristle.fmus.build import program_of
from bristle.fmus.host import Fmu
from bristle.model.native import Native
from bristle.plant.effects import effect

H = 1e-3


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("law", "effects", "fmi", "kind"),
    [
        ("coulomb", ("input_delay", "asymmetric_coulomb", "gravity"), 2, "native"),
        ("coulomb", ("compliance", "presliding"), 3, "native"),
        ("lugre", ("cogging", "disturbance_step"), 2, "native"),
        ("coulomb", ("input_delay", "load_friction"), 2, "python"),
        ("coulomb", ("measurement_delay", "input_noise"), 3, "native"),
        ("lugre", ("measurement_delay", "input_noise"), 2, "python"),
    ],
)
def test_an_augmented_plant_is_a_valid_fmu_with_the_same_digits(law, effects, fmi, kind):
    path = str(obtain("plant", law=law, effects=effects, fmi=fmi, kind=kind))
    assert validate_fmu(path) == []
    expected, _ = Native(program_of("plant", law, effects)).run(
        H, {"u": np.full(100, 5.0)}, ["theta", "v"]
    )
    found = simulate_fmu(
        path,
        fmi_type="CoSimulation",
        stop_time=0.1,
        output_interval=H,
        step_size=H,
        start_values={"u": 5.0},
        output=["theta", "v"],
    )
    assert np.max(np.abs(expected[:, 1])) > 0.1
    for k, name in enumerate(("theta", "v")):
        np.testing.assert_allclose(found[name], expected[:, k], rtol=1e-9, atol=1e-12)


def test_effects_belong_to_the_plant():
    with pytest.raises(BristleError, match="the observer has no effects to add"):
        obtain("observer", effects=("bias",))


@pytest.mark.sampled(4)
def test_parameters_of_effects_are_described_in_the_fmu():
    for fmi, kind in ((2, "native"), (3, "native"), (2, "python")):
        fmu = Fmu(obtain("plant", law="lugre", effects=("cogging", "back_emf"), fmi=fmi, kind=kind))
        for name in ("cogging", "back_emf"):
            for p in effect(name).parameters:
                variable = fmu.variables[p.name]
                assert (variable.causality, fmu.unit(p.name)) == ("parameter", p.unit)
                assert fmu.interval(p.name) == (p.minimum, p.maximum)
                assert fmu.start(p.name) == p.default
                assert variable.description == f"{p.description} ({p.symbol})"
        assert fmu.description.description.endswith(
            "with cogging with back_emf; no true value of load, alpha2"
        )


@pytest.mark.sampled(4)
def test_a_plant_of_one_smooth_law_has_an_encoder_where_that_is_asked_for():
    lean, full = (
        Fmu(obtain("plant", law="lugre", effects=("bias",), encoder=encoder))
        for encoder in (False, True)
    )
    assert not lean.has("theta_enc", "output")
    assert lean.description.modelExchange is not None
    assert full.has("theta_enc", "output")
    assert full.description.modelExchange is None


@pytest.mark.sampled(4)
def test_without_a_law_the_plant_has_all_laws_that_the_effects_can_join():
    fmu = Fmu(obtain("plant", effects=("presliding",)))
    assert "coulomb" in fmu.choices("law")
    assert "lugre" not in fmu.choices("law")
    assert fmu.has("presliding.stiffness", "parameter")
