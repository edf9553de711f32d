"""report.html of a diagnosis: one self-contained file for the engineer, the answer first."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from bristle.common import pages
from bristle.common.pages import number
from bristle.diagnosis.answer import (
    CERTAIN_P,
    LISTED_VIEW_P,
    MIN_SHARE,
    SENSOR_VIEWS,
    Diagnosis,
    Estimate,
    Round,
)
from bristle.diagnosis.report.figures.of_diagnosis import as_given, captions, improved
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


def render(
    diagnosis: Diagnosis,
    figures: Mapping[str, str],
    files: Mapping[str, str],
    notes: Sequence[str] = (),
    choose: str | None = None,
    absent: Mapping[str, str] | None = None,
) -> str:
    """Return the page.

    `figures` holds SVG text by name, from `figures.draw`; `files` what was written, name and
    meaning; `notes` what could not be written, and why; `choose` is a member of a tie that was
    chosen by hand; `absent` holds files that this answer has not, and why.
    """
    return pages.render(
        "bristle.diagnosis.report/report.html",
        diagnosis=diagnosis,
        heading=headline(diagnosis),
        mark=mark(diagnosis),
        records=_records(diagnosis),
        settled=diagnosis.verdict in ("named", "none"),
        improved=improved(diagnosis),
        as_given=as_given(diagnosis),
        figures=figures,
        words=captions(diagnosis),
        files=files,
        absent=absent or {},
        others=[name for name in files if name != "report.html"],
        notes=notes,
        nats=NATS,
        outlier_note=OUTLIER_NOTE,
        interval=interval,
        view_name=view_name,
        **_effects(diagnosis, choose),
        **_residual(diagnosis),
        **_model(diagnosis, choose),
    )


def interval(value: float, low: float, high: float) -> Markup:
    """Write a value with its interval, to two figures of its half width: 0.0600 ± 0.0018, or with
    both ends if lopsided.
    """
    texts_and_power = rounded(value, low, high)
    if texts_and_power is None:
        return number(value)
    texts, power = texts_and_power
    mid, below, above, spread = (text.replace("-", "−") for text in texts)
    lopsided = abs(high + low - 2 * value) > 0.1 * (high - low)
    text = (
        f'{mid} <span class="sub">[{below} … {above}]</span>' if lopsided else f"{mid} ± {spread}"
    )
    shown = text if power == 0 else f"({text})·10<sup>{power}</sup>".replace("-", "−")
    return Markup(shown)


def _records(diagnosis: Diagnosis) -> str:
    said = (f"{each.name} ({np.ptp(each.time):.3g} s)" for each in diagnosis.traces)
    return "; ".join(said) or "records that contradict the model"


def _effects(diagnosis: Diagnosis, choose: str | None) -> dict[str, Any]:
    """Return what the page says of effects: named, tied, chosen, tried and not found."""
    wording = diagnosis.model.wording
    known = all_effects(wording)

    def described(name: str, parameters: Mapping[str, Estimate]) -> dict[str, Any]:
        meanings = {p.name: p.description for p in known[name].parameters}
        about = known[name]
        return {
            "title": effect_name(name, wording),
            "meaning": "" if about.description == about.title else about.description,
            "parameters": [
                {"name": key, "meaning": meanings.get(f"{name}.{key}", ""), "estimate": e}
                for key, e in parameters.items()
            ],
        }

    return {
        "effects": [
            described(each.name, each.parameters) | {"gain": each.gain, "p": each.p}
            for each in diagnosis.effects
        ],
        "suspects": [
            described(each.name, each.parameters) | {"gain": each.gain, "p": each.p}
            for each in diagnosis.suspects
        ],
        "doubts": [words_of(doubt) for doubt in diagnosis.doubts],
        "ties": [effects_listed(tie, "or", wording) for tie in diagnosis.ties],
        "choices": [described(name, choice) for name, choice in diagnosis.choices.items()],
        "chosen": None if choose is None else effect_name(choose, wording),
        "undetected": {
            effect_name(name, wording): text for name, text in diagnosis.undetected.items()
        },
        "rounds": [_round(each, wording) for each in diagnosis.rounds],
    }


def _round(search_round: Round, wording: Wording) -> dict[str, Any]:
    tried = (each for each in search_round.candidates if math.isfinite(each.gain))
    best = max(tried, key=lambda each: each.gain, default=None)
    return {
        "best": None if best is None else effect_name(best.name, wording),
        "gain": None if best is None else best.gain,
        "null_level": search_round.null_level,
        "p": search_round.p,
        "decision": words_of(search_round.decision),
    }


def _residual(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return what the page says of the residual: where it is, and what is left unexplained."""
    left, wording = diagnosis.remains, diagnosis.model.wording
    certain = [each for each in diagnosis.where if each.p_after <= CERTAIN_P]
    most = max(certain, key=lambda each: each.share_after, default=None)
    return {
        "views": sorted(diagnosis.where, key=lambda v: (v.p > LISTED_VIEW_P, -v.share)),
        "unexplained_line": unexplained_line(
            left, wording, bool(diagnosis.ties and not diagnosis.found)
        )
        if left.flag
        else "",
        "most_predicted": most,
        "small": most is not None and most.share_after < MIN_SHARE,
        "of_sensor": most is not None and most.view in SENSOR_VIEWS,
        "unnamed": "" if diagnosis.unnamed is None else unnamed_line(diagnosis.unnamed, wording),
    }


def _model(diagnosis: Diagnosis, choose: str | None) -> dict[str, Any]:
    """Return what the page says of the model's own parameters and of what the records excite."""
    columns = {"refitted without effects": diagnosis.base} if diagnosis.base else {}
    if diagnosis.found:
        names = listed([each.name for each in diagnosis.found], "and")
        columns[f"with {names}"] = diagnosis.parameters
    if diagnosis.whole is not None and diagnosis.whole.refitted:
        before = "of the segments, before the refit to whole records"
        columns[before] = diagnosis.whole.segment_parameters
    for name, estimates in diagnosis.choice_parameters.items():
        columns[f"with {name}" + (" (chosen)" if name == choose else "")] = estimates
    units = {name: diagnosis.model.unit(name) for name in diagnosis.model.values}
    units |= {name: e.unit for column in columns.values() for name, e in column.items()}
    excited = {key: each for key, each in diagnosis.excitation.items() if each not in ("", [])}
    return {
        "columns": columns,
        "units": units,
        "caveats": excited.pop("caveats", ()),
        "excited": excited,
    }
