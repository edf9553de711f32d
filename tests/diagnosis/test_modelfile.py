"""Model files: what is read, what is assumed, what is written back, and one line for every
mistake.
"""

import math
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from bristle.diagnosis.modelfile import Model, default_bounds, load_model, model_text, si_unit
from bristle.plant.effects import effects
from bristle.plant.friction import law

CONTRACT = """
friction = "coulomb"
[parameters]
J = 0.01
a2 = 0.02
Fc = 0.12
[bounds]
J = [0.003, 0.03]
a2 = [0.0, 0.2]
Fc = [0.0, 0.6]
[time]
column = "t"
unit = "s"
[input]
column = "u"
kind = "torque"
unit = "N.m"
[output]
column = "theta"
kind = "position"
unit = "rad"
resolution = 3.834951969714103e-4
"""


def test_the_file_of_the_contract(tmp_path):
    path = tmp_path / "model.toml"
    path.write_text(CONTRACT)
    model = load_model(path)
    assert model.friction == "coulomb"
    assert model.parameters == {"J": 0.01, "a2": 0.02, "coulomb.Fc": 0.12}
    assert model.bounds == {"J": (0.003, 0.03), "a2": (0.0, 0.2), "coulomb.Fc": (0.0, 0.6)}
    assert (model.input_kind, model.output_kind, model.linear) == ("torque", "position", False)
    assert model.resolution == 3.834951969714103e-4
    assert (model.input_unit, model.output_unit) == ("N.m", "rad")
    assert model.path == path
    assert model.settings()["b"] == 1.0
    assert model.settings({"J": 0.02})["J"] == 0.02
    assert model.settings()["u_max"] >= 1e6


def test_quantities_and_full_names(tree):
    tree["parameters"] = {"J": "10 g.cm2", "a2": "1 mN.m.s/rad", "coulomb": {"Fc": "0.3 mN.m"}}
    del tree["bounds"]
    model = Model.from_dict(tree)
    assert model.parameters == pytest.approx({"J": 1e-6, "a2": 1e-3, "coulomb.Fc": 3e-4})
    tree["output"] |= {"unit": "deg", "resolution": 0.1}
    assert Model.from_dict(tree).resolution == pytest.approx(math.radians(0.1))
    tree["output"]["resolution"] = "0.2 mm"
    with pytest.raises(ValueError, match=r"output.resolution"):
        Model.from_dict(tree)
    tree["output"] |= {"unit": "1", "scale": "0.01 rad", "resolution": 1}
    assert Model.from_dict(tree).resolution == 0.01


def test_a_linear_axis(tree):
    tree["parameters"] = {"J": "95 kg", "a2": "203 N.s/m", "Fc": "20 N", "b": "35 N/V"}
    tree["bounds"] = {"J": ["50 kg", 200]}
    tree["input"] = {"column": "u", "kind": "voltage", "unit": "V"}
    tree["output"] |= {"unit": "mm", "resolution": "0.05 um"}
    model = Model.from_dict(tree)
    assert model.linear
    assert model.parameters["J"] == 95.0
    assert model.bounds == {"J": (50.0, 200.0)}
    assert model.resolution == pytest.approx(5e-8)
    assert [
        model.unit(n)
        for n in ("J", "a2", "b", "coulomb.Fc", "gravity.amplitude", "hard_stop.upper")
    ] == ["kg", "N.s/m", "N/V", "N", "N", "m"]
    assert model.output_unit == "m"
    tree["effects"] = {"cogging": {"amplitude": "3 N", "phase": "90 deg", "periods": "250 rad/m"}}
    model = Model.from_dict(tree)
    assert [model.unit(f"cogging.{p}") for p in ("amplitude", "phase", "periods", "phase2")] == [
        "N",
        "rad",
        "rad/m",
        "rad",
    ]
    assert model.effects["cogging"]["phase"] == pytest.approx(np.pi / 2)
    assert model.effects["cogging"]["periods"] == 250.0


