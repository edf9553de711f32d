"""The end of a test run: pythonfmu's libraries may not have the last word."""

from __future__ import annotations

import os
import sys

import pytest

_status = pytest.StashKey[int]()


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    session.config.stash[_status] = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    """Leave with pytest's own exit status before the interpreter is torn down.

    pythonfmu 0.7.0 damages the heap of a process that loaded its libraries, which now and then aborts it at exit, after
    every test has been judged. The harness keeps such FMUs in processes of their own; some tests load them here.
    """
    status = config.stash.get(_status, None)
    if status is not None and "pythonfmu" in sys.modules:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
