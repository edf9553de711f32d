"""The content of diagnosis.json and validation.json: numbers, sentences, and their codes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from bristle.common.output import plain
from bristle.diagnosis.answer import (
    BetweenSensors,
    CandidateEffect,
    DesignedInput,
    Diagnosis,
    Estimate,
    Excitation,
    Gap,
    Named,
    Round,
    SeenController,
    Undetected,
    Unexplained,
    UnnamedTorque,
    Validation,
    WholeRecords,
    coded,
)
from bristle.diagnosis.report.text.designed import EXPERIMENT_FILE
from bristle.diagnosis.report.text.said import said
from bristle.diagnosis.report.text.statement import not_offered


def diagnosis_content(d: Diagnosis) -> dict[str, Any]:
    """Return what diagnosis.json holds: plain numbers, lists and text, no NaN."""
    content: dict[str, Any] = plain(
        {
            "verdict": d.verdict,
            "statement": list(d.statement),
            "effects": [_effect(e) for e in d.effects],
            "suspects": [_effect(e) | {"why": [said(w) for w in d.doubts]} for e in d.suspects],
            "ties": [list(t) for t in d.ties],
            "experiment": d.experiment,
            "experiment_input": _designed(d.designed) if d.designed else None,
            **_of_residual(d),
            "agreement": {"holds": d.agreement.holds, **asdict(d.agreement)}
            if d.agreement
            else None,
            "gap": _gap(d.gap),
            "excitation": d.excitation,
            "findings": list(d.findings),
            "proposals": list(d.proposals),
            "between": _between(d.between) if d.between else None,
            "controller": _controller(d.seen_controller) if d.seen_controller else None,
            "base": _estimates(d.base),
            "parameters": _estimates(d.parameters),
            "rounds": [_round(r) for r in d.rounds],
            "undetected": d.undetected,
            "choices": {name: _estimates(chosen) for name, chosen in d.choices.items()},
            "seconds": d.seconds,
            "open_loop": [asdict(r) for r in d.whole.records] if d.whole else [],
            "whole_record": _whole(d.whole) if d.whole else None,
            "codes": _codes(d),
        }
    )
    return content


def _between(between: BetweenSensors) -> dict[str, Any]:
    parts = {name: _estimates(own) for name, own in between.parts.items()}
    errors = {"before": between.before, "after": between.after, "unit": between.unit}
    return {"parts": parts, "difference": errors}


def _controller(seen: SeenController) -> dict[str, Any]:
    facts = {"of": seen.of, "share": seen.share, "lag": seen.lag, "delay": seen.delay}
    return {"gains": _estimates(seen.gains), **facts}


def _effect(e: Named) -> dict[str, Any]:
    return {
        "name": e.name,
        "class": e.group,
        "parameters": _estimates(e.parameters),
        "gain": e.gain,
        "p": e.p,
    }


def validation_content(validation: Validation) -> dict[str, Any]:
    """Return what validation.json holds: plain numbers, lists and text, no NaN."""
    keys = ("name", "unit", "rms", "fit_percent", "mse_percent", "horizons")
    rows = [
        {key: getattr(record, key) for key in keys}
        | ({"after_start": asdict(record.after_start)} if record.after_start else {})
        for record in validation.records
    ]
    content: dict[str, Any] = plain(
        {"model": validation.name, "records": rows, "findings": list(validation.findings)}
    )
    return content


def excitation_content(excited: Excitation) -> dict[str, Any]:
    """Return what records excite, in numbers and words."""
    return {
        **excited.numbers,
        "lacks": list(excited.lacks),
        "narrow": said(excited.uniform) if excited.uniform else "",
        "caveats": [said(caveat) for caveat in excited.caveats],
    }


def _codes(d: Diagnosis) -> dict[str, Any]:
    """Return the reasons behind the sentences, with their numbers."""
    return {
        "statement": [coded(line) for line in d.leads],
        "findings": [coded(line) for line in d.notes],
        "proposals": [coded(line) for line in d.corrections],
        "uniform": coded(d.excited.uniform),
        "caveats": [coded(line) for line in d.excited.caveats],
        "hindrance": coded(d.hindrance),
        "doubts": [coded(doubt) for doubt in d.doubts],
        "unidentified": list(d.unidentified),
        "rounds": [
            {
                "outcome": r.outcome,
                "best": r.best,
                "ties": list(r.ties),
                "decision": coded(r.decision),
                "candidates": {c.name: coded(c.reason) for c in r.candidates if c.reason},
            }
            for r in d.rounds
        ],
        "undetected": {u.name: _limit_code(u) for u in d.limits},
        "where": {w.view: coded(w.label) for w in d.where if w.label},
        "unnamed_torque": coded(d.unnamed.refused) if d.unnamed else None,
        "motion": coded(d.designed.motion) if d.designed else None,
    }


def _limit_code(u: Undetected) -> dict[str, Any]:
    return {
        "reason": coded(u.reason),
        "gain": u.gain,
        "failed": coded(u.failed),
        "measurable": u.measurable,
        "confounded": list(u.confounded),
        "limit": u.limit,
        "before": u.before or None,
        "same_start": u.same_start,
    }


def _of_residual(d: Diagnosis) -> dict[str, Any]:
    keys = ("view", "share", "p", "share_after", "p_after")
    return {
        "where": [{key: getattr(w, key) for key in keys} for w in d.where],
        "remains": _remains(d.remains),
        "unnamed_torque": _unnamed(d.unnamed) if d.unnamed else None,
    }


def _remains(left: Unexplained) -> dict[str, Any]:
    return {
        "flag": left.flag,
        "view": left.view,
        "share": left.share,
        "disturbance": left.disturbance,
        "disturbed": left.disturbed,
        "label": said(left.label),
    }


def _gap(gap: Gap) -> dict[str, Any]:
    keys = ("before", "after", "noise_floor", "ratio", "shrink", "unit")
    return {key: getattr(gap, key) for key in keys}


def _round(r: Round) -> dict[str, Any]:
    return {
        "candidates": [_candidate(c) for c in r.candidates],
        "null_level": r.null_level,
        "p": r.p,
        "added": r.added,
        "decision": said(r.decision),
        "gain": r.gain,
        "size": r.assessment.error_reduction,
        "rejected": r.rejected,
    }


def _candidate(c: CandidateEffect) -> dict[str, Any]:
    a = c.assessment
    behind, doubt = a.deficit if a else (None, None)
    return {
        "name": c.name,
        "gain": c.gain,
        "level": c.level,
        "note": said(c.reason) if c.reason else "",
        "size": a.error_reduction if a else None,
        "kept": a.predictive_gain if a else None,
        "kept_error": a.gain_error if a else None,
        "behind": behind,
        "doubt": doubt,
    }


def _unnamed(torque: UnnamedTorque) -> dict[str, Any]:
    curves = [
        {"variable": c.variable, "places": c.places, "torque": c.values, "half_width": c.half_width}
        for c in torque.curves
    ]
    return {
        "offered": torque.offered,
        "reason": not_offered(torque.refused) if torque.refused else "",
        "share": torque.share,
        "rms_before": math.sqrt(torque.before),
        "rms_after": math.sqrt(torque.after),
        "functions": curves,
    }


def _designed(designed: DesignedInput) -> dict[str, Any]:
    known = {
        "file": EXPERIMENT_FILE if designed.written else None,
        "rivals": list(designed.rivals),
        "gain": designed.gain,
        "level": designed.level,
    }
    if not designed.written:
        return known
    ends = {
        "input_unit": designed.unit,
        "input_low": designed.low,
        "input_high": designed.high,
        "input_rms": designed.rms,
    }
    place = {
        "start": designed.start,
        "position_low": designed.reach[0],
        "position_high": designed.reach[1],
    }
    return {
        **known,
        "kind": "input" if designed.loop is None else "reference",
        "loop_frequency": designed.loop,
        "motion": said(designed.motion) if designed.motion else "",
        "seconds": float(designed.time[-1] - designed.time[0]),
        **ends,
        **place,
    }


def _whole(whole: WholeRecords) -> dict[str, Any]:
    return {
        "refitted": whole.refitted,
        "refitted_to": whole.refitted_to if whole.refitted else None,
        "horizons": [asdict(h) for h in whole.horizons],
        "segment_parameters": _estimates(whole.segment_parameters),
    }


def _estimates(estimates: Mapping[str, Estimate]) -> dict[str, dict[str, Any]]:
    return {name: asdict(e) for name, e in estimates.items()}
