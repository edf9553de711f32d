"""The runs of the paper: each scheme on each record, and the friction curves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bristle.common.drawing import thin
from bristle.common.signals import Array
from bristle.common.units import quantity
from bristle.common.work import TemporaryFolder
from bristle.harness.metrics.fit import Data
from bristle.harness.metrics.friction_curve import friction_curve
from bristle.harness.metrics.validation import (
    MODEL_PARAMETERS,
    given_parameters,
    identified_model,
    score,
)
from bristle.harness.paper.printed_numbers import PRINTED
from bristle.harness.paper.schemes import (
    BASELINE_SCHEME,
    FILTER_ORDERS,
    GAINS,
    SCHEMES,
    TEST_PLANTS,
    Key,
    Prediction,
    Remark,
    SchemeCase,
)
from bristle.harness.run.checked import Checked, RunOptions
from bristle.harness.run.outcome import Outcome, outcome
from bristle.harness.run.run import build_and_check
from bristle.harness.scenario.catalogue import find_scenario
from bristle.harness.scenario.plan import RunSetup
from bristle.harness.scenario.reading import load

STEP1_ESTIMATES = ("alpha2", "b", "Fc")
# factor on stiffness and 1/distance: the level stays, and friction follows it a thousand times
# sooner
STIFFER = 1e3


def run_scenario(
    path: Path, overrides: Sequence[str], say: Callable[[str], None] = lambda text: None
) -> tuple[Checked, Outcome]:
    """Run a scenario as `bristle run` does, without its files."""

    def stage(name: str, _done: int, _total: int) -> None:
        say(f"{path.stem}: {name}")

    with TemporaryFolder("check") as folder:  # checked for its place, never written
        checked = build_and_check(path, Path(folder), RunOptions(overrides=overrides), stage)
        return checked, outcome(checked, stage)


def scenario_path(scheme: str, plant: str) -> Path:
    """Return the scenario file of a scheme on a plant."""
    return find_scenario(Path("reproduce") / f"{scheme}{TEST_PLANTS[plant]}")


def _shortened(path: Path, share: float) -> list[str]:
    """Return the overrides that shorten a scenario to a share of its lengths."""
    if share == 1.0:
        return []
    scenario = load(path).scenario
    lengths = {"duration": scenario.duration or 0.0}
    if scenario.validation is not None:
        lengths["validation.duration"] = scenario.validation.duration
    for name, given in scenario.observer.parameters.items():
        if name.endswith((".step2_start", ".longest_wait")):
            lengths[f"observer.parameters.{name}"] = quantity(str(given), "s")
    return [f"{name}={round(share * seconds, 3)} s" for name, seconds in lengths.items()]


def case_of(key: Key, share: float, say: Callable[[str], None], second: Data | None) -> SchemeCase:
    path, order = scenario_path(key.scheme, key.plant), key.order
    own = [] if order == FILTER_ORDERS[0] else [f"controller.parameters.order={order}"]
    checked, run_outcome = run_scenario(
        path, [*own, *_shortened(path, share)], lambda text: say(f"order {order}, {text}")
    )
    setup, view, validated = checked.setup, run_outcome.view, run_outcome.validated
    # the second record, on which all schemes are scored
    if second is None and validated is not None:
        second = Data(validated.voltage, validated.measured, setup.h)
    # what the figures show of both records
    window, kept = _inside(view.time, "reference_window", share), thin(len(view.time), 3000)
    measured: Array = np.zeros(0) if second is None else second.y
    seconds: Array = np.asarray(np.arange(len(measured)) * setup.h)
    shown = _inside(seconds, "validation_window", share)
    prediction = _predicted(checked, run_outcome, second)
    predictions = (
        {}
        if validated is None
        else {name: values[shown] for name, values in validated.predictions.items()}
    )
    if prediction.velocity is not None:
        predictions["model"] = prediction.velocity[shown]
    # all that is kept of the run; curves are thinned
    published = {name: course.hat for name, course in view.published.items()}
    return SchemeCase(
        key,
        run_outcome.result,
        path,
        str(setup.scenario.observer.method),
        setup.values["plant"],
        _parameter(setup, "step2_start") or 0.0,
        view.time[kept],
        {name: hat[kept] for name, hat in published.items()},
        {name: float(hat[-1]) for name, hat in published.items()},
        view.time[window],
        view.signals["reference"][window],
        second,
        seconds[shown],
        measured[shown],
        predictions,
        replace(prediction, velocity=None),
        {name: _all_parameters(setup, parameters) for name, parameters in GAINS.items()},
    )


def _predicted(checked: Checked, run_outcome: Outcome, second: Data | None) -> Prediction:
    """Score what an observer published last, as the paper does, whether the observer itself trusts
    it or not.

    Where these numbers make no model that can be simulated, what step 1 found (alpha2, b, Fc) is
    scored alone.
    """
    setup, estimates, failed = (
        checked.setup,
        run_outcome.result["estimates"],
        run_outcome.result.get("diverged"),
    )
    last = {
        name: {"valid": True, "final": float(course.hat[-1])}
        for name, course in run_outcome.view.published.items()
    }
    # what was published last makes a model, or step 1 alone does
    known = given_parameters(setup, setup.values["observer"])
    model, remark = identified_model(last, known, checked.lean), None
    if failed is not None or model.problem is not None:
        why = (
            model.problem
            if failed is None
            else f"diverged at {failed['time_s']:.4g} s: {failed['message']}"
        )
        remark = Remark("step1", str(why))
        model = identified_model(
            {name: last[name] for name in STEP1_ESTIMATES if name in last}, known, checked.lean
        )
    elif not all(
        estimates.get(name, {}).get("valid")
        for name in MODEL_PARAMETERS[str(model.law)].values()
        if name in last
    ):
        remark = Remark("invalid", "the observer calls these estimates not valid")
    if model.law is None or model.problem is not None or second is None:
        return Prediction(remark=Remark("none", str(model.problem or "there is no second record")))
    # the model on the second record
    mse, velocity = score(second, model, checked.lean)
    return Prediction(
        model.law, model.parameters, mse if math.isfinite(mse) else None, velocity, remark
    )


def _inside(times: Array, key: str, share: float) -> NDArray[np.intp]:
    """Return the rows in a time window of the paper."""
    first, last = (share * value for value in PRINTED[key].values)
    return np.flatnonzero((times >= first - 1e-9) & (times <= last + 1e-9))


def _parameter(setup: RunSetup, name: str) -> float | None:
    """Return a parameter of the observer's method, None if it has none of this name."""
    key, fmu = f"{setup.scenario.observer.method}.{name}", setup.fmus["observer"]
    if not fmu.has(key, "parameter"):
        return None
    return float(setup.values["observer"].get(key, fmu.start(key)))


