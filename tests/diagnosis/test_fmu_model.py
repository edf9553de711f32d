"""The model that a plant FMU alone defines: complete, or the missing parameter is named."""

from __future__ import annotations

import zipfile

import pytest

from bristle.common.errors import BristleError
from bristle.diagnosis import fmu_model
from bristle.fmus import obtain
from bristle.plant.friction import laws


def test_an_augmented_plant_is_the_model_it_was_made_from():
    given = {"J": 0.01, "b": 0.5, "coulomb.Fc": 0.12, "cogging.amplitude": 0.06}
    model = fmu_model(obtain("plant", law="coulomb", effects=("cogging",), parameters=given))
    assert (model.friction, model.input_kind, model.output.column) == (
        "coulomb",
        "voltage",
        "theta",
    )
    assert model.parameters == {"J": 0.01, "a2": 0.002, "b": 0.5, "coulomb.Fc": 0.12}
    assert model.effects["cogging"]["amplitude"] == 0.06
    assert model.effects.keys() == {"cogging"}


@pytest.mark.parametrize("law", ["viscous", "modified"])
def test_the_law_is_the_one_it_holds(law):
    assert fmu_model(obtain("plant", law=law)).friction == law


def test_of_all_laws_it_is_the_one_selected_at_the_start():
    model = fmu_model(obtain("plant"))
    assert model.friction == "coulomb"
    assert set(model.parameters) == {"J", "a2", "b", "coulomb.Fc"}


def test_a_selector_is_read_by_the_names_the_fmu_gives_its_laws(tmp_path):
    """Another release numbers them otherwise."""
    renumbered = tmp_path / "renumbered.fmu"
    with zipfile.ZipFile(obtain("plant")) as old, zipfile.ZipFile(renumbered, "w") as new:
        text = old.read("modelDescription.xml").decode()
        for name, before, after in (("coulomb", 1, 99), ("viscous", len(laws()), 1)):
            assert f'name="{name}" value="{before}"' in text
            text = text.replace(f'name="{name}" value="{before}"', f'name="{name}" value="{after}"')
        new.writestr("modelDescription.xml", text)
    assert fmu_model(renumbered).friction == "viscous"


def test_an_unusable_fmu_is_refused_in_one_line(tmp_path):
    with pytest.raises(BristleError, match=r"no parameter 'J' to scale by; give a model file"):
        fmu_model(obtain("controller"))
    with pytest.raises(BristleError, match="No such file"):
        fmu_model(tmp_path / "nowhere.fmu")
    with zipfile.ZipFile(tmp_path / "empty.fmu", "w"):
        pass
    with pytest.raises(BristleError, match="cannot be read"):
        fmu_model(tmp_path / "empty.fmu")
    with zipfile.ZipFile(tmp_path / "other.fmu", "w") as other:
        other.writestr("modelDescription.xml", "<a/>")
    with pytest.raises(
        BristleError,
        match=r"not one of FMI, or lacks an attribute such as fmiVersion; give a valid",
    ):
        fmu_model(tmp_path / "other.fmu")
