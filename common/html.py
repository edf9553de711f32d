"""Parts of HTML pages: numbers, units, tables, figures and the page around them."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files


def number(value: object, digits: int = 4) -> str:
    """Return a number as HTML text; a dash if it is none or not finite."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return "–"
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        rounded = f"{value:.{digits}g}"
        text = rounded if abs(float(rounded)) < 10**digits else f"{value:.0f}"
    else:
        mantissa, exponent = f"{value:.{max(0, digits - 2)}e}".split("e")
        text = f"{mantissa}·10<sup>{int(exponent)}</sup>"
    return text.replace("-", "−")


def unit(text: str) -> str:
    """Return a unit as HTML text: rad/s2 -> rad/s²."""
    return "" if text == "1" else re.sub(r"(?<=[a-z])2", "²", escape(text)).replace(".", "·")


def identifier(text: str) -> str:
    """Return an identifier as HTML text that may break after its dots and underscores where the page is narrow."""
    return re.sub(r"(?<=[._])(?=.)", "<wbr>", escape(text))


def table(head: Sequence[str], rows: Iterable[Sequence[str]], numeric: Sequence[int] = ()) -> str:
    """Return an HTML table; columns in `numeric` are right-aligned."""

    def cell(tag: str, index: int, text: str) -> str:
        return f'<{tag} class="n">{text}</{tag}>' if index in numeric else f"<{tag}>{text}</{tag}>"

    body = "".join("<tr>" + "".join(cell("td", i, text) for i, text in enumerate(row)) + "</tr>" for row in rows)
    return (
        "<table><thead><tr>"
        + "".join(cell("th", i, text) for i, text in enumerate(head))
        + f"</tr></thead><tbody>{body}</tbody></table>"
    )


def badge(kind: str, text: str) -> str:
    """Return a coloured word; `kind` is good, bad or open."""
    return f'<span class="badge {kind}">{escape(text)}</span>'


def figure(title: str, svg: str, caption: str) -> str:
    """Return a figure: an image of its own, so that the ids inside several of them cannot clash."""
    data = base64.b64encode(svg.encode()).decode()
    image = f'<img alt="{escape(title)}" src="data:image/svg+xml;base64,{data}">'
    return f"<figure>{image}<figcaption>{escape(caption)}</figcaption></figure>"


def page(title: str, body: str) -> str:
    """Return the self-contained page around `body`; `title` is plain text."""
    style = (files("bristle.common") / "report.css").read_text(encoding="utf-8")
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{escape(title)}</title><style>{style}</style></head>
<body><main>
{body}
</main></body></html>
"""
