"""All exceptions of the library are in one tree, and the drawing of the tree is right."""

import builtins
import inspect
import pickle
import re

import pytest

from bristle.common import errors
from bristle.common.errors import BristleError, SimulationError
from bristle.fmus.controller.definition import program
from bristle.fmus.python_fmu import python_files

# copied into FMUs, without the library
IN_FMUS = {"bristle.model.runtime.CoreError", "bristle.fmus.slave.RefusedError"}
LINE = re.compile(r"^[\s│├└─]*([A-Z]\w+)", re.MULTILINE)


@pytest.fixture
def exceptions(modules):
    """Every exception class that a module of the library defines, except what never leaves its
    module.
    """
    return {
        f"{each.__module__}.{name}": each
        for module in modules.values()
        for name, each in inspect.getmembers(module, inspect.isclass)
        if issubclass(each, BaseException)
        and each.__module__ == module.__name__
        and not name.startswith("_")
    }


def drawn():
    """Return {class: its parent} as drawn in the docstring of errors.py."""
    found, path = {}, []
    for line in (errors.__doc__ or "").split("\n\n")[1].splitlines():
        name = LINE.match(line)
        assert name is not None, line
        while path and path[-1][0] >= name.start(1):
            path.pop()
        found[name[1]] = path[-1][1] if path else None
        path.append((name.start(1), name[1]))
    return found


def test_every_exception_is_a_bristle_error(exceptions):
    assert len(exceptions) >= 7
    strangers = {
        name
        for name, each in exceptions.items()
        if issubclass(each, Exception) and not issubclass(each, BristleError)
    }
    assert strangers == IN_FMUS


def test_the_tree_is_drawn_as_it_is(exceptions):
    tree = drawn()
    own = {each.__name__: each for each in exceptions.values()}
    assert own.keys() == {name for name in tree if not hasattr(builtins, name)}
    for name, each in own.items():
        assert each.__base__.__name__ == tree[name], name
        assert each.__doc__, name


def test_the_exceptions_of_an_fmu_are_those_of_the_modules_that_are_copied_into_it():
    copied = b"".join(
        content for name, content in python_files(program()).items() if "_parts/" in name
    ).decode()
    assert set(re.findall(r"^class (\w+Error)\(", copied, re.MULTILINE)) == {
        name.split(".")[-1] for name in IN_FMUS
    }


def test_an_error_passes_between_processes(exceptions):
    sent = SimulationError("stopped at 2 s", 2.0)
    got = pickle.loads(pickle.dumps(sent))
    assert isinstance(got, ArithmeticError)
    assert (str(got), got.time) == ("stopped at 2 s", 2.0)
    for each in exceptions.values():
        if issubclass(each, BristleError):
            assert str(pickle.loads(pickle.dumps(each("a line")))) == "a line"
