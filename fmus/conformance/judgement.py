"""All points of an FMU."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from bristle.common.errors import BristleError
from bristle.fmus.calls import Control
from bristle.fmus.conformance.instance import CO_SIMULATION, MODEL_EXCHANGE, Subject
from bristle.fmus.conformance.process import Task, judged
from bristle.fmus.conformance.registry import POINTS, Result, Verdict, static_conformance
from bristle.fmus.conformance.running import BEHAVIOUR
from bristle.fmus.isolate import isolated

LIFE = {CO_SIMULATION: "run-life", MODEL_EXCHANGE: "exchange-life"}  # where they fail, nothing more can be tested
STATIC_SECONDS = 60.0  # s that all points of archive and description may take


def _judge(path: Path, control: Control) -> list[dict[str, Any]]:
    return [{"id": r.point.id, "verdict": r.verdict, "findings": list(r.findings)} for r in static_conformance(path)]


def _results(answer: Any) -> list[Result]:
    return [Result(POINTS[r["id"]], Verdict(r["verdict"]), tuple(map(str, r["findings"]))) for r in answer]


def conformance(path: Path, progress: Callable[[str, float], None] | None = None) -> list[Result]:
    """Return the result of each point for an FMU: of its archive and description, then of its behaviour.

    Parameters
    ----------
    path : Path
        The FMU, of any maker.
    progress : function, optional
        Called with what is done and the share that is done.

    Raises
    ------
    BristleError
        If the file cannot be read or is no zip archive.
    """
    found = isolated(_judge, path, [path], _results, None, STATIC_SECONDS)  # what reads libraries is code in C++
    points = list(BEHAVIOUR.values())

    def tell(done: int) -> None:
        if progress:
            progress(points[min(done, len(points) - 1)].title, done / len(points))

    try:
        subject = Subject(path)
        subject.check_binary()
    except BristleError as error:
        return found + [Result(each, Verdict.not_tested, (str(error),)) for each in points]
    first = judged([Task(path, name) for name in LIFE.values()])
    begun = {kind: Result(BEHAVIOUR[name], *judgement) for (kind, name), judgement in zip(LIFE.items(), first, strict=True)}
    rest = [p for p in points if p.id not in LIFE.values() and begun[p.kind].verdict is not Verdict.failed]
    judgements = judged([Task(path, p.id) for p in rest], tell)
    done = {r.point.id: r for r in begun.values()}
    done |= {p.id: Result(p, *judgement) for p, judgement in zip(rest, judgements, strict=True)}
    return found + [done.get(p.id) or Result(p, Verdict.not_tested, (f"{LIFE[p.kind]} fails",)) for p in points]
