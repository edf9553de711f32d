"""report.html: one self-contained file that an engineer reads from top to bottom."""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape
from typing import Any

from bristle.common.html import badge, beside, figure, identifier, number, page, table, tally, unit
from bristle.harness.metrics.estimates import SIGNS, check_unit

GREEK = {
    "alpha2": "α<sub>2</sub>",
    "b": "b",
    "Fc": "F<sub>c</sub>",
    "sigma0": "σ<sub>0</sub>",
    "sigma1": "σ<sub>1</sub>",
    "sigma2": "σ<sub>2</sub>",
    "c": "c",
    "tau": "τ",
    "a0": "a<sub>0</sub>",
    "a1": "a<sub>1</sub>",
    "v0": "v<sub>0</sub>",
}
BANDS = (
    "Light blue: ±2 standard deviations, if the observer gives any. Grey and dashed: not valid. "
    "The vertical axis does not show the largest initial excursions."
)
LAST_SECONDS = "In print, and where scripts do not run: at most the last ten seconds."
ERRORS = (
    "Errors and changes in percent of the true value. Settled: the last time at which the error"
    " exceeds 5 %; never, if it exceeds it at the end."
)
CAPTIONS = {
    "estimates": (
        "Estimates over time",
        "Blue: estimate. Dashed: true value, with its ±5 % band in green. Dotted green: the last"
        " time the error leaves the band. Above each: final error and that time. " + BANDS,
    ),
    "signals": ("Signals", f"The whole run. {LAST_SECONDS}"),
    "tracking": (
        "Tracking with compensation and without",
        (
            "Velocity and its difference from the reference, in this run and in one in which"
            f" nothing of the observer reaches the controller. {LAST_SECONDS}"
        ),
    ),
    "friction": (
        "Friction curve",
        "Friction over inertia against velocity, viscous part included, late in the run.",
    ),
    "validation": (
        "Validation on a second record",
        (
            "Open loop from rest: the models get the voltage only. Below: the errors of "
            f"all models. {LAST_SECONDS}"
        ),
    ),
    "models": (
        "Errors of the models on the second record",
        "Eq. (25), 100 var(error)/var(velocity).",
    ),
}
RECORD_CAPTIONS = {  # of a measured record, of which the true values are not known
    "estimates": ("Estimates over time", f"Blue: estimate. {BANDS}"),
    "signals": ("Signals", f"The whole record. {LAST_SECONDS}"),
    "friction": (
        "Friction curve",
        (
            "Friction over inertia against velocity as the observer estimates them, viscous part"
            " included, late in the record."
        ),
    ),
}


def _finite(value: object) -> float | None:
    return (
        float(value)
        if isinstance(value, (int, float)) and math.isfinite(value) and value > 0
        else None
    )


def _verdict(passed: bool) -> str:
    return badge("good", "pass") if passed else badge("bad", "fail")


def _checks(result: Mapping[str, Any]) -> str:
    rows = []
    for check in result["checks"]:
        name = identifier(check["name"])
        if check["name"] != check["quantity"]:
            name += f'<div class="sub">{identifier(check["quantity"])}</div>'
        limit = f"{SIGNS[check['kind']]} {number(check['limit'])}"
        shown_unit = unit(check_unit(result, check["quantity"])) or "–"
        rows.append((name, number(check["value"]), limit, shown_unit, _verdict(check["pass"])))
    return table(("check", "value", "limit", "unit", ""), rows, (1, 2))


def _named(name: str, meanings: Mapping[str, str]) -> str:
    """Return the symbol of an estimate and what it means, in the words of the observer's FMU."""
    meaning = meanings.get(name, "").removeprefix("estimate of ")
    return f"<i>{GREEK.get(name, escape(name))}</i>" + (
        f'<div class="sub">{escape(meaning)}</div>' if meaning else ""
    )


