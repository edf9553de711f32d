"""The joint filters, the elements side by side and the heuristic for vc: equations, what they find,
and what upsets them.
"""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest

from bristle.fmus import obtain
from bristle.fmus.host import Fmu
from bristle.harness.cosim.bus import Bus, BusUnit
from bristle.harness.cosim.loop import simulate
from bristle.model.native import Native
from bristle.observer import kalman, observer_program, self_starting_ekf
from bristle.plant.servo import servo_program

STEP = 1e-3
COUNT = 2 * np.pi / 40000  # rad
SIX = ("alpha2", "b", "sigma0", "sigma1", "sigma2", "c")
SET_S = np.array([2.0, 6.5, 600.0, 800.0, 300.0, 150.0])
SERVO = {"J": 0.001, "b": 0.0065, "a2": 0.002}
LAWS = {
    "S": ("modified", {}),
    "L1": ("lugre", {"lugre.sigma1": 0.02}),
    "GMS": ("gms", {}),
    "parallel": ("modified_parallel", {}),
}
BEST = "self_starting_ekf"
PLACES = ("modified.theta", "modified.v", "modified.w")


@cache
def record(
    plant: str,
    seconds: float,
    order: int = 1,
    change: float = 0.0,
    load: float = 2.0,
    torque: tuple[float, float] = (0.0, 0.0),
) -> dict[str, np.ndarray]:
    """Return u, position, velocity and encoder under the reference controller.

    The normal load changes at `change`, if given; `torque`: from when [s] a load torque acts, and
    how large it is [N.m].
    """
    law, parameters = LAWS[plant]
    servo = BusUnit("plant", Fmu(obtain("plant", law=law)), SERVO | parameters)
    controller = BusUnit(
        "controller", Fmu(obtain("controller")), {"seed": 5.0, "order": float(order)}
    )
    links = ((("controller", "u"), ("plant", "u")), (("plant", "v"), ("controller", "y_v")))
    names = (("controller", "u"), ("plant", "theta"), ("plant", "v"))
    events = ((round(change / STEP), ("plant", "load_scale"), load),) if change else ()
    events += ((round(torque[0] / STEP), ("plant", "tau_load"), torque[1]),)
    trace = simulate(
        Bus((servo, controller), round(seconds / STEP), STEP, links, events, record=names)
    )
    assert trace.failure is None
    data = {port[1]: np.ascontiguousarray(trace[port]) for port in names}
    return data | {"encoder": np.floor(data["theta"] / COUNT) * COUNT}


def observed(
    method: str, data: dict[str, np.ndarray], also=(), encoder=True, **given: float
) -> np.ndarray:
    """Return the six estimates and other variables for each t_k."""
    instance = Native(
        observer_program(method), {f"{method}.{name}": value for name, value in given.items()}
    )
    inputs = {"u": data["u"], "y_theta": data["encoder" if encoder else "theta"], "y_v": data["v"]}
    out, _ = instance.run(STEP, inputs, [*(f"{name}_hat" for name in SIX), *also])
    return out[1:]


def errors(rows: np.ndarray, true: np.ndarray = SET_S) -> np.ndarray:
    """Return the errors of the six in %."""
    return 100 * np.abs(rows[:, :6] / true - 1)


def settled(rows: np.ndarray, true: np.ndarray = SET_S) -> float:
    """Return the last time any of the six is more than 5 % off."""
    outside = np.flatnonzero(~(errors(rows, true) <= 5).all(axis=1))
    return (outside[-1] + 1) * STEP if len(outside) else 0.0


# -- equations -------------------------------------------------------------------------------------


def stepped(h: float, start: np.ndarray, u: float, tau: float) -> np.ndarray:
    """Return (theta, v, w) after one sample by the filter's equations, for set S."""
    servo = kalman.ServoParameters(
        ca.SX(2.0), ca.SX(6.5), [ca.SX(600.0), ca.SX(800.0), ca.SX(300.0)], ca.SX(150.0), ca.SX(tau)
    )
    return np.array(
        ca.evalf(kalman.advance(ca.SX(start), servo, servo.push(ca.SX(u)), ca.SX(h)))
    ).ravel()


