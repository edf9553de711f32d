"""Pages: headings with addresses, tables for narrow screens, and plots that zoom in a browser as
their data say.
"""

import math
import re
import shutil
import subprocess

import numpy as np
import pytest
from jinja2 import TemplateNotFound, UndefinedError
from markupsafe import Markup

from bristle.common.drawing import STYLE, Drawing, new_figure, set_labels, svg
from bristle.common.pages import _environment, component, identifier, number, render
from bristle.common.time_plot import time_band, time_curve, time_mark, time_panel

BROWSER = next(
    (
        found
        for name in ("chromium", "chromium-browser", "google-chrome")
        if (found := shutil.which(name))
    ),
    None,
)
MOST_LINES = 200  # of the script in a page


def page(body, **data):
    """Return the page of a template with this body."""
    template = """{% extends "base.html" %}{% from "components.html" import table %}
        {% block title %}<t>{% endblock %}{% block body %}"""
    return _environment().from_string(template + body + "{% endblock %}").render(data)


def figure(title, svg, caption):
    """Return a figure as it stands in a page."""
    return component("plot", title, svg, caption)


def drawn(clock="run"):
    """Return a figure of 100 s with a spike at 30 s; its picture shows the last ten seconds."""
    from matplotlib import rc_context

    time = np.arange(100_001) * 1e-3
    values = np.sin(time)
    values[30_000] = 9.0
    with rc_context(STYLE):
        made = new_figure(8.0, 2.0)
        ax = made.subplots()
        time_panel(ax, clock, (90.0, 100.0))
        time_band(ax, time, values - 0.1, values + 0.1, "#0072B2", 0.2)
        time_curve(ax, time, values, "#0072B2", "estimate </script>")
        time_mark(ax, 51.0, "#007a5a")
        set_labels(ax, x="time, s", y="speed")
        drawing = svg(made, clock)
    drawing.seen = 'settles at 51 s, ends at "2"'
    return drawing


def test_an_identifier_may_break_between_its_parts_but_not_in_a_number():
    assert identifier("plant.J_0=0.001 kg.m2") == "plant.<wbr>J_<wbr>0=<wbr>0.001 kg.<wbr>m2"
    assert identifier("sigma0.error<") == "sigma0.<wbr>error&lt;"


@pytest.mark.parametrize("value", [None, math.nan, -math.inf, "text", True])
def test_what_is_no_finite_number_is_a_dash(value):
    assert number(value) == "–"


def test_every_heading_has_an_address_of_its_own():
    text = page('<h2>A <span class="sub">b</span></h2><h2>A b</h2><h2 id="own">C</h2><h2>—</h2>')
    ids = re.findall(r'<h2 id="([^"]*)"', text)
    assert ids == ["a-b", "a-b-2", "own", "section"]
    assert re.findall(r'href="#([^"]*)"', text) == ids


def test_a_tally_is_good_only_if_all_of_some_hold():
    assert 'good">14 of 14 checks' in component("tally", 14, 14, "checks")
    assert "bad" in component("tally", 13, 14, "checks")
    assert "bad" in component("tally", 0, 0, "checks")


def test_a_table_of_many_columns_names_its_cells_for_narrow_screens():
    body = "{% call(row) table(head, [1]) %}{{ row(*cells) }}{% endcall %}"
    head = ["a", Markup("b<sub>1</sub>"), "c", "d", "e", "f<"]
    text = page(body, head=head, cells="01234<")
    assert '<td class="n" data-name="b1">1</td>' in text
    assert "<td>0</td>" in text
    assert '<td data-name="f&lt;">&lt;</td>' in text
    assert "data-name=" not in page(body, head=head[:5], cells="01234")


def test_what_no_template_made_is_escaped():
    text = page('<a title="{{ name }}">{{ name }}</a>', name="<script>\"'&")
    assert '<a title="&lt;script&gt;&#34;&#39;&amp;">&lt;script&gt;&#34;&#39;&amp;</a>' in text
    assert number(-1.5e-9) == "−1.50·10<sup>-9</sup>".replace("-", "−")
    assert page("{{ x|number(2) }}", x=2e7).count("2·10<sup>7</sup>") == 1


def test_a_name_that_a_template_does_not_know_is_a_mistake():
    with pytest.raises(UndefinedError, match="nothing"):
        page("{{ nothing }}")
    with pytest.raises(TemplateNotFound):
        render("bristle.common/none.html")


def test_provenance_names_what_is_known_file_by_file():
    made = {"version": "1", "folder": None, "seed": 3, "records_sha256": {"a.csv": "12"}}
    text = component("provenance", made)
    assert re.findall(r"<dt>(.*?)</dt>", text) == ["version", "seed of the reference", "a.csv"]
    assert '<code class="sub">12</code>' in text


def test_the_image_says_what_is_seen_and_the_data_cannot_end_the_script():
    text = figure("title", drawn(), "caption")
    assert 'alt="settles at 51 s, ends at &#34;2&#34;"' in text
    assert text.count("</script>") == 1
    assert 'alt="title"' in figure("title", Drawing("<svg></svg>"), "")
    assert "<script" not in page("{{ x }}", x=figure("title", "<svg></svg>", ""))


def test_the_script_is_small_and_loads_nothing():
    text = page("{{ x }}", x=figure("title", drawn(), ""))
    script = re.search(r"</main><script>(.*?)</script>", text, re.DOTALL)[1]
    assert len(script.splitlines()) < MOST_LINES
    assert not re.search(
        r"fetch\(|XMLHttpRequest|import\(|https?://(?!www\.w3\.org/2000/svg)", script
    )


def dom(path, text, action):
    """Return the page as a browser has it after an action in it."""
    done = f"<script>{action}</script></body>"
    path.write_text(text.replace("</body>", done), encoding="utf-8")
    command = [
        BROWSER,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--window-size=1200,900",
        "--virtual-time-budget=2000",
        "--dump-dom",
    ]
    return subprocess.run(
        [*command, path.as_uri()], capture_output=True, text=True, timeout=120, check=True
    ).stdout


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no chromium")
def test_plots_of_one_clock_zoom_together_in_a_browser(tmp_path):
    other = figure("b", drawn("run"), "") + figure("c", drawn("second"), "")
    text = page("{{ x }}", x=figure("a", drawn(), "") + other)
    key = (
        "document.querySelector('.panel svg').dispatchEvent(new KeyboardEvent('keydown', {key:"
        " '%s'}));"
    )

    def last_ticks(found):
        panels = re.findall(r"<svg.*?</svg>", found, re.DOTALL)
        return [re.findall(r'text-anchor="middle">([^<]*)<', panel)[-2] for panel in panels]

    whole = dom(tmp_path / "whole.html", text, "")
    assert whole.count('class="live"') == 3
    assert last_ticks(whole) == ["100", "100", "100"]
    zoomed = dom(tmp_path / "zoomed.html", text, key % "+")
    assert last_ticks(zoomed)[:2] != ["100", "100"]
    assert last_ticks(zoomed)[2] == "100"
    assert last_ticks(dom(tmp_path / "back.html", text, key % "+" + key % "0")) == [
        "100",
        "100",
        "100",
    ]
    part = dom(
        tmp_path / "part.html",
        text,
        "document.querySelectorAll('button')[1].click();" + key % "ArrowRight",
    )
    assert "estimate &lt;/script&gt;" in part
    assert last_ticks(part)[0] == "100"
    assert len(re.findall(r'text-anchor="middle">9\d<', part)) >= 2
    assert re.search(r'class="cursor" visibility="visible"', part)
