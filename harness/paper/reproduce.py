"""The paper's Figures 1 and 3 to 6 and the numbers of its section IV: as printed, as repaired, by
the best observer.

Everything comes from scenario files that are shipped (`scenarios/reproduce`), run as `bristle run`
runs them.
"""

from __future__ import annotations

import hashlib
import math
import shlex
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bristle.common.drawing import thin
from bristle.common.output import check_no_folder, output_folder, plain, replace_files, to_json
from bristle.common.provenance import provenance
from bristle.common.units import quantity
from bristle.common.work import TemporaryFolder
from bristle.fmus.host import Fmu
from bristle.harness.cosim.loop import Drive
from bristle.harness.metrics.fit import Data
from bristle.harness.metrics.validation import (
    MODEL_PARAMETERS,
    given_parameters,
    identified_model,
    score,
)
from bristle.harness.paper.printed_numbers import PAPER, PRINTED
from bristle.harness.run.run import Checked, Options, Outcome, check, outcome
from bristle.harness.scenario.catalogue import find_scenario
from bristle.harness.scenario.plan import Setup
from bristle.harness.scenario.scenario import load

Array = NDArray[np.float64]
Tell = Callable[[str, float], None]  # what is done now, share that is done

SCHEMES = {"printed": "as printed", "repaired": "as repaired", "best": "best observer"}
LETTERS = {
    scheme: f"({letter}) {title}"
    for letter, (scheme, title) in zip("abc", SCHEMES.items(), strict=True)
}
TEST_PLANTS = {"S": "", "L0": "_lugre"}  # set: suffix of the scenario files
# sections of the low-pass that makes the reference: the paper leaves open how many
FILTER_ORDERS = (1, 2)
BASELINE_SCHEME = "repaired"  # whose scenarios fit the baselines: all schemes have the same records
GAINS = {
    "vc": ("vc",),
    "c1": ("c1",),
    "gamma": ("gamma1", "gamma2", "gamma3"),
    "k0": ("k1", "k2"),
    "lambda": ("lam",),
}
STEP1_ESTIMATES = ("alpha2", "b", "Fc")
HEURISTIC = "vc_heuristic"  # the scenario of section IV-B
# columns of the table of eq. (25)
COMPARED = ("printed", "repaired", "best", "linear", "coulomb", "floor")

# rad/s: speed from which a plant coasts down for its friction curve
CURVE_SPEED = math.radians(120.0)
PUSH, PUSH_RATE = 0.2, 40.0  # s and rad/s2: how it is brought there, at most
# factor on stiffness and 1/distance: the level stays, and friction follows it a thousand times
# sooner
STIFFER = 1e3
SLOWEST = math.radians(1.0)  # rad/s: below, a curve is not drawn

REPRODUCE_FILES = (
    "reproduce.json",
    "report.html",
    *(f"figure_{n}.svg" for n in (1, 3, 4, 5, 6)),
    "eq25.svg",
)


@dataclass(frozen=True)
class Remark:
    """What has to be known of a score: step1 (only its estimates are scored), invalid (so the
    observer says), none (no score).
    """

    kind: str
    text: str


@dataclass(frozen=True)
class Prediction:
    """The model that the last published estimates make, on the second record."""

    law: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    mse_percent: float | None = None
    velocity: Array | None = None
    remark: Remark | None = None


class Key(NamedTuple):
    """Which scheme on which record."""

    scheme: str
    plant: str
    order: int


@dataclass
class Case:
    """A scheme on a record: what of it the page shows. Arrays have shape (n,), in SI units."""

    key: Key
    result: dict[str, Any]
    source: Path
    method: str
    values: Mapping[str, Any]  # start values of the plant
    begin: float  # s: when step 2 starts, 0 if all parameters are estimated at once
    time: Array
    hats: Mapping[str, Array]
    last: Mapping[str, float]  # the estimates published last
    sample_time: Array  # of the reference, in the window of Fig. 3
    reference: Array
    second: Data | None  # the second record
    validation_time: Array  # in the window of Fig. 6
    measured: Array
    predictions: Mapping[str, Array]
    model: Prediction
    gains: Mapping[str, list[float] | None] = field(default_factory=dict)


