"""report.html of `reproduce`: the paper's figures and numbers beside ours, from top to bottom."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from bristle.common.html import badge, beside, figure, identifier, number, page, table, tally, unit
from bristle.harness.paper.printed_numbers import FIGURES, PRINTED, PrintedFigure
from bristle.harness.paper.reproduce import COMPARED, LETTERS, SCHEMES, TEST_PLANTS
from bristle.harness.run.run_page import GREEK

ORIGINS = {"text": "text", "axis": "axis", "curve": "curve, by eye"}
HERE = {
    1: (
        "The original LuGre law of set L0 (a0 = 5 mrad, a1 = 4 mrad, v0 = 25 deg/s; friction over"
        " inertia is sigma0/J = 800 1/s² times s), and the levels (18) that the schemes found on"
        " it, on the record of order 1. Each curve is a plant FMU that coasts down, with bristles"
        " stiff enough to follow their level."
    ),
    3: (
        "White noise of seed 1 through one section and through two, rms 120 deg/s, clipped at ±300"
        " deg/s, from the Controller FMU."
    ),
    4: (
        "Set S on the record of order 1. Dashed: the printed levels, which are the truth of set S."
        " What leaves the axes is cut off."
    ),
    5: (
        "The same record, from the start of step 2; (c) has no steps and starts at 0 s. Dashed: the"
        " printed levels, a hundred times larger as in set S, whose truth they are. What leaves the"
        " axes is cut off."
    ),
    6: (
        "Set S, order 1, second record: the models run open loop from rest, with the voltage only."
        " Grey: the velocity of the plant, exact. The model of the last panel has viscous friction"
        " only."
    ),
}
GAIN_UNITS = {"vc": "deg/s", "c1": "1/s", "gamma": "1", "k0": "1", "lambda": "1/s"}
UNUSED = "not used"
FROM_RECORD = "from the speed so far"  # a gate that the method chooses
SHORT = {
    "step1": "alpha2, b, F<sub>c</sub> alone",
    "invalid": "called not valid",
    "none": "no model",
}  # what a cell of eq. (25) says
REASONS = {
    "step1": (
        "<i>alpha2, b, F<sub>c</sub> alone</i>: step 2 diverged, or its estimates at the end make"
        " no model that can be simulated (c is negative, so that friction would grow without"
        " limit); what step 1 found is scored without them."
    ),
    "invalid": (
        "<i>called not valid</i>: the observer itself says that these estimates are not valid,"
        " because its innovations are larger than its sensor explains: it has noticed that the"
        " plant is not its model. The paper has no such measure; the estimates are scored all the"
        " same."
    ),
    "none": (
        "<i>no model</i>: the observer diverged, or its estimates make no model that can be"
        " simulated."
    ),
}


def render(content: Mapping[str, Any], figures: Mapping[str, str]) -> str:
    """Return the page.

    Parameters
    ----------
    content : mapping
        The content of reproduce.json.
    figures : mapping of str to str
        SVG text by name.
    """
    verdict = badge("good", "pass") if content["verdict"] == "pass" else badge("bad", "fail")
    schemes = "".join(f"<li>{_scheme(name, content)}</li>" for name in SCHEMES)
    short = (
        ""
        if content["share"] == 1
        else f'<p class="alarm">Shortened to {content["share"]:g} of the paper\'s durations.</p>'
    )
    checks = [
        bool(check["pass"])
        for run in content["runs"]
        if run["order"] == 1
        for check in run["checks"]
    ]
    data = beside(["reproduce.json", *(f"{name}.svg" for name in figures)])
    body = f"""<header><p class="tally">{tally(sum(checks), len(checks), "checks")}</p>
