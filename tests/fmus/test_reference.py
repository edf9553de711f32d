"""The shipped reference runs, through FMI; and that the comparison can fail."""

from importlib.resources import files

import numpy as np
import pytest

from bristle.fmus.build import FMU_NAMES, program_of
from bristle.fmus.reference import (
    REFERENCE_RUN_STEP,
    REFERENCE_RUN_STEPS,
    STEP_SIZES,
    STEPS_PER_ROW,
    inputs,
    outside,
    read_reference,
    reference_run,
    step_errors,
)


def through_fmi(raw, what, names):
    given, handle = inputs(program_of(what)), raw.running()
    rows = [raw.get(handle, *names)]
    for k in range(REFERENCE_RUN_STEPS):
        for name, values in given.items():
            assert raw.set(handle, name, float(values[k])) == 0
        assert raw.step(handle, REFERENCE_RUN_STEP * k, REFERENCE_RUN_STEP) == 0
        if (k + 1) % STEPS_PER_ROW == 0:
            rows.append(raw.get(handle, *names))
    return dict(zip(names, np.array(rows).T, strict=True))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("what", FMU_NAMES)
def test_the_fmu_stays_in_the_tube(built, Raw, what, fmi):
    fmu, reference = built(what, fmi=fmi), read_reference(what)
    names = [name for name in fmu.names("output") if name in reference]
    assert names
    expected = {name: reference[name] for name in names}
    assert outside(expected, through_fmi(Raw(fmu.info), what, names)) == {}


@pytest.mark.parametrize(
    "what",
    [
        pytest.param(what, marks=pytest.mark.slow) if what == "observer" else what
        for what in FMU_NAMES
    ],
)
def test_the_reference_is_the_run_of_the_program(what):
    reference, run = read_reference(what), reference_run(what)
    assert list(reference) == list(run)
    assert outside(reference, run) == {}
    moving = [
        name
        for name in reference
        if name not in ("time", *inputs(program_of(what))) and np.ptp(reference[name]) > 0
    ]
    assert len(moving) >= 2


@pytest.mark.parametrize(
    "spoil",
    [
        lambda x: x | {"u": x["u"] * (1 + 1e-5)},
        lambda x: x | {"u": np.where(x["time"] == x["time"][7], np.nan, x["u"])},
        lambda x: x | {"u": np.full_like(x["u"], np.nan)},
        lambda x: {name: values for name, values in x.items() if name != "u"},
        lambda x: x | {"u": x["u"][:-1]},
        lambda x: x | {"u": np.roll(x["u"], 1)},
    ],
)
def test_what_leaves_the_tube_is_named(spoil):
    reference = read_reference("controller")
    assert outside(reference, dict(reference)) == {}
    assert list(outside(reference, spoil(dict(reference)))) == ["u"]


@pytest.mark.parametrize("what", FMU_NAMES)
def test_readme_is_ten_lines(what):
    from importlib.resources import files

    lines = (files("bristle.fmus") / what / "README.md").read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("# ")
    assert 8 <= len(lines) <= 12


@pytest.mark.sampled(3, "observer")
def test_errors_by_step_size_are_measured_and_stand_in_the_documentation(built):
    """The table of the documentation; an input that changes is held, which delays it by half a
    step.
    """
    lines = (files("bristle.fmus") / "plant" / "steps.csv").read_text(encoding="utf-8").splitlines()
    table = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    held = [step_errors("viscous", True), step_errors("coulomb", True)]
    moving = step_errors("viscous", False)
    assert np.all(np.max(held, axis=0) <= 1.01 * table[:, 2])
    assert np.all(moving <= 1.05 * table[:, 1])
    # all laws have nearly the same error
    np.testing.assert_allclose(moving, table[:, 1], rtol=0.15)
    np.testing.assert_allclose(
        np.diff(np.log(moving)) / np.diff(np.log(STEP_SIZES)), 1.0, atol=0.15
    )
    page = (built("plant", fmi=3).folder / "documentation" / "index.html").read_text(
        encoding="utf-8"
    )
    assert all(cell in page for line in lines[1:] for cell in line.split(","))
    assert "Communication steps" in (
        built("observer").folder / "documentation" / "index.html"
    ).read_text(encoding="utf-8")
