"""report.html: one self-contained file that an engineer reads from top to bottom."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bristle.common import pages
from bristle.harness.metrics.checks import SIGNS, check_unit

TEMPLATE = "bristle.harness.run/report.html"


def render(
    result: Mapping[str, Any],
    figures: Mapping[str, str],
    about: Mapping[str, str],
    meanings: Mapping[str, str],
    source: str,
) -> str:
    """Return the page.

    Parameters
    ----------
    result : mapping
        The content of result.json.
    figures : mapping of str to str
        SVG text by name.
    about : mapping of str to str
        title, shows, source and limits of the scenario.
    meanings : mapping of str to str
        What each estimate of the observer means.
    source : str
        Text of the scenario file.
    """
    return pages.render(
        TEMPLATE,
        result=result,
        figures=figures,
        files=[f"{name}.svg" for name in figures],
        about=about,
        meanings=meanings,
        source=source,
        signs=SIGNS,
        units={each["quantity"]: check_unit(result, each["quantity"]) for each in result["checks"]},
        held=sum(bool(check["pass"]) for check in result["checks"]),
    )