<p class="name">{escape(content["paper"])}</p>
<h1>The paper, figure by figure {verdict}</h1>
<p class="lead">Figures 1 and 3 to 6 and the numbers of section IV. The rig and its records are not public: all that follows is
simulated, on a plant that has the parameters which the paper found, and on one with the original LuGre law.</p>
<p class="sub">made by <code>bristle reproduce</code> {escape(content["provenance"]["version"])} on
{escape(content["provenance"]["date"])} in {content["wall_s"]:.0f} s</p>{data}</header>{short}
<ul>{schemes}</ul>
<h2>What 4 to 6 % is worth</h2>{_worth(content)}
{figure("Eq. (25) of all models", figures["eq25"], "Each row is a record; the models were identified on another one.")}
{_eq25(content)}
{"".join(_figure(each, figures[f"figure_{each.number}"]) for each in FIGURES)}
<h2>Section IV in numbers: what was identified</h2>{_estimates(content)}
<h2>Section IV in numbers: how</h2>{_settings(content)}
<h2>Remark 3: the interval of c</h2>{_remark3(content)}
<h2>Every number of the paper that is used here</h2>{_printed()}
<h2>The runs</h2>{_runs(content)}"""
    return page("The paper, figure by figure", body)


def _scheme(name: str, content: Mapping[str, Any]) -> str:
    about = {
        "printed": (
            "the scheme of section IV with its gains, gate, basis and zero starts, its estimate of"
            " the velocity set to ±vc where the gate opens, and no normalisation; velocity and"
            " voltage in units of a degree, the velocity exact"
        ),
        "repaired": (
            "the same two steps with gains that fit the units, a gate of its own, a matrix gain and"
            " a normalised step; the velocity is exact"
        ),
        "best": "all parameters at once from the encoder's counts alone",
    }
    return (
        f"<b>{LETTERS[name]}</b>: {about[name]}"
        f" (<code>{identifier(content['methods'][name])}</code>)"
    )


def _unbroken(text: str) -> str:
    """Return a short text that is not to break in a narrow column."""
    return escape(text).replace(" ", "&nbsp;").replace("-", "‑")


def _record_name(entry: Mapping[str, Any]) -> str:
    return _unbroken(f"set {entry['plant']}, order {entry['order']}")


def _span(values: Sequence[float | None]) -> str:
    found = [value for value in values if value is not None]
    if not found:
        return "–"
    low, high = number(min(found), 2), number(max(found), 2)
    return f"{low} %" if low == high else f"{low} to {high} %"


def _worth(content: Mapping[str, Any]) -> str:
    rows = content["eq25"]
    spans = {
        name: _span([row[name] for row in rows])
        for name in ("printed", "repaired", "best", "linear", "coulomb", "floor")
    }
    low, high = PRINTED["mse"].values
    linear = [row["linear"] for row in rows if row["linear"] is not None]
    verdict = ""
    if linear and min(linear) <= high:
        verdict = (
            f" A value of {low:g} to {high:g} % therefore does not tell a model with dry friction"
            " from one without: it has to be compared with what simpler models reach on the same"
            " records."
        )
    return (
        "<p>The paper judges its models by eq. (25), the variance of the prediction's error over"
        f" that of the velocity, finds {low:g} to {high:g} % and calls that acceptable. On records"
        " like the paper's, <b>a linear model, with viscous friction only, reaches"
        f" {spans['linear']}</b>, viscous and Coulomb friction {spans['coulomb']}, the scheme as"
        f" printed {spans['printed']}, as repaired {spans['repaired']}, the best observer"
        f" {spans['best']}.{verdict}</p>"
    )


def _eq25(content: Mapping[str, Any]) -> str:
    rows: list[tuple[str, ...]] = []
    reasons: dict[str, str] = {}
    for row in content["eq25"]:
        name, remarks = _record_name(row), row["remarks"]
        cells = [
            number(row[key], 3)
            + (f'<div class="sub">{SHORT[remarks[key]["kind"]]}</div>' if key in remarks else "")
            for key in COMPARED
        ]
        rows.append((name, *cells))
        reasons |= {each["kind"]: REASONS[each["kind"]] for each in remarks.values()}
    head = (
        "record",
        *(LETTERS[s] for s in SCHEMES),
        "linear, viscous only",
        "viscous + Coulomb",
        "floor",
    )
    legend = (
        "<p>Eq. (25) in %; in the paper 4 to 6 %. Linear, Coulomb and floor are fitted to the first"
        " record, the floor with the model of (15), (17) and bristle damping. Where the plant is"
        " not that model (set L0), (c) may come below it: it estimates the width of the Stribeck"
        " curve as well. Of set S, whose model is exact, the floor is only digits.</p>"
    )
    return (
        table(head, rows, range(1, 7))
        + legend
        + "".join(f"<p>{text}</p>" for text in reasons.values())
    )


def _figure(about: PrintedFigure, svg: str) -> str:
    rows = (
        ("In the paper", about.shows),
        ("Known of it", about.known),
        ("Not in its text", about.unknown),
        ("Here", HERE[about.number]),
    )
    facts = "".join(f"<dt>{name}</dt><dd>{escape(text)}</dd>" for name, text in rows)
    title = f"Figure {about.number}: {about.title}"
    return f"<h2>{escape(title)}</h2><dl>{facts}</dl>{figure(title, svg, '')}"


def _estimates(content: Mapping[str, Any]) -> str:
    found, rows = content["estimates"]["S"], []
    for name in ("alpha2", "b", "sigma0", "sigma1", "sigma2", "c"):
        printed = PRINTED[name]
        truth = next(
            (
                each[name]
                for each in found.values()
                if name in each and each[name]["true"] is not None
            ),
            None,
        )
        cells = [
            _final(found[scheme].get(name), content["step2_start_s"][scheme], printed.place)
            for scheme in SCHEMES
        ]
        rows.append(
            (
                f"<i>{GREEK[name]}</i>",
                _unbroken(printed.place),
                number(printed.values[0]),
                number(truth and truth["true"]),
                unit(truth["unit"]) if truth else "",
                *cells,
            )
        )
    head = (
        "",
        "place",
        "printed",
        "truth of set S",
        "its unit",
        *(LETTERS[scheme] for scheme in SCHEMES),
    )
    when = " to ".join(f"{value:g}" for value in PRINTED["converged"].values)
    return (
        table(head, rows, (2, 3))
        + "<p>Set S, order 1: estimate at the end, its error, and the time after which the error"
        " stays within 5 % (of step 2 of (a) from its start). The paper says that all parameters"
        f" of step 2 converge at {when} s; it has no truth to compare with.</p>"
    )


def _final(e: Mapping[str, Any] | None, begin: float, place: str) -> str:
    if e is None or e["last"] is None or not math.isfinite(e["last"]):
        return "none"
    if not e["valid"] or e["final"] is None:
        off = "" if e["true"] is None else f"{number(100.0 * (e['last'] / e['true'] - 1.0), 2)} %, "
        return f'{number(e["last"], 4)}<div class="sub">{off}not valid</div>'
    settled = e["settling_s"]
    own = begin if place == "Fig. 5" else 0.0
    when = (
        "never"
        if settled is None or not math.isfinite(settled)
        else f"{number(max(settled - own, 0.0), 3)} s"
    )
    return (
        f'{number(e["final"], 4)}<div class="sub">{number(e["error_percent"], 2)} %, {when}</div>'
    )


def _settings(content: Mapping[str, Any]) -> str:
    rows = []
    for key, found in content["gains"].items():
        printed = PRINTED[key]
        cells = [
            (
                FROM_RECORD
                if key == "vc" and found[scheme] == [0.0]
                else _several(found[scheme]) or UNUSED
            )
            for scheme in SCHEMES
        ]
        rows.append(
            (
                escape(printed.meaning),
                _unbroken(printed.place),
                _several(printed.values),
                unit(GAIN_UNITS[key]),
                *cells,
            )
        )
    head = ("", "place", "printed", "unit", *(LETTERS[scheme] for scheme in SCHEMES))
    heuristic = number(content["vc_heuristic_deg_s"], 3)
    return (
        table(head, rows)
        + "<p>The paper's heuristic for the gate, the lowest speed at which a step of the input"
        f" ends in uniform motion, proposes {heuristic} deg/s on set S, not 50 deg/s"
        " (<code>bristle run vc_heuristic</code>). Gains without a unit hold for one choice of"
        " units only; those of (a) are in degrees, those of (b) in radians.</p>"
    )


def _several(values: Sequence[float] | None) -> str:
    return ", ".join(number(value) for value in values) if values else ""


def _remark3(content: Mapping[str, Any]) -> str:
    facts = content["remark3"]
    low, high = facts["interval"]
    rows = []
    for row in facts["c"]:
        cells = [
            f"{number(row[name], 4)}{_inside(row[name], low, high)}" for name in (*SCHEMES, "floor")
        ]
        rows.append((_unbroken(f"order {row['order']}"), *cells))
    head = ("set L0", *(LETTERS[scheme] for scheme in SCHEMES), "floor")
    return (
        "<p>The authors found by simulation that a good c lies between 1/(a0 + a1) and 1/a0. For"
        f" set L0 that is {number(low)} to {number(high)} 1/rad.</p>"
        + table(head, rows, range(1, 5))
    )


def _inside(value: float | None, low: float, high: float) -> str:
    if value is None:
        return ""
    return f'<div class="sub">{"inside" if low < value < high else "outside"}</div>'


def _printed() -> str:
    rows = [
        (
            escape(each.meaning),
            _several(each.values),
            unit(each.unit),
            _unbroken(each.place),
            ORIGINS[each.origin],
            escape(each.note),
        )
        for each in PRINTED.values()
    ]
    return (
        table(("", "printed", "unit", "place", "known from", "remark"), rows)
        + "<p>What is known of the paper here is its text. No curve was digitised: levels read by"
        " eye are those at which curves end.</p>"
    )


def _runs(content: Mapping[str, Any]) -> str:
    rows = []
    for run in content["runs"]:
        own = "".join(f" --set {escape(each)}" for each in run["overrides"])
        command = f"<code>bristle run {escape(run['scenario'])}{own} --out out</code>"
        passed = sum(check["pass"] for check in run["checks"])
        shown = f"{passed} of {len(run['checks'])}" if run["order"] == 1 else "–"
        rows.append((_record_name(run), SCHEMES[run["scheme"]], command, shown))
    plants = " and ".join(f"set {name}" for name in TEST_PLANTS)
    return (
        table(
            (
                "record",
                "scheme",
                "the same with signals and figures of its own",
                "checks that pass",
            ),
            rows,
        )
        + "<p>The checks of a scenario hold for its own record, order 1; they give the verdict of"
        f" this page. The records of {plants} are the same for all schemes: an observer acts on"
        " nothing.</p>"
    )
