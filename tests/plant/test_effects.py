"""Effects: each composes with each law and differentiates exactly; those shipped follow their
equations, typed a second time.
"""

import math
import tomllib
from functools import cache
from itertools import combinations, pairwise
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bristle.common.errors import BristleError
from bristle.model.native import Native
from bristle.model.program import Program
from bristle.model.python import python_tables
from bristle.model.runtime import Core
from bristle.plant.effect import VIEWS, Context, Evidence, RecordedMotion
from bristle.plant.effects import effect, effects
from bristle.plant.friction import law, laws
from bristle.plant.servo import servo, servo_program

H = 1e-3
J, B, A2, FC = 0.001, 0.0065, 0.002, 0.004  # the defaults of the servo and of the law
LISTS = tomllib.loads((Path(__file__).parents[1] / "shipped.toml").read_text(encoding="utf-8"))
SHIPPED, SHIPPED_LAWS = tuple(LISTS["effects"]), tuple(LISTS["laws"])
# and extensions, which owe no more than what the tests of all names ask for
NAMES = tuple(effects())
GROUPS = (
    {"bias", "asymmetric_coulomb"},
    {"input_delay", "electrical_pole"},
    {"presliding", "bristle_damping"},
    {"load_friction", "gear_loss"},
    {"gravity", "return_spring"},
)
# the parameter whose derivative is tested: the first one, but for these
STRENGTH = {"bristle_damping": "damping", "backlash": "stiffness", "compliance": "stiffness"}
# no values at which they do nothing
ALWAYS_ACTING = {"presliding", "bristle_damping", "electrical_pole", "backlash", "compliance"}
SETTING = {
    "hard_stop.upper": 0.05,
    "disturbance_step.onset": 0.1,
    "backlash.play": 0.01,
    "saturation.limit": 2.5,
    "temperature_friction.temperature": 320.0,
}
SCALING = {
    "asymmetric_coulomb",
    "stribeck",
    "friction_drift",
    "position_friction",
    "temperature_friction",
}
BRISTLES = {"presliding", "bristle_damping"}
REFUSED = {(name, "viscous") for name in SCALING | BRISTLES} | {
    (name, "modified_polynomial") for name in ("load_friction", "gear_loss")
}
REFUSED |= {(name, other.name) for name in BRISTLES for other in laws().values() if other.states}


def strength(name):
    return f"{name}.{STRENGTH[name]}" if name in STRENGTH else effect(name).parameters[0].name


def setting(name):
    return {key: value for key, value in SETTING.items() if key.startswith(f"{name}.")}


def voltages(n, size=1.0):
    k = np.arange(n)
    return size * (2.5 * np.sin(0.023 * k) + np.sin(0.05 * k + 0.3))


@cache
def lean(name, law_name="coulomb"):
    """The servo of one law and one effect, with the derivative by the effect's strength."""
    return servo_program(law_name, encoder=False, effects=(name,), sensitivities=(strength(name),))


@cache
def plain(law_name):
    return servo_program(law_name, encoder=False)


def joined(name, law_name):
    """The servo of a law and an effect, or None where they cannot be combined."""
    try:
        system = servo(law(law_name), True, [effect(name)])
    except BristleError:
        return None
    system.name = name
    return system


@cache
def every(law_name):
    """All effects that join a law, behind a selector, so that they are compiled at once."""
    return Program(
        f"Every_{law_name}",
        [system for name in NAMES if (system := joined(name, law_name))],
        "case",
    )


# -- declarations ----------------------------------------------------------------------------------


def test_what_is_shipped_is_the_catalogue():
    assert set(SHIPPED) <= set(effects())
    assert len(SHIPPED) == len(set(SHIPPED)) == 28
    assert list(effects()) == sorted(effects())
    assert {name for name in SHIPPED if not effect(name).off} == ALWAYS_ACTING


@pytest.mark.parametrize("name", NAMES)
def test_each_effect_is_declared_in_full(name):
    e = effect(name)
    assert e.name == name
    members = e.group.split("/")
    assert name in members
    assert all(effect(other).group == e.group for other in members)
    if name in SHIPPED:
        assert set(members) == next((g for g in GROUPS if name in g), {name})
    assert all(p.name.startswith(f"{name}.") for p in e.parameters)
    assert strength(name) in [p.name for p in e.parameters]
    assert set(e.residual) <= set(VIEWS)
    assert e.residual
    assert e.excitation
    assert e.equation
    assert set(e.confounded) <= set(NAMES) - {name}
    shorts = {p.name.removeprefix(f"{name}.") for p in e.parameters}
    named = {e.free_play, e.periods} - {""}
    assert {
        *e.off,
        *e.unused,
        *e.search_interval,
        *e.second_term,
        *e.shape_parameters,
        *named,
    } <= shorts
    # a diagnosis compares it with that of the servo
    assert "stiffness" in shorts or not (e.bristles or e.free_play)
    for p in e.parameters:
        assert p.minimum <= p.default <= p.maximum
        low, high = e.search_interval.get(p.name.removeprefix(f"{name}."), (p.minimum, p.maximum))
        assert p.minimum <= low < high <= p.maximum
    slots = (e.command, e.drive, e.torque, e.factor, e.bound, e.output, e.coupling, e.bristles)
    # viscous and dry friction fall together
    assert sum(slot is not None for slot in slots) == 1 + (name == "temperature_friction")