@pytest.mark.parametrize("tau", [0.0, 0.02])
def test_the_filter_steps_as_the_plant_does_to_second_order(tau):
    """The plant is integrated by another method, with error control; halving the sample must make
    the step's error 8 times less.
    """
    program = servo_program("modified", encoder=False)
    for seed in range(6):
        random = np.random.default_rng(seed)
        start, u = random.normal(size=3) * [0.1, 2.0, 3.0], float(random.normal() * 3)
        found = []
        for h in (4e-4, 2e-4):
            plant = Native(
                program, {"modified.tau": tau, "u_max": 100.0, "solver.tolerance": 1e-12}
            )
            table = plant.values
            for name, value in zip(PLACES, start, strict=True):
                table[program.index[name]] = value
            table[program.index["u"]] = u
            plant.write(table)
            plant.advance(h)
            exact = plant.values[[program.index[name] for name in PLACES]]
            found.append(np.abs(stepped(h, start, u, tau) - exact))
        assert np.all(found[0] < [1e-6, 1e-3, 1e-2])
        assert np.linalg.norm(found[1]) < np.linalg.norm(found[0]) / 5


def test_the_prediction_carries_the_covariance_by_the_slope_of_the_step():
    """P' = F P F' with F by central differences of the step itself."""
    random = np.random.default_rng(1)
    entries = np.array([2.0, 6.5, 4.0, 5.0, 2.0, np.log(150.0), 0.01, 0.7, 1.3, 0.2])
    z = np.concatenate([[0.3, 1.2, 2.5], entries])
    order = len(z)
    root = random.normal(size=(order, order)) * 0.01
    covariance = root @ root.T
    symbol = ca.SX.sym("z", order)
    meaning = self_starting_ekf._servo
    inputs = ca.SX([2.0, 1.0, -3.0, 0.5])
    stepped = kalman.sample(symbol[:3], meaning(symbol[3:]), inputs, ca.SX(1e-3))
    whole = ca.Function("f", [symbol], [ca.vertcat(stepped, symbol[3:])])
    slope = np.column_stack(
        [
            (np.array(whole(z + step)) - np.array(whole(z - step))).ravel() / 2e-6
            for step in 1e-6 * np.eye(order)
        ]
    )
    moved, new = kalman.predict(meaning, ca.SX(z), ca.SX(covariance), inputs, ca.SX(1e-3))
    np.testing.assert_allclose(
        np.array(ca.evalf(moved)).ravel(), np.array(whole(z)).ravel(), rtol=1e-12
    )
    np.testing.assert_allclose(
        np.array(ca.evalf(new)),
        slope @ covariance @ slope.T,
        atol=1e-9 * np.abs(covariance).max() + 1e-11,
    )


# -- what they find --------------------------------------------------------------------------------


@pytest.mark.sampled(4)
@pytest.mark.parametrize("order", [1, 2])
def test_it_starts_itself_and_finds_all_six_from_the_encoder(order):
    rows = observed(BEST, record("S", 60.0, order), [f"{BEST}.starts"])
    assert settled(rows) < 10.0
    assert errors(rows)[-1].max() < 0.04
    # one step a sample: 0.02
    assert errors(observed(BEST, record("S", 60.0, order), encoder=False))[-1].max() < 0.01
    assert rows[-1, -1] == 1.0  # one start, and no change seen where nothing changed


def test_what_it_starts_from_does_not_matter():
    ends = [observed(BEST, record("S", 30.0), c_start=c)[-1, :6] for c in (15.0, 100.0, 1500.0)]
    for end in ends:
        assert np.max(100 * np.abs(end / SET_S - 1)) < 2.0


