"""A scenario from file to result folder."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import Any

from bristle.common.output import output_folder
from bristle.harness.run.checked import (
    Checked,
    Clock,
    Progress,
    RunOptions,
    check_estimated,
    check_loaded,
    no_progress,
)
from bristle.harness.run.outcome import outcome
from bristle.harness.run.results import files_of, refuse_strange, write
from bristle.harness.scenario.parts import build_fmus
from bristle.harness.scenario.reading import load


@dataclass
class FinishedRun:
    """A finished scenario."""

    result: dict[str, Any]
    folder: Path
    # what was found in the record and repaired, and why its verdict is fail, one line each
    findings: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether the verdict is pass."""
        return bool(self.result["verdict"] == "pass")


def run(
    path: Path, out: Path, options: RunOptions | None = None, progress: Progress | None = None
) -> FinishedRun:
    """Run a scenario and write its result folder `out/<scenario>`.

    Raises
    ------
    BristleError
        One line; nothing is written then, and what was there stays.
    """
    with output_folder(out):
        checked = build_and_check(path, out, options, progress)
        return execute(checked, progress)


def build_and_check(
    path: Path,
    out: Path,
    options: RunOptions | None = None,
    progress: Progress | None = None,
    refuse: Callable[[Path], None] = refuse_strange,
) -> Checked:
    """Read a scenario, build the FMUs that it needs and that are new, and check it against them and
    its record; `execute` runs it.

    `refuse` raises an error if the folder of the result may not be replaced.

    Raises
    ------
    BristleError
        One line; nothing is written then, and what was there stays.
    """
    options, clock = options or RunOptions(), Clock()
    loaded = load(path, options.overrides, options.seed)
    with output_folder(out):
        refuse(out / loaded.name)
        with clock.stage("FMUs (built only if new)"):
            (progress or no_progress)("building FMUs", 0, 0)
            fmus = build_fmus(loaded, options.fmi, options.kind)
            checked = check_loaded(loaded, fmus, out, options, clock)
            check_estimated(checked.setup)
            return checked


def execute(checked: Checked, progress: Progress | None = None) -> FinishedRun:
    """Run a scenario that is checked, and write its result folder."""
    Thread(target=_load_drawing, daemon=True).start()
    run_outcome = outcome(checked, progress)
    with checked.clock.stage("report"):
        (progress or no_progress)("report", 0, 0)
        files = files_of(run_outcome, checked.setup, checked.clock, checked.options.full)
    folder = write(checked.out, checked.setup.loaded.name, files)
    return FinishedRun(run_outcome.result, folder, run_outcome.findings)


def _load_drawing() -> None:
    """Import what the report needs while the compiled loop runs, which releases the interpreter."""
    # the report says it, in the thread that needs it
    with suppress(ImportError, OSError, MemoryError):
        import matplotlib.backends.backend_svg
        import matplotlib.figure  # noqa: F401 - imported for its cost, not for its names

        from bristle.common import pages
        from bristle.harness.run.run_page import TEMPLATE

        pages.load(TEMPLATE)
