"""docs/scenario_reference.md lists every key of a scenario, every check quantity and every stimulus
that the classes have.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bristle.harness.cosim.ports import PORTS
from bristle.harness.metrics.checks import CHECK_QUANTITIES, STATES
from bristle.harness.scenario.scenario import Scenario
from bristle.model.normalised import OBSERVED

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "scenario_reference.md").read_text(
    encoding="utf-8"
)
SCHEMA = Scenario.model_json_schema()


def sections(page: str) -> dict[str, list[str]]:
    """Return what stands in the first column of the tables of a page, by the heading above, without
    marks.
    """
    parts = re.split(r"^## ", page, flags=re.MULTILINE)[1:]
    return {
        part.partition("\n")[0].strip("`[]"): re.findall(
            r"^\| `([^`]+)` \|", part.partition("\n")[2], re.MULTILINE
        )
        for part in parts
    }


def tables(schema: dict, path: str = "") -> dict[str, list[str]]:
    """Return the keys of each table of a JSON schema by the path of the table."""
    found = {path: list(schema["properties"])}
    for key, value in schema["properties"].items():
        for name in re.findall(r"'#/\$defs/(\w+)'", str(value)):
            if "properties" in SCHEMA["$defs"][name]:
                found |= tables(SCHEMA["$defs"][name], f"{path}.{key}".strip("."))
    return found


def missing(page: str) -> set[str]:
    """Return what a scenario may hold and a page does not list."""
    listed = sections(page)
    wanted = {path or "Top level": keys for path, keys in tables(SCHEMA).items()}
    wanted["Stimuli"] = [name for ports in PORTS.values() for name in ports.free]
    wanted["Check quantities"] = [*CHECK_QUANTITIES, *OBSERVED, *STATES]
    wanted["Signals of the bus"] = [name for ports in PORTS.values() for name in ports.units]
    assert len(wanted) >= 16
    return {
        f"{path}: {key}"
        for path, keys in wanted.items()
        for key in keys
        if key not in listed.get(path, [])
    }


def test_nothing_is_missing():
    assert missing(PAGE) == set()


@pytest.mark.parametrize(
    "what",
    [
        "record.velocity: unit",
        "stimuli.sine: phase",
        "Top level: controller_sensor",
        "checks: max_abs",
        "Stimuli: u_ff",
        "Check quantities: estimates.PARAMETER.settling_s",
        "Check quantities: alpha2",
        "validation: baselines",
    ],
)
def test_what_is_left_out_is_noticed(what):
    """Each row counts, and only under its own heading."""
    heading, key = what.split(": ")
    before, mark, rest = PAGE.partition(
        next(
            line
            for line in PAGE.splitlines()
            if line.startswith("## ") and heading == line[3:].strip("`[]")
        )
    )
    row = re.search(rf"^\| `{re.escape(key)}` \|.*\n", rest, re.MULTILINE)
    assert row is not None
    assert missing(before + mark + rest.replace(row[0], "", 1)) == {what}