def _estimates(result: Mapping[str, Any], meanings: Mapping[str, str]) -> str:
    """Return the table of the estimates; on a record, of which no true value is known, without
    errors.
    """
    if not result["estimates"]:
        return "<p>The observer gave no estimate.</p>"
    errors = (
        ()
        if "record" in result
        else ("true", "error, %", "settled after, s", "largest change from the first value, %")
    )
    rows = []
    for name, e in result["estimates"].items():
        state = (
            badge("good", "valid")
            if e["valid"]
            else badge("bad", "not valid" if e["adapted"] else "not adapted")
        )
        cells = [
            _named(name, meanings),
            state,
            unit(e["unit"]) or "1",
            number(e["final"], 5),
            number(e["sd"], 2),
        ]
        rows.append(
            cells
            + (
                [
                    number(e["true"]),
                    number(e["error_percent"], 3),
                    _settled(e),
                    number(e["moved_percent"], 3),
                ]
                if errors
                else []
            )
        )
    head = ("parameter", "", "unit", "final", "standard deviation", *errors)
    legend = f'<p class="sub">{ERRORS}</p>' if errors else ""
    return _innovation(result) + table(head, rows, (3, 4, 5, 6, 7, 8)) + legend


def _settled(estimate: Mapping[str, Any]) -> str:
    if estimate["error_percent"] is None:
        return "–"
    settled = estimate["settling_s"]
    return number(settled, 3) if settled is not None and math.isfinite(settled) else "never"


def _innovation(result: Mapping[str, Any]) -> str:
    """Return what the observer says of itself as a whole."""
    if not result["adapted"]:
        return '<p class="alarm">The observer says that it has not adapted since the start.</p>'
    if result["innovation"] is None:
        return ""
    text = (
        "Recent mean squared innovation relative to the value that the observer expects (1 where"
        " its model is right)"
    )
    return f"<p>{text}: {number(result['innovation'], 3)}.</p>"


def _states(result: Mapping[str, Any], meanings: Mapping[str, str]) -> str:
    states = result.get("states") or {}
    if not states:
        return ""
    rows = [
        (
            _named(n, meanings),
            unit(s["unit"]),
            number(s["rms"], 3),
            number(s["late_rms"], 3),
            number(s["late_percent"], 3),
        )
        for n, s in states.items()
    ]
    legend = (
        "Late: rms error in the last tenth of the run, and in percent of the standard deviation of"
        " the state."
    )
    head = ("state", "unit", "rms error", "late", "late, %")
    return (
        "<h2>State estimates</h2>" + table(head, rows, (2, 3, 4)) + f'<p class="sub">{legend}</p>'
    )


def _validation(result: Mapping[str, Any]) -> str:
    found = result.get("validation")
    if not found:
        return ""
    model, facts = found["model"], []
    if model["problem"]:
        facts.append(f"The observer's model could not be simulated: {escape(model['problem'])}.")
    elif model["law"]:
        left = number(found["mse_percent"], 3)
        facts.append(
            f"The estimates make a <b>{escape(model['law'])}</b> model that leaves {left} % of the"
            " variance."
        )
    for key, text in (
        ("coulomb", "the fitted viscous + Coulomb model"),
        ("linear", "the fitted viscous model"),
    ):
        ratio = _finite(found.get(f"mse_over_{key}"))
        if ratio is not None:
            better = ratio <= 1
            facts.append(
                f"It is {number(1 / ratio if better else ratio, 3)} times"
                f" {'better' if better else 'worse'} than {text}."
            )
    floor = _finite(found.get("mse_over_floor"))
    if floor is not None and found["floor_mse_percent"] > 1e-6:  # below, the floor is only digits
        facts.append(
            f"Its error is {number(floor, 3)} times the best-fit floor, the error of a modified"
            " LuGre model fitted directly."
        )
    stuck = [f"{n} of the {k} fit" for k, f in found.get("fits", {}).items() for n in f["at_bound"]]
    if stuck:
        facts.append(f"At a bound: {escape(', '.join(stuck))}.")
    return f"<p>{' '.join(facts)}</p>"