@pytest.mark.sampled(4)
def test_it_finds_a_delay_of_the_measurement_and_of_none():
    """The true delay is known; a filter that takes it as zero is off by percents and says that its
    estimates do not count.
    """
    data, also = record("S", 30.0), ["delay_hat", "delay_sd", "b_valid"]
    for samples in (0.0, 0.5, 1.0, 2.0):
        time = STEP * (np.arange(len(data["u"])) - samples)
        late = np.interp(time, STEP * np.arange(len(data["u"])), data["theta"])
        rows = observed(BEST, data | {"encoder": np.floor(late / COUNT) * COUNT}, also)
        assert rows[-1, 6] == pytest.approx(samples, abs=0.02)
        assert rows[-1, 8] == 1.0
        assert errors(rows)[-1].max() < 0.3
    deaf = observed(
        BEST, data | {"encoder": np.floor(late / COUNT) * COUNT}, also, delay_spread=0.0
    )
    assert errors(deaf)[-1].max() > 3.0
    assert deaf[-1, 8] == 0.0


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", ["rls", "swapped_position", "self_starting_ekf"])
@pytest.mark.parametrize("samples", [2, 2.5])
def test_a_delay_that_is_declared_costs_no_accuracy(method, samples):
    data = record("S", 30.0)
    steps = np.arange(len(data["u"]))
    late = data | {
        "encoder": np.floor(np.interp(steps - samples, steps, data["theta"]) / COUNT) * COUNT
    }
    program = observer_program(method)

    def b_of(signals: dict[str, np.ndarray], delay: float) -> float:
        inputs = {"u": signals["u"], "y_theta": signals["encoder"], "y_v": signals["v"]}
        return float(Native(program, {"delay": delay}).run(STEP, inputs, ["b_hat"])[0][-1, 0])

    assert abs(b_of(late, samples) - 6.5) < 1.5 * abs(b_of(data, 0.0) - 6.5) + 0.01
    if method != "self_starting_ekf":  # which finds it
        assert abs(b_of(late, 0.0) - 6.5) > 2 * abs(b_of(late, samples) - 6.5)


def test_an_input_that_comes_too_late_is_no_delay_and_makes_nothing_valid():
    data = record("S", 30.0)
    late = data | {"u": np.concatenate([data["u"][:2], data["u"][:-2]])}
    rows = observed(BEST, late, ["b_valid", "innovation"])
    assert rows[-1, 6] == 0.0
    assert rows[-1, 7] > 4.0


@pytest.mark.sampled(4)
@pytest.mark.parametrize("share", [0.02, 0.5])
def test_it_finds_a_constant_load_torque_and_its_step(share):
    """J v' = b u + tau_load - F - a2 v: the load over the inertia is `share` of Fc = 4 rad/s2, from
    the start or from 30 s on.
    """
    for begin in (0.0, 30.0):
        rows = observed(
            BEST,
            record("S", 45.0, torque=(begin, share * 0.004)),
            ["load_hat", "load_valid", "load_sd"],
        )
        assert rows[-1, 6] == pytest.approx(4.0 * share, abs=0.002)
        assert rows[-1, 7] == 1.0
        assert abs(rows[-1, 6] - 4.0 * share) < 4 * rows[-1, 8]
        assert errors(rows)[-1].max() < 0.3
        assert settled(rows) < begin + 10.0


@pytest.mark.sampled(4)
def test_rest_teaches_nothing_and_spoils_nothing():
    """The servo rests for ten times as long as it has moved."""
    inputs = np.concatenate([record("S", 20.0)["u"], np.zeros(200_000)])
    plant = Native(servo_program("modified"), SERVO)
    theta, velocity = plant.run(STEP, {"u": inputs}, ["theta", "v"])[0][:-1].T
    still = {"u": inputs, "encoder": np.floor(theta / COUNT) * COUNT, "v": velocity}
    rows = observed(BEST, still, ["b_sd", "b_valid"])
    assert errors(rows)[-1].max() < 2 * errors(rows)[20_000].max() + 0.05
    assert rows[-1, 6] == pytest.approx(rows[20_500, 6], rel=0.2)
    assert rows[-1, 7] == 1.0


