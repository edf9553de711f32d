"""Judging points in processes of their own: one unpacks the FMU and forks another for each point of
behaviour.

Where there is no fork, each point has a process from the start, which unpacks the FMU.
"""

from __future__ import annotations

import mmap
import os
import signal
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from bristle.common.errors import BristleError
from bristle.fmus.answer import read_answer, write_answer
from bristle.fmus.calls import Control
from bristle.fmus.conformance import running
from bristle.fmus.conformance.instance import CO_SIMULATION, MODEL_EXCHANGE, Ended, Subject
from bristle.fmus.conformance.registry import POINTS, Verdict, static_conformance
from bristle.fmus.conformance.running import BEHAVIOUR, NotApplicable
from bristle.fmus.isolate import isolated

# bytes of memory that the processes share, for the name of the call that is under way
NOTE_SIZE = 64
FORK_POLL = 0.003  # s between two looks at the processes
MOST_AT_ONCE = 4  # points that run at a time
READING_SECONDS = 60.0  # s that all points of archive, libraries and description may take
MOST_SECONDS = 900.0  # s that all points of an FMU may take
# where they fail, nothing more can be tested
LIFE = {CO_SIMULATION: "run-life", MODEL_EXCHANGE: "exchange-life"}

Row = dict[str, Any]  # id of a point, verdict, findings
Subjects = Callable[[Path], Subject]


@dataclass(frozen=True)
class Reading:
    """All points of archive, libraries and description of an FMU, for one process."""

    path: Path
    step_seconds: None = None

    @property
    def seconds(self) -> float:
        """Time [s] that they may take."""
        return READING_SECONDS

    def rows(self, subjects: Subjects) -> list[Row]:
        """Judge them in this process."""
        return [_row(r.point.id, r.verdict, r.findings) for r in static_conformance(self.path)]

    def lost(self, why: str) -> list[Row]:
        """Return what is to be said where the process gave no answer."""
        return [_row(name, Verdict.not_tested, [why]) for name in POINTS]


@dataclass(frozen=True)
class Task:
    """A point of behaviour to judge for an FMU, with additions to its process's environment."""

    path: Path
    point: str
    environment: Mapping[str, str] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Time [s] that it may take."""
        return running.POINT_SECONDS

    @property
    def step_seconds(self) -> float | None:
        """Time [s] that a step may take, where the point states one."""
        return BEHAVIOUR[self.point].step_seconds

    def rows(self, subjects: Subjects) -> list[Row]:
        """Judge it in this process."""
        point = BEHAVIOUR[self.point]
        try:
            subject = subjects(self.path)
            if subject.interface(point.kind) is None:
                raise NotApplicable(f"it does not offer {point.kind}")
            findings = list(point.judge(subject))
        except (NotApplicable, Ended) as reason:
            return [_row(self.point, Verdict.not_applicable, [str(reason)])]
        except BristleError as error:
            findings = [str(error)]
        return [_row(self.point, Verdict.failed if findings else Verdict.passed, findings)]

    def lost(self, why: str) -> list[Row]:
        """Return what is to be said where the process gave no answer."""
        return [_row(self.point, Verdict.failed, [why])]


Job = Reading | Task
Runner = Callable[[Sequence[Job]], list[Row]]


def _row(name: str, verdict: Verdict, findings: Sequence[str]) -> Row:
    return {"id": name, "verdict": verdict, "findings": list(findings)}


def judged(tasks: Sequence[Task]) -> list[Row]:
    """Return a row for each task: the verdict with what was found, or why it does not apply; a
    crash or a hang is a finding.
    """
    return _with_runner(_run_tasks, tasks, list(dict.fromkeys(task.path for task in tasks)), None)


def examined(path: Path, progress: Callable[[int], None] | None = None) -> list[Row]:
    """Return a row for each point of an FMU.

    `progress` is called now and then with the number of points of behaviour that are done.
    """
    return _with_runner(_run_all, path, [path], progress)


def _run_tasks(run: Runner, tasks: Sequence[Task]) -> list[Row]:
    return run(tasks)


def _run_all(run: Runner, path: Path) -> list[Row]:
    rows = run([Task(path, name) for name in LIFE.values()])
    dead = {row["id"] for row in rows if row["verdict"] == Verdict.failed}
    rest = [point for point in BEHAVIOUR.values() if point.id not in LIFE.values()]
    rows += run(
        [Reading(path), *(Task(path, point.id) for point in rest if LIFE[point.kind] not in dead)]
    )
    return rows + [
        _row(p.id, Verdict.not_tested, [f"{LIFE[p.kind]} fails"])
        for p in rest
        if LIFE[p.kind] in dead
    ]


def _with_runner(
    work: Callable[[Runner, Any], list[Row]],
    argument: Any,
    paths: list[Path],
    progress: Callable[[int], None] | None,
) -> list[Row]:
    """Do work that runs jobs, in a process that forks, or, where there is no fork, in this one."""
    if not hasattr(os, "fork"):
        return work(partial(_run_alone, progress), argument)
    return isolated(
        _fork_all, (work, argument, running.POINT_SECONDS), paths, _rows, progress, MOST_SECONDS
    )


def _rows(answer: Any) -> list[Row]:
    return [
        _row(str(row["id"]), Verdict(row["verdict"]), [str(finding) for finding in row["findings"]])
        for row in answer
    ]


# -- without forks ---------------------------------------------------------------------------------


def _run_alone(progress: Callable[[int], None] | None, jobs: Sequence[Job]) -> list[Row]:
    rows: list[Row] = []
    for job in jobs:
        if progress:
            progress(len(rows))
        try:
            rows += isolated(_alone, job, [job.path], _rows, None, job.seconds)
        except BristleError as error:
            rows += job.lost(str(error))
    return rows


def read_alone(path: Path) -> list[Row]:
    """Return a row for each point of archive, libraries and description; raise `BristleError` if
    the file cannot be read.
    """
    return isolated(_alone, Reading(path), [path], _rows, None, READING_SECONDS)


def _alone(job: Job, control: Control) -> list[Row]:
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        return job.rows(_Unpacked(Path(folder)))


class _Unpacked:
    """FMUs that are unpacked, each once, when it is asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.known = folder, dict[Path, Subject]()

    def __call__(self, path: Path) -> Subject:
        if path not in self.known:
            self.known[path] = Subject(path, self.folder / f"fmu{len(self.known)}")
            self.known[path].unpack()
        return self.known[path]


