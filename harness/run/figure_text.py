"""What the figures of a run show, in numbers, for those who cannot see them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bristle.common.drawing import DEGREES
from bristle.harness.run.pictures import Pictures

MODEL_LABELS = {  # of the models that are compared
    "model": "observer's model",
    "floor": "best-fit floor: fitted 7-parameter model",
    "coulomb": "fitted viscous + Coulomb",
    "linear": "fitted viscous",
}


def seen(name: str, pictures: Pictures) -> str:
    """Return what the figure of this name shows."""
    return {
        "estimates": _estimates,
        "signals": _signals,
        "tracking": _tracking,
        "friction": _friction,
        "validation": _validation,
        "models": _models,
    }[name](pictures)


def _estimates(pictures: Pictures) -> str:
    return "; ".join(_estimate(name, pictures.estimates[name]) for name in pictures.published)


def _estimate(name: str, facts: Mapping[str, Any]) -> str:
    """Return: estimate of alpha2 settles at 51 s, ends at 2.002 1/s against a true 2."""
    last, true, settled, error = (
        facts.get(key) for key in ("final", "true", "settling_s", "error_percent")
    )
    unit = "" if facts["unit"] == "1" else f" {facts['unit']}"
    words = []
    if error is not None and math.isfinite(error):  # an error in percent of a true 0 says nothing
        known = settled is not None and math.isfinite(settled)
        words.append(f"settles at {settled:.3g} s" if known else "does not settle")
    if not facts["valid"]:
        words.append("is not valid at the end")
    elif last is not None and math.isfinite(last):
        words.append(
            f"ends at {last:.4g}{unit}" + ("" if true is None else f" against a true {true:.4g}")
        )
    return f"estimate of {name} " + ", ".join(words)


def _range(values: NDArray[np.float64], unit: str) -> str:
    finite = values[np.isfinite(values)]
    return (
        f"from {finite.min():.3g} to {finite.max():.3g} {unit}"
        if len(finite)
        else "without a finite value"
    )


def _signals(pictures: Pictures) -> str:
    signals, scale, unit = (
        pictures.signals,
        pictures.speed_scale,
        pictures.speed_label.split(", ")[1],
    )
    v = signals["v"]
    words = [f"velocity {_range(scale * v, unit)}"]
    for key, what in (("reference", "reference"), ("v_hat", "estimate of the velocity")):
        if key in signals and np.isfinite(signals[key]).any():
            words.append(f"{what} differs by {scale * _rms(signals[key] - v):.3g} {unit} rms")
    if "u" in signals:
        words.append(f"input {_range(signals['u'], pictures.rig.input)}")
    return f"over {pictures.time[-1] - pictures.time[0]:.4g} s: " + ", ".join(words)


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def _tracking(pictures: Pictures) -> str:
    tracking = pictures.tracking
    assert tracking is not None
    with_it, without = (DEGREES * _rms(error) for error in (tracking.compensated, tracking.alone))
    return (
        f"tracking error {with_it:.3g} deg/s rms with compensation, {without:.3g} deg/s rms with"
        " the controller alone"
    )


def _friction(pictures: Pictures) -> str:
    unit = f"{pictures.rig.position}/s2"
    clouds = (("plant", pictures.friction), ("observer", pictures.friction_hat))
    words = [
        f"{what}: friction {_range(cloud[1], unit)}" for what, cloud in clouds if cloud is not None
    ]
    return "; ".join(words)


def _validation(pictures: Pictures) -> str:
    validation = pictures.validation
    assert validation is not None
    errors = {
        name: DEGREES * _rms(each - validation.measured)
        for name, each in validation.predictions.items()
    }
    words = [
        f"{MODEL_LABELS[name]} is off by {error:.3g} deg/s rms"
        for name, error in errors.items()
        if math.isfinite(error)
    ]
    return f"velocity {_range(DEGREES * validation.measured, 'deg/s')}; " + ", ".join(words)


def _models(pictures: Pictures) -> str:
    assert pictures.validation is not None
    scores = pictures.validation.scores
    words = [
        f"{MODEL_LABELS[name]} {score:.3g} %"
        for name, score in scores.items()
        if math.isfinite(score)
    ]
    return "mean squared error in percent of the variance: " + ", ".join(
        words or ["no model could be scored"]
    )