@pytest.mark.parametrize("name", ["friction_drift", "position_friction"])
def test_friction_that_varies_never_drives(name):
    """Within the declared intervals of its parameters, the factor of dry friction is 0 or more."""
    e, rng = effect(name), np.random.default_rng(1)
    p = {q.name.removeprefix(f"{name}."): ca.SX.sym(q.name) for q in e.parameters}
    theta, time = ca.SX.sym("theta"), ca.SX.sym("time")
    factor = e.factor(Context(SimpleNamespace(**p), theta, ca.SX(1), ca.SX(0), time, ca.SX(0)))
    of = ca.Function("factor", [theta, time, *p.values()], [ca.vertcat(*factor)])
    low, high = np.array([(q.minimum, q.maximum) for q in e.parameters]).T
    seen = np.array(
        [of(rng.uniform(-4, 4), rng.uniform(0, 10), *rng.uniform(low, high)) for _ in range(2000)]
    )
    assert seen.min() == 0
    assert seen.max() > 1


def test_what_is_in_one_class_is_confounded():
    for group in GROUPS:
        for name in group:
            assert group - {name} <= set(effect(name).confounded)


def moved():
    """A motion of some seconds with reversals, as arrays (n,): position, velocity, acceleration,
    input and time.
    """
    t = H * np.arange(6000)
    theta = 2.0 * np.sin(2.0 * t) + 0.7 * np.sin(11.0 * t + 0.4)
    v, a = np.gradient(theta, H), np.gradient(np.gradient(theta, H), H)
    return theta, v, a, 1.5 * np.sin(5.0 * t) + 0.3 * v, t


@pytest.mark.parametrize("residual", ["noise", "none"])
@pytest.mark.parametrize("name", NAMES)
def test_start_values_are_finite_numbers_of_its_parameters(name, residual):
    """Also where nothing is left to explain, for which the regression returns zeros."""
    theta, v, a, u, t = moved()
    left = np.random.default_rng(1).normal(0.0, 0.01, len(t)) * (residual == "noise")

    def regress(torques):
        found = np.linalg.lstsq(torques, left, rcond=None)[0]
        return found, 0.5 * float(np.sum((torques @ found) ** 2))

    e = effect(name)
    starts = e.starts(Evidence(theta, v, a, u, t, H, 1e-4, J, FC, B, regress))
    shorts = {p.name.removeprefix(f"{name}.") for p in e.parameters}
    assert starts
    for start in starts:
        assert set(start) <= shorts
        assert all(math.isfinite(value) for value in start.values())


@pytest.mark.parametrize("hertz", [3.2, 6.0, 12.0])
def test_a_resonance_is_seen_in_the_torque_that_a_rigid_servo_lacks(hertz):
    """That of a load of half the inertia behind a spring, at any frequency, driven by noise."""
    share, t = 0.5, H * np.arange(30000)
    spring = {
        "compliance.share": share,
        "compliance.stiffness": share * (1 - share) * J * (2 * math.pi * hertz) ** 2,
    }
    native = Native(every("viscous"), spring | {"compliance.damping": 1e-4}, "compliance")
    u = np.repeat(np.random.default_rng(2).normal(0.0, 2.0, 3000), 10)
    v = native.run(H, {"u": u}, ["v"])[0][:-1, 0]
    evidence = Evidence(
        np.cumsum(v) * H,
        v,
        np.gradient(v, H),
        u,
        t,
        H,
        1e-4,
        J,
        0.0,
        B,
        lambda torques: (np.zeros(1), 0.0),
    )
    assert evidence.resonances(1)[0] == pytest.approx(hertz, rel=0.15)


@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_limits_from_records_are_intervals_of_its_parameters(name, linear):
    theta, v, _, u, t = moved()
    motion = RecordedMotion(
        theta, v, u, t, float(np.ptp(theta)) if linear else 2 * math.pi, 0.4, linear
    )
    declared = {p.name: p for p in effect(name).parameters}
    for make in (effect(name).limits, effect(name).credible):
        for key, (low, high) in effect(name).by_full_name(make(motion) if make else {}).items():
            assert max(low, declared[key].minimum) < min(high, declared[key].maximum), key


# -- composition -----------------------------------------------------------------------------------


@pytest.mark.parametrize("law_name", list(laws()))
def test_every_effect_joins_every_law_or_is_refused(law_name):
    allowed = set()
    for name in NAMES:
        try:
            servo(law(law_name), True, [effect(name)]).check()
            allowed.add(name)
        except BristleError as error:
            text = str(error)
            assert "\n" not in text
            assert text.startswith(f"effect '{name}' ")
            assert f"'{law_name}'" in text
            assert ";" in text
    if law_name in SHIPPED_LAWS:
        assert allowed & set(SHIPPED) == {
            name for name in SHIPPED if (name, law_name) not in REFUSED
        }


@pytest.mark.slow
@pytest.mark.sampled(11)
@pytest.mark.parametrize("law_name", list(laws()))
def test_each_runs_for_two_seconds_and_shows(law_name):
    program, u = every(law_name), voltages(2000, 3.0 if law_name == "modified_polynomial" else 1.5)
    base, _ = Native(servo_program(law_name)).run(H, {"u": u}, ["theta", "v", "F", "theta_enc"])
    for variant in program.variants:
        name = variant.system.name
        found, _ = Native(program, setting(name), name).run(
            H, {"u": u}, ["theta", "v", "F", "theta_enc"]
        )
        assert np.all(np.isfinite(found)), name
        assert np.max(np.abs(found[:, 1] - base[:, 1])) > 1e-3 * np.ptp(base[:, 1]), name
        # the encoder shows theta
        assert np.max(np.abs(found[:, 0] - found[:, 3])) < 2 * math.pi / 40000 + 1e-12, name


