"""What the figures of a run show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bristle.common.drawing import DEGREES
from bristle.harness.cosim.bus import Array
from bristle.harness.metrics.estimates import Course
from bristle.harness.metrics.tracking import Tracking
from bristle.harness.metrics.validation import (
    ModelValidation,
)
from bristle.harness.run.outcome import Outcome
from bristle.harness.scenario.rig import Rig

LATE_FRICTION = 0.25  # share of the run, at its end, that the friction curve shows


# by the unit of the position: factor and unit on the axes
SPEED_SCALES = {"rad": (DEGREES, "deg/s"), "m": (1.0, "m/s")}


@dataclass
class Pictures:
    """The data of the figures, in SI units; `measured`: they are those of a record, which nobody
    knows the truth of.
    """

    time: Array
    estimates: Mapping[str, Mapping[str, Any]]
    published: Mapping[str, Course]
    true: Mapping[str, Array]
    rig: Rig = field(default_factory=Rig)
    measured: bool = False
    signals: Mapping[str, Array] = field(default_factory=dict)
    friction: tuple[Array, Array] | None = None  # v, F/J of the plant
    friction_hat: tuple[Array, Array] | None = None
    validation: ModelValidation | None = None
    tracking: Tracking | None = None

    @property
    def step(self) -> float:
        """Time between two rows."""
        return float(self.time[1] - self.time[0]) if len(self.time) > 1 else 1.0

    @property
    def speed_scale(self) -> float:
        """Factor of a speed on the axes."""
        return SPEED_SCALES[self.rig.position][0]

    @property
    def speed_label(self) -> str:
        """Name and unit of a speed on the axes."""
        return f"velocity, {SPEED_SCALES[self.rig.position][1]}"


def pictures_of(run_outcome: Outcome) -> Pictures:
    """Return what the figures of a run show."""
    result, view = run_outcome.result, run_outcome.view
    late = slice(int((1 - LATE_FRICTION) * len(view.time)), None)
    pictures = Pictures(
        view.time,
        result["estimates"],
        view.published,
        view.true,
        rig=view.rig,
        measured="record" in result,
    )
    pictures.signals = {
        **view.signals,
        **({"v_hat": view.estimated["v"]} if "v" in view.estimated else {}),
    }
    pictures.validation, pictures.tracking = run_outcome.validated, run_outcome.tracking
    if view.friction is not None:
        pictures.friction = (view.signals["v"][late], view.friction[late])
    if {"v", "F"} <= set(view.estimated):
        v, force = view.estimated["v"][late], view.estimated["F"][late]
        if np.isfinite(force).any() and np.isfinite(v).any():
            pictures.friction_hat = (v, force)
    return pictures
