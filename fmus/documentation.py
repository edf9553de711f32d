"""documentation/index.html of an FMU, generated from its variables."""

from __future__ import annotations

import csv
from importlib.resources import files

from bristle.common.pages import render
from bristle.fmus.interface import Exposed, Interface
from bristle.model.system import SAMPLE_TIME
from bristle.model.variables import Parameter

PAGE_SECTIONS = {
    "Parameters": ("parameter",),
    "Calculated parameters": ("calculatedParameter",),
    "Inputs": ("input",),
    "Outputs": ("output",),
    "States and derivatives": ("local",),
}
PAGE_COLUMNS = ("name", "unit", "start", "interval", "meaning", "source")


def _row(x: Exposed) -> list[str]:
    variable = x.slot.variable
    low, high = ("" if limit is None else f"{limit:g}" for limit in (x.minimum, x.maximum))
    source = variable.source if isinstance(variable, Parameter) else ""
    start = f"{x.slot.start:g}" if x.settable else ""
    interval = f"[{low}, {high}]" if low or high else ""
    return [x.name, variable.unit, start, interval, variable.description, source]


def _step_errors() -> list[list[str]]:
    """Return the measured errors of the plant by the communication step, columns' names first."""
    table = (files("bristle.fmus") / "plant" / "steps.csv").read_text(encoding="utf-8")
    return list(csv.reader(table.splitlines()))


def documentation(interface: Interface) -> str:
    """Return a page with a table of all variables, and what a host has to know of communication
    steps.
    """
    program = interface.program
    sections = {
        title: [_row(x) for x in variables]
        for title, causalities in PAGE_SECTIONS.items()
        if (variables := interface.of(*causalities))
    }
    return render(
        "bristle.fmus/documentation.html",
        name=program.name,
        description=program.description,
        selector=program.selector,
        systems=[v.system for v in program.variants],
        columns=PAGE_COLUMNS,
        sections=sections,
        sample_time=SAMPLE_TIME.name,
        period=interface.sample_time,
        continuous=interface.continuous,
        steps=_step_errors() if interface.continuous else [],
    )
