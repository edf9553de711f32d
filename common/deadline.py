"""A deadline within which simulations begin: what runs over it is left where it is."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

T = TypeVar("T")

_DEADLINE: ContextVar[float] = ContextVar("deadline", default=math.inf)


class OutOfTime(BaseException):
    """A simulation would begin after the deadline."""


@contextmanager
def until(deadline: float) -> Iterator[None]:
    """Let no simulation begin after a time [s, of `time.perf_counter`], or after that of an
    enclosing block if it is earlier.
    """
    token = _DEADLINE.set(min(deadline, _DEADLINE.get()))
    try:
        yield
    finally:
        _DEADLINE.reset(token)


def within(deadline: float, work: Callable[[], T]) -> T | None:
    """Return what work gives; None if one of its simulations would begin after the deadline."""
    try:
        with until(deadline):
            return work()
    except OutOfTime:
        return None


def check_deadline() -> None:
    """Raise `OutOfTime` after the deadline."""
    if time.perf_counter() > _DEADLINE.get():
        raise OutOfTime