@pytest.mark.slow
@pytest.mark.sampled(11)
@pytest.mark.parametrize("law_name", list(laws()))
def test_with_zero_strength_it_is_the_servo_without_the_effect(law_name):
    program, u = every(law_name), voltages(2000, 3.0 if law_name == "modified_polynomial" else 1.5)
    base, _ = Native(servo_program(law_name)).run(
        H, {"u": u}, ["theta", "v", "F", "theta_enc", "v_enc"]
    )
    size = np.ptp(base, axis=0)
    for variant in program.variants:
        name = variant.system.name
        if effect(name).off:
            off = setting(name) | effect(name).by_full_name(effect(name).off)
            found, _ = Native(program, off, name).run(
                H, {"u": u}, ["theta", "v", "F", "theta_enc", "v_enc"]
            )
            # a bound makes the viscous law set-valued, which is integrated in steps of its own, to
            # second order
            limit = 1e-6 if effect(name).bound and law_name == "viscous" else 1e-12
            assert np.all(np.abs(found - base)[:, :3] <= limit * size[:3]), name
            assert limit > 1e-12 or np.all(found[:, 3:] == base[:, 3:]), name


@pytest.mark.sampled(4)
def test_pairs_compose_or_are_refused():
    refused = set()
    for pair in combinations(NAMES, 2):
        try:
            system = servo(law("coulomb"), False, [effect(name) for name in pair]).check()
        except BristleError:
            refused.add(frozenset(pair))
        else:
            assert all(
                p.name in system.parameters for name in pair for p in effect(name).parameters
            )
    shipped = {pair for pair in refused if pair <= set(SHIPPED)}
    assert shipped == {
        frozenset({"presliding", "bristle_damping"}),
        frozenset({"backlash", "compliance"}),
    }


def test_the_order_in_which_effects_are_named_does_not_matter():
    some = (
        "input_delay",
        "back_emf",
        "compliance",
        "gravity",
        "stribeck",
        "load_friction",
        "presliding",
    )
    one, two = (servo_program("coulomb", effects=e, encoder=False) for e in (some, some[::-1]))
    assert one.name == two.name
    assert one.token == two.token
    u = voltages(500)
    first, _ = Native(one).run(H, {"u": u}, ["theta", "v", "F", "theta_load"])
    second, _ = Native(two).run(H, {"u": u}, ["theta", "v", "F", "theta_load"])
    np.testing.assert_array_equal(first, second)
    assert np.all(np.isfinite(first))


@pytest.mark.parametrize(
    ("law_name", "names", "text"),
    [
        (
            "coulomb",
            ("coging",),
            (
                "unknown effect 'coging' (did you mean 'cogging'?); known: asymmetric_coulomb,"
                " asymmetric_viscous"
            ),
        ),
        ("coulomb", ("bias", "bias"), "effect 'bias' is given twice"),
        (
            "coulomb",
            ("compliance", "backlash"),
            "effects 'backlash' and 'compliance' both put a second inertia",
        ),
        (
            "coulomb",
            ("presliding", "bristle_damping"),
            "effects 'bristle_damping' and 'presliding' both put bristles under",
        ),
        (
            None,
            ("compliance", "backlash"),
            "effects 'backlash' and 'compliance' both put a second inertia",
        ),
    ],
)
def test_what_cannot_be_is_refused(law_name, names, text):
    with pytest.raises(BristleError) as caught:
        servo_program(law_name, effects=names)
    assert str(caught.value).startswith(text)
    assert "\n" not in str(caught.value)


def test_without_a_law_a_plant_has_all_laws_that_the_effects_can_join():
    assert [v.system.name for v in servo_program(effects=("bias",)).variants] == list(laws())
    rigid = [v.system.name for v in servo_program(effects=("presliding",)).variants]
    assert rigid == [name for name in laws() if ("presliding", name) not in REFUSED]
    assert 1 < len(rigid) < len(laws())


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", SHIPPED)
def test_what_changes_a_parameter_leaves_no_true_value_of_it(name):
    """Whatever scales or adds dry friction, splits the inertia, or acts in proportion to input or
    velocity.
    """
    e = effect(name)
    dry = bool(e.factor or e.bound) and name != "stribeck"  # which ends at Fc
    assert ("Fc" in e.without_truth) is (dry or e.coupling is not None)
    assert ("alpha2" in e.without_truth) is (
        e.coupling is not None or name in ("back_emf", "asymmetric_viscous", "temperature_friction")
    )
    assert ("b" in e.without_truth) is (e.coupling is not None or name == "gain_asymmetry")
    # the one is even in the velocity, the other is a load
    pushes = e.torque is not None and name not in ("quadratic_drag", "bias")
    assert ("load" in e.without_truth) is (
        pushes or e.coupling is not None or name == "asymmetric_coulomb"
    )
    assert ("delay" in e.without_truth) is (name in ("input_delay", "electrical_pole"))
    program = servo_program(
        "stribeck_static" if (name, "lugre") in REFUSED else "lugre", effects=(name,)
    )
    values = Native(program).values
    for key in ("alpha2", "b", "Fc", "v0", "load", "delay"):
        valid = values[program.index[f"true.{key}_valid"]]
        assert valid == (key not in e.without_truth)
        assert valid or values[program.index[f"true.{key}"]] == 0.0


