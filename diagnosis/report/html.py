"""report.html of a diagnosis: one self-contained file for the engineer at the rig, the answer
first.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any
from urllib.parse import quote

import numpy as np

from bristle.common.html import badge, beside, figure, number, page, table, unit
from bristle.diagnosis.answer import (
    CERTAIN_P,
    LISTED_VIEW_P,
    MIN_SHARE,
    SENSOR_VIEWS,
    CandidateEffect,
    Diagnosis,
    Estimate,
    Named,
)
from bristle.diagnosis.report.figures.of_diagnosis import as_given, captions, improved
from bristle.diagnosis.report.figures.whole_records import whole_table
from bristle.diagnosis.report.headline import headline, mark
from bristle.diagnosis.report.text.names import (
    NATS,
    OUTLIER_NOTE,
    effect_name,
    effects_listed,
    listed,
    rounded,
    view_name,
)
from bristle.diagnosis.report.text.said import said as words_of
from bristle.diagnosis.report.text.statement import unexplained_line, unnamed_line
from bristle.plant.effects import effects as all_effects
from bristle.plant.wording import Wording

EXCITATION = {  # key of the excitation -> words; the others read as they are
    "input_range": "input",
    "input_between_samples": "input between samples",
    "speed_dominant_tone_share": "share of the strongest tone in the speed",
    "inertia_share": "mean torque of the inertia over that of the input",
    "input_bandwidth": "bandwidth of the input",
    "speed_range": "speed",
    "range_travelled": "range of positions",
    "path_travelled": "path",
    "turns_travelled": "turns spanned",
    "rest_share": "time at rest",
    "slow_share": "time in slow motion",
    "forward_share": "time forward",
    "backward_share": "time backward",
    "torque_range": "torque of the drive",
}


def interval(value: float, low: float, high: float) -> str:
    """Write a value with its interval, to two figures of its half width: 0.0600 ± 0.0018, or with
    both ends if lopsided.
    """
    found = rounded(value, low, high)
    if found is None:
        return number(value)
    texts, power = found
    mid, below, above, spread = (text.replace("-", "−") for text in texts)
    lopsided = abs(high + low - 2 * value) > 0.1 * (high - low)
    text = (
        f'{mid} <span class="sub">[{below} … {above}]</span>' if lopsided else f"{mid} ± {spread}"
    )
    return text if power == 0 else f"({text})·10<sup>{power}</sup>".replace("-", "−")


# -- tables ----------------------------------------------------------------------------------------
class _Writer:
    """Writes effects and estimates in the words of an axis."""

    def __init__(self, wording: Wording) -> None:
        self.wording, self.known = wording, all_effects(wording)

    def estimate(self, e: Estimate | None) -> str:
        """Write value, interval and, where it ended there, the bound."""
        if e is None:
            return "–"
        text = number(e.value) if e.ci95 is None else interval(e.value, *e.ci95)
        return text + (f" {badge('bad', 'at its bound')}" if e.at_bound else "")

    def name(self, effect: str) -> str:
        """Write an effect in words, with its identifier."""
        return f"<b>{escape(effect_name(effect, self.wording))}</b>"

    def effects(self, effects: Iterable[Named]) -> str:
        """Return the table of named effects, a line for each parameter."""
        rows = []
        for effect in effects:
            known = self.known[effect.name]
            meaning = (
                ""
                if known.description == known.title
                else f'<div class="sub">{escape(known.description)}</div>'
            )
            facts = f"gain {number(effect.gain, 3)} nats, p ≤ {number(effect.p, 2)}"
            first = f'{self.name(effect.name)}{meaning}<div class="sub">{facts}</div>'
            rows += self.parameters(effect.name, first, effect.parameters)
        text = table(("effect", "parameter", "value, 95 % interval", "unit"), rows) if rows else ""
        return (
            f'<p class="sub">Gains in nats ({NATS}); p: probability of as much by chance.</p>'
            if rows
            else ""
        ) + text

    def parameters(
        self, name: str, first: str, parameters: Mapping[str, Estimate]
    ) -> list[tuple[str, ...]]:
        meanings = {p.name: p.description for p in self.known[name].parameters}
        rows: list[tuple[str, ...]] = []
        for k, (key, e) in enumerate(parameters.items()):
            meaning = meanings.get(f"{name}.{key}", "")
            label = f'{escape(key)}<div class="sub">{escape(meaning)}</div>'
            rows.append((first if k == 0 else "", label, self.estimate(e), unit(e.unit) or "–"))
        return rows or [(first, "", "", "")]

    def base(self, diagnosis: Diagnosis, choose: str | None) -> str:
        """Return the model's parameters: nominal, refitted, refitted with the effects."""
        nominal = diagnosis.model.values
        columns = {"refitted without effects": diagnosis.base} if diagnosis.base else {}
        if diagnosis.effects:
            columns["with " + listed([e.name for e in diagnosis.effects], "and")] = (
                diagnosis.parameters
            )
        if diagnosis.whole is not None and diagnosis.whole.refitted:
            columns["of the segments, before the refit to whole records"] = (
                diagnosis.whole.segment_parameters
            )
        for name, found in diagnosis.choice_parameters.items():
            columns[f"with {name}" + (" (chosen)" if name == choose else "")] = found
        units = {name: diagnosis.model.unit(name) for name in nominal}
        units |= {name: e.unit for column in columns.values() for name, e in column.items()}
        rows = []
        for name in dict.fromkeys([*nominal, *units]):
            fitted = [
                self.estimate(column[name]) if name in column else "not fitted"
                for column in columns.values()
            ]
            rows.append(
                (escape(name), unit(units[name]) or "–", number(nominal.get(name)), *fitted)
            )
        return table(("parameter", "unit", "nominal", *map(escape, columns)), rows, (2,))


