"""Many runs of scenarios, by file, seed and values: which passed, and how each check fared."""

from __future__ import annotations

import itertools
import logging
import math
import multiprocessing
import os
import signal
import statistics
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from bristle.common.errors import BristleError
from bristle.harness.run.checked import RunOptions
from bristle.harness.run.run import build_and_check, run
from bristle.harness.scenario.catalogue import find_scenario, is_scenario, scenario_files
from bristle.harness.scenario.vary import refuse_conflicts

Told = Callable[[str, int, int], None]  # what was done last, how many are done, of how many
Work = Callable[["SuiteCase"], "CaseResult"]

PATIENCE = 5.0  # s that ending a process may take
LONGEST_NAME = 255  # bytes that file systems allow in the name of a folder


@dataclass(frozen=True)
class SuiteCase:
    """One run: a scenario file, a seed if given, and values that differ from the file's."""

    path: Path
    seed: int | None = None
    values: tuple[str, ...] = ()  # each path=value

    @property
    def folder(self) -> Path:
        """Where its result folder lies, below that of the suite."""
        parts = [_file_name(value) for value in self.values]
        return Path(*parts, *([f"seed-{self.seed}"] if self.seed is not None else []))

    @property
    def name(self) -> str:
        """What distinguishes it from other runs of its scenario."""
        return ", ".join([*self.values, *([f"seed {self.seed}"] if self.seed is not None else [])])


@dataclass(frozen=True)
class CaseResult:
    """What came of a case: verdict pass, fail or error; its checks as in result.json, or the
    message of the error.

    `origin` holds the SHA-256 of scenario file, FMUs and record.
    """

    case: SuiteCase
    verdict: str
    checks: tuple[Mapping[str, Any], ...] = ()
    wall_s: float = 0.0
    message: str = ""
    origin: Mapping[str, Any] = field(default_factory=dict)

    @property
    def report(self) -> Path:
        """Its report, relative to the folder of the suite."""
        return self.case.folder / self.case.path.stem / "report.html"


class CasesError(BristleError):
    """Cases that cannot be run, so that none of the suite is; a line for each mistake.

    Attributes
    ----------
    tested : list of CaseResult
        Those cases, of verdict error.
    waiting : list of SuiteCase
        The others.
    """

    def __init__(
        self, message: str, tested: Sequence[CaseResult] = (), waiting: Sequence[SuiteCase] = ()
    ) -> None:
        super().__init__(message)
        self.tested, self.waiting = list(tested), list(waiting)


@dataclass(frozen=True)
class CheckSummary:
    """One limit of one check over all runs of a scenario: how often it held, median and worst
    value, and where that is.

    `count` includes the runs that came to no result, in which nothing held; median and worst value
    are of the others.
    """

    name: str
    quantity: str
    kind: str
    limit: float
    passed: int
    count: int
    median: float
    worst: float
    worst_run: str


def find_cases(
    given: Sequence[Path],
    seeds: Sequence[int],
    values: Sequence[Sequence[str]],
    overrides: Sequence[str] = (),
) -> list[SuiteCase]:
    """Return a case for each scenario, combination of values and seed.

    Parameters
    ----------
    given : sequence of Path
        Files, names from ``bristle list``, or folders, of which all scenario files are taken
        (without sub-folders); others are logged.
    seeds : sequence of int
        Seeds of the reference; none: that of the file.
    values : sequence of sequence of str
        For each path that varies, its ``path=value``; all combinations are run.
    overrides : sequence of str
        ``path=value`` of all runs.

    Raises
    ------
    BristleError
        If nothing is there to run, two files have one name, a path would have two values at once,
        or a value cannot name a folder.
    """
    refuse_conflicts([of_key[0] for of_key in values if of_key], seeds, overrides)
    for of_key in values:
        _refuse_folders(of_key)
    paths = [path for each in given for path in _files(each)]
    names = [path.stem for path in paths]
    for path in paths:
        if names.count(path.stem) > 1:
            raise BristleError(
                f"{path}: a scenario '{path.stem}' is given twice; results are named by the file:"
                " rename one"
            )
    return [
        SuiteCase(p, s, v)
        for p in paths
        for v in itertools.product(*values)
        for s in seeds or (None,)
    ]


