"""What a long computation shows of its progress unless it is told otherwise: a line that changes,
on a terminal and in a notebook.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from bristle.common.errors import BristleError

Progress = Callable[[str, float], None]  # told what is done, and the fraction that is
SECONDS_BETWEEN = 0.2  # s: least time between two changes of the line
LINE_WIDTH = 78  # characters of the line


@contextmanager
def teller(name: str, progress: Progress | None) -> Iterator[Progress]:
    """Give what progress is reported to: the function that is given, or else a line on the error
    output if somebody watches it; raise `BristleError` if it is no function.
    """
    if not (progress is None or callable(progress)):
        raise BristleError(
            f"progress is a {type(progress).__name__}; give a function of a text and the fraction"
            " done, or None"
        )
    if progress is not None or not _is_watched():
        yield progress or (lambda text, fraction: None)
        return
    last = 0.0

    def tell(text: str, fraction: float) -> None:
        nonlocal last
        if time.monotonic() > last + SECONDS_BETWEEN:
            last = time.monotonic()
            _write(f"{name}: {text}, {fraction:.0%}")

    try:
        yield tell
    finally:
        _write("")


def _write(line: str) -> None:
    sys.stderr.write(f"\r{line[:LINE_WIDTH]:<{LINE_WIDTH}}\r")
    sys.stderr.flush()


def _is_watched() -> bool:
    """Return whether the error output is a terminal, or a cell of a notebook."""
    return bool(sys.stderr.isatty()) or "ipykernel" in type(sys.stderr).__module__
