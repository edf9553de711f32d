"""The colours of figures and pages can be told from their background, and thinning loses no
spike.
"""

import re
from importlib.resources import files

import numpy as np
import pytest

from bristle.common.drawing import FAILED, INK, LIMIT, ROLES, STYLE
from bristle.common.time_plot import extremes

CSS = (files("bristle.common.pages") / "report.css").read_text(encoding="utf-8")
WHITE = "#ffffff"
LEAST_TEXT, LEAST_LINE = 4.5, 3.0  # WCAG 2.2, 1.4.3 and 1.4.11


def luminance(colour):
    """Return the relative luminance of WCAG of #rgb or #rrggbb."""
    digits = colour.lstrip("#")
    digits = "".join(2 * each for each in digits) if len(digits) == 3 else digits
    parts = [int(digits[k : k + 2], 16) / 255 for k in (0, 2, 4)]
    linear = [
        part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one, other):
    """Return the contrast ratio of WCAG of two colours."""
    light, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def declared(selector, name):
    """Return the colour that the style sheet gives a selector, variables resolved."""
    rule = re.search(rf"^{re.escape(selector)} {{(.*?)}}", CSS, re.MULTILINE | re.DOTALL)[1]
    value = re.search(rf"(?:^|[;\s]){name}: (?:[^;]*?)(#[0-9a-f]{{3,6}}|var\(--\w+\))", rule)[1]
    variable = re.fullmatch(r"var\((--\w+)\)", value)
    return re.search(rf"{variable[1]}: (#\w+)", CSS)[1] if variable else value


def test_the_contrast_is_that_of_the_standard():
    assert contrast("#000", WHITE) == pytest.approx(21.0)
    assert contrast("#777777", WHITE) == pytest.approx(4.48, abs=0.01)


@pytest.mark.parametrize("role", ROLES)
def test_every_role_can_be_seen_as_a_line(role):
    assert contrast(ROLES[role], WHITE) >= LEAST_LINE


def test_roles_have_different_colours():
    assert len(set(ROLES.values())) == len(ROLES)


def test_texts_of_figures_can_be_read():
    for colour in (INK, LIMIT, FAILED, STYLE["xtick.color"], STYLE["axes.labelcolor"]):
        assert contrast(colour, WHITE) >= LEAST_TEXT


def test_texts_of_pages_can_be_read():
    page = declared("body", "background")
    alarm = declared(".alarm", "background")
    for selector, background in (
        ("body", page),
        (".sub", page),
        (".head span", page),
        ("summary", page),
        ("figcaption", page),
    ):
        assert contrast(declared(selector, "color"), background) >= LEAST_TEXT, selector
    assert contrast(declared("body", "color"), alarm) >= LEAST_TEXT
    for kind in (".good", ".bad", ".open", ".calm"):
        assert contrast(declared(".badge", "color"), declared(kind, "background")) >= LEAST_TEXT, (
            kind
        )


def test_no_page_has_a_dark_scheme_of_which_nothing_is_tested():
    assert "prefers-color-scheme" not in CSS


@pytest.mark.parametrize("n", [1, 2, 7, 999, 100_000])
def test_thinning_keeps_every_spike_and_both_ends(n):
    values = np.sin(np.arange(n) / 50)
    spikes = [k for k in (n // 3, n // 2 + 1) if k < n]
    values[spikes] = [7.0, -7.0][: len(spikes)]
    index = extremes(values, 300)
    assert set(spikes) <= set(index)
    assert {0, n - 1} <= set(index)
    assert len(index) <= 2 * 300 + 2
    assert np.all(np.diff(index) > 0)


def test_thinning_keeps_gaps():
    values = np.ones(10_000)
    values[5000:5004] = np.nan
    assert np.isnan(values[extremes(values, 100)]).any()
