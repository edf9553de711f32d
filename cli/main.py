"""The command line.

Exit code 0: all verdicts pass (diagnose, validate: it completed), 1: one failed, 2: an error,
reported in one line.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable

# more do not pay on small matrices
OPTIONS_OF_LIBRARIES = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "OMP", "MKL")}


def main() -> None:
    """Run the command line; an error ends with one line and exit code 2."""
    _on_signals(_leave)  # before the imports, which take most of the start
    _open_streams()
    for name, value in OPTIONS_OF_LIBRARIES.items():
        os.environ.setdefault(name, value)
    import logging
    import warnings

    import bristle.cli.commands  # noqa: F401 - imported so that the application has them
    from bristle.cli.app import ERROR, FAIL, PASS, app
    from bristle.cli.terminal import (
        Interrupted,
        complain,
        interrupt,
        show_log,
        show_unraisable,
        show_warning,
    )

    # a home folder that it cannot write is no matter of ours
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    warnings.showwarning, sys.unraisablehook = show_warning, show_unraisable
    show_log()
    try:
        _on_signals(interrupt)
        code = app(standalone_mode=False)
        sys.stdout.flush()  # while an error of it can be said
    # the latter is how the option parser ends, too, when nobody reads
    except (BrokenPipeError, SystemExit) as end:
        if isinstance(end, SystemExit) and end.code != FAIL:
            raise
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 1)
        print("bristle: standard output: nobody reads it any more", file=sys.stderr)
        raise SystemExit(ERROR) from None  # 1 would be a verdict
    except (Exception, Interrupted) as error:
        _on_signals(signal.SIG_IGN)
        complain(error, "--debug" in sys.argv)
        raise SystemExit(ERROR) from None
    _on_signals(signal.SIG_IGN)
    raise SystemExit(code if isinstance(code, int) else PASS)


def _open_streams() -> None:
    """Let streams that were closed (`>&-`) lead nowhere, so that no file that is opened later takes
    their place.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_RDWR)
            if nowhere != number:
                os.dup2(nowhere, number)
                os.close(nowhere)
            setattr(sys, name, os.fdopen(number, "w" if number else "r"))


def _on_signals(handler: Callable[[int, object], None] | signal.Handlers) -> None:
    """Set what Ctrl-C and SIGTERM do: at the end nothing, so that what is under way at the end of
    the process is done.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def _leave(_number: int, _frame: object) -> None:
    """Leave at once: nothing is begun yet, and an exception in the middle of imports may be printed
    by others.
    """
    os.write(2, b"bristle: interrupted\n")
    os._exit(2)


if __name__ == "__main__":
    main()