@pytest.mark.parametrize("kind", ["voltage", "current"])
def test_a_drive_needs_its_gain_and_may_turn(kind, tree, message):
    tree["input"] = {"column": "u", "kind": kind, "unit": {"voltage": "V", "current": "A"}[kind]}
    assert "parameters.b: missing" in message(lambda: Model.from_dict(tree))
    tree["parameters"]["b"] = 0.5
    model = Model.from_dict(tree)
    assert not model.linear
    assert model.unit("b") == {"voltage": "N.m/V", "current": "N.m/A"}[kind]
    assert model.settings()["b"] == 0.5


def test_every_unit_of_the_servo_has_a_linear_twin():
    units = {p.unit for e in effects().values() for p in e.parameters} | {
        "N.m.s/rad",
        "kg.m2",
        "N.m/V",
    }
    for unit in units:
        linear = si_unit(unit, True, "force")
        assert "rad" not in linear
        assert "N.m" not in linear
        assert "V" not in linear
    assert si_unit("N.m.s2/rad2", True, "voltage") == "N.s2/m2"
    assert si_unit("N.m/rad", True, "voltage") == "N/m"


def test_bounds_that_are_not_given(tree):
    del tree["bounds"]
    assert Model.from_dict(tree).bounds == {
        "J": (0.002, 0.05),
        "a2": (0.0, 0.1),
        "coulomb.Fc": (0.0, 0.6),
    }
    tree["parameters"]["a2"] = 0.0  # nothing to scale by
    assert set(Model.from_dict(tree).bounds) == {"J", "coulomb.Fc"}
    tree["bounds"] = {}
    assert Model.from_dict(tree).bounds == {}
    own = {
        "J": 1.0,
        "a2": 1.0,
        "lugre.sigma0": 1.0,
        "lugre.sigma1": 0.0,
        "lugre.Fc": 1.0,
        "lugre.Fs": 2.0,
        "lugre.vs": 1.0,
    }
    found = default_bounds(law("lugre"), own)
    assert set(found) == {"J", "a2", "lugre.Fc", "lugre.Fs"}
    assert found["lugre.Fs"] == (0.4, 10.0)


def test_what_is_zero_unless_wanted_may_be_left_out(tree, message):
    tree["friction"] = "lugre"
    tree["bounds"] = {}
    tree["parameters"] |= {"sigma0": 10.0, "Fs": 0.2}
    assert "parameters.lugre.vs: missing" in message(lambda: Model.from_dict(tree))
    tree["parameters"]["vs"] = 0.1
    assert Model.from_dict(tree).parameters["lugre.sigma1"] == 0.0