@dataclass
class Comparison:
    """Everything on the page."""

    cases: dict[Key, Case]
    # velocity and level of friction over inertia of L0: the plant's and the schemes'
    curves: dict[str, tuple[Array, Array]]
    content: dict[str, Any]  # reproduce.json
    share: float = 1.0

    def window(self, key: str) -> tuple[float, float]:
        """Return a time window of the paper, shortened as the runs are."""
        first, last = PRINTED[key].values
        return first * self.share, last * self.share


def reproduce(out: Path, tell: Tell | None = None, *, share: float = 1.0) -> dict[str, Any]:
    """Make the page and write it into `out` with its figures and reproduce.json: all files or none.

    Parameters
    ----------
    out : Path
        The folder; created if it is missing.
    tell : callable, optional
        Called with what is done now and the share that is done.
    share : float
        Share of the paper's durations that is simulated; tests shorten it.

    Returns
    -------
    dict
        The content of reproduce.json.

    Raises
    ------
    BristleError
        One line; nothing is written then.
    """
    from bristle.harness.paper.reproduce_figures import draw
    from bristle.harness.paper.reproduce_page import render

    say, begin = tell or (lambda text, done: None), time.perf_counter()
    with output_folder(out):
        check_no_folder(out, REPRODUCE_FILES)
        found = compute(say, share)
        found.content["provenance"] = {
            **provenance(),
            "command": shlex.join(["bristle", "reproduce", "--out", str(out)]),
        }
        found.content["wall_s"] = round(time.perf_counter() - begin, 2)
        say("report", 0.97)
        figures = draw(found)
        content = plain(found.content)
        files = {"reproduce.json": to_json(content), "report.html": render(content, figures)}
        files |= {f"{name}.svg": svg for name, svg in figures.items()}
        replace_files(out, {name: text.encode() for name, text in files.items()}, REPRODUCE_FILES)
    return dict(content)


def compute(say: Tell, share: float = 1.0) -> Comparison:
    """Run all scenarios and return what the page shows."""
    # it comes first: all are scored on its second record
    schemes = sorted(SCHEMES, key=lambda scheme: scheme != BASELINE_SCHEME)
    wanted = [
        Key(scheme, plant, order)
        for plant in TEST_PLANTS
        for order in FILTER_ORDERS
        for scheme in schemes
    ]
    cases: dict[Key, Case] = {}
    for k, key in enumerate(wanted):

        def tell(text: str, share_done: float = k / (len(wanted) + 1)) -> None:
            say(text, share_done)

        baseline = cases.get(Key(BASELINE_SCHEME, key.plant, key.order))
        cases[key] = _case(key, share, tell, None if baseline is None else baseline.second)
    say("gate", len(wanted) / (len(wanted) + 1))
    heuristic = _run(find_scenario(Path(HEURISTIC)), ())[1].result["estimates"]["vc"]["final"]
    curves = _curves(cases)
    return Comparison(cases, curves, _content(cases, heuristic, share), share)


# -- runs ------------------------------------------------------------------------------------------


def _run(
    path: Path, overrides: Sequence[str], say: Callable[[str], None] = lambda text: None
) -> tuple[Checked, Outcome]:
    """Run a scenario as `bristle run` does, without its files."""

    def stage(name: str, _done: int, _total: int) -> None:
        say(f"{path.stem}: {name}")

    with TemporaryFolder("check") as folder:  # checked for its place, never written
        checked = check(path, Path(folder), Options(overrides=overrides), stage)
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