# -- sections --------------------------------------------------------------------------------------
def _section(title: str, body: str) -> str:
    return f"<h2>{escape(title)}</h2>{body}" if body else ""


def _items(lines: Iterable[str]) -> str:
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f"<ul>{items}</ul>" if items else ""


def _proposals(diagnosis: Diagnosis) -> str:
    if not diagnosis.proposals:
        return ""
    return (
        '<div class="alarm"><b>Correct this first, then diagnose'
        f" again:</b>{_items(diagnosis.proposals)}</div>"
    )


def _tie(diagnosis: Diagnosis, writer: _Writer, choose: str | None) -> str:
    if not diagnosis.ties:
        return ""
    sets = [escape(effects_listed(tie, "or", writer.wording)) for tie in diagnosis.ties]
    parts = [f"<p>Any one of these explains the records equally well: {each}.</p>" for each in sets]
    if diagnosis.choices:
        rows = [
            row
            for name, found in diagnosis.choices.items()
            for row in writer.parameters(name, writer.name(name), found)
        ]
        parts.append(table(("with", "parameter", "value, 95 % interval", "unit"), rows))
    if choose is not None:
        parts.append(f"<p>Chosen by hand for the augmented model: {writer.name(choose)}.</p>")
    elif diagnosis.verdict == "tie":
        parts.append(
            "<p>No augmented model was written: choose one of them with <code>--choose NAME</code>"
            " to get it.</p>"
        )
    return "".join(parts)


def _gap_facts(diagnosis: Diagnosis) -> str:
    gap, facts = diagnosis.gap, []
    if as_given(diagnosis):
        return ""
    if improved(diagnosis) and gap.after >= gap.before:
        return f"<p>On held-out segments the error did not fall: {OUTLIER_NOTE}.</p>"
    # an unexplained residual is partly taken for noise
    most, least = ("at most ", "at least ") if diagnosis.remains.predictable else ("", "")
    if gap.shrink is not None and improved(diagnosis):
        closed = (
            gap.noise_floor is not None
            and gap.after <= gap.noise_floor
            and not diagnosis.remains.predictable
        )
        rest = ", down to what disturbance and sensor noise alone account for" if closed else ""
        facts.append(
            "The mean squared error above the noise floor shrank by"
            f" {most}<b>{100 * gap.shrink:.1f} %</b>{rest}."
        )
    if gap.ratio is None:
        facts.append(
            "The noise floor, which disturbance and sensor noise alone would leave, is not known."
        )
    elif improved(diagnosis) or gap.ratio > 1:
        begin = (
            "Before, the mean squared error was"
            if improved(diagnosis)
            else "The mean squared error is"
        )
        facts.append(f"{begin} {least}{number(gap.ratio, 3)} times the noise floor.")
    elif not diagnosis.remains.flag:
        facts.append("The error is no larger than disturbance and sensor noise alone account for.")
    return f"<p>{' '.join(facts)}</p>"


