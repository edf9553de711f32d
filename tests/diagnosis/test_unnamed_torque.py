"""What nothing in the catalogue explains: fitted as a function of one variable, offered where it
helps, written as what it is.
"""

from __future__ import annotations

import tomllib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.diagnosis import Model, records_from_arrays
from bristle.diagnosis.answer import TorqueCurve, Unexplained, UnnamedTorque
from bristle.diagnosis.checks.preparation import base_servo_of, dataset_of
from bristle.diagnosis.estimation.fitted_model import fit_with_noise
from bristle.diagnosis.modelfile import model_text
from bristle.diagnosis.report.export import augment, nothing_filled
from bristle.diagnosis.report.figures.of_diagnosis import draw
from bristle.diagnosis.report.html import render
from bristle.diagnosis.report.text.statement import not_offered
from bristle.diagnosis.stages.unnamed_torque import _refusal, torque_of
from bristle.diagnosis.workflow import validate
from bristle.model.native import Native
from bristle.plant.effects import effects
from bristle.plant.servo import servo_program
from bristle.plant.unnamed_torque import UNNAMED_KNOTS, UNNAMED_TORQUES

H, STEP, TENTH, N = 1e-3, 2 * np.pi / 16384, 5, 8000
LEFT = Unexplained(True, "v", 0.6)


