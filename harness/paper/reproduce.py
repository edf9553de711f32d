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
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from bristle.common.output import check_no_folder, output_folder, plain, replace_files, to_json
from bristle.common.provenance import provenance
from bristle.harness.paper.cases import case_of, curves_of, run_scenario
from bristle.harness.paper.printed_numbers import PAPER, PRINTED
from bristle.harness.paper.schemes import (
    BASELINE_SCHEME,
    COMPARED,
    FILTER_ORDERS,
    GAINS,
    SCHEMES,
    TEST_PLANTS,
    Key,
    PaperComparison,
    SchemeCase,
)
from bristle.harness.scenario.catalogue import find_scenario

Tell = Callable[[str, float], None]  # what is done now, share that is done
HEURISTIC = "vc_heuristic"  # the scenario of section IV-B

REPRODUCE_FILES = (
    "reproduce.json",
    "report.html",
    *(f"figure_{n}.svg" for n in (1, 3, 4, 5, 6)),
    "eq25.svg",
)


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
    with output_folder(out, "reproduce.json"):
        check_no_folder(out, REPRODUCE_FILES)
        comparison = compute(say, share)
        comparison.content["provenance"] = {
            **provenance(),
            "command": shlex.join(["bristle", "reproduce", "--out", str(out)]),
        }
        comparison.content["wall_s"] = round(time.perf_counter() - begin, 2)
        say("report", 0.97)
        figures = draw(comparison)
        content = plain(comparison.content)
        files = {"reproduce.json": to_json(content), "report.html": render(content, figures)}
        files |= {f"{name}.svg": svg for name, svg in figures.items()}
        replace_files(out, {name: text.encode() for name, text in files.items()}, REPRODUCE_FILES)
    return dict(content)


def compute(say: Tell, share: float = 1.0) -> PaperComparison:
    """Run all scenarios and return what the page shows."""
    # it comes first: all are scored on its second record
    schemes = sorted(SCHEMES, key=lambda scheme: scheme != BASELINE_SCHEME)
    wanted = [
        Key(scheme, plant, order)
        for plant in TEST_PLANTS
        for order in FILTER_ORDERS
        for scheme in schemes
    ]
    cases: dict[Key, SchemeCase] = {}
    for k, key in enumerate(wanted):

        def tell(text: str, share_done: float = k / (len(wanted) + 1)) -> None:
            say(text, share_done)

        baseline = cases.get(Key(BASELINE_SCHEME, key.plant, key.order))
        cases[key] = case_of(key, share, tell, None if baseline is None else baseline.second)
    say("gate", len(wanted) / (len(wanted) + 1))
    _, run_outcome = run_scenario(find_scenario(Path(HEURISTIC)), ())
    heuristic = run_outcome.result["estimates"]["vc"]["final"]
    return PaperComparison(cases, curves_of(cases), _content(cases, heuristic, share), share)


# -- numbers ---------------------------------------------------------------------------------------


def _content(cases: Mapping[Key, SchemeCase], heuristic: float, share: float) -> dict[str, Any]:
    """Return reproduce.json."""
    first = FILTER_ORDERS[0]
    shown = [(plant, order) for plant in TEST_PLANTS for order in FILTER_ORDERS]
    judged = [case.result for key, case in cases.items() if key.order == first]
    # the cases of one plant by scheme: gains and methods are the same on both
    by_plant = {
        plant: {scheme: cases[Key(scheme, plant, first)] for scheme in SCHEMES}
        for plant in TEST_PLANTS
    }
    given = by_plant["S"]
    return {
        "verdict": "pass" if all(result["verdict"] == "pass" for result in judged) else "fail",
        "paper": PAPER,
        "share": share,
        "printed": {key: _printed_entry(key) for key in PRINTED},
        "estimates": {plant: _of_each(each, _estimates) for plant, each in by_plant.items()},
        "step2_start_s": _of_each(given, lambda case: case.begin),
        "methods": _of_each(given, lambda case: case.method),
        "gains": {key: _of_each(given, partial(_gain, key)) for key in GAINS},
        "vc_heuristic_deg_s": math.degrees(heuristic),
        "eq25": [_eq25(cases, plant, order) for plant, order in shown],
        "remark3": _remark3(cases),
        "runs": [
            _run_entry(cases[Key(scheme, plant, order)])
            for plant, order in shown
            for scheme in SCHEMES
        ],
    }


def _of_each(cases: Mapping[str, SchemeCase], what: Callable[[SchemeCase], Any]) -> dict[str, Any]:
    """Return something of the case of each scheme."""
    return {scheme: what(case) for scheme, case in cases.items()}


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


def _estimates(case: SchemeCase) -> dict[str, Any]:
    kept = ("unit", "true", "final", "valid", "error_percent", "settling_s")
    return {
        name: {key: e[key] for key in kept} | {"last": case.last.get(name)}
        for name, e in case.result["estimates"].items()
    }


def _gain(key: str, case: SchemeCase) -> list[float] | None:
    """Return gains in the printed unit."""
    gains = case.gains[key]
    return [math.degrees(value) for value in gains] if gains and key == "vc" else gains


def _run_entry(case: SchemeCase) -> dict[str, Any]:
    return {
        **case.key._asdict(),
        "scenario": f"reproduce/{case.source.stem}",
        "scenario_sha256": hashlib.sha256(case.source.read_bytes()).hexdigest(),
        "overrides": case.result["overrides"],
        "verdict": case.result["verdict"],
        "diverged": case.result.get("diverged"),
        "checks": case.result["checks"],
    }


def _eq25(cases: Mapping[Key, SchemeCase], plant: str, order: int) -> dict[str, Any]:
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


def _remark3(cases: Mapping[Key, SchemeCase]) -> dict[str, Any]:
    """Return the interval of c of remark 3 for L0, 1/(a0 + a1) < c < 1/a0, and the c of the fits
    and the schemes.

    Source: dixit2008 section III remark 3 and eq. (10).
    """
    plant = cases[Key(BASELINE_SCHEME, "L0", FILTER_ORDERS[0])].values
    stiffness, low, high = (float(plant[f"lugre.{name}"]) for name in ("sigma0", "Fs", "Fc"))
    rows = []
    for order in FILTER_ORDERS:
        row: dict[str, Any] = {"order": order}
        for scheme in SCHEMES:
            case = cases[Key(scheme, "L0", order)]
            row[scheme] = None if "diverged" in case.result else case.last.get("c")
        fits = cases[Key(BASELINE_SCHEME, "L0", order)].result.get("validation", {}).get("fits", {})
        row["floor"] = fits["floor"]["parameters"]["modified.c"] if "floor" in fits else None
        rows.append(row)
    return {
        "plant": "L0",
        "unit": "1/rad",
        "interval": [stiffness / low, stiffness / high],
        "c": rows,
    }
