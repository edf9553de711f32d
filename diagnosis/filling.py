"""Unnamed torques: what the catalogue leaves unexplained, fitted and judged on segments that took
no part in the fit.
"""

from __future__ import annotations

import math
from dataclasses import replace

from bristle.diagnosis.conclusion import Case, Conclusion
from bristle.diagnosis.estimation.likelihood import mean_square
from bristle.diagnosis.localisation.unnamed_torque import Curve, fill
from bristle.diagnosis.report import result as answer
from bristle.diagnosis.report.text import unnamed_line, view_name
from bristle.diagnosis.selection.effect_size import LEAST_FALL, fall_in_all

MOST_CURVES = 2  # variables that an unexplained residual is taken for a sum of functions of


def unnamed_torque(case: Case, found: Conclusion) -> answer.UnnamedTorque | None:
    """Return the residual that is left as a function of one variable, or as a sum of functions of
    two.

    Each must lower the error on held-out segments by as much as an effect has to. None where
    nothing much is left, or bounds must be widened first.
    """
    if not found.remains.flag or found.proposal:
        return None
    dataset, model = case.dataset, found.final
    curves: list[Curve] = []
    refused: tuple[Curve, float] | None = None
    while len(curves) < MOST_CURVES and (filled := fill(dataset, model)) is not None:
        whole = [mean_square(each.fit, dataset.held_out) for each in (model, filled.fitted)]
        falls = min(fall_in_all(filled.before, filled.after), whole[0] / max(whole[1], 1e-300))
        if falls < LEAST_FALL:
            refused = filled.curve, falls
            break
        curves.append(filled.curve)
        model = filled.fitted
    before, after = (mean_square(each.fit, dataset.held_out) for each in (found.final, model))
    shown = tuple(curves) or ((refused[0],) if refused else ())
    values = {name: float(x) for name, x in model.fit.values.items()} if curves else {}
    return answer.UnnamedTorque(
        shown,
        bool(curves),
        before,
        after,
        case.model.output_unit,
        values,
        _reason(refused) if not curves else "",
    )


def with_unnamed_torque(
    diagnosis: answer.Diagnosis, unnamed: answer.UnnamedTorque | None
) -> answer.Diagnosis:
    """Return a diagnosis with what was found of its unexplained residual."""
    if unnamed is None:
        return diagnosis
    line = unnamed_line(unnamed, diagnosis.model.wording)
    return replace(diagnosis, unnamed=unnamed, findings=(*diagnosis.findings, line))


def _reason(refused: tuple[Curve, float] | None) -> str:
    """Return why nothing is offered."""
    if refused is None:
        return (
            "no smooth function of velocity, position, input or time predicts anything of it in"
            " segments left out of the fit"
        )
    best = f"the best function, of {view_name(refused[0].variable)},"
    if refused[1] <= 1.0:
        return f"{best} does not lower the squared error on held-out segments"
    factor = math.floor(100 * refused[1]) / 100
    return (
        f"{best} lowers the squared error on held-out segments by a factor of {factor:.2f} only,"
        f" and {LEAST_FALL:g} is asked"
    )
