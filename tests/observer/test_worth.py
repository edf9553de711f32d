"""What the methods of step 2 say their estimates are worth: where they are right, where noise or a
wrong model makes them wrong.
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
from bristle.observer import information, methods, observer_program
from bristle.observer.companion import View

SX = ca.SX
STEP = 1e-3
TRUE = {
    "alpha2": 2.0,
    "b": 6.5,
    "Fc": 4.0,
    "sigma0": 600.0,
    "sigma1": 800.0,
    "sigma2": 300.0,
    "c": 150.0,
}
STEP2 = ("sigma0", "sigma1", "sigma2", "c")
WIDE = {"lugre.vs": np.deg2rad(90.0)}
TWO_STEP = ("two_step_drem", "two_step_iv_drem", "two_step_martinez", "two_step_position")


@cache
def record(
    law: str = "modified", seconds: float = 60.0, seed: float = 3.0
) -> dict[str, np.ndarray]:
    """Return u, position and velocity of a plant under the reference controller."""
    plant = BusUnit("plant", Fmu(obtain("plant", law=law)), WIDE if law == "lugre" else {})
    controller = BusUnit("controller", Fmu(obtain("controller")), {"seed": seed, "order": 2.0})
    links = ((("controller", "u"), ("plant", "u")), (("plant", "v"), ("controller", "y_v")))
    names = (("controller", "u"), ("plant", "theta"), ("plant", "v"))
    trace = simulate(Bus((plant, controller), round(seconds / STEP), STEP, links, record=names))
    assert trace.failure is None
    return dict(
        zip(
            ("u", "theta", "y_v"),
            (np.ascontiguousarray(trace[port]) for port in names),
            strict=True,
        )
    )


def observed(
    method: str, data: dict[str, np.ndarray], counts: float = 40000.0, **given: float
) -> dict[str, np.ndarray]:
    """Return estimates, deviations and validity over time, through an encoder; alpha2 and b are
    given where they must be.
    """
    program = observer_program(method)
    known = {
        p.name: TRUE[p.symbol] for p in methods()[method].parameters if "known" in p.description
    }
    parameters = known | {f"{method}.{name}": value for name, value in given.items()}
    count = 2 * np.pi / counts
    if f"{method}.resolution" in program.index:
        parameters[f"{method}.resolution"] = count
    inputs = {
        "u": data["u"],
        "y_v": data["y_v"],
        "y_theta": np.floor(data["theta"] / count) * count,
    }
    names = [
        f"{name}_{what}" for what in ("hat", "sd", "valid") for name in (*TRUE, "load", "delay")
    ]
    out, _ = Native(program, parameters).run(STEP, inputs, names)
    assert np.all(np.isfinite(out))
    return dict(zip(names, out[1:].T, strict=True))


def wrong(found: dict[str, np.ndarray], names=TRUE) -> list[str]:
    """Return what is valid at the end and more than 10 % off."""
    off = {name: abs(found[f"{name}_hat"][-1] / TRUE[name] - 1) for name in names}
    return [name for name, error in off.items() if found[f"{name}_valid"][-1] and error > 0.1]


def late(data: dict[str, np.ndarray], samples: float) -> dict[str, np.ndarray]:
    """Return the record with a measurement that comes late."""
    k = np.arange(len(data["u"]))
    return data | {name: np.interp(k - samples, k, data[name]) for name in ("theta", "y_v")}


# -- right, and it says so -------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "names"),
    [
        ("swapped", tuple(TRUE)),
        ("swapped_position", tuple(TRUE)),
        ("swapped_known", STEP2),
        ("martinez_poznyak", STEP2),
        ("drem_position", STEP2),
        ("two_step_martinez", tuple(TRUE)),
        ("two_step_iv_drem", tuple(TRUE)),
        ("joint_ukf", tuple(TRUE)),
    ],
)
def test_what_is_right_is_valid_and_within_two_deviations(method, names):
    found = observed(method, record())
    for name in names:
        error = abs(found[f"{name}_hat"][-1] - TRUE[name])
        assert found[f"{name}_valid"][-1] == 1.0, name
        assert error < 2.5 * found[f"{name}_sd"][-1], name
        assert error < 0.05 * TRUE[name], name
        assert found[f"{name}_sd"][-1] < 0.08 * max(
            TRUE[name], 600.0 if name.startswith("sigma") else 0.0
        )


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", ["swapped", "swapped_position"])
@pytest.mark.parametrize("samples", [0.5, 2.0])
def test_filtered_approach_one_finds_a_delay_and_loses_nothing(method, samples):
    found = observed(method, late(record(), samples))
    assert found["delay_hat"][-1] == pytest.approx(samples, abs=0.2)
    assert not wrong(found)
    assert abs(found["c_hat"][-1] / TRUE["c"] - 1) < 0.03


# -- wrong, and it says so -------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.sampled(5)
@pytest.mark.parametrize(
    "method", [*TWO_STEP, "swapped_position", "joint_ekf", "joint_ukf", "parallel_elements"]
)
@pytest.mark.parametrize("case", ["coarse encoder", "delay", "wide Stribeck curve"])
def test_what_is_wrong_is_not_valid(method, case):
    data = {
        "coarse encoder": record(),
        "delay": late(record(), 2.0),
        "wide Stribeck curve": record("lugre"),
    }[case]
    found = observed(method, data, 4096.0 if case == "coarse encoder" else 40000.0)
    # the rest has no true value there
    own = ("alpha2", "b", "Fc") if case == "wide Stribeck curve" else tuple(TRUE)
    true_level = 3.0 if case == "wide Stribeck curve" else TRUE["Fc"]
    found = found | {"Fc_hat": found["Fc_hat"] * TRUE["Fc"] / true_level}
    assert not wrong(found, own)


def test_noise_in_the_regressor_is_told_from_the_samples_alone():
    """A tenth of the counts makes sigma_i and c too small by a third; the bound by reverse
    regression holds the truth.
    """
    fine, coarse = (observed("swapped_position", record(), counts) for counts in (40000.0, 4096.0))
    assert coarse["c_hat"][-1] < 0.75 * TRUE["c"]
    assert coarse["c_sd"][-1] > 0.5 * (TRUE["c"] - coarse["c_hat"][-1])
    assert fine["c_sd"][-1] < 0.05 * TRUE["c"]


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("method", "share"),
    [("besancon", 1.03), ("drem", 1.03), ("martinez_poznyak", 1.1), ("drem_position", 1.03)],
)
def test_a_wrong_b_that_is_given_as_known_makes_step_2_not_valid(method, share):
    assert observed(method, record())["c_valid"][-1] == 1.0
    off = observed(method, record(), b=share * TRUE["b"])
    errors = [abs(off[f"{name}_hat"][-1] / TRUE[name] - 1) for name in STEP2]
    assert max(errors) > 0.1
    assert not wrong(off, STEP2)


@pytest.mark.parametrize(
    "method",
    [
        "approach_one",
        "approach_one_known",
        "approach_one_smooth",
        "approach_one_smooth_known",
        "besancon_scalar",
        "two_step_printed",
    ],
)
def test_what_is_kept_to_show_its_failure_is_never_valid(method):
    found = observed(method, record())
    assert not any(found[f"{name}_valid"].any() for name in TRUE)


# -- when step 2 begins ----------------------------------------------------------------------------


@pytest.mark.sampled(4)
def test_step_2_begins_when_step_1_has_converged():
    data = record()
    names = [
        "two_step_martinez.step2_runs",
        "b_sd",
        "b_hat",
        "alpha2_sd",
        "alpha2_hat",
        "sigma0_hat",
        "sigma0_valid",
    ]
    inputs = {
        "u": data["u"],
        "y_v": data["y_v"],
        "y_theta": np.floor(data["theta"] * 40000 / 2 / np.pi) * 2 * np.pi / 40000,
    }

    def run(wait):
        out, _ = Native(
            observer_program("two_step_martinez"), {"two_step_martinez.longest_wait": wait}
        ).run(STEP, inputs, names)
        return out, int(np.argmax(out[:, 0] > 0))

    out, begin = run(1e6)
    assert 500 < begin < 20_000
    assert out[begin - 1, 1] < 0.0101 * out[begin - 1, 2]
    assert out[begin - 1, 3] < 0.0101 * out[begin - 1, 4]
    assert np.ptp(out[:begin, 5]) == 0.0
    assert not out[:begin, 6].any()
    assert np.all(out[begin:, 0] == 1.0)
    # the wait is that in motion, after what step 1 needs at least
    assert 501 <= run(0.5)[1] < begin


# -- the companion through a view ------------------------------------------------------------------


def test_the_form_along_a_direction_is_that_of_the_inverse():
    random = np.random.default_rng(1)
    rows = random.standard_normal((30, 5)) * [1.0, 100.0, 1e-2, 3.0, 1.0]
    matrix, direction = rows.T @ rows, random.standard_normal(4)
    found = float(
        ca.evalf(information.Factors(SX(ca.DM(matrix))).inverse_along(SX(ca.DM(direction))))
    )
    assert found == pytest.approx(direction @ np.linalg.solve(matrix[:4, :4], direction), rel=1e-8)


def test_a_view_fits_functions_of_fewer_parameters_with_what_is_known_of_one():
    """z = p h0 + q h1 + p q h2: two parameters in three entries, one of them known to a tenth; by
    numpy on the stacked rows.
    """
    random = np.random.default_rng(2)
    n, p, q, known = 400, 2.0, -0.7, 2.3
    h = random.standard_normal((n, 3))
    z = h @ [p, q, p * q] + 0.05 * random.standard_normal(n)
    weight = 25.0
    slope = SX(ca.DM([[1, 0], [0, 1], [q, p]]))
    rest, origin, certainty = (SX(ca.DM(x)) for x in ([0, 0, -p * q], [known, 0], [weight, 0]))
    view = View(slope, rest, origin, certainty, SX(2, 1), lambda fit: (fit, SX.eye(2)))
    lines = np.column_stack([h, z])
    seen, _ = view.of(SX(ca.DM(lines.T @ lines)), SX(4, 1))
    fit = np.array(ca.evalf(information.Factors(seen).regression())).ravel() + np.array(
        [known, 0.0]
    )
    turned = h @ np.array([[1, 0], [0, 1], [q, p]])
    stacked = np.vstack([turned, [np.sqrt(weight), 0.0]])
    right = np.concatenate([z + p * q * h[:, 2], [np.sqrt(weight) * known]])
    np.testing.assert_allclose(fit, np.linalg.lstsq(stacked, right, rcond=None)[0], rtol=1e-6)
