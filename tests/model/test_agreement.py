"""Native C, generated Python and CasADi give the same digits over a whole scenario."""

import casadi as ca
import numpy as np
import pytest

from bristle.common.errors import SimulationError
from bristle.model.native import Native
from bristle.model.program import Program
from bristle.model.python import casadi_tables, python_source, python_tables
from bristle.model.runtime import Core, CoreError
from bristle.model.system import System
from bristle.model.variables import State, Variable
from bristle.plant.friction import laws
from bristle.plant.servo import servo_program

LENGTH = 20_000
# CasADi needs about 30 us a function call: fewer internal steps keep the test short and change
# nothing it is about.
PARAMETERS = {"solver.tolerance": 1e-6, "solver.friction_step": 5e-4}


def voltages(rms, seed):
    """Low-pass noise, as large as the law needs to move, with many reversals."""
    white = np.random.default_rng(seed).standard_normal(LENGTH)
    u = np.empty(LENGTH)
    x = 0.0
    for k in range(LENGTH):
        x = 0.995 * x + 0.1 * white[k]
        u[k] = rms * x
    return u


def in_python(program, tables, inputs, record, parameters):
    core = Core(tables)
    for name, value in parameters.items():
        core.v[program.index[name]] = value
    core.initialise(0.0)
    places = [program.index[name] for name in inputs]
    recorded = [program.index[name] for name in record]
    table = np.column_stack(list(inputs.values())).tolist()
    out = [[core.v[i] for i in recorded]]
    for row in table:
        for place, value in zip(places, row, strict=True):
            core.v[place] = value
        core.advance(1e-3)
        out.append([core.v[i] for i in recorded])
    return np.array(out), core.steps


@pytest.mark.slow
@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", list(laws()))
def test_three_arithmetics_agree_over_20_seconds(name):
    program = servo_program(name)
    system = program.variants[0].system
    parameters = {k: x for k, x in PARAMETERS.items() if k in system.parameters}
    k = np.arange(LENGTH)
    inputs = {
        "u": voltages(8.0 if name == "modified_polynomial" else 3.0, seed=4),
        "tau_load": np.where(k % 3000 > 2000, 0.004, 0.0),
        "load_scale": np.where(k > LENGTH // 2, 1.5, 1.0),
    }
    record = [slot.name for slot in program.slots if slot.kind in ("output", "state", "sampled")]
    native = Native(program, parameters)
    c, _ = native.run(1e-3, inputs, record)
    python, python_steps = in_python(program, python_tables(program), inputs, record, parameters)
    symbolic, symbolic_steps = in_python(
        program, casadi_tables(program), inputs, record, parameters
    )
    size = np.max(np.abs(c), axis=0)
    assert np.all(size > 0.0)  # every signal takes part
    assert np.sum(np.diff(np.sign(c[:, record.index("v")])) != 0) > 20
    assert np.all(np.abs(python - c) <= 1e-12 * size)
    assert np.all(np.abs(symbolic - c) <= 1e-12 * size)
    assert native.steps == python_steps == symbolic_steps


@pytest.mark.sampled(4)
def test_the_selected_law_in_the_large_program_equals_the_lean_one():
    whole, u = servo_program(), voltages(3.0, seed=5)[:2000]
    for name in laws():
        lean, _ = Native(servo_program(name)).run(1e-3, {"u": u}, ["theta", "v", "F", "theta_enc"])
        chosen, _ = Native(whole, variant=name).run(
            1e-3, {"u": u}, ["theta", "v", "F", "theta_enc"]
        )
        np.testing.assert_array_equal(lean, chosen)


def test_a_run_repeats_to_the_last_bit():
    native, u = Native(servo_program("lugre")), voltages(3.0, seed=6)[:3000]
    first, _ = native.run(1e-3, {"u": u}, ["theta", "v", "F"])
    native.reset()
    second, _ = native.run(1e-3, {"u": u}, ["theta", "v", "F"])
    np.testing.assert_array_equal(first, second)


def test_a_snapshot_continues_to_the_last_bit():
    program = servo_program("modified")
    core = Core(python_tables(program))
    core.initialise(0.0)
    core.v[program.index["u"]] = 4.0
    for _ in range(50):
        core.advance(1e-3)
    kept = core.snapshot()
    for _ in range(50):
        core.advance(1e-3)
    end = list(core.v)
    core.restore(kept)
    for _ in range(50):
        core.advance(1e-3)
    assert core.v == end


def test_the_generated_module_imports_nothing_but_math():
    text = python_source(servo_program())
    assert [line for line in text.splitlines() if line.strip().startswith(("import", "from"))] == [
        "import math"
    ]


def test_an_overflow_is_an_error_in_both_languages():
    """Python raises where C goes on with inf: both end as the same kind of error."""
    system = System("explosion")
    x = system.state(State("x", "1", "state", initial=600.0))
    u = system.input(Variable("u", "1", "input"))
    system.rate("x", ca.exp(x) + u)
    system.output(Variable("y", "1", "state"), x)
    program = Program("Explosion", [system])
    with pytest.raises(SimulationError, match=r"finite|small"):
        Native(program).advance(1e-3)
    core = Core(python_tables(program))
    core.initialise(0.0)
    with pytest.raises(CoreError, match=r"finite|small"):
        core.advance(1e-3)


@pytest.mark.parametrize("divergence", [1e308, -1e308])
def test_divergence_is_an_error_in_both_languages(divergence):
    program = servo_program("viscous", encoder=False)
    native = Native(program, {"tau_load": divergence, "J": 1e-9})
    with pytest.raises(SimulationError, match=r"finite|small") as caught:
        native.run(1e-3, {"tau_load": np.full(10, divergence)}, ["v"])
    assert 0.0 <= caught.value.time <= 0.01
    core = Core(python_tables(program))
    core.v[program.index["J"]] = 1e-9
    core.initialise(0.0)
    core.v[program.index["tau_load"]] = divergence
    with pytest.raises(CoreError, match=r"finite|small"):
        core.advance(1e-3)
