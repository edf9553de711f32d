"""Properties of every observer method, and the errors of each on records made in this process."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.model.native import Native
from bristle.model.normalised import NORMALISED
from bristle.observer import estimated, methods, observer_program
from bristle.plant.servo import servo_program

STEP = 1e-3
SET_S = {
    "alpha2": 2.0,
    "b": 6.5,
    "Fc": 4.0,
    "sigma0": 600.0,
    "sigma1": 800.0,
    "sigma2": 300.0,
    "c": 150.0,
}
STEP1 = ("alpha2", "b", "Fc")
STEP2 = ("sigma0", "sigma1", "sigma2", "c")


def test_what_a_method_estimates_is_known_without_a_run() -> None:
    assert estimated("rls") == ["v", "alpha2", "b", "Fc", "load", "delay"]
    # never valid
    assert estimated("two_step_printed") == [
        "v",
        "w",
        "F",
        "alpha2",
        "b",
        "Fc",
        "sigma0",
        "sigma1",
        "sigma2",
        "c",
    ]
    with pytest.raises(BristleError, match="did you mean 'rls'"):
        estimated("rlss")


@lru_cache(maxsize=4)
def record(seconds: float, seed: int = 1) -> dict[str, np.ndarray]:
    """Let set S track low-pass noise of 120 deg/s under a PI controller with one sample of
    delay.
    """
    program = servo_program("modified", encoder=False)
    plant, index = Native(program), program.index
    n = int(seconds / STEP)
    random = np.random.default_rng(seed)
    decay = np.exp(-5 * STEP)
    noise = np.sqrt(1 - decay**2) * 2.1 * random.standard_normal(n)
    u, theta, v = np.zeros(n), np.zeros(n), np.zeros(n)
    reference = integral = voltage = 0.0
    table = plant.values
    for k in range(n):
        theta[k], v[k], u[k] = table[index["theta"]], table[index["v"]], voltage
        reference = decay * reference + noise[k]
        error = float(np.clip(reference, -5.2, 5.2)) - v[k]
        integral += 20 * STEP * error
        table[index["u"]] = voltage
        voltage = float(np.clip(4 * error + integral, -24, 24))
        plant.write(table)
        plant.advance(STEP)
        table = plant.values
    return {"u": u, "y_theta": theta, "y_v": v}


def observe(
    method: str,
    data: dict[str, np.ndarray],
    names: tuple[str, ...],
    parameters: dict[str, float] | None = None,
):
    """Return estimates, shape (n, len(names)); row k is the estimate for t_k."""
    out, _ = Native(observer_program(method), parameters).run(
        STEP, data, [f"{name}_hat" for name in names]
    )
    return out[1:]


def known(method: str) -> dict[str, float]:
    """Give alpha2 and b to the methods that take them as known."""
    parameters = methods()[method].parameters
    return {p.name: SET_S[p.symbol] for p in parameters if "known" in p.description}


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("method", "names", "limit"),
    [("bastin_gevers", STEP1, 3.0), ("rls", STEP1, 0.5), ("besancon", STEP2, 8.0)],
)
def test_method_finds_the_true_parameters(method, names, limit):
    final = observe(method, record(60.0), names, known(method))[-1]
    error = 100 * (final / [SET_S[name] for name in names] - 1)
    assert np.all(np.abs(error) < limit), dict(zip(names, error, strict=True))


@pytest.mark.parametrize(("method", "names"), [("bastin_gevers", STEP1), ("besancon", STEP2)])
def test_a_shift_of_the_input_by_one_sample_is_seen(method, names):
    data = record(60.0)
    shifted = data | {"u": np.concatenate([data["u"][1:], data["u"][-1:]])}
    truth = [SET_S[name] for name in names]
    right = np.max(np.abs(observe(method, data, names, known(method))[-1] / truth - 1))
    wrong = np.max(np.abs(observe(method, shifted, names, known(method))[-1] / truth - 1))
    assert wrong > 3 * right
    assert wrong > 0.04


@pytest.mark.sampled(11)
@pytest.mark.parametrize("method", sorted(methods()))
def test_method_reads_only_its_declared_output(method):
    data = record(5.0)
    # a gate is proposed only where the input stays; the velocity moves always
    names = ("v", *NORMALISED)
    unread = ({"y_v", "y_theta"} - {methods()[method].reads}).pop()
    garbled = data | {unread: np.random.default_rng(0).standard_normal(len(data["u"]))}
    np.testing.assert_array_equal(observe(method, data, names), observe(method, garbled, names))
    read = data | {methods()[method].reads: data[methods()[method].reads] * 1.01 + 0.1}
    assert not np.array_equal(
        observe(method, data, names), observe(method, read, names), equal_nan=True
    )


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", sorted(methods()))
def test_what_is_not_estimated_is_nan_and_not_valid(method):
    instance = Native(observer_program(method))
    record_names = [f"{name}_{what}" for name in NORMALISED for what in ("hat", "valid")]
    out, _ = instance.run(STEP, record(0.1), record_names)
    values = dict(zip(record_names, out[-1], strict=True))
    published = [name for name in NORMALISED if np.isfinite(values[f"{name}_hat"])]
    assert published
    for name in NORMALISED:
        if name not in published:
            assert values[f"{name}_valid"] == 0.0


@pytest.mark.sampled(4)
def test_both_steps_are_visible_all_the_time_and_step_2_is_not_valid_before_it_begins():
    names = [*(f"{n}_hat" for n in STEP1 + STEP2), *(f"{n}_valid" for n in STEP2)]
    instance = Native(observer_program("two_step"), {"two_step.longest_wait": 2.0})
    out, _ = instance.run(STEP, record(4.0), names)
    assert np.all(np.isfinite(out))
    assert not out[:2000, 7:].any()
    assert np.ptp(out[:1900, 3]) == 0.0  # waits
    assert np.ptp(out[2100:, 3]) > 1.0  # runs
    assert np.ptp(out[2100:, 0]) > 1e-6  # and step 1 goes on


def test_projection_keeps_sigma0_and_c_positive_under_a_wrong_model():
    data = record(20.0)
    parameters = known("besancon") | {"besancon.b": 3.0, "besancon.averaging": 0.0}
    estimates = observe("besancon", data, ("sigma0", "c"), parameters)
    assert estimates.min() >= 1.0
    assert np.any(estimates == 1.0)  # the bound was needed


@pytest.mark.sampled(4)
def test_printed_gains_change_the_estimates_but_do_not_converge():
    data = record(60.0)
    estimates = observe(
        "two_step_printed", data, ("alpha2", "sigma0", "c"), {"two_step_printed.step2_start": 30.0}
    )
    assert estimates[-1, 0] > 1.2 * SET_S["alpha2"]
    assert np.ptp(estimates[30000:, 2]) > 5.0
    assert abs(estimates[-1, 1]) < 0.1 * SET_S["sigma0"]


def printed(also, **given):
    """Return outputs and states of the printed scheme over 30 s."""
    parameters = {f"two_step_printed.{name}": value for name, value in given.items()} | {
        "two_step_printed.step2_start": 5.0
    }
    return Native(observer_program("two_step_printed"), parameters).run(
        STEP, record(30.0), list(also)
    )[0][1:]


def test_what_is_repaired_of_the_printed_scheme_can_be_had_as_printed():
    names = ("sigma1_hat", "sigma2_hat", "alpha2_hat")
    repaired, odd = printed(names), printed(names, even=0.0)
    assert np.ptp(odd[:, 1]) > 0.0
    # the second function, at negative velocities
    assert abs(odd[-1, 1] / repaired[-1, 1] - 1) > 0.2
    np.testing.assert_array_equal(odd[:, 2], repaired[:, 2])
    explicit = printed((*names, "v_hat"), implicit=0.0)
    assert np.all(np.isfinite(explicit))
    assert np.abs(explicit[-1, :2]).min() > 1e9  # it diverges, up to the bound


def test_at_gate_entry_the_printed_scheme_starts_from_the_gate():
    v = np.rad2deg(record(30.0)["y_v"])
    entries = 1 + np.flatnonzero(
        (np.abs(v[1:-1]) > 50) & (np.abs(v[:-2]) <= 50) & (np.abs(v[2:]) > 50)
    )
    states = ["two_step_printed.step1_v", *(f"two_step_printed.step1_{name}" for name in STEP1)]
    for measured in (1.0, 0.0):
        rows = printed(states, measured_entry=measured)
        for k in entries[[0, 5, -1]]:  # the step from k to k + 1, with theta^ of step k
            alpha2, b, friction = rows[k, 1:]
            u, sign = np.rad2deg(record(30.0)["u"][k]), np.sign(v[k])
            begun = v[k] if measured else 50 * sign
            predicted = begun + STEP * (b * u - alpha2 * (v[k] + v[k + 1]) / 2 - friction * sign)
            assert rows[k + 1, 0] == pytest.approx(
                v[k + 1] - np.exp(-0.1) * (v[k + 1] - predicted), rel=1e-4
            )


def test_convergence_measure_falls_as_the_estimates_settle():
    out, _ = Native(observer_program("bastin_gevers")).run(STEP, record(60.0), ["convergence"])
    assert out[1000:3000, 0].max() > 20 * out[-2000:, 0].max()


def test_an_unknown_method_is_refused_with_the_known_ones():
    with pytest.raises(BristleError, match=r"unknown observer 'kalman'; known: .*bastin_gevers"):
        observer_program("kalman")