def run_suite(
    cases: Sequence[SuiteCase],
    out: Path,
    options: RunOptions | None = None,
    jobs: int = 1,
    progress: Told | None = None,
) -> list[CaseResult]:
    """Check all scenarios, run all cases and write their result folders; return what came of each,
    in the order of the cases.

    Parameters
    ----------
    cases : sequence of SuiteCase
        What to run.
    out : Path
        Folder of the suite; each run has one below it.
    options : RunOptions, optional
        How to run them; their overrides come before the values of a case.
    jobs : int
        Number of processes.
    progress : function, optional
        Called with the name of what was done last, how many are done and how many there are.

    Raises
    ------
    CasesError
        Before anything runs, if a scenario cannot be run: one line for each.
    """
    options = options or RunOptions()
    results: dict[SuiteCase, CaseResult] = {}

    def keep(tested: CaseResult) -> None:
        results[tested.case] = tested
        if progress is not None:
            progress(
                " ".join([tested.case.path.stem, tested.case.name]).strip(),
                len(results),
                len(cases),
            )

    work = partial(run_case, out=out, options=options)
    waiting = deque(cases)
    try:
        _check(cases, out, options)
        while waiting and jobs == 1:
            keep(work(waiting.popleft()))
        while waiting:
            _run_in_processes(waiting, jobs, work, keep)
    finally:
        _remove_empty(out, cases)
    return [results[case] for case in cases]


def summaries(tested: Sequence[CaseResult]) -> list[CheckSummary]:
    """Return each limit of each check over runs of one scenario; what is not finite is worst."""
    lines: dict[tuple[str, str, str, float], list[tuple[float, bool, str]]] = {}
    for each in tested:
        for c in each.checks:
            key = (c["name"], c["quantity"], c["kind"], c["limit"])
            value = c["value"] if c["value"] is not None else math.nan
            lines.setdefault(key, []).append((value, bool(c["pass"]), each.case.name))
    limits, lost = [], sum(each.verdict == "error" for each in tested)
    for (name, quantity, kind, limit), values in lines.items():
        worst = max(values, key=lambda each: _badness(each[0], kind))
        median = statistics.median(abs(v) if kind == "max_abs" else v for v, _, _ in values)
        passed = sum(held for _, held, _ in values)
        limits.append(
            CheckSummary(
                name, quantity, kind, limit, passed, len(values) + lost, median, worst[0], worst[2]
            )
        )
    return limits


def by_scenario(tested: Sequence[CaseResult]) -> dict[Path, list[CaseResult]]:
    """Return the runs of each scenario file."""
    runs: dict[Path, list[CaseResult]] = {}
    for each in tested:
        runs.setdefault(each.case.path, []).append(each)
    return runs


def _badness(value: float, kind: str) -> float:
    if not math.isfinite(value):
        return math.inf
    return -value if kind == "min" else abs(value) if kind == "max_abs" else value


# -- running ---------------------------------------------------------------------------------------
def _files(given: Path) -> list[Path]:
    """Return the scenario files that a path or a name stands for."""
    if not given.is_dir():
        return [find_scenario(given)]
    inside = sorted(given.glob("*.toml"))
    scenarios = [path for path in inside if is_scenario(path)]
    if not scenarios:
        if str(given) in scenario_files():
            return [find_scenario(given)]
        raise BristleError(
            f"{given}: no scenario file in this folder; a scenario is a .toml file with a table"
            " [observer]"
        )
    if others := [path.name for path in inside if path not in scenarios]:
        told = "%s: left out %d of %d .toml files, which have no table [observer]: %s"
        logging.getLogger("bristle").warning(
            told, given, len(others), len(inside), ", ".join(others)
        )
    return scenarios


def _refuse_folders(of_key: Sequence[str]) -> None:
    """Refuse values of a key that cannot name result folders, or that would name one twice."""
    taken: dict[str, str] = {}
    for given in of_key:
        name = _file_name(given)
        if len(name.encode()) > LONGEST_NAME:
            what = (
                f"its result folder would need a name of {len(name.encode())} bytes, allowed are"
                f" {LONGEST_NAME}"
            )
            raise BristleError(f"vary '{given[:60]}...': {what}; give a shorter value")
        # not all file systems tell capital letters
        other = taken.setdefault(name.casefold(), given)
        if other != given:
            raise BristleError(
                f"vary '{given}': its result folder would be that of '{other}', {name}; leave one"
                " of them out"
            )


