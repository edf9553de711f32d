"""The page of `bristle reproduce`: the figures and numbers of the paper beside ours."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bristle.common import pages
from bristle.harness.paper.printed_numbers import FIGURES, PRINTED
from bristle.harness.paper.schemes import COMPARED, LETTERS, SCHEMES, TEST_PLANTS

IDENTIFIED = ("alpha2", "b", "sigma0", "sigma1", "sigma2", "c")


def render(content: Mapping[str, Any], figures: Mapping[str, str]) -> str:
    """Return the page.

    Parameters
    ----------
    content : mapping
        The content of reproduce.json.
    figures : mapping of str to str
        SVG text by name.
    """
    checks = [
        bool(check["pass"])
        for run in content["runs"]
        if run["order"] == 1
        for check in run["checks"]
    ]
    remarks = (each["kind"] for row in content["eq25"] for each in row["remarks"].values())
    return pages.render(
        "bristle.harness.paper/report.html",
        content=content,
        figures=figures,
        files=[f"{name}.svg" for name in figures],
        held=sum(checks),
        checks=len(checks),
        remarks=list(dict.fromkeys(remarks)),
        estimates=[_estimate(name, content["estimates"]["S"]) for name in IDENTIFIED],
        printed=PRINTED,
        printed_figures=FIGURES,
        compared=COMPARED,
        letters=LETTERS,
        schemes=SCHEMES,
        test_plants=list(TEST_PLANTS),
    )


def _estimate(name: str, estimates: Mapping[str, Any]) -> dict[str, Any]:
    """Return a parameter as printed and as each scheme finds it, and an estimate that knows the
    truth, None if none does.
    """
    each = {scheme: estimates[scheme].get(name) for scheme in SCHEMES}
    known = (e for e in each.values() if e is not None and e["true"] is not None)
    return {"printed": PRINTED[name], "identified": each, "truth": next(known, None)}
