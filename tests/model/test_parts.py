"""The small parts: units, parameters, programs, linear algebra, compiler, cache."""

import ctypes
import math
import os
import time
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm as scipy_expm

from bristle.common import cache
from bristle.common.errors import BristleError
from bristle.common.units import convert, parse_unit, quantity
from bristle.model import compiler
from bristle.model.linear import Elimination, expm
from bristle.model.native import Native
from bristle.model.program import Program
from bristle.model.system import System
from bristle.model.variables import Parameter, State, Variable
from bristle.plant.servo import servo_program


@pytest.mark.parametrize(
    ("text", "si", "value"),
    [
        ("75 deg/s", "rad/s", 75 * math.pi / 180),
        ("20 ms", "s", 0.02),
        ("5ms", "s", 0.005),
        ("-2e3mm", "m", -2.0),
        ("1e3 mm", "m", 1.0),
        ("0.001 kg.m2", "kg.m2", 0.001),
        ("40 mN.m", "N.m", 0.04),
        ("2 1/s", "1/s", 2.0),
        ("3 rev/min", "rad/s", 2 * math.pi * 3 / 60),
        ("1 V", "kg.m2/s3.A", 1.0),
        ("5 %", "1", 0.05),
        ("7", "1", 7.0),
        (1e-3, "1", 1e-3),
        ("600 1/s2", "1/s2", 600.0),
    ],
)
def test_quantities(text, si, value):
    assert quantity(text, si) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("20", "has no unit"),
        ("1e3", "has no unit"),
        ("20 V", "does not fit"),
        ("20 foo", "'foo' is not known"),
        ("x ms", "not a quantity"),
        ("nan s", "not finite"),
        (True, "not a quantity"),
        (None, "not a quantity"),
        ("", "not a quantity"),
    ],
)
def test_bad_quantities_are_refused_in_one_line(text, complaint):
    with pytest.raises(BristleError, match=complaint) as caught:
        quantity(text, "s")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("unit", ["deg/s", "ms", "mN.m", "rev/min", "um", "kg.m2"])
def test_units_convert_back(unit):
    si = {
        "deg/s": "rad/s",
        "ms": "s",
        "mN.m": "N.m",
        "rev/min": "rad/s",
        "um": "m",
        "kg.m2": "kg.m2",
    }[unit]
    assert convert(convert(1.7, unit, si), si, unit) == pytest.approx(1.7, rel=1e-14)


def test_dimensions_of_derived_units():
    assert parse_unit("N.m.s/rad").exponents == (1, 2, -1, 0, 0, -1)
    assert parse_unit("V").exponents == parse_unit("N.m/A.s").exponents


@pytest.mark.parametrize("value", [-1e-3, 11.0, math.nan, math.inf, -math.inf])
def test_a_parameter_error_names_value_unit_and_range(value):
    parameter = Parameter(
        "law.k", "k", "N.m", 1.0, 0.0, 10.0, "stiffness of something", "dixit2008 eq. (8)"
    )
    with pytest.raises(
        BristleError, match=r"law\.k = .* N\.m is outside \[0, 10\] N\.m; .*stiffness of something"
    ):
        parameter.check(value)
    assert parameter.check(10.0) == 10.0


def test_a_system_with_a_missing_equation_is_refused():
    system = System("half")
    system.state(State("x", "1", "state"))
    with pytest.raises(BristleError, match="'x' needs both a state and a rate"):
        Program("Half", [system])


def test_a_name_cannot_be_declared_twice():
    system = System("twice")
    system.input(Variable("u", "V", "input"))
    with pytest.raises(BristleError, match="declares 'u' twice"):
        system.state(State("u", "1", "state"))


def test_unknown_parameters_and_variants_are_refused():
    with pytest.raises(BristleError, match="'Fc' is no parameter of ServoPlant_lugre"):
        Native(servo_program("lugre"), {"Fc": 1.0})
    with pytest.raises(BristleError, match="'tanh' is no variant of ServoPlant; known: coulomb"):
        Native(servo_program(), variant="tanh")


def test_the_token_follows_the_interface():
    assert servo_program("lugre").token == servo_program("lugre").token
    assert (
        len(
            {
                servo_program("lugre").token,
                servo_program("modified").token,
                servo_program("lugre", encoder=False).token,
            }
        )
        == 3
    )


def test_elimination_solves_like_numpy():
    rng = np.random.default_rng(0)
    matrix, rhs = rng.normal(size=(4, 4)) + 8 * np.eye(4), rng.normal(size=4)
    a, b = ca.SX.sym("a", 4, 4), ca.SX.sym("b", 4)
    found = ca.Function("solve", [a, b], [Elimination(a).solve(b)])(matrix, rhs)
    np.testing.assert_allclose(np.asarray(found).ravel(), np.linalg.solve(matrix, rhs), rtol=1e-13)


@pytest.mark.parametrize("norm", [1e-3, 1.0, 50.0, 400.0])
def test_exponential_like_scipy(norm):
    matrix = np.random.default_rng(1).normal(size=(3, 3))
    matrix = matrix / np.linalg.norm(matrix, 2) * norm - norm * np.eye(3)  # stable, as filters are
    a = ca.SX.sym("a", 3, 3)
    found = np.asarray(ca.Function("exponential", [a], [expm(a)])(matrix))
    expected = scipy_expm(matrix)
    assert np.max(np.abs(found - expected)) <= 1e-11


