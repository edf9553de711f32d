"""What a suite leaves behind: suite.json, a page with links to all runs, and JUnit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote
from xml.etree import ElementTree

from bristle.common.html import badge, beside, identifier, number, page, table, tally, unit
from bristle.common.xml import printable
from bristle.harness.metrics import SIGNS, check_unit
from bristle.harness.suite import Case, CaseResult, CheckSummary, by_scenario, summaries

NOT_RUN = "another scenario of the suite cannot be run, so none was"
VERDICT_BADGES = {"pass": "good", "fail": "bad", "error": "bad"}


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


def junit(tested: Sequence[CaseResult], waiting: Sequence[Case] = ()) -> bytes:
    """Return JUnit: a suite a scenario, a case a run; what a check demands stands in its failure.

    `waiting` are cases that were not run because others cannot be; they are skipped ones.
    """
    root = ElementTree.Element("testsuites")
    for path, runs in by_scenario(tested).items():
        count = {word: sum(each.verdict == word for each in runs) for word in ("fail", "error")}
        attributes = {
            "tests": str(len(runs)),
            "failures": str(count["fail"]),
            "errors": str(count["error"]),
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
    for left in waiting:
        name, attributes = left.path.stem, {"tests": "1", "skipped": "1"}
        suite = ElementTree.SubElement(root, "testsuite", {"name": name, **attributes})
        case = {"classname": name, "name": left.name or name, "time": "0.000"}
        ElementTree.SubElement(
            ElementTree.SubElement(suite, "testcase", case), "skipped", {"message": NOT_RUN}
        )
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def render(tested: Sequence[CaseResult], provenance: Mapping[str, Any]) -> str:
    """Return index.html: each scenario with its checks over all runs, and all runs with links to
    their reports.
    """
    passed = sum(each.verdict == "pass" for each in tested)
    head = f'<p class="tally">{tally(passed, len(tested), "runs pass")} {_checks_held(tested)}</p>'
    word = badge(VERDICT_BADGES[verdict(tested)], verdict(tested))
    parts = [
        f"<header>{head}<h1>Scenario suite {word}</h1>{beside(['suite.json'])}</header>",
        "<h2>Scenarios</h2>",
        _overview(tested),
    ]
    parts += [_scenario(path, runs) for path, runs in by_scenario(tested).items()]
    rows = [f"<dt>{key}</dt><dd>{escape(str(value))}</dd>" for key, value in provenance.items()]
    parts.append(f"<h2>Where it comes from</h2><dl>{''.join(rows)}</dl>")
    return page(f"{passed} of {len(tested)} runs pass", "\n".join(parts))


def _checks_held(tested: Sequence[CaseResult]) -> str:
    """Return in how many runs checks hold, of all checks and runs; good only if every run came to a
    result.
    """
    found = [each for runs in by_scenario(tested).values() for each in summaries(runs)]
    passed, count = sum(each.passed for each in found), sum(each.count for each in found)
    lost = sum(each.verdict == "error" for each in tested)
    if not lost:
        return tally(passed, count, "checks")
    return badge(
        "bad", f"{passed} of {count} checks, {lost} {'run' if lost == 1 else 'runs'} without result"
    )


def _overview(tested: Sequence[CaseResult]) -> str:
    rows = []
    for path, runs in by_scenario(tested).items():
        passed = sum(each.verdict == "pass" for each in runs)
        link = f'<a href="#{quote(path.stem)}">{identifier(path.stem)}</a>'
        rows.append(
            (
                link,
                badge("good" if passed == len(runs) else "bad", f"{passed} of {len(runs)}"),
                number(_seconds(runs), 3),
            )
        )
    return table(("scenario", "runs that pass", "s"), rows, (2,))


def _seconds(runs: Sequence[CaseResult]) -> float:
    return math.fsum(each.wall_s for each in runs)


def _scenario(path: Path, runs: Sequence[CaseResult]) -> str:
    checks = [_check_row(each, len(runs)) for each in summaries(runs)]
    parts = [f'<h2 id="{quote(path.stem)}">{escape(path.stem)}</h2>']
    if checks:
        parts.append(
            table(
                ("check", "limit", "unit", "holds in", "median", "worst", "where"),
                checks,
                (1, 4, 5),
            )
        )
    rows = []
    for each in runs:
        name = identifier(each.case.name or path.stem)
        link = (
            name
            if each.verdict == "error"
            else f'<a href="{quote(each.report.as_posix())}">{name}</a>'
        )
        rows.append(
            (
                link,
                badge(VERDICT_BADGES[each.verdict], each.verdict),
                "<br>".join(map(escape, failures(each))),
            )
        )
    listed = table(("run", "", "what does not hold"), rows)
    many = len(runs) > 1
    return "\n".join(
        [
            *parts,
            f"<details><summary>All {len(runs)} runs</summary>{listed}</details>"
            if many
            else listed,
        ]
    )


def _check_row(each: CheckSummary, runs: int) -> tuple[str, ...]:
    held = badge("good" if each.passed == each.count else "bad", f"{each.passed} of {each.count}")
    limit = f"{SIGNS[each.kind]} {number(each.limit)}"
    where = identifier(each.worst_run) if runs > 1 else ""
    own = unit(check_unit({}, each.quantity)) or "–"
    return (identifier(each.name), limit, own, held, number(each.median), number(each.worst), where)
