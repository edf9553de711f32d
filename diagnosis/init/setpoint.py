"""A model of a servo that was given a goal: all torques relative to an inertia of 1."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bristle.common.errors import BristleError
from bristle.diagnosis.answer import Finding, Reason, Rough, finding
from bristle.diagnosis.checks.preparation import dataset_of, slides_of
from bristle.diagnosis.following.controller import controllers
from bristle.diagnosis.modelfile import Model
from bristle.plant.controller import CONTROLLER
from bristle.plant.servo import J
from bristle.records.layout import Layout
from bristle.records.record import Record

WIDEST = 1e6  # of what friction may be where nothing is known of it, per unit of inertia
ROUGHLY = 5.0  # a parameter may move by this factor


def relative_to_inertia(
    layout: Layout, records: Sequence[Record]
) -> tuple[dict[str, Rough], Mapping[str, float], list[Finding]]:
    """Return rough parameters, those of the controller, and what had to be assumed.

    Raise `BristleError` where too little of the motion slides.
    """
    blank = Model(
        friction="coulomb",
        parameters={J.name: 1.0, "a2": 0.0, "coulomb.Fc": 0.0},
        bounds={
            J.name: (1.0 / ROUGHLY, ROUGHLY),
            "a2": (0.0, WIDEST),
            "coulomb.Fc": (0.0, WIDEST),
        },
        effects={CONTROLLER.name: {}},
        **vars(layout),
    )
    slides = slides_of(dataset_of(blank, records))
    known = next(iter(controllers(blank, slides)), blank)
    fit = slides(known)
    if fit is None or not known.controller:
        raise BristleError(
            "too little motion in these records to find the controller; record steps of several"
            " sizes and slow motion"
        )
    rough, errors = {J.name: Rough(1.0, None, 1.0 / ROUGHLY, ROUGHLY)}, fit.deviations()
    for name in ("a2", "coulomb.Fc"):
        value, error = fit.values[name], errors[name]
        most = ROUGHLY * max(value, 2.0 * error)
        rough[name.rpartition(".")[2]] = Rough(_short(value), _short(error), 0.0, _short(most))
    return rough, known.controller, [finding(Reason.SETPOINT_INPUT, column=layout.input.column)]


def _short(value: float) -> float:
    return float(f"{value:.3g}")