# -- arithmetic ------------------------------------------------------------------------------------


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", NAMES)
def test_generated_python_gives_the_same_digits(name):
    program, n = lean(name), 200
    u, record = voltages(n), ["theta", "v", "F"]
    c, _ = Native(program, setting(name)).run(H, {"u": u}, record)
    core = Core(python_tables(program))
    for key, value in setting(name).items():
        core.v[program.index[key]] = value
    core.initialise(0.0)
    found = [[core.v[program.index[key]] for key in record]]
    for value in u:
        core.v[program.index["u"]] = float(value)
        core.advance(H)
        found.append([core.v[program.index[key]] for key in record])
    assert np.all(np.abs(np.array(found) - c) <= 1e-12 * np.max(np.abs(c), axis=0))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", NAMES)
def test_sensitivities_equal_central_differences(name):
    """Of the states by the steps taken; of what is measured by the chain rule on top."""
    program, key, u = lean(name), strength(name), voltages(800)
    system = program.variants[0].system
    states = [f"coulomb.{s}" for s in system.states]
    fixed = {
        "solver.max_step": 2.5e-4,
        "solver.tolerance": 1e-2,
        "solver.friction_step": 2.5e-4,
    } | setting(name)
    fixed = {k: value for k, value in fixed.items() if k in {*system.parameters, *system.inputs}}
    value = fixed.get(key, system.parameters[key].default)
    native = Native(program, fixed)
    record, sens = native.run(H, {"u": u}, states, sensitivities=True)
    assert sens is not None
    shown = ca.vertcat(system.outputs["theta"][1], system.outputs["v"][1])
    x = system.vector(list(system.states))
    rest = [s for s in system.symbols if s not in system.states]
    measured = ca.Function(
        "measured",
        [x, system.vector(rest)],
        [ca.jacobian(shown, x), ca.jacobian(shown, system.symbols[key])],
    )
    numbers = [native.values[program.place(system, each)] for each in rest]
    exact = np.empty((len(record), 2))
    for k in range(len(record)):
        by_x, by_p = measured(record[k], numbers)
        exact[k] = (np.asarray(by_x) @ sens[k, :, 0] + np.asarray(by_p)[:, 0]).ravel()
    delta = 1e-6 * value
    runs = [
        Native(program, fixed | {key: value + sign * delta}).run(H, {"u": u}, ["theta", "v"])[0]
        for sign in (1, -1)
    ]
    difference = (runs[0] - runs[1]) / (2 * delta)
    size = np.max(np.abs(difference), axis=0)
    assert size[0] > 0
    assert np.all(np.abs(exact - difference) <= 1e-5 * size)
    assert np.sum(np.diff(np.sign(record[1:, 1])) != 0) >= 2


# -- equations, typed a second time ----------------------------------------------------------------

LEVELS = ((3.0, 0.4), (-2.0, 0.5), (0.2, 0.3), (6.0, 0.4))  # volts and seconds


def levels(scale=1.0):
    return scale * np.concatenate([np.full(round(1e3 * length), u) for u, length in LEVELS])


def solve(rates, n, scale=1.0, pieces=LEVELS):
    """Return the states at the samples, x' = rates(t, x, u), from zero, with an independent
    solver.
    """
    x, begin, rows = np.zeros(n), 0.0, [np.zeros((1, n))]
    for u, length in pieces:
        steps = round(1e3 * length)
        times = begin + 1e-3 * np.arange(steps + 1)
        done = solve_ivp(
            lambda t, x, u=u: rates(t, x, scale * u),
            times[[0, -1]],
            x,
            "LSODA",
            times,
            rtol=1e-9,
            atol=1e-11,
            max_step=2e-3,
        )
        assert done.success
        x, begin = done.y[:, -1], times[-1]
        rows.append(done.y.T[1:])
    return np.concatenate(rows)


def simple(torque):
    """A single inertia with a torque T(t, theta, v, u), viscous friction included here."""
    return lambda t, x, u: [x[1], (torque(t, x[0], x[1], u) - A2 * x[1]) / J]


def limited(u, s):
    return math.copysign(min(abs(u), s), u)


def play(x, half):
    return math.copysign(max(abs(x) - half, 0.0), x)


def two(twist_torque):
    """Motor and load of half of J each, viscous friction on the motor; states theta, v, theta_load,
    v_load.
    """

    def rates(t, x, u):
        handed = twist_torque(x[0] - x[2], x[1] - x[3])
        return [x[1], (B * u - A2 * x[1] - handed) / (0.5 * J), x[3], handed / (0.5 * J)]

    return rates