def test_a_failed_build_leaves_nothing_in_the_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("BRISTLE_CACHE", str(tmp_path))

    def broken(path):
        path.write_text("half")
        raise BristleError("no more")

    with pytest.raises(BristleError, match="no more"):
        cache.cached("thing", broken)
    assert not [path for path in tmp_path.rglob("*") if path.is_file() and path.suffix != ".lock"]
    path = cache.cached("thing", lambda p: p.write_text("whole"))
    assert path.read_text() == "whole"
    assert cache.cached("thing", broken) == path  # not made again


def test_of_those_that_miss_the_same_file_at_once_one_makes_it(tmp_path, monkeypatch):
    monkeypatch.setenv("BRISTLE_CACHE", str(tmp_path))
    made = []

    def slowly(path):
        made.append(path)
        time.sleep(0.2)
        path.write_text("whole")

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: cache.cached("thing", slowly).read_text(), range(4)))
    assert found == ["whole"] * 4
    assert len(made) == 1


def test_what_a_cached_file_lacks_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("BRISTLE_CACHE", str(tmp_path / "cache"))
    missing = tmp_path / "template.c"
    with pytest.raises(BristleError, match=f"{missing}: No such file"):
        cache.cached("thing", lambda p: p.write_text(missing.read_text()))
    with pytest.raises(BristleError, match="set BRISTLE_CACHE to a folder you can write"):
        cache.cached("thing", lambda p: (p.parent / "no" / "folder").write_text(""))


def test_a_compiler_error_is_one_line(tmp_path):
    with pytest.raises(BristleError, match=r"failed: .*error") as caught:
        compiler.compile_shared({"a.c": "int f(void) { return nonsense; }\n"}, tmp_path / "a.so")
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_compiling_twice_gives_the_same_bytes(tmp_path, monkeypatch):
    for name in ("a.so", "b.so"):
        monkeypatch.setenv("BRISTLE_CACHE", str(tmp_path / f"cache of {name}"))
        compiler.compile_shared(
            {"a.c": "double f(double x) { return 2.0 * x; }\n"}, tmp_path / name
        )
    assert (tmp_path / "a.so").read_bytes() == (tmp_path / "b.so").read_bytes()


def test_a_unit_is_compiled_again_only_if_it_or_what_it_includes_changed(tmp_path, monkeypatch):
    monkeypatch.setenv("BRISTLE_CACHE", str(tmp_path / "cache"))
    compiled = []
    run = compiler._compiler
    monkeypatch.setattr(
        compiler,
        "_compiler",
        lambda triple, arguments, folder: (
            compiled.append(arguments),
            run(triple, arguments, folder),
        ),
    )
    shown = '__attribute__((visibility("default")))'
    sources = {
        "a.c": f'#include "a.h"\n{shown} double f(double x) {{ return FACTOR * x; }}\n',
        "a.h": '# include "b.h"\n',
        "b.h": "#define FACTOR 2.0\n",
        "c.c": "int c;\n",
        "c.h": "\n",
    }

    def units(**changed):
        """Return the units compiled for sources with some changed, and f(3) of the library."""
        compiled.clear()
        library = tmp_path / f"{len(os.listdir(tmp_path))}.so"
        compiler.compile_shared(
            sources | {name.replace("_", "."): text for name, text in changed.items()}, library
        )
        f = ctypes.CDLL(str(library)).f
        f.restype, f.argtypes = ctypes.c_double, [ctypes.c_double]
        # side by side, in any order
        return sorted(each[each.index("-c") + 1] for each in compiled if "-c" in each), f(3.0)

    assert units() == (["a.c", "c.c"], 6.0)
    assert units() == ([], 6.0)
    assert units(c_h="int other;\n") == ([], 6.0)
    assert units(b_h="#define FACTOR 3.0\n") == (["a.c"], 9.0)
    assert units(c_c="int d;\n") == (["c.c"], 6.0)
    monkeypatch.setattr(compiler, "compiler_identity", lambda triple: "another one")
    assert units() == (["a.c", "c.c"], 6.0)


def test_a_toolchain_is_used_inside_its_context_only_and_is_part_of_what_names_a_library(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("BRISTLE_CACHE", str(tmp_path / "cache"))
    sources = {
        "a.c": '__attribute__((visibility("default"))) double f(double x) { return FACTOR * x; }\n'
    }
    usual = compiler.compiler_identity()

    def value(name, *flags):
        with compiler.compiled_with(compiler.Toolchain(name, flags=flags)):
            assert compiler.compiler_identity() != usual
            compiler.compile_shared(sources, tmp_path / f"{name}.so")
        assert compiler.compiler_identity() == usual
        f = ctypes.CDLL(str(tmp_path / f"{name}.so")).f
        f.restype, f.argtypes = ctypes.c_double, [ctypes.c_double]
        return f(3.0)

    assert value("two", "-DFACTOR=2.0") == 6.0
    assert value("three", "-DFACTOR=3.0") == 9.0  # not the unit that the cache holds already
    with pytest.raises(BristleError, match="FACTOR"):
        compiler.compile_shared(sources, tmp_path / "usual.so")
    with compiler.compiled_with(compiler.Toolchain("other", ("no-such-compiler",))):
        assert compiler.find_compiler() == ("no-such-compiler",)


def test_a_compiler_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler -O3")
    compiler.find_compiler.cache_clear()
    try:
        with pytest.raises(BristleError, match="no such program"):
            compiler.find_compiler()
    finally:
        compiler.find_compiler.cache_clear()