def _case(key: Key, share: float, say: Callable[[str], None], second: Data | None) -> Case:
    path, order = scenario_path(key.scheme, key.plant), key.order
    own = [] if order == FILTER_ORDERS[0] else [f"controller.parameters.order={order}"]
    checked, found = _run(
        path, [*own, *_shortened(path, share)], lambda text: say(f"order {order}, {text}")
    )
    setup, view, validated = checked.setup, found.view, found.validated
    if second is None and validated is not None:
        second = Data(validated.voltage, validated.measured, setup.h)
    window, kept = _inside(view.time, "reference_window", share), thin(len(view.time), 3000)
    measured: Array = np.zeros(0) if second is None else second.y
    seconds: Array = np.asarray(np.arange(len(measured)) * setup.h)
    shown = _inside(seconds, "validation_window", share)
    prediction = _predicted(checked, found, second)
    predictions = (
        {}
        if validated is None
        else {name: values[shown] for name, values in validated.predictions.items()}
    )
    if prediction.velocity is not None:
        predictions["model"] = prediction.velocity[shown]
    published = {name: course.hat for name, course in view.published.items()}
    return Case(
        key,
        found.result,
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


def _predicted(checked: Checked, found: Outcome, second: Data | None) -> Prediction:
    """Score what an observer published last, as the paper does, whether the observer itself trusts
    it or not.

    Where these numbers make no model that can be simulated, what step 1 found (alpha2, b, Fc) is
    scored alone.
    """
    setup, estimates, failed = (
        checked.setup,
        found.result["estimates"],
        found.result.get("diverged"),
    )
    last = {
        name: {"valid": True, "final": float(course.hat[-1])}
        for name, course in found.view.published.items()
    }
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
    mse, velocity = score(second, model, checked.lean)
    return Prediction(
        model.law, model.parameters, mse if math.isfinite(mse) else None, velocity, remark
    )


def _inside(times: Array, key: str, share: float) -> NDArray[np.intp]:
    """Return the rows in a time window of the paper."""
    first, last = (share * value for value in PRINTED[key].values)
    return np.flatnonzero((times >= first - 1e-9) & (times <= last + 1e-9))


def _parameter(setup: Setup, name: str) -> float | None:
    """Return a parameter of the observer's method, None if it has none of this name."""
    key, fmu = f"{setup.scenario.observer.method}.{name}", setup.fmus["observer"]
    if not fmu.has(key, "parameter"):
        return None
    return float(setup.values["observer"].get(key, fmu.start(key)))


def _all_parameters(setup: Setup, names: Sequence[str]) -> list[float] | None:
    found = [value for name in names if (value := _parameter(setup, name)) is not None]
    return found if len(found) == len(names) else None


# -- Figure 1 --------------------------------------------------------------------------------------


def _curves(cases: Mapping[Key, Case]) -> dict[str, tuple[Array, Array]]:
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


def friction_curve(law: str, parameters: Mapping[str, float]) -> tuple[Array, Array]:
    """Return velocity and level of friction of a plant that coasts down, the fastest first.

    Parameters
    ----------
    law : str
        Law of a lean plant FMU, which has J = 1 kg.m2 and b = 1 N.m/V.
    parameters : mapping of str to float
        Those of the law.

    Returns
    -------
    velocity, level : ndarray, shape (n,)
        rad/s and rad/s2; both are empty if the plant does not get to speed.
    """
    from bristle.fmus import obtain

    h = 1e-3
    values = {"J": 1.0, "b": 1.0, "a2": 0.0, "u_max": 1e6, **parameters}
    push = np.full(round(PUSH / h), PUSH_RATE)
    drive = Drive(Fmu(obtain("plant", law=law, encoder=False)), ["u"], ["v", "F"], list(values))
    try:
        [pushed] = drive.run(push[:, None], np.array([[*values.values()]]), h)
        count = int(np.argmax(pushed[:, 0] > CURVE_SPEED))
        series = np.concatenate([push[:count], np.zeros(round(2.0 / h))])
        [found] = drive.run(series[:, None], np.array([[*values.values()]]), h)
    finally:
        drive.close()
    v, level = found[count + 2 :].T
    end = int(np.argmax(~(v > SLOWEST))) if np.any(~(v > SLOWEST)) else len(v)
    return v[:end], level[:end]


# -- numbers ---------------------------------------------------------------------------------------


def _content(cases: Mapping[Key, Case], heuristic: float, share: float) -> dict[str, Any]:
    """Return reproduce.json."""
    first = FILTER_ORDERS[0]
    order_shown = [
        Key(scheme, plant, order)
        for plant in TEST_PLANTS
        for order in FILTER_ORDERS
        for scheme in SCHEMES
    ]
    runs = [_run_entry(cases[key]) for key in order_shown]
    judged = [case.result for key, case in cases.items() if key.order == first]
    content: dict[str, Any] = {
        "verdict": "pass" if all(result["verdict"] == "pass" for result in judged) else "fail",
        "paper": PAPER,
        "share": share,
        "printed": {key: _printed_entry(key) for key in PRINTED},
        "estimates": {
            plant: {scheme: _estimates(cases[Key(scheme, plant, first)]) for scheme in SCHEMES}
            for plant in TEST_PLANTS
        },
        "step2_start_s": {scheme: cases[Key(scheme, "S", first)].begin for scheme in SCHEMES},
        "methods": {scheme: cases[Key(scheme, "S", first)].method for scheme in SCHEMES},
        "gains": {
            key: {scheme: _gain(cases[Key(scheme, "S", first)], key) for scheme in SCHEMES}
            for key in GAINS
        },
        "vc_heuristic_deg_s": math.degrees(heuristic),
        "eq25": [_eq25(cases, plant, order) for plant in TEST_PLANTS for order in FILTER_ORDERS],
        "remark3": _remark3(cases),
        "runs": runs,
    }
    return content


def _printed_entry(key: str) -> dict[str, Any]:
    each = PRINTED[key]
    value = each.values[0] if len(each.values) == 1 else list(each.values)
    return {
        "value": value,
        "unit": each.unit,
        "meaning": each.meaning,
        "place": each.place,
        "origin": each.origin,
        "note": each.note,
    }


def _estimates(case: Case) -> dict[str, Any]:
    kept = ("unit", "true", "final", "valid", "error_percent", "settling_s")
    return {
        name: {key: e[key] for key in kept} | {"last": case.last.get(name)}
        for name, e in case.result["estimates"].items()
    }


def _gain(case: Case, key: str) -> list[float] | None:
    """Return gains in the printed unit."""
    found = case.gains[key]
    return [math.degrees(value) for value in found] if found and key == "vc" else found


def _run_entry(case: Case) -> dict[str, Any]:
    return {
        **case.key._asdict(),
        "scenario": f"reproduce/{case.source.stem}",
        "scenario_sha256": hashlib.sha256(case.source.read_bytes()).hexdigest(),
        "overrides": case.result["overrides"],
        "verdict": case.result["verdict"],
        "diverged": case.result.get("diverged"),
        "checks": case.result["checks"],
    }


def _eq25(cases: Mapping[Key, Case], plant: str, order: int) -> dict[str, Any]:
    """Return eq. (25) of all models on the validation record of a plant and an order, and why one
    has none.
    """
    row: dict[str, Any] = {"plant": plant, "order": order} | dict.fromkeys(COMPARED)
    for scheme in SCHEMES:
        row[scheme] = cases[Key(scheme, plant, order)].model.mse_percent
    fitted = cases[Key(BASELINE_SCHEME, plant, order)].result.get("validation")
    if fitted is not None:
        row |= {name: fitted[f"{name}_mse_percent"] for name in ("linear", "coulomb", "floor")}
        row["rms_velocity"] = fitted["rms_velocity"]
    remarks = {scheme: cases[Key(scheme, plant, order)].model.remark for scheme in SCHEMES}
    return row | {
        "remarks": {
            scheme: vars(remark) for scheme, remark in remarks.items() if remark is not None
        }
    }


def _remark3(cases: Mapping[Key, Case]) -> dict[str, Any]:
    """Return the interval of c of remark 3 for L0, 1/(a0 + a1) < c < 1/a0, and the c of the fits
    and the schemes.

    Source: dixit2008 section III remark 3 and eq. (10).
    """
    plant = cases[Key(BASELINE_SCHEME, "L0", FILTER_ORDERS[0])].values
    stiffness, low, high = (float(plant[f"lugre.{name}"]) for name in ("sigma0", "Fs", "Fc"))
    found = []
    for order in FILTER_ORDERS:
        row: dict[str, Any] = {"order": order}
        for scheme in SCHEMES:
            case = cases[Key(scheme, "L0", order)]
            row[scheme] = None if "diverged" in case.result else case.last.get("c")
        fits = cases[Key(BASELINE_SCHEME, "L0", order)].result.get("validation", {}).get("fits", {})
        row["floor"] = fits["floor"]["parameters"]["modified.c"] if "floor" in fits else None
        found.append(row)
    return {
        "plant": "L0",
        "unit": "1/rad",
        "interval": [stiffness / low, stiffness / high],
        "c": found,
    }