VISCOUS = {  # name: (parameters, states, rates)
    "bias": ({"bias.torque": -0.004}, 2, simple(lambda t, th, v, u: B * u - 0.004)),
    "quadratic_drag": (
        {"quadratic_drag.coefficient": 3e-4},
        2,
        simple(lambda t, th, v, u: B * u - 3e-4 * v * abs(v)),
    ),
    "cogging": (
        {
            "cogging.amplitude": 0.003,
            "cogging.phase": 0.4,
            "cogging.amplitude2": 0.002,
            "cogging.phase2": -1.0,
            "cogging.periods": 5.0,
        },
        2,
        simple(
            lambda t, th, v, u: (
                B * u + 0.003 * math.sin(5 * th + 0.4) + 0.002 * math.sin(10 * th - 1.0)
            )
        ),
    ),
    "gravity": (
        {"gravity.amplitude": 0.01, "gravity.phase": 0.3},
        2,
        simple(lambda t, th, v, u: B * u - 0.01 * math.sin(th + 0.3)),
    ),
    "hard_stop": (
        {"hard_stop.stiffness": 0.3, "hard_stop.upper": 0.5, "hard_stop.lower": -0.4},
        2,
        simple(
            lambda t, th, v, u: (
                B * u - 0.3 * ((th - 0.5) if th > 0.5 else (th + 0.4) if th < -0.4 else 0.0)
            )
        ),
    ),
    "return_spring": (
        {"return_spring.stiffness": 0.01, "return_spring.rest": 0.3},
        2,
        simple(lambda t, th, v, u: B * u + 0.003 - 0.01 * th),
    ),
    "disturbance_step": (
        {
            "disturbance_step.torque": 0.006,
            "disturbance_step.onset": 0.25,
            "disturbance_step.rise": 0.1,
        },
        2,
        simple(
            lambda t, th, v, u: (
                B * u + 0.006 * (0.0 if t < 0.25 else 1.0 if t > 0.35 else (t - 0.25) / 0.1)
            )
        ),
    ),
    "dead_zone": ({"dead_zone.width": 0.5}, 2, simple(lambda t, th, v, u: B * play(u, 0.5))),
    "saturation": ({"saturation.limit": 2.5}, 2, simple(lambda t, th, v, u: B * limited(u, 2.5))),
    "gain_asymmetry": (
        {"gain_asymmetry.share": 0.2},
        2,
        simple(lambda t, th, v, u: B * u * (1.2 if u > 0 else 0.8)),
    ),
    "torque_ripple": (
        {"torque_ripple.share": 0.3, "torque_ripple.periods": 2.0, "torque_ripple.phase": 0.4},
        2,
        simple(lambda t, th, v, u: B * u * (1 + 0.3 * math.sin(2 * th + 0.4))),
    ),
    "asymmetric_viscous": (
        {"asymmetric_viscous.coefficient": 1.5e-3},
        2,
        simple(lambda t, th, v, u: B * u - 1.5e-3 * (v if v > 0 else -v)),
    ),
    "back_emf": ({"back_emf.constant": 0.1}, 2, simple(lambda t, th, v, u: B * (u - 0.1 * v))),
    "electrical_pole": (
        {"electrical_pole.time_constant": 0.02},
        3,
        lambda t, x, u: [x[1], (B * x[2] - A2 * x[1]) / J, (u - x[2]) / 0.02],
    ),
    "compliance": (
        {"compliance.stiffness": 2.0, "compliance.damping": 0.003},
        4,
        two(lambda twist, rate: 2.0 * twist + 0.003 * rate),
    ),
    "backlash": (
        {"backlash.play": 0.04, "backlash.stiffness": 5.0, "backlash.dissipation": 2.0},
        4,
        two(
            lambda twist, rate: (
                5.0 * play(twist, 0.02) * max(0.0, 1.0 + 2.0 * math.copysign(rate, rate * twist))
            )
        ),
    ),
}


def usual(name, parameters):
    """Without what bends the form of an effect, and its further terms."""
    bending = {f"{name}.{short}" for short in effect(name).optional_parameters}
    assert bending & set(parameters)
    return {key: value for key, value in parameters.items() if key not in bending}


FORMS = {  # name: (parameters with those that bend the form, states, rates)
    "cogging": (
        {
            "cogging.amplitude": 0.004,
            "cogging.periods": 2.0,
            "cogging.sine3": 0.3,
            "cogging.cosine3": 0.4,
            "cogging.sine4": 0.6,
            "cogging.cosine4": -0.8,
        },
        2,
        simple(
            lambda t, th, v, u: (
                B * u
                + 0.004 * math.sin(2 * th)
                + 0.002 * math.sin(6 * th + math.atan2(4, 3))
                + 0.004 * math.sin(8 * th - math.atan2(4, 3))
            )
        ),
    ),
    "compliance": (
        {"compliance.stiffness": 2.0, "compliance.damping": 0.003, "compliance.hardening": 1500.0},
        4,
        two(lambda twist, rate: 2.0 * twist + 3000.0 * twist**3 + 0.003 * rate),
    ),
    "backlash": (
        {
            "backlash.play": 0.04,
            "backlash.stiffness": 0.4,
            "backlash.dissipation": 2.0,
            "backlash.exponent": 1.5,
        },
        4,
        two(
            lambda twist, rate: (
                0.4
                / math.sqrt(1e-3)
                * math.copysign(abs(play(twist, 0.02)) ** 1.5, twist)
                * max(0.0, 1.0 + 2.0 * math.copysign(rate, rate * twist))
            )
        ),
    ),
    "gravity": (
        {
            "gravity.amplitude": 0.01,
            "gravity.phase": 0.3,
            "gravity.sine2": 0.32,
            "gravity.cosine2": -0.24,
        },
        2,
        simple(
            lambda t, th, v, u: (
                B * u
                - 0.01 * math.sin(th + 0.3)
                - 0.004 * math.sin(2 * th + math.atan2(-0.003, 0.004))
            )
        ),
    ),
    "hard_stop": (
        {
            "hard_stop.stiffness": 0.3,
            "hard_stop.upper": 0.5,
            "hard_stop.lower": -0.4,
            "hard_stop.exponent": 2.0,
        },
        2,
        simple(
            lambda t, th, v, u: (
                B * u
                - 3.0 * ((th - 0.5) ** 2 if th > 0.5 else -((th + 0.4) ** 2) if th < -0.4 else 0.0)
            )
        ),
    ),
}


