"""Judging points of behaviour: the FMU is unpacked in a process of its own, which forks one for each point."""

from __future__ import annotations

import mmap
import os
import signal
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bristle.common.errors import BristleError
from bristle.fmus.answer import read_answer, write_answer
from bristle.fmus.calls import Control
from bristle.fmus.conformance import running
from bristle.fmus.conformance.instance import Ended, Subject
from bristle.fmus.conformance.registry import Verdict
from bristle.fmus.conformance.running import BEHAVIOUR, NotApplicable
from bristle.fmus.isolate import isolated

NOTE_SIZE = 64  # bytes of memory that the processes share, for the name of the call that is under way
FORK_POLL = 0.003  # s between two looks at the processes
MOST_AT_ONCE = 4  # points that run at a time
SPARE_SECONDS = 20.0  # s that all points may take in addition to the sum of theirs

Judgement = tuple[Verdict, tuple[str, ...]]


@dataclass(frozen=True)
class Task:
    """A point to judge for an FMU, with what is added to the environment of its process."""

    path: Path
    point: str
    environment: Mapping[str, str] = field(default_factory=dict)


def judged(tasks: Sequence[Task], progress: Callable[[int], None] | None = None) -> list[Judgement]:
    """Return for each task the verdict with what was found, or why it does not apply; a crash or a hang is a finding.

    `progress` is called now and then with the number of points that are done.
    """
    if not hasattr(os, "fork"):
        return [_alone(task, progress, k) for k, task in enumerate(tasks)]
    limit = running.POINT_SECONDS * len(tasks) + SPARE_SECONDS
    try:
        return isolated(_judge, (tasks, running.POINT_SECONDS), _paths(tasks), _judgements, progress, limit)
    except BristleError as error:
        return [(Verdict.failed, (str(error),))] * len(tasks)


def _alone(task: Task, progress: Callable[[int], None] | None, done: int) -> Judgement:
    """Judge a point in a process that is no fork."""
    if progress:
        progress(done)
    try:
        return isolated(_judge_one, task, [task.path], _judgements, None, running.POINT_SECONDS)[0]
    except BristleError as error:
        return Verdict.failed, (str(error),)


def _judge_one(task: Task, control: Control) -> list[dict[str, Any]]:
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        subject = Subject(task.path, Path(folder))
        subject.unpack()
        return [_judgement(subject, task)]


def _paths(tasks: Sequence[Task]) -> list[Path]:
    return list(dict.fromkeys(task.path for task in tasks))


def _judgements(answer: Any) -> list[Judgement]:
    return [(Verdict(each["verdict"]), tuple(map(str, each["findings"]))) for each in answer]


def _judgement(subject: Subject, task: Task) -> dict[str, Any]:
    """Judge a point in this process."""
    point = BEHAVIOUR[task.point]
    try:
        if subject.interface(point.kind) is None:
            raise NotApplicable(f"it does not offer {point.kind}")
        findings = list(point.judge(subject))
    except (NotApplicable, Ended) as reason:
        return {"verdict": Verdict.not_applicable, "findings": [str(reason)]}
    except BristleError as error:
        findings = [str(error)]
    return {"verdict": Verdict.failed if findings else Verdict.passed, "findings": findings}


# -- in the process that forks -------------------------------------------------------------------------------------------


@dataclass
class _Fork:
    """A process that judges a point: the call that is under way, and since when."""

    place: int
    pid: int
    note: mmap.mmap
    step_seconds: float | None
    begun: float = field(default_factory=time.monotonic)
    call: str = ""
    since: float = field(default_factory=time.monotonic)

    def late(self) -> float | None:
        """Return the time [s] that it may take, or its step, if that is over."""
        now, call = time.monotonic(), self.note[:].decode("ascii", "replace").strip(" \0")
        if call != self.call:
            self.call, self.since = call, now
        if now - self.begun > running.POINT_SECONDS:
            return running.POINT_SECONDS
        if self.step_seconds and call.endswith("DoStep") and now - self.since > self.step_seconds:
            return self.step_seconds
        return None


def _judge(work: tuple[Sequence[Task], float], control: Control) -> list[dict[str, Any]]:
    tasks, running.POINT_SECONDS = work
    answers: list[dict[str, Any]] = [{} for _ in tasks]
    with ExitStack() as stack:
        place = Path(stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True)))
        subjects = {path: Subject(path, place / f"fmu{k}") for k, path in enumerate(_paths(tasks))}
        for subject in subjects.values():
            subject.unpack()
        waiting, under_way = list(reversed(range(len(tasks)))), list[_Fork]()
        while waiting or under_way:
            while waiting and len(under_way) < min(MOST_AT_ONCE, os.cpu_count() or 1):
                k = waiting.pop()
                under_way.append(_forked(subjects[tasks[k].path], tasks[k], k, place / f"answer{k}"))
            time.sleep(FORK_POLL)
            for fork in list(under_way):
                finding = _ended(fork)
                if finding is not None:
                    under_way.remove(fork)
                    answers[fork.place] = _answer(place / f"answer{fork.place}", finding)
                    control[0] += 1
    return answers


def _forked(subject: Subject, task: Task, k: int, answer: Path) -> _Fork:
    note = mmap.mmap(-1, NOTE_SIZE)
    pid = os.fork()
    if pid:
        return _Fork(k, pid, note, BEHAVIOUR[task.point].step_seconds)
    try:
        os.setpgid(0, 0)
        os.environ.update(task.environment)
        subject.note = lambda function: note.__setitem__(slice(0, NOTE_SIZE), function.encode()[:NOTE_SIZE].ljust(NOTE_SIZE))
        write_answer(answer, _judgement(subject, task))
    except Exception as error:  # a fault of ours, too, is to be seen
        write_answer(answer, {"verdict": Verdict.failed, "findings": [f"{type(error).__name__}: {' '.join(str(error).split())}"]})
    finally:
        os._exit(0)


def _ended(fork: _Fork) -> str | None:
    """Return what is to be said if there is no answer, once the process has ended or is too late; None before."""
    pid, status = os.waitpid(fork.pid, os.WNOHANG)
    late = fork.late()
    if not pid and late is None:
        return None
    for end in (os.killpg, os.kill):
        with suppress(OSError):
            end(fork.pid, signal.SIGKILL)
    during = f" during {fork.call}" if fork.call else ""
    if not pid:
        os.waitpid(fork.pid, 0)
        return f"took longer than {late:g} s{during}"
    if os.WIFSIGNALED(status):
        return f"crashed ({signal.Signals(os.WTERMSIG(status)).name}){during}"
    return f"ended its process{during}"


def _answer(path: Path, otherwise: str) -> dict[str, Any]:
    answer = read_answer(path)
    return answer if isinstance(answer, dict) else {"verdict": Verdict.failed, "findings": [otherwise]}