def changed(tree, path, value):
    node = tree
    *way, last = path.split("/")
    for key in way:
        node = node[key] if key in node else node.setdefault(key, {})
    if value is None:
        del node[last]
    else:
        node[last] = value


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("friction", "coulom", ["friction", "did you mean 'coulomb'", "lugre"]),
        ("fricton", "coulomb", ["fricton", "unknown key", "did you mean 'friction'"]),
        ("parameters/Fcc", 1.0, ["parameters.Fcc", "did you mean 'Fc'", "J, a2, Fc"]),
        ("parameters/b", 1.0, ["parameters.b", "remove b"]),
        ("parameters/J", None, ["parameters.J: missing", "inertia"]),
        ("parameters/J", -1.0, ["parameters.J", "outside [1e-09, 1e+06] kg.m2"]),
        ("parameters/J", "0.1 kg", ["parameters.J", "kg.m2"]),
        ("parameters/J", float("nan"), ["parameters.J", "outside"]),
        ("parameters/J", True, ["parameters.J", "must be a number"]),
        ("parameters/coulomb", {"Fc": 0.1}, ["coulomb.Fc is given twice"]),
        ("bounds/J", [0.05, 0.002], ["bounds.J", "must rise"]),
        ("bounds/J", [0.02, 0.05], ["bounds.J", "nominal value 0.01 lies outside"]),
        ("bounds/J", [0.02], ["bounds.J", "two numbers"]),
        ("bounds/J", [0.002, float("inf")], ["bounds.J[1] = inf", "outside"]),
        ("bounds/sigma", [0, 1], ["bounds.sigma", "no parameter of law"]),
        ("time/unit", "V", ["time.unit", "does not fit"]),
        ("time/unit", "sec", ["time.unit", "not known"]),
        ("time/kind", "clock", ["time.kind", "unknown key", "allowed here: column, unit, scale"]),
        ("time/scale", "2 m", ["time.unit", "unit 's' with scale '2 m' gives none like 's'"]),
        ("time", None, ["time: missing"]),
        ("input/kind", "torq", ["input.kind", "'torque', 'force', 'voltage', 'current'"]),
        ("input/kind", "force", ["input.kind", "turns", '"torque"']),
        ("input/unit", "A", ["input.unit", "does not fit", "N.m"]),
        ("input/scale", "much", ["input.unit", "not a number with a unit"]),
        ("input/scale", "0 N.m", ["input.unit", "is zero"]),
        ("input/scale", 0.1, ["input.scale", "must be text in quotes"]),
        ("input/column", "theta", ["output.column", "is the column of [input] already"]),
        ("effects/gravity", 1, ["effects.gravity", "must be a table"]),
        ("output/unit", "m", ["input.kind", "metres", '"force"']),
        ("output/unit", "V", ["output.unit", "does not fit kind 'position'", "deg"]),
        ("output/kind", "velocity", ["output.unit", "does not fit kind 'velocity'", "rad/s"]),
        ("output/resolution", 0.0, ["output.resolution", "above 0"]),
        ("output/resolution", "much", ["output.resolution", "not a quantity"]),
        ("effects/coging", {}, ["effects.coging", "did you mean 'cogging'"]),
        (
            "effects/cogging",
            {"amplitud": 1.0},
            ["effects.cogging.amplitud", "did you mean 'amplitude'"],
        ),
        ("effects/cogging", {"amplitude": 1.0}, ["effects.cogging.periods: missing"]),
        (
            "effects/cogging",
            {"amplitude": 1.0, "periods": 0.5},
            ["effects.cogging.periods", "outside [1, 10000]"],
        ),
    ],
)
def test_every_mistake_is_one_line(path, value, words, tree, message, tmp_path):
    changed(tree, path, value)
    where = tmp_path / "model.toml"
    text = message(lambda: Model.from_dict(tree, where))
    assert text.startswith(f"{where}: ")
    for word in words:
        assert word in text, text


def test_effects_that_cannot_be_combined_are_refused(tree, message):
    tree["effects"] = {
        "presliding": {"stiffness": 1.0},
        "bristle_damping": {"stiffness": 1.0, "damping": 0.1},
    }
    assert "choose one of them" in message(lambda: Model.from_dict(tree))


def test_a_file_that_begins_with_a_byte_order_mark(tree, tmp_path):
    text = model_text(Model.from_dict(tree))
    (tmp_path / "model.toml").write_text(text, encoding="utf-8")
    (tmp_path / "marked.toml").write_text(text, encoding="utf-8-sig")
    assert (
        load_model(tmp_path / "marked.toml").parameters
        == load_model(tmp_path / "model.toml").parameters
    )


def test_files_that_cannot_be_read(tmp_path, message):
    assert "No such file" in message(lambda: load_model(tmp_path / "none.toml"))
    (tmp_path / "bad.toml").write_text("friction = ")
    assert "not valid TOML" in message(lambda: load_model(tmp_path / "bad.toml"))


def test_what_is_written_reads_back_the_same(tree, tmp_path):
    tree["output"] |= {
        "unit": "1",
        "scale": "0.1 deg",
        "resolution": 1.0,
        "column": 'a "quoted\\" name\n',
    }
    tree["effects"] = {
        "cogging": {"amplitude": 0.1 + 0.2, "periods": 7.0, "phase": -1.0},
        "hard_stop": {"stiffness": 1.0, "upper": 1.0, "lower": -1e6},
    }
    model = Model.from_dict(tree)
    model = replace(
        model,
        parameters={
            name: np.float64(value) * (1 + 1e-16) for name, value in model.parameters.items()
        },
    )
    path = tmp_path / "augmented.toml"
    path.write_text(model_text(model), encoding="utf-8")
    again = load_model(path)
    assert replace(again, path=None) == model
    assert tomllib.loads(model_text(model))["effects"]["cogging"]["amplitude"] == 0.1 + 0.2
    assert again.settings()["cogging.phase"] == -1.0


def test_a_model_without_bounds_reads_back_without(tree):
    tree["bounds"] = {}
    model = Model.from_dict(tree)
    assert Model.from_dict(tomllib.loads(model_text(model))) == model