@pytest.mark.parametrize("name", list(FORMS))
def test_another_form_of_an_effect_follows_the_equation(name):
    parameters, n, rates = FORMS[name]
    both = (parameters, usual(name, parameters))
    record, straight = (
        Native(every("viscous"), p, name).run(H, {"u": levels()}, ["theta", "v"])[0] for p in both
    )
    expected = solve(rates, n)[:, :2]
    size = np.ptp(expected, axis=0)
    assert np.all(np.abs(record - expected) <= 1e-5 * size)
    assert np.max(np.abs(straight - expected) / size) > 1e-2  # the form matters here


@pytest.mark.parametrize("name", list(VISCOUS))
def test_motion_without_dry_friction_follows_the_equation(name):
    parameters, n, rates = VISCOUS[name]
    record, _ = Native(every("viscous"), parameters, name).run(H, {"u": levels()}, ["theta", "v"])
    expected = solve(rates, n)[:, :2]
    without = solve(simple(lambda t, th, v, u: B * u), 2)
    size = np.ptp(expected, axis=0)
    assert np.all(np.abs(record - expected) <= 1e-5 * size)
    assert np.max(np.abs(expected - without) / size) > 1e-2  # the effect matters here


def dry(level):
    """Dry friction of the size level(t, theta, v, u): while the drive is stronger it does not
    stick.
    """
    return simple(
        lambda t, th, v, u: B * u - level(t, th, v, u) * (np.sign(v) if v else np.sign(u))
    )


COULOMB = {
    "asymmetric_coulomb": (
        {"asymmetric_coulomb.share": 0.3},
        dry(lambda t, th, v, u: FC * (1.3 if v > 0 else 0.7)),
    ),
    "stribeck": (
        {"stribeck.excess": 0.8, "stribeck.speed": 2.0},
        dry(lambda t, th, v, u: FC * (1 + 0.8 * math.exp(-((v / 2.0) ** 2)))),
    ),
    "friction_drift": ({"friction_drift.rate": 0.5}, dry(lambda t, th, v, u: FC * (1 + 0.5 * t))),
    "position_friction": (
        {
            "position_friction.amplitude": 0.6,
            "position_friction.periods": 2.0,
            "position_friction.phase": 0.5,
        },
        dry(lambda t, th, v, u: FC * (1 + 0.6 * math.sin(2 * th + 0.5))),
    ),
    "load_friction": (
        {"load_friction.coefficient": 0.2},
        dry(lambda t, th, v, u: FC + 0.2 * abs(B * u)),
    ),
    "gear_loss": (
        {"gear_loss.driving": 0.1, "gear_loss.driven": 0.4},
        dry(lambda t, th, v, u: FC + (0.4 if u * v < 0 else 0.1) * abs(B * u)),
    ),
}

DRY_FORMS = {
    "load_friction": (
        {
            "load_friction.coefficient": 0.1,
            "load_friction.falling": 0.4,
            "load_friction.speed": 2.0,
        },
        dry(lambda t, th, v, u: FC + (0.1 + 0.4 * math.exp(-((v / 2.0) ** 2))) * abs(B * u)),
    ),
    "stribeck": (
        {"stribeck.excess": 1.5, "stribeck.speed": 2.0, "stribeck.exponent": 1.0},
        dry(lambda t, th, v, u: FC * (1 + 1.5 * math.exp(-abs(v) / 2.0))),
    ),
    "friction_drift": (
        {"friction_drift.rate": 2.0, "friction_drift.settling": 4.0},
        dry(lambda t, th, v, u: FC * (1 + 0.5 * (1 - math.exp(-4.0 * t)))),
    ),
    "position_friction": (
        {
            "position_friction.amplitude": 0.4,
            "position_friction.periods": 2.0,
            "position_friction.phase": 0.5,
            "position_friction.sine2": 0.18,
            "position_friction.cosine2": 0.24,
        },
        dry(
            lambda t, th, v, u: (
                FC
                * (
                    1
                    + 0.4 * math.sin(2 * th + 0.5)
                    + 0.12 * math.sin(4 * th + math.atan2(0.4, 0.3))
                )
            )
        ),
    ),
}


def follows(name, parameters, rates):
    u = levels(1.5)[:900]  # never weaker than friction
    record, _ = Native(lean(name), parameters | {"solver.friction_step": 1e-5}).run(
        H, {"u": u}, ["theta", "v"]
    )
    expected, without = (
        solve(each, 2, 1.5, LEVELS[:2]) for each in (rates, dry(lambda t, th, v, u: FC))
    )
    size = np.ptp(expected, axis=0)
    assert np.all(np.abs(record - expected) <= 2e-4 * size)
    assert np.max(np.abs(expected - without) / size) > 2e-2
    assert np.min(expected[:, 1]) < 0 < np.max(expected[:, 1])


@pytest.mark.parametrize("name", list(COULOMB))
def test_motion_with_dry_friction_follows_the_equation(name):
    parameters, rates = COULOMB[name]
    follows(name, parameters, rates)


@pytest.mark.parametrize("name", list(DRY_FORMS))
def test_another_form_of_dry_friction_follows_the_equation(name):
    parameters, rates = DRY_FORMS[name]
    record, straight = (
        Native(lean(name), p).run(H, {"u": levels(1.5)[:900]}, ["theta", "v"])[0]
        for p in (parameters, usual(name, parameters))
    )
    # the form matters here
    assert np.max(np.abs(straight - record) / np.ptp(record, axis=0)) > 1e-2
    follows(name, parameters, rates)