def test_motion_in_one_direction_makes_nothing_valid():
    time = STEP * np.arange(30_000)
    data = {
        "u": 2.0 + 0.5 * np.sin(time),
        "encoder": np.floor(3 * time / COUNT) * COUNT,
        "v": np.full(len(time), 3.0),
    }
    rows = observed(BEST, data, [f"{name}_valid" for name in SIX])
    assert not rows[:, 6:].any()


def test_an_entry_set_back_to_its_bound_moves_the_others_as_the_covariance_relates_them():
    """The result is the point of the bound that is nearest in the norm of the inverse covariance;
    by a solver of its own.
    """
    covariance = np.array([[4.0, 1.5, -0.5], [1.5, 2.0, 0.3], [-0.5, 0.3, 1.0]])
    z = np.array([1.0, -2.0, 0.5])
    found = np.array(
        ca.evalf(kalman.bounded(ca.SX(z), ca.SX(covariance), {1: ca.SX(0)}, {}))
    ).ravel()
    inverse = np.linalg.inv(covariance)
    system = np.block([[inverse, np.eye(3)[:, 1:2]], [np.eye(3)[1:2], np.zeros((1, 1))]])
    nearest = np.linalg.solve(system, np.concatenate([inverse @ z, [0.0]]))[:3]
    np.testing.assert_allclose(found, nearest, atol=1e-12)
    inside = np.array(
        ca.evalf(kalman.bounded(ca.SX(z), ca.SX(covariance), {1: ca.SX(-3)}, {1: ca.SX(3)}))
    ).ravel()
    np.testing.assert_array_equal(inside, z)


def test_it_starts_anew_when_the_load_doubles():
    data = record("S", 50.0, change=30.0)
    rows = observed(BEST, data, [f"{BEST}.starts"])
    loaded = SET_S * [1, 1, 2, 2, 2, 1]
    assert rows[29_999, -1] == 1.0
    assert rows[-1, -1] == 2.0
    assert 30.0 < settled(rows, loaded) < 40.0
    deaf = observed(BEST, data, change_ratio=1e12, surprise=1e12)
    assert settled(deaf, loaded) > 49.0  # without the detection it does not come back


@pytest.mark.parametrize("load", [0.7, 1.1])
def test_it_sees_a_small_change_of_the_load_too(load):
    rows = observed(BEST, record("S", 50.0, change=30.0, load=load), [f"{BEST}.starts"])
    loaded = SET_S * [1, 1, load, load, load, 1]
    assert rows[-1, -1] == 2.0
    assert 30.0 < settled(rows, loaded) < 40.0
    assert errors(rows, loaded)[-1].max() < 0.3


def test_an_estimate_is_valid_where_it_is_certain():
    rows = observed(BEST, record("S", 20.0), [f"{name}_valid" for name in SIX])
    valid, error = rows[:, 6:] > 0, errors(rows)
    assert not valid[:1000].all(axis=1).any()  # not from its first second
    assert valid[10_000:].all()
    assert error[valid].max() < 30.0
    assert np.quantile(error[valid], 0.99) < 8.0
    assert error[~valid].max() > 50.0


def test_it_finds_bristle_damping_where_there_is_some():
    rows = observed(BEST, record("L1", 60.0), ["tau_hat"])
    assert rows[-1, -1] == pytest.approx(0.025, rel=0.2)  # sigma1 / sigma0 of the original law
    assert observed(BEST, record("S", 60.0), ["tau_hat"])[-1, -1] < 1e-3
    np.testing.assert_allclose(rows[-1, :2], [2.0, 6.5], rtol=0.03)


