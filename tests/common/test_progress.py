"""What a long computation shows of its progress, and where."""

from __future__ import annotations

import io

import pytest

from bristle.common.errors import BristleError
from bristle.common.progress import teller


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("stream", "lines"), [(Terminal(), 2), (io.StringIO(), 0)])
def test_a_terminal_shows_a_line_that_is_gone_at_the_end(
    stream: io.StringIO, lines: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stderr", stream)
    with teller("diagnose", None) as tell:
        tell("base refit", 0.25)
        tell("too soon after it", 0.3)
    shown = [line for line in stream.getvalue().split("\r") if line]
    assert len(shown) == lines
    if lines:
        assert shown[0].rstrip() == "diagnose: base refit, 25%"
        assert shown[1].strip() == ""
        assert len(shown[1]) == len(shown[0])


def test_what_is_given_is_told_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    stream, told = Terminal(), list[tuple[str, float]]()
    monkeypatch.setattr("sys.stderr", stream)
    with teller("diagnose", lambda text, share: told.append((text, share))) as tell:
        tell("residual", 0.5)
    assert told == [("residual", 0.5)]
    assert stream.getvalue() == ""


def test_what_is_no_function_is_refused() -> None:
    refused = pytest.raises(BristleError, match="progress is a int; give a function")
    with refused, teller("diagnose", 3):  # type: ignore[arg-type]
        pass