def test_a_drift_is_continuous_where_a_series_replaces_the_exponential():
    """Where the exponential is replaced by its series, nothing jumps."""
    records = [
        Native(
            lean("friction_drift"), {"friction_drift.rate": 0.5, "friction_drift.settling": s}
        ).run(H, {"u": levels(1.5)}, ["theta", "v"])[0]
        for s in (0.0, 0.99e-4, 1.01e-4)
    ]
    size = np.ptp(records[0], axis=0)
    assert 0 < np.max(np.abs(records[1] - records[0]) / size) < 2e-4
    assert np.max(np.abs(records[2] - records[1]) / size) < 1e-5


@pytest.mark.parametrize(("name", "damping"), [("presliding", 0.0), ("bristle_damping", 0.02)])
def test_bristles_follow_the_equation(name, damping):
    """To second order in the step, whichever half of a step a reversal falls in."""

    def rates(t, x, u):
        dz = x[1] - 1.5 * abs(x[1]) * x[2] / FC
        return [x[1], (B * u - A2 * x[1] - 1.5 * x[2] - damping * dz) / J, dz]

    parameters = {f"{name}.stiffness": 1.5} | ({f"{name}.damping": damping} if damping else {})
    expected = solve(rates, 3)[:, :2]
    assert np.sum(np.diff(np.sign(expected[1:, 1])) != 0) == 2
    size, errors = np.ptp(expected, axis=0), []
    for step in (1e-3, 5e-4, 2.5e-4, 1.25e-4, 6.25e-5):
        record, _ = Native(lean(name), parameters | {"solver.friction_step": step}).run(
            H, {"u": levels()}, ["theta", "v"]
        )
        errors.append(np.max(np.abs(record - expected) / size))
    assert errors[0] <= 1e-5
    for coarse, fine in pairwise(errors):
        assert 3.3 <= coarse / fine <= 4.7


# -- what each must do besides ---------------------------------------------------------------------


def test_bristle_damping_of_none_is_presliding():
    u = voltages(800)
    first, _ = Native(lean("presliding")).run(H, {"u": u}, ["theta", "v", "F"])
    second, _ = Native(lean("bristle_damping"), {"bristle_damping.damping": 0.0}).run(
        H, {"u": u}, ["theta", "v", "F"]
    )
    np.testing.assert_allclose(second, first, rtol=0, atol=1e-12)


@pytest.mark.parametrize("periods", [0.0, 1.0, 3.25, 7.5, 40.0, 55.0])
def test_a_delay_shifts_the_input(periods):
    """By whole samples exactly, between them as the mean of its neighbours, and by 40 samples at
    most.
    """
    u, kept = voltages(600), min(periods, 40.0)
    whole, part = int(kept), kept - int(kept)
    before = np.concatenate([np.zeros(50), u])
    shifted = (1 - part) * before[50 - whole : 650 - whole] + part * before[
        49 - whole : 649 - whole
    ]
    found, _ = Native(lean("input_delay"), {"input_delay.delay": periods * H}).run(
        H, {"u": u}, ["theta", "v"]
    )
    expected, _ = Native(plain("coulomb")).run(H, {"u": shifted}, ["theta", "v"])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("law_name", ["coulomb", "modified", "viscous"])
def test_an_encoder_behind_play_stands_still_until_the_motor_has_crossed_it(law_name):
    """The play operator applied to the samples of a motion without it; within a sample only a
    reversal makes a difference.
    """
    play, u = 0.05, levels(1.5)
    shown, _ = Native(every(law_name), {"encoder_play.play": play}, "encoder_play").run(
        H, {"u": u}, ["theta", "v"]
    )
    motor, _ = Native(plain(law_name)).run(H, {"u": u}, ["theta", "v"])
    expected = [0.0]
    for theta in motor[1:, 0]:
        expected.append(min(max(expected[-1], theta - play / 2), theta + play / 2))
    largest = np.max(np.abs(np.diff(motor[:, 1]))) * H  # way back within the sample of a reversal
    np.testing.assert_allclose(shown[:, 0], expected, rtol=0, atol=largest)
    assert np.max(np.abs(shown[:, 0] - motor[:, 0])) == pytest.approx(play / 2)
    still = np.flatnonzero((shown[:, 1] == 0) & (motor[:, 1] != 0))
    assert len(still) > 20
    assert np.max(np.abs(np.diff(shown[:, 0])[still[:-1]])) < 2e-3
    moving = shown[:, 1] != 0
    np.testing.assert_array_equal(shown[moving, 1], motor[moving, 1])


def test_an_eccentric_encoder_shows_a_consistent_velocity():
    program, e, phi = every("viscous"), 0.1, 0.7
    parameters = {
        "eccentric_encoder.amplitude": e,
        "eccentric_encoder.phase": phi,
        "theta_start": 0.3,
        "eccentric_encoder.sine2": 0.2,
        "eccentric_encoder.cosine2": -0.3,
    }
    native = Native(program, parameters, "eccentric_encoder")
    names = ["theta", "v", "eccentric_encoder.theta", "eccentric_encoder.v", "theta_enc"]
    record, _ = native.run(1e-4, {"u": np.full(15000, 6.0)}, names)
    shown, rate, theta, v, counted = record.T
    twice = e * math.hypot(0.2, 0.3) * np.sin(2 * theta + math.atan2(-0.3, 0.2))
    np.testing.assert_allclose(shown, theta + e * np.sin(theta + phi) + twice, rtol=1e-13)
    assert np.max(np.abs(np.gradient(shown, 1e-4)[1:-1] - rate[1:-1])) < 1e-4 * np.max(rate)
    assert np.max(np.abs(rate - v)) > 0.05 * np.max(v)
    assert np.all(shown[::10] - counted[::10] < 2 * math.pi / 40000)
    plain_motion, _ = Native(plain("viscous"), {"theta_start": 0.3}).run(
        1e-4, {"u": np.full(15000, 6.0)}, ["theta", "v"]
    )
    # it moves nothing
    np.testing.assert_allclose(record[:, 2:4], plain_motion, rtol=1e-9, atol=1e-12)


