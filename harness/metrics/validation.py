"""Validation on a second record: the observer's model in open loop, beside fitted baselines and the
best-fit floor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bristle.common.signals import Array
from bristle.fmus.host import Fmu, Value
from bristle.harness.metrics.fit import LEAN_PARAMETERS, Data, LeanFit, LeanModel, fit
from bristle.harness.scenario.plan import RunSetup

# What each lean model (with J = 1 kg.m2) needs to know: its parameter -> the observer's estimate.
MODEL_PARAMETERS = {
    "modified": {
        "b": "b",
        "a2": "alpha2",
        "modified.sigma0": "sigma0",
        "modified.sigma1": "sigma1",
        "modified.sigma2": "sigma2",
        "modified.c": "c",
        "modified.tau": "tau",
        "modified.width": "width",
    },
    "coulomb": {"b": "b", "a2": "alpha2", "coulomb.Fc": "Fc"},
    "viscous": {"b": "b", "a2": "alpha2"},
}
NOMINAL = {"tau": 0.0, "width": 1.0}  # what counts where the observer has no estimate of it
# name of each baseline: law that is fitted
BASELINES = {"linear": "viscous", "coulomb": "coulomb", "floor": "modified"}


@dataclass
class Identified:
    """The lean model that an observer's estimates make, or why they make none."""

    law: str | None
    parameters: dict[str, float] = field(default_factory=dict)
    problem: str | None = None


@dataclass
class ModelValidation:
    """All models on the second record."""

    time: Array
    measured: Array
    voltage: Array
    predictions: dict[str, Array]
    identified: Identified
    fits: dict[str, LeanFit]
    scores: dict[str, float]

    def as_dict(self, seed: int) -> dict[str, Any]:
        """Return what goes into result.json."""
        mse = self.scores.get("model", math.nan)
        out: dict[str, Any] = {
            "mse_percent": mse,
            "seed": seed,
            "duration_s": float(self.time[-1]),
            "rms_velocity": float(np.std(self.measured)),
            "model": {
                "law": self.identified.law,
                "parameters": self.identified.parameters,
                "problem": self.identified.problem,
            },
        }
        for name in BASELINES:
            if name in self.scores:
                out[f"{name}_mse_percent"] = self.scores[name]
        out |= {
            f"mse_over_{name}": _ratio(mse, self.scores[name])
            for name in BASELINES
            if name in self.scores
        }
        # the fitted models that these are compared with
        out["fits"] = {
            name: {
                "law": f.model,
                "parameters": f.parameters,
                "identification_mse_percent": f.mse_percent,
                "at_bound": f.at_bound,
                "runs": f.runs,
            }
            for name, f in self.fits.items()
        }
        return out


def _ratio(above: float, below: float) -> float:
    return above / below if below > 0 else math.nan


def identified_model(
    estimates: Mapping[str, Mapping[str, Any]], known: Mapping[str, float], fmus: Mapping[str, Fmu]
) -> Identified:
    """Choose the richest lean model that the estimates at the end determine.

    `known` are parameters that the observer is given instead of estimating them (alpha2, b of a
    step 2 alone).
    """
    # what is known at the end
    have = dict(known) | {
        name: e["final"]
        for name, e in estimates.items()
        if e["valid"] and math.isfinite(e["final"])
    }
    # the richest law first; one whose parameters nothing gives is left out
    for law, names in MODEL_PARAMETERS.items():
        missing = [name for name in names.values() if name not in have and name not in NOMINAL]
        if missing:
            continue
        values = {
            parameter: have[name] if name in have else NOMINAL[name]
            for parameter, name in names.items()
        }
        for parameter, value in values.items():
            low, high = fmus[law].interval(parameter)
            if not low <= value <= high:
                return Identified(
                    law,
                    values,
                    f"{parameter} = {value:g} is outside [{low:g}, {high:g}]: no such model can be"
                    " simulated",
                )
        return Identified(law, values)
    return Identified(
        None,
        {},
        "the estimates at the end do not determine a model (alpha2 and b are needed at least)",
    )


def given_parameters(setup: RunSetup, final: Mapping[str, Value]) -> dict[str, float]:
    """Return the alpha2 and b that the observer's method has as parameters."""
    observer, method = setup.fmus["observer"], setup.scenario.observer.method
    out = {}
    for name in ("alpha2", "b"):
        parameter = f"{method}.{name}"
        if observer.has(parameter, "parameter"):
            out[name] = float(final.get(parameter, observer.start(parameter)))
    return out


def identification_data(setup: RunSetup, u: Array, theta: Array, v: Array) -> Data:
    """Return the identification record as the observer read it: velocity, or increments."""
    increments = (
        setup.samples.measured == ("theta",)
        if setup.samples
        else setup.scenario.sensor == "encoder"
    )
    return Data(u, v, setup.h, increments, v_start=float(v[0]) if setup.samples else 0.0)


def lean_fmus() -> dict[str, Fmu]:
    """Return the lean plant FMUs, native ones, whatever kind the scenario runs."""
    from bristle.fmus import obtain

    return {law: Fmu(obtain("plant", law=law, encoder=False)) for law in MODEL_PARAMETERS}


def validate(
    identification: Data,
    second: Data,
    identified: Identified,
    fmus: Mapping[str, Fmu],
    baselines: bool,
) -> ModelValidation:
    """Fit the baselines to the identification record and score all models on the second one.

    Parameters
    ----------
    identification : Data
        The record the observer ran on.
    second : Data
        The record on which the models are compared: voltage and velocity of the plant.
    identified : Identified
        The observer's model.
    fmus : mapping of str to Fmu
        The lean FMUs by law.
    baselines : bool
        Whether to fit the baselines and the best-fit floor.
    """
    wanted: dict[str, list[str]] = {}
    for name, law in BASELINES.items():
        if baselines:
            wanted.setdefault(law, []).append(name)
    result = ModelValidation(
        np.asarray(np.arange(len(second.y)) * second.h),
        second.y,
        second.u,
        {},
        identified,
        {},
        {"model": math.nan},
    )
    for law, names in wanted.items():
        with LeanModel(law, fmus[law]) as model:
            for name in names:
                result.fits[name] = fit(model, identification)
                result.scores[name], result.predictions[name] = model.score(
                    second, result.fits[name].parameters
                )
    if identified.law is not None and identified.problem is None:
        result.scores["model"], result.predictions["model"] = score(second, identified, fmus)
    return result


def score(data: Data, identified: Identified, fmus: Mapping[str, Fmu]) -> tuple[float, Array]:
    """Return eq. (25) and the prediction of an identified model that has a law and no problem."""
    law, parameters = str(identified.law), identified.parameters
    fixed = {name: value for name, value in parameters.items() if name not in LEAN_PARAMETERS[law]}
    with LeanModel(law, fmus[law], fixed) as model:
        return model.score(data, parameters)
