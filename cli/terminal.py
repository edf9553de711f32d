"""What all commands say on the terminal: errors in one line, progress, interrupts."""

from __future__ import annotations

import difflib
import logging
import re
import shlex
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from bristle.cli.app import app
from bristle.common.errors import BristleError
from bristle.common.work import no_room

if TYPE_CHECKING:
    from rich.progress import Progress

DID_YOU_MEAN = re.compile(r"\. Did you mean (.*\?)$")  # how the option parser proposes a command
SECONDS_BETWEEN_LINES = 5.0  # s, of progress where there is no terminal for a bar
LEAST_TOLD = logging.INFO  # level of what the library logs from which it is printed
# characters that a word of a message may have, and what is kept of a longer one
LONGEST_WORD, CUT_WORD = 300, 60
LEAST_ROOM = 1 << 20  # bytes; a folder for temporary files with less is taken for what was full
LIKE = 0.75  # least likeness of an option that is proposed for one that does not exist


class Interrupted(BaseException):
    """Ctrl-C or SIGTERM; not a KeyboardInterrupt, which the option parser would turn into its own
    exit code.
    """


def say(line: str) -> None:
    """Print one line, whatever it holds, to the error output; a word in it that is longer than
    `LONGEST_WORD` is cut.
    """
    words = (
        word if len(word) <= LONGEST_WORD else f"{word[:CUT_WORD]}... ({len(word)} characters)"
        for word in line.split()
    )
    print(" ".join(words), file=sys.stderr, flush=True)


class Lines(logging.Handler):
    """Prints what the library logs, one line each, to the error output."""

    def emit(self, record: logging.LogRecord) -> None:
        say(f"bristle: {record.getMessage()}")


_lines = Lines()


def show_log() -> None:
    """Let the library say what it logs: what is left out, and what takes long."""
    logger = logging.getLogger("bristle")
    logger.addHandler(_lines)
    logger.setLevel(LEAST_TOLD)


def complain(error: BaseException, debug: bool) -> None:
    """Print an error as one line."""
    if debug:
        traceback.print_exc()
    say(explain(error))


def complain_each(error: BristleError, debug: bool) -> None:
    """Print an error that has a line for each mistake."""
    for mistake in dict.fromkeys(str(error).splitlines()):
        complain(BristleError(mistake), debug)


def command_line() -> str:
    """Return the command that repeats this call."""
    return shlex.join(["bristle", *sys.argv[1:]])


@contextmanager
def _bar() -> Iterator[Progress | None]:
    """Give a progress bar on a terminal, else None."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.fields[name]}"),
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        yield bar


@contextmanager
def progress(name: str) -> Iterator[Callable[[str, int, int], None]]:
    """Show the progress of a run, stage by stage."""
    with _bar() as bar:
        if bar is None:
            yield lambda stage, done, total: check_interrupt()
            return
        current = [bar.add_task("starting", name=name, total=None)]
        stages = ["starting"]

        def tell(stage: str, done: int, total: int) -> None:
            check_interrupt()
            if stage != stages[-1]:
                bar.remove_task(current.pop())
                current.append(bar.add_task(stage, name=name, total=total or None))
                stages.append(stage)
            bar.update(current[0], completed=done)

        yield tell


@contextmanager
def fraction(name: str) -> Iterator[Callable[[str, float], None]]:
    """Show the progress of a long computation: its present step, and the share that is done."""
    with _bar() as bar:
        task = None if bar is None else bar.add_task("starting", name=name, total=1.0)
        last = time.monotonic()

        def tell(text: str, fraction: float) -> None:
            nonlocal last
            check_interrupt()
            if bar is not None and task is not None:
                bar.update(task, description=text, completed=fraction)
            elif time.monotonic() > last + SECONDS_BETWEEN_LINES:
                last = time.monotonic()
                print(f"{name}: {text}, {fraction:.0%}", file=sys.stderr, flush=True)

        yield tell


_interrupts: list[int] = []


def interrupt(number: int, _frame: object) -> None:
    """Raise once; later signals are ignored, so that the clean-up can finish."""
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, signal.SIG_IGN)
    _interrupts.append(number)
    raise Interrupted(number)


def check_interrupt() -> None:
    """Raise an interrupt again that came in a finaliser or a callback from C, where Python drops
    exceptions.
    """
    if _interrupts:
        raise Interrupted(_interrupts[0])


def show_unraisable(unraisable: Any) -> None:
    """Print an exception that Python drops as it does, but not an interrupt, which
    `check_interrupt` raises again.
    """
    if not isinstance(unraisable.exc_value, Interrupted):
        sys.__unraisablehook__(unraisable)


def show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: object = None,
    line: str | None = None,
) -> None:
    """Print in one line what is deprecated; of other warnings also where they come from."""
    say(
        f"bristle: {message}"
        if issubclass(category, FutureWarning)
        else f"{filename}:{lineno}: {category.__name__}: {message}"
    )


def _of_the_system(error: OSError) -> str:
    """Return an error of the system as one line: of the file it names, of temporary files, or of
    the standard output.
    """
    file, place = error.filename2 or error.filename, tempfile.gettempdir()
    if (full := no_room(error)) and (
        shutil.disk_usage(place).free < LEAST_ROOM if file is None else str(file).startswith(place)
    ):
        return str(full)
    if file is None:
        return f"standard output: {error.strerror or error}; give it another place"
    return f"{file}: {error.strerror}; check the path, its rights and the room there"


def _names() -> list[str]:
    return [
        command.name or str(getattr(command.callback, "__name__", ""))
        for command in app.registered_commands
    ]


def _is_unmapped_library(error: BaseException) -> bool:
    """Return whether a library found no room in memory, which the loader of Linux says in words."""
    return isinstance(error, ImportError) and "failed to map segment" in str(error)


def explain(error: BaseException) -> str:
    """Return an error as one line; wrong options are errors of the option parser."""
    usage = getattr(error, "format_message", None)
    if isinstance(error, Interrupted):
        return "bristle: interrupted"
    if isinstance(error, BristleError):
        return f"bristle: {error}"
    if isinstance(error, MemoryError) or _is_unmapped_library(error):
        return "bristle: no memory left; end other programs, or allow more (ulimit -v)"
    if isinstance(error, OSError):
        return f"bristle: {_of_the_system(error)}"
    if type(error).__name__ == "NoArgsIsHelpError":
        return f"bristle: no command; choose one of {', '.join(_names())}, or see bristle --help"
    if type(error).__name__ == "NoSuchOption":  # click also proposes options that are hardly alike
        name, known = getattr(error, "option_name", ""), getattr(error, "possibilities", None) or []
        error.possibilities = difflib.get_close_matches(name, known, 1, LIKE)  # type: ignore[attr-defined]  # of click, by its name
    if usage is not None:
        context = getattr(error, "ctx", None)
        command = (
            "bristle"
            if context is None or context.parent is None
            else f"bristle {context.info_name}"
        )
        said = DID_YOU_MEAN.sub(
            r" (did you mean \1)", usage().replace("Value error, ", "").rstrip(".")
        )
        return f"bristle: {said}; see {command} --help"
    return (
        f"bristle: {type(error).__name__}: {error}; run again with --debug and report the traceback"
    )