def _all_parameters(setup: RunSetup, names: Sequence[str]) -> list[float] | None:
    values = [value for name in names if (value := _parameter(setup, name)) is not None]
    return values if len(values) == len(names) else None


def curves_of(cases: Mapping[Key, SchemeCase]) -> dict[str, tuple[Array, Array]]:
    """Return the friction curves of Fig. 1: the original law's, and what each scheme found."""
    first = FILTER_ORDERS[0]
    lugre = cases[Key(BASELINE_SCHEME, "L0", first)].values
    inertia = float(lugre["J"])
    stiff = {
        "lugre.sigma0": STIFFER * float(lugre["lugre.sigma0"]) / inertia,
        "lugre.vs": float(lugre["lugre.vs"]),
    }
    stiff |= {name: float(lugre[name]) / inertia for name in ("lugre.Fc", "lugre.Fs")}
    curves = {"plant": friction_curve("lugre", stiff)}
    for scheme in SCHEMES:
        model = cases[Key(scheme, "L0", first)].model
        if model.law == "modified":
            curves[scheme] = friction_curve("modified", stiffer(model.parameters))
    return curves


def stiffer(parameters: Mapping[str, float]) -> dict[str, float]:
    """Return the friction of an identified model with a presliding distance that is next to
    nothing.

    Source: dixit2008 eq. (18): the level depends on sigma_i / c alone.
    """
    own = {
        name: value
        for name, value in parameters.items()
        if name.startswith("modified.") and name != "modified.tau"
    }
    return {
        name: value if name == "modified.width" else STIFFER * value for name, value in own.items()
    }
