"""Functions for arrays, printed as NumPy, against CasADi's own evaluation point by point."""

import casadi as ca
import numpy as np
import pytest

from bristle.model.python import for_arrays
from bristle.plant.effects import effects
from bristle.plant.friction import laws
from bristle.plant.servo import servo_program

POINTS = 40
CASES = [(law, ()) for law in laws()] + [("coulomb", (name,)) for name in effects()]


@pytest.mark.parametrize(("law", "added"), CASES, ids=str)
def test_every_law_and_effect_gives_what_casadi_gives(law, added):
    program = servo_program(law, encoder=False, effects=added)
    kernel = program.variants[0].kernels["step"]
    [(function, _)] = kernel.blocks
    v, h = ca.SX.sym("v", function.numel_in(0)), ca.SX.sym("h")
    whole = ca.Function("whole", [ca.vertcat(v, h)], [function(v, h)])
    rng = np.random.default_rng(1)
    start = np.array([program.starts[i] for i in kernel.reads])[:, None]
    shape = (len(start), POINTS)
    given = np.vstack(
        [start * rng.uniform(0.5, 2.0, shape) + rng.normal(0, 0.3, shape), np.full(POINTS, 1e-3)]
    )
    outputs = for_arrays(whole)(list(given))
    expected = np.column_stack([np.asarray(whole(given[:, k])).ravel() for k in range(POINTS)])
    assert np.isfinite(expected).mean() > 0.5
    for row, want in zip(outputs, expected, strict=True):
        np.testing.assert_allclose(
            np.broadcast_to(row, POINTS), want, rtol=1e-9, atol=1e-12, equal_nan=True
        )


OPERATIONS = {
    "comparisons": lambda x, y: [
        x < y,
        x <= y,
        x == y,
        x != y,
        ca.logic_not(x > 0),
        ca.logic_and(x, y),
        ca.logic_or(x, y),
    ],
    "choices": lambda x, y: [ca.if_else(x > y, x, y), ca.sign(x)],
    "rounding": lambda x, y: [ca.floor(x), ca.ceil(x), ca.fabs(y)],
    "elementary": lambda x, y: [
        ca.sqrt(x),
        ca.exp(x),
        ca.log(x),
        ca.sin(x),
        ca.cos(x),
        ca.tanh(x),
        ca.atan2(x, y),
    ],
    "powers": lambda x, y: [x**y, x**3, x**0.5, 1 / x, 2 * x, x * x, -x, x / y, x - y],
    "constants": lambda x, y: [
        x + ca.inf,
        x - ca.inf,
        y + float("nan"),
        ca.SX(3) + 0 * x,
        x * -2.5,
    ],
}


@pytest.mark.parametrize("kind", OPERATIONS)
def test_every_operation_even_where_it_has_no_value(kind):
    z = ca.SX.sym("z", 2)
    function = ca.Function("f", [z], [ca.vertcat(*OPERATIONS[kind](z[0], z[1]))])
    edge = [-np.inf, -2.0, -0.5, -0.0, 0.0, 0.5, 1.0, 3.0, np.inf, np.nan]
    x, y = (a.ravel() for a in np.meshgrid(edge, edge))
    outputs = for_arrays(function)([x, y])
    expected = np.column_stack(
        [np.asarray(function([a, b])).ravel() for a, b in zip(x, y, strict=True)]
    )
    for row, want in zip(outputs, expected, strict=True):
        np.testing.assert_allclose(np.broadcast_to(row, len(x)), want, rtol=1e-12, equal_nan=True)


def test_a_minimum_or_maximum_lets_nan_through():
    z = ca.SX.sym("z", 2)
    least, most = for_arrays(
        ca.Function("f", [z], [ca.vertcat(ca.fmin(z[0], z[1]), ca.fmax(z[0], z[1]))])
    )([np.array([1.0, np.nan, 2.0]), np.array([np.nan, 1.0, 3.0])])
    np.testing.assert_array_equal(least, [np.nan, np.nan, 2.0])
    np.testing.assert_array_equal(most, [np.nan, np.nan, 3.0])
