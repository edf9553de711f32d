"""Parts of HTML pages: numbers, units, tables, figures and the page around them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from urllib.parse import quote

from bristle.common.drawing import Drawing

CARD_COLUMNS = 6  # of a table that is too wide for a narrow screen
# characters that may stand unescaped in an address inside quotes
URL_SAFE = " !$'()*+,-./:;<=>?@[]^_`{|}~"


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
    return escape(written_unit(text))


def written_unit(text: str) -> str:
    """Return a unit as people write it, nothing for 1."""
    return "" if text == "1" else re.sub(r"(?<=[a-z])2", "²", text).replace(".", "·")


def identifier(text: str) -> str:
    """Return an identifier as HTML text that may break after dots, underscores and = where the page
    is narrow, not in a number.
    """
    return re.sub(r"(?<=[._=])(?!(?<=\d\.)\d)(?=.)", "<wbr>", escape(text))


def table(head: Sequence[str], rows: Iterable[Sequence[str]], numeric: Sequence[int] = ()) -> str:
    """Return an HTML table; columns in `numeric` are right-aligned. On a narrow screen one of many
    columns becomes cards.
    """
    cards = len(head) >= CARD_COLUMNS
    names = [re.sub(r"<[^>]*>", "", text) for text in head]

    def cell(tag: str, index: int, text: str) -> str:
        right = ' class="n"' if index in numeric else ""
        name = (
            f' data-name="{names[index]}"'
            if cards and tag == "td" and index and names[index]
            else ""
        )
        return f"<{tag}{right}{name}>{text}</{tag}>"

    body = "".join(
        "<tr>" + "".join(cell("td", i, text) for i, text in enumerate(row)) + "</tr>"
        for row in rows
    )
    return (
        ('<table class="cards">' if cards else "<table>")
        + "<thead><tr>"
        + "".join(cell("th", i, text) for i, text in enumerate(head))
        + f"</tr></thead><tbody>{body}</tbody></table>"
    )


def badge(kind: str, text: str) -> str:
    """Return a coloured word; `kind` is good, bad or open."""
    return f'<span class="badge {kind}">{escape(text)}</span>'


def tally(passed: int, total: int, what: str) -> str:
    """Return how many of `total` hold as a coloured word for the top of a page: 14 of 14 checks."""
    return badge("good" if passed == total > 0 else "bad", f"{passed} of {total} {what}")


def beside(names: Iterable[str]) -> str:
    """Return a line with links to the files that lie beside the page."""
    links = ", ".join(f'<a href="{quote(name)}">{escape(name)}</a>' for name in names)
    return f'<p class="sub">Beside this page: {links}</p>'


def figure(title: str, svg: str, caption: str) -> str:
    """Return a figure: an image of its own, so that the ids inside several of them cannot clash.

    A `Drawing` brings its own text for those who cannot see it, without it the title is the text;
    and one with the data of its time axes becomes a plot to zoom into, while the image stays for
    print and for browsers without scripts.
    """
    data = quote(" ".join(svg.split()), safe=URL_SAFE)
    plot, seen = (svg.plot, svg.seen) if isinstance(svg, Drawing) else ("", "")
    image = f'<img alt="{escape(seen or title)}" src="data:image/svg+xml,{data}">'
    said = f"<figcaption>{escape(caption)}</figcaption>"
    inside = plot.replace("<", "\\u003c")
    script = f'<script type="application/json" class="plot">{inside}</script>' if plot else ""
    return f"<figure>{image}{script}{said}</figure>"


def _anchored(body: str) -> str:
    """Give each heading an address of its own and a link to it, so that people can send each other
    to it.
    """
    taken = set(re.findall(r' id="([^"]*)"', body))

    def link(match: re.Match[str]) -> str:
        given, text = match.groups()
        name = given
        if name is None:
            words = re.sub(r"<[^>]*>|&\w+;", "", text).lower()
            stem = name = re.sub(r"[^\w]+", "-", words).strip("-") or "section"
            count = 1
            while name in taken:
                count += 1
                name = f"{stem}-{count}"
            taken.add(name)
        return (
            f'<h2 id="{name}">{text} <a class="anchor" href="#{name}" aria-label="link to this'
            ' section"></a></h2>'
        )

    return re.sub(r'<h2(?: id="([^"]*)")?>(.*?)</h2>', link, body, flags=re.DOTALL)


def page(title: str, body: str) -> str:
    """Return the self-contained page around `body`, its headings with links to themselves; `title`
    is plain text.
    """
    style = (files("bristle.common") / "report.css").read_text(encoding="utf-8")
    script = ""
    if 'class="plot"' in body:
        code = (files("bristle.common") / "report.js").read_text(encoding="utf-8")
        script = f"<script>{code}</script>"
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{escape(title)}</title><style>{style}</style></head>
<body><main>
{_anchored(body)}
</main>{script}</body></html>
"""
