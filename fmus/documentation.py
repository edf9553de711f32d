"""documentation/index.html of an FMU, generated from its variables."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from html import escape
from importlib.resources import files

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
PAGE_STYLE = (
    "body{font-family:sans-serif;max-width:60em;margin:auto}td,th{padding:.2em"
    " .6em;text-align:left}"
)


def _row(x: Exposed) -> list[str]:
    variable = x.slot.variable
    low, high = ("" if limit is None else f"{limit:g}" for limit in (x.minimum, x.maximum))
    source = variable.source if isinstance(variable, Parameter) else ""
    start = f"{x.slot.start:g}" if x.settable else ""
    interval = f"[{low}, {high}]" if low or high else ""
    return [x.name, variable.unit, start, interval, variable.description, source]


def _table(rows: Sequence[Sequence[str]], columns: Sequence[str] = PAGE_COLUMNS) -> str:
    lines = [
        "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in row) + "</tr>"
        for tag, row in (("th", columns), *(("td", row) for row in rows))
    ]
    return "<table>\n" + "\n".join(lines) + "\n</table>"


def _step_sizes(interface: Interface) -> str:
    """Return what a host has to know of communication steps, with measured errors of the plant."""
    parts, period = ["<h2>Communication steps</h2>"], interface.sample_time
    if period is not None:
        what = "What is sampled, such as an encoder, is" if interface.continuous else "It is"
        parts.append(
            f"<p>{what} computed every <code>{SAMPLE_TIME.name}</code> ({period:g} s), whatever the"
            " communication step is. Steps of that size are preferred; over longer ones inputs are"
            " held, and of the values between only the last is seen.</p>"
        )
    if interface.continuous:
        parts.append(
            "<p>What is continuous is integrated with steps of its own, so that the communication"
            " step only says for how long an input is held. Error of the velocity over its own size"
            " (rms, the worst of all friction laws of ServoPlant, with a voltage of two sines of 5"
            " and 23 rad/s), and what of it the integration causes:</p>"
        )
        columns, *rows = csv.reader(
            (files("bristle.fmus") / "plant" / "steps.csv").read_text(encoding="utf-8").splitlines()
        )
        parts.append(_table(rows, columns))
    return "\n".join(parts)


def documentation(interface: Interface) -> str:
    """Return a page with a table of all variables."""
    program = interface.program
    parts = [f"<h1>{escape(program.name)}</h1>\n<p>{escape(program.description)}</p>"]
    if program.selector:
        items = "".join(
            f"<li>{v.system.name}: {escape(v.system.description)}</li>" for v in program.variants
        )
        name = program.selector
        chooses = (
            f"The parameter <code>{name}</code>, or its number <code>{name}_index</code> (0: as"
            f" <code>{name}</code> says), chooses"
        )
        parts.append(
            f"<p>{chooses}; <code>{name}_running</code> is the number of what"
            f" runs:</p>\n<ol>{items}</ol>"
        )
    for title, causalities in PAGE_SECTIONS.items():
        if variables := interface.of(*causalities):
            parts.append(f"<h2>{title}</h2>\n" + _table([_row(x) for x in variables]))
    parts.append(_step_sizes(interface))
    parts.append(
        '<p>How to see that an importer steps it as it should: <a href="fmi-ls-ref.html">related'
        " files</a>.</p>"
    )
    head = (
        "<meta"
        f' charset="utf-8">\n<title>{escape(program.name)}</title>\n<style>{PAGE_STYLE}</style>'
    )
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n{head}\n</head>\n<body>\n'
        + "\n".join(parts)
        + "\n</body>\n</html>\n"
    )