def simulated(seed, missing):
    """Return input and position of a servo with a torque missing(v), by semi-implicit Euler with
    friction that sticks.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(N) * H
    waves = [(0.37, 0.18), (0.93, 0.18), (1.7, 0.18), (4.3, 0.12), (11.0, 0.06)]
    u = sum(size * np.sin(2 * np.pi * f * time + rng.uniform(0, 2 * np.pi)) for f, size in waves)
    y, theta, v, h = np.empty(N), 0.0, 0.0, H / TENTH
    for k, torque in enumerate((u + 0.002 * rng.standard_normal(N)).tolist()):
        y[k] = theta
        for _ in range(TENTH):
            free = v + h / 0.01 * (torque + missing(v) - 0.02 * v)
            v = np.sign(free) * max(abs(free) - h / 0.01 * 0.12, 0.0)
            theta += h * v
    return time, u, np.floor(y / STEP) * STEP


def wave(v):
    return 0.06 * np.sin(0.9 * v)


def found_in(model, missing):
    """Return what is found in two records, and a third record."""
    records = records_from_arrays(model, [(f"run {k}", *simulated(k, missing)) for k in (1, 2, 3)])
    dataset = dataset_of(model, records[:2])
    base = fit_with_noise(dataset, *base_servo_of(model, dataset))
    case = SimpleNamespace(model=model, dataset=dataset, final=base)
    return (
        torque_of(case),
        base,
        records[2],
    )


@pytest.mark.long
def test_a_torque_of_no_name_is_found_with_its_band_and_helps_on_another_record(model, answer):
    found, base, other = found_in(model, wave)
    assert found.offered
    curve = found.curves[0]
    assert curve.variable == "v"
    inside = abs(curve.places) < 0.8 * max(abs(curve.places))
    departure = (curve.values - wave(curve.places))[inside]
    # what viscous and dry friction do as well
    free = np.column_stack([curve.places, np.sign(curve.places)])[inside]
    departure -= free @ np.linalg.lstsq(free, departure, rcond=None)[0]
    assert np.sqrt(np.mean(departure**2)) < 0.01
    assert found.after < 0.25 * found.before
    diagnosis = replace(
        answer("none"), model=model, remains=LEFT, unnamed=found, base={}, fitted={}
    )
    filled = augment(diagnosis, fill=True).model
    filled = replace(filled, parameters={name: found.values[name] for name in filled.parameters})
    plain = replace(
        model, parameters={name: float(base.fit.values[name]) for name in model.parameters}
    )
    short = [validate(each, [other]).records[0].horizons[0][1] for each in (plain, filled)]
    assert short[1] < 0.5 * short[0]


@pytest.mark.long
def test_where_nothing_is_missing_nothing_is_offered(model):
    found, _, _ = found_in(model, lambda v: 0.0)
    assert not found.offered
    assert not_offered(found.refused)


def made_up(offered=True):
    curve = TorqueCurve(
        "v",
        -6.0,
        6.0,
        np.sin(np.linspace(-6, 6, UNNAMED_KNOTS)) * 0.03,
        np.full(UNNAMED_KNOTS, 0.004),
    )
    refused, after = (None, 3e-7) if offered else ("it does not help", 8.5e-7)
    return UnnamedTorque((curve,), 9e-7, after, "rad", {"J": 0.0123}, refused)


def test_it_is_put_into_the_model_only_on_request_and_reads_back(answer):
    diagnosis = replace(answer("none"), unnamed=made_up())
    assert "unnamed_torque_v" not in augment(diagnosis).effects
    augmented = augment(diagnosis, fill=True)
    assert augmented.added == ("unnamed_torque_v",)
    assert augmented.model.parameters["J"] == 0.0123
    back = Model.from_dict(tomllib.loads(model_text(augmented.model)))
    assert back.effects == augmented.model.effects
    assert back.unit("unnamed_torque_v.low") == "rad/s"
    native = Native(servo_program("coulomb", effects=("unnamed_torque_v",)), augmented.parameters)
    assert np.isfinite(native.run(H, {"u": np.full(50, 0.3)}, ["v"])[0]).all()


def test_one_that_does_not_help_is_not_offered_and_says_so(answer):
    diagnosis = replace(answer("none"), unnamed=made_up(offered=False))
    assert "unnamed_torque_v" not in augment(diagnosis, fill=True).effects
    assert nothing_filled(diagnosis) == "No unnamed torque was added: it does not help."
    assert (
        nothing_filled(answer("named"))
        == "No unnamed torque was added: nothing much is unexplained."
    )
    assert "No unnamed torque is offered" in render(diagnosis, {}, {})


@pytest.mark.sampled(4)
def test_the_report_draws_it_and_calls_it_unnamed(answer):
    diagnosis = replace(answer("none"), unnamed=made_up())
    figures = draw(diagnosis)
    assert "unnamed" in figures
    assert "unnamed" not in draw(answer("none"))
    page = render(diagnosis, figures, {})
    assert (
        "An unnamed torque, a smooth function of velocity, explains 67 % of the squared error"
        in page
    )
    found = diagnosis.to_dict()["unnamed_torque"]
    assert (found["offered"], len(found["functions"][0]["torque"])) == (True, UNNAMED_KNOTS)
    assert answer("none").to_dict()["unnamed_torque"] is None


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", sorted(UNNAMED_TORQUES))
def test_it_is_the_curve_through_its_values_and_constant_beyond(name):
    """At a constant acceleration without friction, the velocity after a step gives the torque
    back.
    """
    assert name not in effects()
    values = {f"{name}.value{k + 1}": 0.01 * k**2 for k in range(UNNAMED_KNOTS)} | {
        f"{name}.low": 0.0,
        f"{name}.high": 12.0,
    }
    program = servo_program("coulomb", encoder=False, effects=(name,))
    setting = {"J": 1.0, "a2": 0.0, "coulomb.Fc": 0.0, "b": 2.0, "u_max": 1e6}
    seen = []
    for x in (-3.0, 0.0, 4.0, 4.5, 12.0, 20.0):
        at = {"v": {"v_start": x}, "theta": {"theta_start": x}}.get(name.rpartition("_")[2], {})
        native = Native(program, setting | values | at)
        time = np.array([0.0]) if name.endswith("_t") else None
        if time is not None:
            native = Native(
                program, setting | values | {f"{name}.low": -x, f"{name}.high": 12.0 - x}
            )
        u = x if name.endswith("_u") else 0.0
        out, _ = native.run(1e-6, {"u": np.full(1, u)}, ["v"])
        seen.append((out[1, 0] - out[0, 0]) / 1e-6 - 2.0 * u)
    assert seen == pytest.approx([0.0, 0.0, 0.16, 0.205, 1.44, 1.44], abs=1e-4)


def test_it_can_be_asked_for_where_nothing_is_named_but_not_beside_a_choice(answer):
    tie = replace(answer("tie"), remains=LEFT, unnamed=made_up())
    assert augment(tie) is None
    assert augment(tie, fill=True).added == ("unnamed_torque_v",)
    with pytest.raises(BristleError, match="choose an effect or fill, not both"):
        augment(tie, "bias", fill=True)


def test_a_fall_that_is_too_small_is_not_rounded_to_the_one_that_is_asked():
    curve = TorqueCurve("v", -1.0, 1.0, np.zeros(UNNAMED_KNOTS), np.ones(UNNAMED_KNOTS))
    assert "by a factor of 1.19 only, and 1.2 is asked" in not_offered(_refusal((curve, 1.1999)))
    assert not_offered(_refusal((curve, 0.7))).endswith(
        "does not lower the squared error on held-out segments"
    )