# -- with forks ------------------------------------------------------------------------------------


def _fork_all(
    work: tuple[Callable[[Runner, Any], list[Row]], Any, float], control: Control
) -> list[Row]:
    """Do work whose jobs have a fork each."""
    function, argument, running.POINT_SECONDS = work
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        return function(_Forks(Path(folder), control), argument)


class _Forks:
    """Runs jobs, some at a time, each in a fork of this process, which has unpacked the FMUs."""

    def __init__(self, folder: Path, control: Control) -> None:
        self.folder, self.control = folder, control
        self.subjects = _Unpacked(folder)

    def __call__(self, jobs: Sequence[Job]) -> list[Row]:
        for path in dict.fromkeys(job.path for job in jobs):
            self.subjects(path)
        answers: list[list[Row]] = [[] for _ in jobs]
        waiting, under_way = list(reversed(range(len(jobs)))), dict[int, _Fork]()
        while waiting or under_way:
            while waiting and len(under_way) < min(MOST_AT_ONCE, os.cpu_count() or 1):
                k = waiting.pop()
                under_way[k] = _Fork(jobs[k], self.subjects, self.folder / f"answer{k}")
            time.sleep(FORK_POLL)
            for k, fork in list(under_way.items()):
                rows = fork.rows()
                if rows is not None:
                    answers[k] = rows
                    del under_way[k]
                    self.control[0] += len(rows) if isinstance(jobs[k], Task) else 0
        return [row for rows in answers for row in rows]


class _Fork:
    """A process that does a job: the call that is under way, and since when."""

    def __init__(self, job: Job, subjects: _Unpacked, answer: Path) -> None:
        self.job, self.answer, self.note = job, answer, mmap.mmap(-1, NOTE_SIZE)
        self.call, self.begun = "", time.monotonic()
        self.since = self.begun
        self.pid = os.fork()
        if not self.pid:
            self._do(subjects)

    def _do(self, subjects: _Unpacked) -> None:
        try:
            os.setpgid(0, 0)
            if isinstance(self.job, Task):
                os.environ.update(self.job.environment)
            for subject in subjects.known.values():
                subject.note = self._write_note
            write_answer(self.answer, self.job.rows(subjects))
        except Exception as error:  # a fault of ours, too, is to be seen
            write_answer(
                self.answer,
                self.job.lost(f"{type(error).__name__}: {' '.join(str(error).split())}"),
            )
        finally:
            os._exit(0)

    def _write_note(self, function: str) -> None:
        self.note[:] = function.encode()[:NOTE_SIZE].ljust(NOTE_SIZE)

    def _late(self) -> float | None:
        """Return the time [s] that it may take, or its step, if that is over."""
        now, call = time.monotonic(), self.note[:].decode("ascii", "replace").strip(" \0")
        if call != self.call:
            self.call, self.since = call, now
        if now - self.begun > self.job.seconds:
            return self.job.seconds
        longest = self.job.step_seconds
        return (
            longest if longest and call.endswith("DoStep") and now - self.since > longest else None
        )

    def rows(self) -> list[Row] | None:
        """Return its answer, or what is to be said in place of it, once it has ended or is too
        late; None before.
        """
        pid, status = os.waitpid(self.pid, os.WNOHANG)
        late = self._late()
        if not pid and late is None:
            return None
        for end in (os.killpg, os.kill):
            with suppress(OSError):
                end(self.pid, signal.SIGKILL)
        if not pid:
            os.waitpid(self.pid, 0)
        self.note.close()
        answer = read_answer(self.answer)
        self.answer.unlink(missing_ok=True)
        return (
            answer
            if isinstance(answer, list)
            else self.job.lost(self._why(late if not pid else None, status))
        )

    def _why(self, late: float | None, status: int) -> str:
        during = f" during {self.call}" if self.call else ""
        if late is not None:
            return f"took longer than {late:g} s{during}"
        if os.WIFSIGNALED(status):
            return f"crashed ({signal.Signals(os.WTERMSIG(status)).name}){during}"
        return f"ended its process{during}"