def _figures(result: Mapping[str, Any], figures: Mapping[str, str]) -> str:
    parts = []
    for name, svg in figures.items():
        title, caption = (RECORD_CAPTIONS if "record" in result else CAPTIONS)[name]
        extra = _validation(result) if name == "validation" else ""
        parts.append(f"<h2>{escape(title)}</h2>{extra}{figure(title, svg, caption)}")
    return "".join(parts)


def _times(result: Mapping[str, Any]) -> str:
    timing = result["timing"]
    total = sum(timing.values()) or 1.0
    rows = [
        (
            escape(name),
            f"{seconds:.2f}",
            f'<div class="bar" style="width:{160 * seconds / total:.0f}px"></div>',
        )
        for name, seconds in timing.items()
    ]
    return table(("stage", "s", ""), [*rows, ("<b>total</b>", f"<b>{total:.2f}</b>", "")], (1,))


def _participants(result: Mapping[str, Any]) -> str:
    found = dict(result["fmus"])
    if "record" in result:
        found["record"] = {"fmi": "", "kind": "measured", **result["record"]}
    rows = [
        (name, escape(f["file"]), f["fmi"], f["kind"], f'<code class="sub">{f["sha256"]}</code>')
        for name, f in found.items()
    ]
    return table(("part", "file", "FMI", "kind", "sha256"), rows)


def _provenance(result: Mapping[str, Any]) -> str:
    """Return version, date, platform, seed, and the command that repeats the run in the folder it
    ran in.
    """
    found = result["provenance"]
    keys = (
        ("version", "version"),
        ("date", "date"),
        ("platform", "platform"),
        ("seed", "seed of the reference"),
        ("folder", "folder"),
    )
    rows = [
        f"<dt>{text}</dt><dd>{escape(str(found[key]))}</dd>"
        for key, text in keys
        if found[key] is not None
    ]
    rows.append(f"<dt>command</dt><dd><code>{escape(found['command'])}</code></dd>")
    rows.append(
        "<dt>sha256 of the scenario</dt><dd><code"
        f' class="sub">{found["scenario_sha256"]}</code></dd>'
    )
    return f"<dl>{''.join(rows)}</dl>"


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
    notes = "".join(f'<p class="alarm">{escape(note)}</p>' for note in result.get("notes", []))
    about_rows = "".join(
        f"<dt>{key}</dt><dd>{escape(about[key])}</dd>"
        for key in ("source", "limits")
        if about.get(key)
    )
    overrides = result.get("overrides") or []
    changed = (
        f"<p>Overridden on the command line: <code>{escape('  '.join(overrides))}</code></p>"
        if overrides
        else ""
    )
    title = about.get("title") or result["scenario"]
    steps = f"{result['steps']:,}".replace(",", "\u202f")
    done = (
        f"{result['duration_s']:g} s measured, {steps} samples"
        if "record" in result
        else f"{result['duration_s']:g} s simulated in {steps} steps"
    )
    simulated = f"{done}; the whole run took {result['wall_s']:.1f} s"
    held = sum(bool(check["pass"]) for check in result["checks"])
    data = beside(["signals.csv", "result.json", *(f"{name}.svg" for name in figures)])
    body = f"""<header><p class="tally">{tally(held, len(result["checks"]), "checks")}</p>
<p class="name">{escape(result["scenario"])}</p>
<h1>{escape(title)} {_verdict(result["verdict"] == "pass")}</h1>
<p class="lead">{escape(about.get("shows", ""))}</p><p class="sub">{simulated}</p>{data}</header>
{notes}
<h2>Verdict</h2>{_checks(result)}
<h2>Estimates</h2>{_estimates(result, meanings)}
{_states(result, meanings)}
{_figures(result, figures)}
<h2>About this scenario</h2><dl>{about_rows}</dl>{changed}
<details><summary>The scenario file</summary><pre>{escape(source)}</pre></details>
<h2>Where the time went</h2>{_times(result)}
<h2>What took part</h2>{_participants(result)}
<h2>Where it comes from</h2>{_provenance(result)}"""
    return page(f"{result['scenario']}: {result['verdict']}", body)