def _whole(diagnosis: Diagnosis) -> str:
    return "" if diagnosis.whole is None else whole_table(diagnosis.whole, improved(diagnosis))


def _unexplained(diagnosis: Diagnosis) -> str:
    left = diagnosis.remains
    if diagnosis.proposals or not (left.flag or diagnosis.where):
        return ""  # nothing was searched, or it waits for wider bounds
    open_tie = bool(diagnosis.ties and not diagnosis.effects)
    if left.flag:
        line = unexplained_line(left, diagnosis.model.wording, open_tie)
        return f'<p class="alarm">{escape(line)}</p>'
    certain = [v for v in diagnosis.where if v.p_after <= CERTAIN_P]
    if not certain:
        return (
            "<p>Nothing that matters: no motion variable predicts more of the residual than chance"
            " does.</p>"
        )
    most = max(certain, key=lambda v: v.share_after)
    said = (
        f"<b>{escape(view_name(most.view))}</b> predicts {100 * most.share_after:.0f} % of the"
        " residual that is left, "
    )
    said += "every other motion variable less, or no more than chance does"
    if most.view in SENSOR_VIEWS:
        said += (
            "; in a closed loop it holds noise of the sensor, so that it is not reported as"
            " unexplained"
        )
    small = (
        "Nothing that matters"
        if most.share_after < MIN_SHARE
        else "Small beside what was explained, but more than chance"
    )
    return f"<p>{small}: {said}.</p>"


def _unnamed(diagnosis: Diagnosis) -> str:
    if diagnosis.unnamed is None:
        return ""
    line = unnamed_line(diagnosis.unnamed, diagnosis.model.wording)
    return f"<p>{escape(line[0].upper() + line[1:])}.</p>"


def _views(diagnosis: Diagnosis) -> str:
    rows = []
    for v in sorted(diagnosis.where, key=lambda v: (v.p > LISTED_VIEW_P, -v.share)):
        name = escape(view_name(v.view, v.label))
        rows.append(
            (
                name,
                f"{100 * v.share:.0f} %",
                number(v.p, 2),
                f"{100 * v.share_after:.0f} %",
                number(v.p_after, 2),
            )
        )
    kept = 5 if improved(diagnosis) else 3
    head = (
        "predicted from, or found in",
        "share before" if kept == 5 else "share",
        "p",
        "share after",
        "p",
    )
    return table(head[:kept], [row[:kept] for row in rows], (1, 2, 3, 4)) if rows else ""


def _value(value: Any) -> str:
    """Write what an excitation table holds: a number, text, a number or a range with its unit."""
    if isinstance(value, Mapping):
        ends = [value[key] for key in ("value", "lowest", "highest") if key in value]
        return f"{' … '.join(map(_value, ends))} {unit(str(value.get('unit', '1')))}".strip()
    return number(value, 3) if isinstance(value, (int, float)) else escape(str(value))


def _fact(key: str, value: Any) -> tuple[str, str]:
    """Return a line of the excitation table; shares are written in per cent."""
    share = key.endswith("_share") and isinstance(value, float)
    return escape(EXCITATION.get(key, key.replace("_", " "))), (
        f"{100 * value:.0f} %" if share else _value(value)
    )


def _excitation(diagnosis: Diagnosis) -> str:
    excitation = diagnosis.excitation
    rows = [
        _fact(key, value) for key, value in excitation.items() if key != "caveats" and value != ""
    ]
    return (table(("of the records", ""), rows) if rows else "") + _items(excitation["caveats"])


def _undetected(diagnosis: Diagnosis) -> str:
    wording = diagnosis.model.wording
    rows = [
        (escape(effect_name(name, wording)), escape(text))
        for name, text in diagnosis.undetected.items()
    ]
    return table(("effect", "what would have been detected"), rows) if rows else ""


