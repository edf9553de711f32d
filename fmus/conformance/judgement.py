"""All points of an FMU, and their results as JSON and JUnit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from bristle.common.errors import BristleError
from bristle.fmus.conformance.behaviour import BEHAVIOUR, judged
from bristle.fmus.conformance.registry import Result, Verdict, static_conformance
from bristle.fmus.host import Fmu


def conformance(path: Path, progress: Callable[[str, float], None] | None = None) -> list[Result]:
    """Return the result of each point for an FMU: of its archive and description, then of its behaviour.

    Parameters
    ----------
    path : Path
        The FMU, of any maker.
    progress : function, optional
        Called with the name of a point and the share that is done.

    Raises
    ------
    BristleError
        If the file cannot be read or is no zip archive.
    """
    found = static_conformance(path)
    try:
        Fmu(path)
        why = ""
    except BristleError as error:  # Model Exchange alone, too
        why = str(error)
    for k, each in enumerate(BEHAVIOUR.values()):
        if progress:
            progress(each.title, k / len(BEHAVIOUR))
        found.append(Result(each, *((Verdict.not_tested, (why,)) if why else judged(path, each.id))))
    return found


def to_tree(path: Path, results: Sequence[Result]) -> dict[str, Any]:
    """Return the results for a JSON file."""
    rows = [
        {"id": r.point.id, "title": r.point.title, "severity": str(r.point.severity), "verdict": str(r.verdict),
         "findings": list(r.findings)}
        for r in results
    ]  # fmt: skip
    return {"fmu": str(path), "points": rows}


def junit(path: Path, results: Sequence[Result]) -> bytes:
    """Return the results as JUnit: a test case a point; what is not applicable or not tested is skipped."""
    failed = [r for r in results if r.verdict is Verdict.failed]
    skipped = [r for r in results if r.verdict in (Verdict.not_tested, Verdict.not_applicable)]
    counts = {"tests": str(len(results)), "failures": str(len(failed)), "skipped": str(len(skipped))}
    suite = ElementTree.Element("testsuite", {"name": path.name, **counts})
    for r in results:
        case = ElementTree.SubElement(suite, "testcase", {"classname": path.name, "name": r.point.id})
        if r in failed or r in skipped:
            kind = "failure" if r in failed else "skipped"
            ElementTree.SubElement(case, kind, {"message": r.point.title}).text = "\n".join(_printable(f) for f in r.findings)
    return bytes(ElementTree.tostring(suite, encoding="utf-8", xml_declaration=True))


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else " " for c in text)