def test_rest_neither_starts_it_nor_winds_it_up():
    data = record("S", 20.0)
    rest = 20_000
    still = {
        name: np.concatenate([values, np.full(rest, values[-1] if name != "u" else 0.0)])
        for name, values in data.items()
    }
    variances = [f"{BEST}.cov{n * (n + 3) // 2}" for n in range(3, 10)]
    priors = [f"{BEST}.prior{n}" for n in range(3, 10)]
    rows = observed(BEST, still, [*variances, *priors])
    assert np.all(np.isfinite(rows))
    assert np.all(rows[:, 6:13] <= 1.003 * rows[:, 13:] ** 2 + 1e-12)
    nothing = {name: np.zeros(5_000) for name in data}
    rows = observed(BEST, nothing, ["sigma0_valid", f"{BEST}.starts"])
    assert rows[-1, -1] == 0.0
    assert rows[:, -2].max() == 0.0


@pytest.mark.sampled(4)
def test_constant_noise_and_the_papers_entries_are_slower_and_less_exact():
    data = record("S", 60.0)
    usual, own = observed("joint_ekf", data), observed(BEST, data)
    assert errors(usual)[-1].max() < 15.0
    assert errors(usual)[-1].max() > 10 * errors(own)[-1].max()
    assert settled(usual) > 3 * settled(own)


@pytest.mark.slow
def test_elements_side_by_side_are_found_where_their_distances_are_known():
    data = record("parallel", 60.0)
    c = {"c1": 50.0, "c2": 150.0, "c3": 450.0}
    names = [f"parallel_elements.fit{i}" for i in range(11)]
    rows = observed("parallel_elements", data, [*names, "Fc_hat"], **c)[:, 6:]
    levels = np.array([4.0, 16 / 3, 2.0])
    true = [
        2.0,
        6.5,
        *np.concatenate(
            [share * c[f"c{i}"] * levels for i, share in enumerate((0.4, 0.3, 0.3), start=1)]
        ),
    ]
    np.testing.assert_allclose(rows[-1, :2], true[:2], rtol=0.01)
    assert rows[-1, -1] == pytest.approx(4.0, rel=0.01)
    stiffness = rows[-1, 2:11].reshape(3, 3) / np.array(list(c.values()))[:, None]
    # the levels are better known than who holds them
    np.testing.assert_allclose(stiffness.sum(axis=0), levels, rtol=0.1)


@pytest.mark.sampled(4)
def test_elements_side_by_side_follow_maxwell_slip_better_than_one_alone():
    data = record("GMS", 60.0)
    late = slice(30_000, None)
    several = observed("parallel_elements", data, ["w_hat"])[late, -1]
    one = observed("parallel_elements", data, ["w_hat"], c1=100.0, c2=100.0, c3=100.0)[late, -1]
    w = true_friction(data)[late]
    assert np.std(several - w) < 0.7 * np.std(one - w)


def true_friction(data: dict[str, np.ndarray]) -> np.ndarray:
    """Return the friction acceleration without the viscous part from the motion itself: b u -
    alpha2 v - v'.
    """
    v = data["v"]
    rate = np.concatenate([np.diff(v), [0.0]]) / STEP
    middle = np.concatenate([(v[1:] + v[:-1]) / 2, v[-1:]])
    return 6.5 * data["u"] - 2.0 * middle - rate


def test_the_heuristic_takes_the_lowest_speed_of_uniform_motion():
    def held(*levels):
        return np.repeat(levels, 4000).astype(float)

    u = held(0.5, 0.0, 1.0, 0.0, 1.5, 0.0, 2.0, 0.0)
    uneven = 0.8 * (1 + 0.3 * np.sin(np.arange(4000) * 0.02))  # stick and slip at 1.0 V
    v = np.concatenate([held(0.0, 0.0), uneven, held(0.0, 2.0, 0.0, 3.0, 0.0)])
    data = {"u": u, "theta": np.zeros_like(u), "v": v, "encoder": np.zeros_like(u)}
    rows = observed("uniform_motion", data, ["vc_hat", "vc_valid"])
    assert rows[-1, -2] == pytest.approx(2.0, rel=0.01)
    assert rows[19_000, -1] == 0.0
    assert rows[-1, -1] == 1.0