def _check(cases: Sequence[SuiteCase], out: Path, options: RunOptions) -> None:
    """Check each scenario with each combination of values, and build its FMUs; raise `CasesError`
    with all mistakes.
    """
    mistakes: dict[tuple[Path, tuple[str, ...]], str] = {}
    for case in {replace(case, seed=case.seed and 1): case for case in cases}.values():
        try:
            build_and_check(case.path, out / case.folder, _options(case, options))
        except BristleError as error:
            mistakes[case.path, case.values] = str(error)
    if mistakes:
        message = {case: mistakes.get((case.path, case.values)) for case in cases}
        raise CasesError(
            "\n".join(mistakes.values()),
            [CaseResult(case, "error", message=said) for case, said in message.items() if said],
            [case for case, said in message.items() if not said],
        )


def _options(case: SuiteCase, options: RunOptions) -> RunOptions:
    return replace(
        options,
        overrides=(*options.overrides, *case.values),
        seed=case.seed if case.seed is not None else options.seed,
    )


def run_case(case: SuiteCase, out: Path, options: RunOptions | None = None) -> CaseResult:
    """Run one case and write its result folder; an error of the scenario is a verdict, too."""
    try:
        done = run(case.path, out / case.folder, _options(case, options or RunOptions()))
    except BristleError as error:
        return CaseResult(case, "error", message=str(error))
    result = done.result
    message = result["diverged"]["message"] if "diverged" in result else ""
    origin = {
        "scenario_sha256": result["provenance"]["scenario_sha256"],
        "fmus_sha256": {name: fmu["sha256"] for name, fmu in result["fmus"].items()},
        "record_sha256": result["record"]["sha256"] if "record" in result else None,
    }
    return CaseResult(
        case, result["verdict"], tuple(result["checks"]), result["wall_s"], message, origin
    )


def _run_in_processes(
    waiting: deque[SuiteCase], jobs: int, work: Work, keep: Callable[[CaseResult], None]
) -> None:
    """Run cases, one a process at a time, until none waits any more or a process is killed; that
    loses those under way.
    """
    count, broken = min(jobs, len(waiting)), False
    running: dict[Future[CaseResult], SuiteCase] = {}
    with _workers(count) as pool:
        while running or (waiting and not broken):
            try:
                while waiting and len(running) < count and not broken:
                    with _uninterrupted():  # the process, which may begin here, inherits it
                        future = pool.submit(work, waiting[0])
                    running[future] = waiting.popleft()
            except BrokenProcessPool:
                broken = True
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                broken = broken or isinstance(future.exception(), BrokenProcessPool)
                keep(_result(future, running.pop(future)))
        for child in multiprocessing.active_children() if broken else ():
            # one that has just begun may ignore that the pool terminates it, if this process does
            child.kill()


def _result(future: Future[CaseResult], case: SuiteCase) -> CaseResult:
    try:
        return future.result()
    except BrokenProcessPool:
        message = (
            f"{case.path}: was under way when a process of this suite was killed; run it again with"
            " fewer jobs"
        )
        return CaseResult(case, "error", message=message)


def _remove_empty(out: Path, cases: Sequence[SuiteCase]) -> None:
    """Remove the folders of runs that left nothing there."""
    for case in cases:
        for place in (case.folder, *case.folder.parents)[:-1]:
            with suppress(OSError):  # it is not empty, or not there
                (out / place).rmdir()


@contextmanager
def _workers(count: int) -> Iterator[ProcessPoolExecutor]:
    """Give a pool of processes that end with this one, which interrupts are for."""
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _start_worker)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        children = multiprocessing.active_children()
        for child in children:
            child.terminate()
        for child in children:
            child.join(PATIENCE)
        raise
    pool.shutdown()


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Keep interrupts until the end of the context, where the system can."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start_worker() -> None:
    """Leave interrupts to the parent process, and end with it, however that ends, or when it says
    so.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # which the parent may ignore, and its children with it
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _file_name(text: str) -> str:
    """Return a text as the name of a folder."""
    return "".join(c if c.isalnum() or c in "=.-_" else "_" for c in text)