def test_a_stop_carries_the_drive():
    parameters = {"hard_stop.stiffness": 0.4, "hard_stop.upper": 0.1}
    record, _ = Native(every("viscous"), parameters, "hard_stop").run(
        H, {"u": np.full(12000, 2.0)}, ["theta", "v"]
    )
    assert record[-1, 0] == pytest.approx(0.1 + B * 2.0 / 0.4, abs=1e-5)
    assert abs(record[-1, 1]) < 1e-3


def test_cogging_settles_where_its_slope_is_negative():
    parameters = {"cogging.amplitude": 0.01, "cogging.periods": 4.0, "theta_start": 0.1}
    record, _ = Native(every("viscous"), parameters, "cogging").run(
        H, {"u": np.zeros(12000)}, ["theta", "v"]
    )
    assert record[-1, 0] == pytest.approx(math.pi / 4, abs=1e-3)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("law_name", ["coulomb", "lugre", "modified"])
@pytest.mark.parametrize(
    ("name", "value", "level"),
    [
        ("asymmetric_coulomb", 0.3, lambda t, u: 1 + 0.3 * np.sign(u)),
        ("stribeck", 2.0, lambda t, u: 1.0),
        ("friction_drift", 0.25, lambda t, u: 1 + 0.25 * t),
        ("friction_drift", -0.5, lambda t, u: max(1 - 0.5 * t, 0.0)),
        ("load_friction", 0.1, lambda t, u: 1 + 0.1 * B * abs(u) / FC),
    ],
)
@pytest.mark.parametrize("u", [10.0, -10.0])
def test_friction_of_a_fast_shaft(law_name, name, value, level, u):
    """Set-valued and smooth laws agree on what the effect does to sliding friction, in both
    directions.
    """
    native = Native(every(law_name), {strength(name): value}, name)
    record, _ = native.run(H, {"u": np.full(3000, u)}, ["v", "F"])
    v, force = record[-1]
    assert force - A2 * v == pytest.approx(math.copysign(FC * level(3.0, u), u), rel=2e-3, abs=1e-6)


@pytest.mark.parametrize("share", [0.4, -0.4])
def test_unequal_bounds_stick_exactly_and_give_way_on_the_weak_side(share):
    program = lean("asymmetric_coulomb")
    for side in (1.0, -1.0):
        bound = FC * (1 + side * share)
        for part, moves in ((0.999, False), (1.01, True)):
            native = Native(
                program, {"asymmetric_coulomb.share": share, "theta_start": 0.123456789}
            )
            record, _ = native.run(
                H, {"u": np.full(1000, side * part * bound / B)}, ["theta", "v", "F"]
            )
            if moves:
                assert side * record[-1, 1] > 0.0
            else:
                assert np.all(record[:, 0] == 0.123456789)
                assert np.all(record[:, 1] == 0.0)
                assert record[-1, 2] == pytest.approx(side * part * bound, abs=1e-15)


def test_a_smooth_law_has_no_jump_where_its_friction_changes_direction():
    record, _ = Native(every("lugre"), {"asymmetric_coulomb.share": 0.5}, "asymmetric_coulomb").run(
        1e-4, {"u": voltages(20000)}, ["v", "F"]
    )
    assert np.max(np.abs(np.diff(record[:, 1]))) < 0.02 * np.ptp(record[:, 1])
    assert np.ptp(np.sign(record[:, 0])) == 2


def test_a_stiff_shaft_is_none():
    u = voltages(1000)
    one, _ = Native(plain("coulomb")).run(H, {"u": u}, ["theta", "v"])
    errors = []
    for stiffness in (1e2, 1e3, 1e4):
        found, _ = Native(
            lean("compliance"), {"compliance.stiffness": stiffness, "compliance.damping": 0.05}
        ).run(H, {"u": u}, ["theta", "v"])
        errors.append(np.max(np.abs(found - one)[:, 0]) / np.ptp(one[:, 0]))
    assert errors[2] < 1e-3
    assert errors[2] < errors[1] < errors[0]


def test_only_a_second_friction_level_distinguishes_asymmetry_from_constant_torque():
    """They move alike, from rest and over reversals; not so where friction is half as large
    again.
    """
    u = 0.25 * np.sin(2 * np.pi * np.arange(2000) / 1000) * np.linspace(0, 1, 2000)

    def theta(name, value, level):
        values = {"J": 0.01, "b": 1.0, "u_max": 1e6, "coulomb.Fc": level, name: value}
        program = servo_program("coulomb", encoder=False, effects=(name.split(".")[0],))
        return Native(program, values).run(1e-3, {"u": u}, ["theta"])[0]

    alike, apart = (
        np.abs(
            theta("bias.torque", -0.02, level) - theta("asymmetric_coulomb.share", 0.2, level)
        ).max()
        for level in (0.1, 0.15)
    )
    assert alike < 1e-9
    assert apart > 0.01
