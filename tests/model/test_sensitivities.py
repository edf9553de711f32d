"""Exact derivatives of the steps taken: against differences of whole runs, CasADi through the whole
chain, closed forms.
"""

import casadi as ca
import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.model.native import Native
from bristle.model.program import Program
from bristle.model.system import System
from bristle.model.variables import Parameter, State, Variable
from bristle.plant.servo import servo_program

LAWS = {
    "lugre": ("J", "b", "a2", "lugre.sigma0", "lugre.sigma1", "lugre.Fc", "lugre.Fs", "lugre.vs"),
    "modified": (
        "J",
        "b",
        "a2",
        "modified.sigma0",
        "modified.sigma1",
        "modified.sigma2",
        "modified.c",
        "modified.tau",
    ),
    "coulomb": ("J", "b", "a2", "coulomb.Fc"),
}
START = {"lugre.sigma1": 0.01, "modified.tau": 0.01}
# Every error is acceptable, so that a small change of a parameter does not change the steps that
# are taken.
FIXED = {
    "lugre": {"solver.tolerance": 1e-2},
    "modified": {"solver.tolerance": 1e-2},
    "coulomb": {"solver.friction_step": 2.5e-4},
}


def voltages(n):
    k = np.arange(n)
    return 2.5 * np.sin(0.023 * k) + np.sin(0.05 * k + 0.3)


def setting(law):
    return (
        {k: x for k, x in START.items() if k.startswith(law)}
        | FIXED[law]
        | {"solver.max_step": 2.5e-4}
    )


@pytest.mark.sampled(4)
@pytest.mark.parametrize("law", list(LAWS))
def test_sensitivities_equal_central_differences_of_the_whole_run(law):
    names, n = LAWS[law], 1500
    program = servo_program(law, encoder=False, sensitivities=names)
    states = [f"{law}.{s}" for s in program.variants[0].system.states]
    u = voltages(n)
    defaults = {
        name: p.default for name, p in program.variants[0].system.parameters.items()
    } | setting(law)
    native = Native(program, setting(law))
    record, exact = native.run(1e-3, {"u": u}, states, sensitivities=True)
    plain, none = Native(program, setting(law)).run(1e-3, {"u": u}, states)
    assert none is None
    np.testing.assert_array_equal(record, plain)  # to ask for derivatives changes nothing
    assert np.sum(np.diff(np.sign(record[1:, 1])) != 0) > 5
    for k, name in enumerate(names):
        delta = 1e-6 * defaults[name]
        runs = []
        for sign in (1, -1):
            shifted = Native(program, setting(law) | {name: defaults[name] + sign * delta})
            runs.append(shifted.run(1e-3, {"u": u}, states)[0])
            assert shifted.steps == native.steps
        difference = (runs[0] - runs[1]) / (2 * delta)
        size = np.max(np.abs(difference), axis=0)
        assert np.all(size[:2] > 0)
        assert np.all(np.abs(exact[:, :, k] - difference) <= 3e-6 * size + 1e-30)


@pytest.mark.parametrize("law", list(LAWS))
def test_sensitivities_equal_casadi_through_the_chain_of_steps(law):
    names, n = LAWS[law], 120
    program = servo_program(law, encoder=False, sensitivities=names)
    system, kernel = program.variants[0].system, program.variants[0].kernels["step"]
    [(step, _)] = kernel.blocks
    states = [f"{law}.{s}" for s in system.states]
    native = Native(program, setting(law))
    table = native.values
    index = program.index
    u = voltages(n)
    _, exact = native.run(1e-3, {"u": u}, states, sensitivities=True)
    x, p, drive = ca.MX.sym("x", len(states)), ca.MX.sym("p", len(names)), ca.MX.sym("u")
    here = dict(zip([index[s] for s in states], ca.vertsplit(x), strict=True))
    here |= dict(zip([index[s] for s in names], ca.vertsplit(p), strict=True)) | {index["u"]: drive}
    arguments = ca.vertcat(*(here.get(i, table[i]) for i in kernel.reads))
    one = ca.Function("one", [x, drive, p], [step(arguments, 2.5e-4)[: len(states)]])
    four = ca.Function(
        "four", [x, drive, p], [one(one(one(one(x, drive, p), drive, p), drive, p), drive, p)]
    )
    chain = four.fold(n)
    final = chain(ca.DM(table[[index[s] for s in states]]), ca.DM(u).T, ca.repmat(p, 1, n))
    jacobian = ca.Function("jacobian", [p], [ca.jacobian(final, p)])
    expected = np.asarray(jacobian(table[[index[s] for s in names]]))
    np.testing.assert_allclose(
        exact[-1], expected, rtol=1e-9, atol=1e-12 * np.max(np.abs(expected))
    )


def test_sensitivity_of_a_linear_servo_in_closed_form():
    program = servo_program("viscous", encoder=False, sensitivities=("b", "a2", "J"))
    n, j, b, a2, u = 1000, 0.001, 0.0065, 0.002, 3.0
    _, s = Native(program).run(1e-3, {"u": np.full(n, u)}, ["v"], sensitivities=True)
    t = 1e-3 * np.arange(n + 1)
    e = np.exp(-a2 / j * t)
    by_b = u / a2 * (1 - e)
    by_a2 = -b * u / a2**2 * (1 - e) + b * u / a2 * t / j * e
    by_j = -b * u / a2 * (a2 * t / j**2) * e
    for k, expected in enumerate((by_b, by_a2, by_j)):
        np.testing.assert_allclose(
            s[:, 1, k], expected, rtol=0, atol=1e-6 * np.max(np.abs(expected))
        )


def test_while_it_sticks_nothing_depends_on_anything():
    program = servo_program("coulomb", sensitivities=("coulomb.Fc", "b"))
    _, s = Native(program).run(1e-3, {"u": np.full(50, 0.5)}, ["v"], sensitivities=True)
    assert np.all(s == 0.0)


def test_an_unknown_sensitivity_is_refused():
    with pytest.raises(BristleError, match="'friction' is no parameter of 'lugre'; known: J, b"):
        servo_program("lugre", sensitivities=("friction",))


def test_sensitivities_go_through_constants_computed_at_the_start():
    system = System("decay")
    a = system.parameter(
        Parameter("a", "a", "1", 1.3, 0.0, 10.0, "root of the rate", "dixit2008 eq. (7)")
    )
    rate = system.constant({"square": a * a}).square
    double = system.constant({"double": 2.0 * rate}).double
    system.input(Variable("pace", "1", "only counts the steps"))
    x = system.state(State("x", "1", "state", initial=1.0))
    system.rate("x", -double * x)
    system.output(Variable("y", "1", "state"), x)
    program = Program("Decay", [system], sensitivities=("a",))
    record, s = Native(program).run(1e-2, {"pace": np.zeros(60)}, ["time", "y"], sensitivities=True)
    t = record[:, 0]
    np.testing.assert_allclose(
        s[:, 0, 0], -4.0 * 1.3 * t * np.exp(-2.0 * 1.69 * t), rtol=0, atol=1e-6
    )