def _rounds(diagnosis: Diagnosis) -> str:
    rows = []
    for k, each in enumerate(diagnosis.rounds, start=1):
        best = max(
            (c for c in each.candidates if math.isfinite(c.gain)),
            key=lambda c: c.gain,
            default=None,
        )
        rows.append(
            (
                str(k),
                _best(best, diagnosis.model.wording),
                number(each.null_level, 3),
                number(each.p, 2),
                escape(words_of(each.decision)),
            )
        )
    return (
        table(
            ("round", "best candidate", "gain that chance may give, nats", "p ≤", "decision"),
            rows,
            (2, 3),
        )
        if rows
        else ""
    )


def _best(candidate: CandidateEffect | None, wording: Wording) -> str:
    if candidate is None:
        return "–"
    return (
        f'{escape(effect_name(candidate.name, wording))}<div class="sub">gain'
        f" {number(candidate.gain, 3)} nats</div>"
    )


def _files(files: Mapping[str, str]) -> str:
    return table(
        ("file", ""),
        [
            (f'<a href="{quote(name)}">{escape(name)}</a>', escape(text))
            for name, text in files.items()
        ],
    )


def _records(diagnosis: Diagnosis) -> str:
    return (
        "; ".join(f"{t.name} ({number(float(np.ptp(t.time)), 3)} s)" for t in diagnosis.traces)
        or "records that contradict the model"
    )


def render(
    diagnosis: Diagnosis,
    figures: Mapping[str, str],
    files: Mapping[str, str],
    notes: Sequence[str] = (),
    choose: str | None = None,
) -> str:
    """Return the page.

    `figures` holds SVG text by name, from `figures.draw`; `files` what was written, name and
    meaning; `notes` what could not be written, and why; `choose` is a member of a tie that was
    chosen by hand.
    """
    writer = _Writer(diagnosis.model.wording)
    words = captions(diagnosis)
    drawn = {name: figure(words[name][0], text, words[name][1]) for name, text in figures.items()}
    lead = "".join(f'<p class="lead">{escape(line)}</p>' for line in diagnosis.statement)
    alarms = _proposals(diagnosis) + "".join(
        f'<p class="alarm">{escape(note)}</p>' for note in notes
    )
    following = _section(
        "What to measure next",
        f"<p>{escape(diagnosis.experiment)}</p>" if diagnosis.experiment else "",
    )
    others = [name for name in files if name != "report.html"]
    data = beside(others) if others else ""
    settled = diagnosis.verdict in ("named", "none")  # else what to measure next is the answer
    parts = [
        (
            '<header><p class="name">diagnosis of'
            f" {escape(_records(diagnosis))}</p><h1>{escape(headline(diagnosis))}"
            f' {badge(*mark(diagnosis))}</h1>{lead}<p class="sub">the diagnosis took'
            f" {diagnosis.seconds:.0f} s</p>{data}</header>{alarms}"
        ),
        _section("What is missing", writer.effects(diagnosis.effects)),
        _section("What fits equally well", _tie(diagnosis, writer, choose)),
        "" if settled else following,
        _section(words["gap"][0], _gap_facts(diagnosis) + drawn.get("gap", "")),
        _section(
            words["open_loop"][0],
            _whole(diagnosis) + drawn.get("open_loop", "") + drawn.get("horizons", ""),
        ),
        _section(words["overlay"][0], drawn.get("overlay", "")),
        _section(words["maps"][0], drawn.get("maps", "") + _views(diagnosis)),
        _section(words["candidates"][0], drawn.get("candidates", "")),
        _section(
            "Unexplained residual",
            _unexplained(diagnosis) + _unnamed(diagnosis) + drawn.get("unnamed", ""),
        ),
        following if settled else "",
        _section("What the records excite", _excitation(diagnosis)),
        _section("Findings", _items(diagnosis.findings)),
        _section("The model's own parameters", writer.base(diagnosis, choose)),
        _section(
            "Effects that were not found, and what size would have been detected",
            _undetected(diagnosis),
        ),
        _section("The search", _rounds(diagnosis)),
        _section("Files", _files(files)),
    ]
    return page(f"diagnosis: {diagnosis.verdict}", "\n".join(part for part in parts if part))
