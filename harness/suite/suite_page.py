"""What a suite leaves behind: suite.json, a page with links to all runs, and JUnit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

from bristle.common import pages
from bristle.common.xml import printable
from bristle.harness.metrics.checks import SIGNS, check_unit
from bristle.harness.suite.suite import CaseResult, SuiteCase, by_scenario, summaries

NOT_RUN = "another scenario of the suite cannot be run, so none was"


def verdict(tested: Sequence[CaseResult]) -> str:
    """Return the worst verdict of all runs."""
    verdicts = {each.verdict for each in tested}
    return next((word for word in ("error", "fail") if word in verdicts), "pass")


def shown(value: float | None) -> str:
    """Return the value of a check as text."""
    return "none" if value is None or not math.isfinite(value) else f"{value:.6g}"


def failures(tested: CaseResult) -> list[str]:
    """Return one line for each check that does not hold, or the message of what ended the run."""
    lines = [tested.message] if tested.message else []
    for c in tested.checks:
        if not c["pass"]:
            lines.append(
                f"{c['name']}: {shown(c['value'])}, must be {SIGNS[c['kind']]} {c['limit']:g}"
            )
    return lines


def to_tree(tested: Sequence[CaseResult], provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of suite.json."""
    runs = [
        {
            "scenario": each.case.path.stem,
            "seed": each.case.seed,
            "values": list(each.case.values),
            "verdict": each.verdict,
            "wall_s": each.wall_s,
            "message": each.message,
            "checks": list(each.checks),
            "folder": each.report.parent.as_posix() if each.verdict != "error" else None,
            "origin": dict(each.origin),
        }
        for each in tested
    ]
    checks = {
        path.stem: [vars(summary) for summary in summaries(runs_of)]
        for path, runs_of in by_scenario(tested).items()
    }
    return {
        "verdict": verdict(tested),
        "runs": runs,
        "checks": checks,
        "provenance": dict(provenance),
    }


def junit(tested: Sequence[CaseResult], waiting: Sequence[SuiteCase] = ()) -> bytes:
    """Return JUnit: a suite a scenario, a case a run; what a check demands stands in its failure.

    `waiting` are cases that were not run because others cannot be; they are skipped ones.
    """
    root = ElementTree.Element("testsuites")
    for path, runs in by_scenario(tested).items():
        attributes = {
            "tests": str(len(runs)),
            "failures": str(_count(runs, "fail")),
            "errors": str(_count(runs, "error")),
        }
        suite = ElementTree.SubElement(root, "testsuite", {"name": path.stem, **attributes})
        for each in runs:
            name, time = each.case.name or path.stem, f"{each.wall_s:.3f}"
            case = ElementTree.SubElement(
                suite, "testcase", {"classname": path.stem, "name": name, "time": time}
            )
            if each.verdict != "pass":
                kind = "failure" if each.verdict == "fail" else "error"
                said = [printable(line) for line in failures(each)]
                ElementTree.SubElement(
                    case, kind, {"message": said[0] if said else ""}
                ).text = "\n".join(said)
    # cases that did not run
    for left in waiting:
        name, attributes = left.path.stem, {"tests": "1", "skipped": "1"}
        suite = ElementTree.SubElement(root, "testsuite", {"name": name, **attributes})
        case_of = {"classname": name, "name": left.name or name, "time": "0.000"}
        skipped = ElementTree.SubElement(suite, "testcase", case_of)
        ElementTree.SubElement(skipped, "skipped", {"message": NOT_RUN})
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def render(tested: Sequence[CaseResult], provenance: Mapping[str, Any]) -> str:
    """Return index.html: each scenario with its checks over all runs, linked to their reports."""
    scenarios = [_scenario(path.stem, runs) for path, runs in by_scenario(tested).items()]
    checks = [check for each in scenarios for check in each["checks"]]
    return pages.render(
        "bristle.harness.suite/index.html",
        scenarios=scenarios,
        verdict=verdict(tested),
        passed=_count(tested, "pass"),
        count=len(tested),
        lost=_count(tested, "error"),
        checks_passed=sum(check.passed for check in checks),
        checks=sum(check.count for check in checks),
        signs=SIGNS,
        units={check.quantity: check_unit({}, check.quantity) for check in checks},
        made=provenance,
    )


def _scenario(name: str, runs: Sequence[CaseResult]) -> dict[str, Any]:
    listed = [
        {
            "name": each.case.name or name,
            "verdict": each.verdict,
            "report": each.report.as_posix(),
            "failures": failures(each),
        }
        for each in runs
    ]
    return {
        "name": name,
        "runs": listed,
        "passed": _count(runs, "pass"),
        "seconds": math.fsum(each.wall_s for each in runs),
        "checks": summaries(runs),
    }


def _count(runs: Sequence[CaseResult], verdict: str) -> int:
    return sum(each.verdict == verdict for each in runs)
