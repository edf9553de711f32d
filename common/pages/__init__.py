"""Pages: data and a template give one self-contained HTML file.

A template of a room lies in its folder `templates` and is called by package and file name, such as
``bristle.harness.run/report.html``. What all pages share lies here and is called by its file name
alone: `base.html` is the page around them, `components.html` the parts of which they are made.
Data are plain text and numbers; what is not made by a template is escaped.
"""

from __future__ import annotations

import math
import re
from contextlib import suppress
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, TypeGuard
from urllib.parse import quote

from markupsafe import Markup, escape

if TYPE_CHECKING:
    from jinja2 import Environment

__all__: list[str] = []  # for the rooms of the library

# characters that may stand unescaped in an address inside quotes
URL_SAFE = " !$'()*+,-./:;<=>?@[]^_`{|}~"


def render(template: str, **data: object) -> str:
    """Return the page, or the part of one, that a template makes of data."""
    return _environment().get_template(template).render(data)


def load(template: str) -> None:
    """Compile a template before it is needed."""
    _environment().get_template(template)


def component(name: str, *arguments: object) -> Markup:
    """Return what a macro of `components.html` makes of its arguments."""
    return Markup(getattr(_environment().get_template("components.html").module, name)(*arguments))


def finite(value: object) -> TypeGuard[float]:
    """Return whether something is a finite number."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def number(value: object, digits: int = 4) -> Markup:
    """Return a number as HTML text; a dash if it is none or not finite."""
    if not finite(value):
        return Markup("–")
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        rounded = f"{value:.{digits}g}"
        text = rounded if abs(float(rounded)) < 10**digits else f"{value:.0f}"
    else:
        mantissa, exponent = f"{value:.{max(0, digits - 2)}e}".split("e")
        text = f"{mantissa}·10<sup>{int(exponent)}</sup>"
    return Markup(text.replace("-", "−"))


def unit(text: str) -> str:
    """Return a unit as people write it, nothing for 1: rad/s2 -> rad/s²."""
    return "" if text == "1" else re.sub(r"(?<=[a-z])2", "²", text).replace(".", "·")


def identifier(text: str) -> Markup:
    """Return an identifier as HTML text that may break after dots, underscores and = where the page
    is narrow, not in a number.
    """
    return Markup(re.sub(r"(?<=[._=])(?!(?<=\d\.)\d)(?=.)", "<wbr>", str(escape(text))))


def capitalised(text: str) -> str:
    """Return a text with a capital at its begin, the rest as it is."""
    return text[:1].upper() + text[1:]


def _plain_text(text: str) -> str:
    """Return a text as Markdown shows it, without markup."""
    return re.sub(r"([\\`*\[\]<>&|~])", r"\\\1", text)


# -- of the templates ------------------------------------------------------------------------------
@cache
def _environment() -> Environment:
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    made = Environment(
        extensions=["jinja2.ext.do"],
        autoescape=lambda name: name is None or not name.endswith(".md"),
        undefined=StrictUndefined,
        loader=FunctionLoader(_found),
        keep_trailing_newline=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= {
        "number": number,
        "unit": unit,
        "identifier": identifier,
        "capitalised": capitalised,
        "image": _image,
        "plain_text": _plain_text,
        "data": _data,
        "anchored": _anchored,
    }
    made.tests["finite"] = finite
    made.globals["own_text"] = lambda name: Markup(_text_of(name))
    return made


def _text_of(template: str) -> str:
    """Return the text of a template, or of a file beside `base.html`."""
    package, _, name = template.rpartition("/")
    place = files(package) / "templates" if package else files(__name__)
    return (place / name).read_text(encoding="utf-8")


def _found(template: str) -> str | None:
    """Return the text of a template, None if there is none, which Jinja makes an error of."""
    with suppress(FileNotFoundError):
        return _text_of(template)
    return None


def _image(svg: str) -> Markup:
    """Return the address of an image of its own, so that the ids inside several cannot clash."""
    return Markup("data:image/svg+xml,") + Markup(quote(" ".join(svg.split()), safe=URL_SAFE))


def _data(json: str) -> Markup:
    """Return JSON as it may stand in a script element, which it cannot end."""
    return Markup(json.replace("<", "\\u003c"))


def _anchored(body: str) -> Markup:
    """Give each heading an address of its own and a link to it, so that people can send each other
    to it.
    """
    taken = set(re.findall(r' id="([^"]*)"', body))

    def link(match: re.Match[str]) -> str:
        name, text = match.groups()
        if name is None:
            words = re.sub(r"<[^>]*>|&[\w#]+;", "", text).lower()
            stem = name = re.sub(r"[^\w]+", "-", words).strip("-") or "section"
            count = 1
            while name in taken:
                count += 1
                name = f"{stem}-{count}"
            taken.add(name)
        return f'<h2 id="{name}">{text} {component("anchor", name)}</h2>'

    return Markup(re.sub(r'<h2(?: id="([^"]*)")?>(.*?)</h2>', link, body, flags=re.DOTALL))
