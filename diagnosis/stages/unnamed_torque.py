"""Unnamed torques: what the catalogue leaves unexplained, fitted and judged on segments that took
no part in the fit.
"""

from __future__ import annotations

from dataclasses import replace

from bristle.diagnosis.answer import (
    LEAST_FALL,
    Diagnosis,
    Finding,
    Reason,
    TorqueCurve,
    UnnamedTorque,
    finding,
)
from bristle.diagnosis.estimation.likelihood import mean_square
from bristle.diagnosis.localisation.torque_curve import fitted_curve
from bristle.diagnosis.selection.effect_size import fall_in_all
from bristle.diagnosis.stages.case import Budget, SearchedCase

MOST_CURVES = 2  # variables that an unexplained residual is taken for a sum of functions of


def unnamed_torque(case: SearchedCase, answer: Diagnosis, _: Budget) -> Diagnosis:
    """Return an answer with the residual that is left as a function of one variable, or as a sum of
    functions of two; as it is where nothing much is left, or bounds must be widened first.
    """
    if not answer.remains.flag or answer.corrections:
        return answer
    return replace(answer, unnamed=torque_of(case))


def torque_of(case: SearchedCase) -> UnnamedTorque:
    """Return the functions that each lower the error on held-out segments as an effect must."""
    dataset, model = case.dataset, case.final
    curves: list[TorqueCurve] = []
    refused: tuple[TorqueCurve, float] | None = None
    while len(curves) < MOST_CURVES and (more := fitted_curve(dataset, model)) is not None:
        # by how much the error falls, with and without bounds on the influence of segments
        whole = [mean_square(each.fit, dataset.held_out) for each in (model, more.fitted)]
        falls = min(fall_in_all(more.before, more.after), whole[0] / max(whole[1], 1e-300))
        if falls < LEAST_FALL:
            refused = more.curve, falls
            break
        curves.append(more.curve)
        model = more.fitted
    before, after = (mean_square(each.fit, dataset.held_out) for each in (case.final, model))
    shown = tuple(curves) or ((refused[0],) if refused else ())
    values = {name: float(x) for name, x in model.fit.values.items()} if curves else {}
    why = None if curves else _refusal(refused)
    return UnnamedTorque(shown, before, after, case.model.output_unit, values, why)


def _refusal(refused: tuple[TorqueCurve, float] | None) -> Finding:
    """Return why nothing is offered."""
    if refused is None:
        return finding(Reason.NO_FUNCTION)
    variable, factor = refused[0].variable, refused[1]
    if factor <= 1.0:
        return finding(Reason.FUNCTION_NO_BETTER, variable=variable)
    return finding(Reason.FUNCTION_TOO_WEAK, variable=variable, factor=factor, asked=LEAST_FALL)
