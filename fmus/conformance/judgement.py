"""All points of an FMU."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bristle.common.errors import BristleError
from bristle.fmus.conformance.instance import Subject
from bristle.fmus.conformance.process import Row, examined, read_alone
from bristle.fmus.conformance.registry import POINTS, Point, PointResult, Verdict
from bristle.fmus.conformance.running import BEHAVIOUR, BehaviourPoint


def conformance(
    path: Path, progress: Callable[[str, float], None] | None = None
) -> list[PointResult]:
    """Return the result of each point for an FMU: of its archive, libraries and description, then
    of its behaviour.

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
    points = list(BEHAVIOUR.values())

    def tell(done: int) -> None:
        if progress:
            progress(points[min(done, len(points) - 1)].title, done / len(points))

    try:
        Subject(path).check_binary()
        rows = examined(path, tell)
    except BristleError as error:
        rows = read_alone(path)
        rows += [
            {"id": name, "verdict": Verdict.not_tested, "findings": [str(error)]}
            for name in BEHAVIOUR
        ]
    found = {row["id"]: row for row in rows}
    every: list[Point | BehaviourPoint] = [*POINTS.values(), *points]
    return [_result(point, found[point.id]) for point in every]


def _result(point: Point | BehaviourPoint, row: Row) -> PointResult:
    return PointResult(point, row["verdict"], tuple(row["findings"]))
