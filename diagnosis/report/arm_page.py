"""diagnosis.json and report.html of an arm: its joints side by side."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bristle.common import pages
from bristle.common.output import check_writable, replace_files, to_json
from bristle.diagnosis.answer import Diagnosis, Estimate
from bristle.diagnosis.report.content import diagnosis_content
from bristle.diagnosis.report.headline import headline
from bristle.diagnosis.report.text.names import effects_listed, value

ARM_FILES = ("diagnosis.json", "report.html")
SHOWN = ("J", "a2", "coulomb.Fc", "known.scale")  # parameters that the table of the joints has
# of diagnosis.json of a joint, what is repeated in that of the arm
KEPT = ("verdict", "statement", "effects", "suspects", "ties", "parameters", "findings", "gap")


def write_arm(
    name: str, joints: Mapping[str, Diagnosis], out: Path, made: Mapping[str, Any]
) -> None:
    """Write what the joints of an arm lack, each with a link to its own report, in the folder of
    its name.
    """
    check_writable(out)
    content = {joint: diagnosis_content(found) for joint, found in joints.items()}
    short = {joint: {key: own[key] for key in KEPT} for joint, own in content.items()}
    page = render(name, joints, made)
    files = {"diagnosis.json": to_json({"joints": short, "provenance": made}), "report.html": page}
    replace_files(out, {file: text.encode() for file, text in files.items()}, ARM_FILES)


def render(name: str, joints: Mapping[str, Diagnosis], made: Mapping[str, Any]) -> str:
    """Return the page of an arm; `made` is the key `provenance`."""
    return pages.render(
        "bristle.diagnosis.report/arm.html",
        name=name,
        rows=[_row(joint, found) for joint, found in joints.items()],
        findings=_findings(joints),
        named=sum(found.verdict == "named" for found in joints.values()),
        made=made,
    )


def _row(joint: str, found: Diagnosis) -> dict[str, Any]:
    """Return what the table says of a joint."""
    named = tuple(effect.name for effect in found.effects)
    suspects = tuple(effect.name for effect in found.suspects)
    return {
        "joint": joint,
        "headline": headline(found),
        "verdict": found.verdict,
        "effects": effects_listed(named, "and", found.model.wording) if named else "",
        "suspects": effects_listed(suspects, "and", found.model.wording) if suspects else "",
        "parameters": [_text(found.parameters.get(key)) for key in SHOWN],
    }


def _text(estimate: Estimate | None) -> str:
    return "–" if estimate is None else value(estimate)


def _findings(joints: Mapping[str, Diagnosis]) -> list[str]:
    """Return what is said of the known torque of each joint."""
    return [
        f"{joint}: {line}"
        for joint, found in joints.items()
        for line in found.findings
        if "known torque" in line
    ]
