"""The results as text, JSON, JUnit and SARIF."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from bristle.common.xml import printable
from bristle.fmus.conformance.registry import PointResult, Verdict

ORDER = (Verdict.failed, Verdict.not_tested, Verdict.not_applicable, Verdict.passed)
MOST_NAMED = 6  # points in a line
SARIF_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"


def to_lines(results: Sequence[PointResult]) -> list[str]:
    """Return a line for each finding and each reason, one for points that share it, and last the
    numbers of points.
    """
    lines: dict[tuple[Verdict, str, str], list[str]] = {}
    for r in sorted(results, key=lambda r: ORDER.index(r.verdict)):
        for finding in r.findings if r.verdict is not Verdict.passed else ():
            place = r.point.id if r.verdict is Verdict.failed else ""
            lines.setdefault(
                (
                    r.verdict,
                    str(r.point.severity) if place else "",
                    f"{place}: {printable(finding)}",
                ),
                [],
            ).append(r.point.id)
    shown = [
        f"{verdict:<14}  {severity:<7}  {text if severity else f'{_several(points)}{text}'}"
        for (verdict, severity, text), points in lines.items()
    ]
    counts = {verdict: sum(r.verdict is verdict for r in results) for verdict in Verdict}
    applicable = len(results) - counts[Verdict.not_applicable]
    return [
        *shown,
        (
            f"{counts[Verdict.passed]} of {applicable} points pass,"
            f" {counts[Verdict.not_applicable]} are not applicable"
        ),
    ]


def _several(points: Sequence[str]) -> str:
    return (
        ", ".join(points)
        if len(points) <= MOST_NAMED
        else f"{', '.join(points[:MOST_NAMED])} and {len(points) - MOST_NAMED} more"
    )


def to_tree(path: Path, results: Sequence[PointResult]) -> dict[str, Any]:
    """Return the results for a JSON file."""
    rows = [
        {
            "id": r.point.id,
            "title": r.point.title,
            "severity": str(r.point.severity),
            "verdict": str(r.verdict),
            "findings": list(r.findings),
        }
        for r in results
    ]
    return {"fmu": str(path), "points": rows}


def junit(path: Path, results: Sequence[PointResult]) -> bytes:
    """Return the results as JUnit: a case a point; not applicable or not tested is skipped."""
    failed = [r for r in results if r.verdict is Verdict.failed]
    skipped = [r for r in results if r.verdict in (Verdict.not_tested, Verdict.not_applicable)]
    counts = {
        "tests": str(len(results)),
        "failures": str(len(failed)),
        "skipped": str(len(skipped)),
    }
    suite = ElementTree.Element("testsuite", {"name": path.name, **counts})
    for r in results:
        case = ElementTree.SubElement(
            suite, "testcase", {"classname": path.name, "name": r.point.id}
        )
        if r in failed or r in skipped:
            kind = "failure" if r in failed else "skipped"
            ElementTree.SubElement(case, kind, {"message": r.point.title}).text = "\n".join(
                printable(f) for f in r.findings
            )
    return bytes(ElementTree.tostring(suite, encoding="utf-8", xml_declaration=True))


def sarif(path: Path, results: Sequence[PointResult]) -> dict[str, Any]:
    """Return the results as SARIF 2.1.0: a rule a point, a result a finding of a point that failed
    or could not be tested.
    """
    rules = [
        {
            "id": r.point.id,
            "shortDescription": {"text": r.point.title},
            "defaultConfiguration": {"level": str(r.point.severity)},
        }
        for r in results
    ]
    found = [
        {
            "ruleId": r.point.id,
            "ruleIndex": k,
            "level": str(r.point.severity),
            "message": {
                "text": printable(
                    finding if r.verdict is Verdict.failed else f"not tested: {finding}"
                )
            },
            "locations": [
                {"physicalLocation": {"artifactLocation": {"uri": path.resolve().as_uri()}}}
            ],
        }
        for k, r in enumerate(results)
        if r.verdict in (Verdict.failed, Verdict.not_tested)
        for finding in r.findings
    ]
    tool = {"driver": {"name": "bristle check", "version": version("bristle"), "rules": rules}}
    return {"$schema": SARIF_SCHEMA, "version": "2.1.0", "runs": [{"tool": tool, "results": found}]}
