"""The command line.

Exit code 0: all verdicts pass (diagnose, validate: it completed), 1: one failed, 2: an error, reported in one line.
"""

from __future__ import annotations

import os
import signal
import sys
import warnings

import bristle.cli.commands  # noqa: F401  # the application then has them
from bristle.cli.app import ERROR, PASS, app
from bristle.cli.terminal import Interrupted, complain, interrupt, show_log, show_warning


def main() -> None:
    """Run the command line; an error ends with one line and exit code 2."""
    debug = "--debug" in sys.argv
    for library in ("OPENBLAS", "OMP", "MKL"):  # before NumPy: its threads do not pay on matrices this small
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)
    warnings.showwarning = show_warning
    show_log()
    try:
        code = app(standalone_mode=False)
    except (Exception, Interrupted) as error:
        complain(error, debug)
        raise SystemExit(ERROR) from None
    raise SystemExit(code if isinstance(code, int) else PASS)


if __name__ == "__main__":
    main()
