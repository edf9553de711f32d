"""No name from outside becomes markup on a page: each template is fed with one that tries."""

import importlib.util
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bristle.common import pages
from bristle.common.drawing import Drawing
from bristle.diagnosis.answer import Undetected, ValidatedRecord, Validation
from bristle.diagnosis.report import arm_page, validation_page
from bristle.diagnosis.report import html as diagnosis_page
from bristle.fmus import related
from bristle.fmus.documentation import documentation
from bristle.harness.baseline import comparison_page
from bristle.harness.baseline.verdicts import (
    QuantityVerdict,
    RunComparison,
    SignalCourse,
    SignalVerdict,
)
from bristle.harness.coupling.coupling import CouplingCost, Error, Scheme, _page
from bristle.harness.exchange.replay import SignalAgreement
from bristle.harness.paper import reproduce_page
from bristle.harness.paper.printed_numbers import FIGURES
from bristle.harness.paper.schemes import COMPARED, SCHEMES
from bristle.harness.run import run_page
from bristle.harness.suite import suite_page
from bristle.harness.suite.suite import CaseResult, SuiteCase
from bristle.harness.sweep.store import Store
from bristle.harness.sweep.sweep_page import Runs
from bristle.harness.sweep.sweep_page import render as render_sweep

ROOT = Path(__file__).resolve().parents[2]
EVIL = '<script>alert("x")&\''
MADE = {"version": "1", "date": EVIL, "platform": EVIL, "folder": EVIL, "command": EVIL}
CHECK = {"name": EVIL, "quantity": "steps", "kind": "max", "value": 1.0, "limit": 2.0}
DRAWING = Drawing("<svg></svg>")
DRAWING.seen, DRAWING.plot = EVIL, f'{{"label": "{EVIL}"}}'


def run_of(_):
    estimate = dict.fromkeys(("final", "sd", "true", "error_percent", "settling_s"), 1.0)
    estimate |= {"unit": EVIL, "valid": True, "adapted": True, "moved_percent": 1.0}
    fmu = {"file": EVIL, "fmi": EVIL, "kind": EVIL, "sha256": EVIL}
    validation = {
        "model": {"problem": EVIL, "law": None},
        "fits": {EVIL: {"at_bound": [EVIL]}},
        "mse_percent": 1.0,
    }
    result = {
        "scenario": EVIL,
        "verdict": EVIL,
        "checks": [CHECK | {"pass": False}],
        "estimates": {EVIL: estimate},
        "states": {EVIL: dict.fromkeys(("rms", "late_rms", "late_percent"), 1.0) | {"unit": EVIL}},
        "validation": validation,
        "fmus": {EVIL: fmu},
        "timing": {EVIL: 1.0},
        "notes": [EVIL],
        "overrides": [EVIL],
        "provenance": MADE | {"scenario_sha256": EVIL, "seed": EVIL},
    } | {"steps": 1, "wall_s": 1.0, "duration_s": 1.0, "adapted": True, "innovation": 1.0}
    about = dict.fromkeys(("title", "shows", "source", "limits"), EVIL)
    return run_page.render(result, {"validation": DRAWING}, about, {EVIL: EVIL}, EVIL)


def suite_of(_):
    case = SuiteCase(Path(f"{EVIL}.toml"), values=(EVIL,))
    held, broken = (CHECK | {"pass": holds} for holds in (True, False))
    runs = [CaseResult(case, "pass", (held,)), CaseResult(case, "fail", (broken,))]
    return suite_page.render([*runs, CaseResult(case, "error", message=EVIL)], {EVIL: EVIL})


def sweep_of(folder):
    store = Store(folder / "store")
    told = {"scenario": EVIL, "scenario_sha256": EVIL, "runs": 2, "fmus": [EVIL]}
    vary = {"x": "text", "y": EVIL}
    store.describe("s", told | {"provenance": MADE, "vary": vary, "finished": False})
    common = {"sweep": "s", "verdict": "fail", "command": EVIL, "failed": EVIL, "message": EVIL}
    common |= {"estimates.b.valid": True, "estimates.b.true": 1.0, "estimates.b.sd": 1.0}
    for k in range(2):
        own = {"key": str(k), "run": k, "x": f"{EVIL}{k}", "y": float(k), "scenario_sha256": EVIL}
        numbers = {"estimates.b.final": 1.0 + k, "estimates.b.error_percent": 1.0 + k}
        store.add([common | own | numbers])
    return render_sweep(Runs(store))


def comparison_of(_):
    x = np.arange(3.0)
    course = SignalCourse(x, x, x - 1, x + 1, x)
    signals = (SignalVerdict(EVIL, False, 2.0, 1.0, 1.0, 1.0, 0.0, 2.0, EVIL),)
    numbers = (QuantityVerdict(EVIL, EVIL, 1.0, 2.0, 0.1, False, EVIL),)
    comparison = RunComparison(
        EVIL, EVIL, EVIL, 3, 3, (), signals, numbers, (EVIL,), {EVIL: course}, (MADE, MADE)
    )
    refused = replace(comparison, refused=(EVIL,))
    return comparison_page.render(comparison) + comparison_page.render(refused)


def coupling_of(_):
    scheme = Scheme(EVIL, EVIL, {EVIL: Error(1.0, 1.0, 1.0, None)}, {EVIL: 1.0})
    cost = CouplingCost(EVIL, 1e-3, EVIL, (scheme,), {EVIL: 1.0}, {EVIL: 1.0}, (EVIL,))
    return _page(cost, MADE).decode()


def replay_of(_):
    replayed = SimpleNamespace(
        agreement=(SignalAgreement(EVIL, None, 0.0, 1.0, EVIL),),
        compared=True,
        failure=EVIL,
        passed=False,
        verdict=EVIL,
    )
    return pages.render(
        "bristle.harness.exchange/replay.html", package=EVIL, replayed=replayed, made=MADE
    )


def experiments_of(_):
    each = SimpleNamespace(
        experiment=SimpleNamespace(name=EVIL),
        passed=False,
        verdict=EVIL,
        summary=EVIL,
        agreement=(SignalAgreement(EVIL, None, 0.0, 1.0, EVIL),),
    )
    replayed = SimpleNamespace(passed=False, changed=(EVIL,), experiments=(each,))
    data = {"fmu": EVIL, "replayed": replayed, "signals": each.agreement, "files": [EVIL]}
    data["made"] = MADE
    return pages.render("bristle.harness.exchange/experiments.html", **data)


def paper_of(_):
    row = {"plant": EVIL, "order": 1, "remarks": {"printed": {"kind": "none"}}}
    run = {"scenario": EVIL, "plant": EVIL, "order": 1, "scheme": "printed", "overrides": [EVIL]}
    content = {
        "verdict": "pass",
        "paper": EVIL,
        "provenance": MADE,
        "methods": dict.fromkeys(SCHEMES, EVIL),
        "eq25": [row | dict.fromkeys(COMPARED, 1.0)],
        "estimates": {"S": {scheme: {} for scheme in SCHEMES}},
        "step2_start_s": dict.fromkeys(SCHEMES, 0.0),
        "gains": {"vc": {scheme: [0.0] for scheme in SCHEMES}},
        "remark3": {"interval": [1, 2], "c": [{"order": EVIL, **dict.fromkeys(COMPARED, 1.0)}]},
        "runs": [run | {"checks": [{"pass": True}]}],
    } | {"wall_s": 1.0, "share": 0.5, "vc_heuristic_deg_s": 1.0}
    names = ["eq25", *(f"figure_{each.number}" for each in FIGURES)]
    return reproduce_page.render(content, dict.fromkeys(names, DRAWING))


def fabricated_diagnoses():
    path = ROOT / "tests" / "diagnosis" / "fabricated.py"
    spec = importlib.util.spec_from_file_location("fabricated_for_pages", path)
    fabricated = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fabricated)
    return [make() for make in fabricated.CASES.values()]


def diagnosis_of(_):
    text = ""
    for diagnosis in fabricated_diagnoses():
        diagnosis = replace(
            diagnosis,
            **{name: (EVIL,) for name in ("leads", "notes", "corrections")},
            limits=(Undetected(EVIL, EVIL),),
            traces=tuple(replace(each, name=EVIL) for each in diagnosis.traces),
        )
        words = diagnosis_page.captions(diagnosis)
        drawn = dict.fromkeys(words, DRAWING)
        text += (
            diagnosis_page.render(diagnosis, drawn, {EVIL: EVIL}, [EVIL]) + diagnosis._repr_html_()
        )
    return text


def arm_of(_):
    notes = (f"known torque {EVIL}",)
    joints = {
        f"{EVIL}{k}": replace(each, notes=notes) for k, each in enumerate(fabricated_diagnoses())
    }
    return arm_page.render(EVIL, joints, MADE)


def validation_of(_):
    x = np.arange(5.0)
    record = ValidatedRecord(EVIL, EVIL, 1.0, 1.0, 1.0, ((1.0, 1.0),), x, x, x, x)
    validation = Validation(EVIL, EVIL, (record,), (EVIL,))
    return validation_page.render(validation, MADE | {EVIL: EVIL, "x": {EVIL: EVIL}})


def documentation_of(_):
    program = SimpleNamespace(name=EVIL, description=EVIL, selector=EVIL)
    program.variants = [SimpleNamespace(system=program)]
    interface = SimpleNamespace(program=program, of=lambda *_: [], sample_time=1.0, continuous=True)
    return documentation(interface)


def related_of(_):
    return related._page([(EVIL, EVIL, EVIL, EVIL)])


PAGES = {
    "fmus/templates/documentation.html": documentation_of,
    "fmus/templates/related.html": related_of,
    "harness/run/templates/report.html": run_of,
    "harness/suite/templates/index.html": suite_of,
    "harness/sweep/templates/report.html": sweep_of,
    "harness/baseline/templates/compare.html": comparison_of,
    "harness/coupling/templates/report.html": coupling_of,
    "harness/exchange/templates/replay.html": replay_of,
    "harness/exchange/templates/experiments.html": experiments_of,
    "harness/paper/templates/report.html": paper_of,
    "diagnosis/report/templates/report.html": diagnosis_of,
    "diagnosis/report/templates/arm.html": arm_of,
    "diagnosis/report/templates/validation.html": validation_of,
}


def test_every_page_is_tested():
    pages_shown = {
        path.relative_to(ROOT).as_posix()
        for room in ("harness", "diagnosis", "package", "cli", "fmus")
        for path in (ROOT / room).rglob("templates/*.html")
        if "{% extends" in path.read_text(encoding="utf-8")
    }
    assert pages_shown == set(PAGES)


@pytest.mark.parametrize("name", PAGES)
def test_a_name_from_outside_is_text(name, tmp_path):
    # comments are in pictures, where the name is in a font that has no text
    text = re.sub(r"<!--.*?-->", "", PAGES[name](tmp_path), flags=re.DOTALL)
    assert "<script>alert" not in text
    assert 'alert("x")' not in re.sub(r'<script type="application/json".*?</script>', "", text)
    assert "&lt;script&gt;alert(&#34;x&#34;)&amp;&#39;" in text


def test_only_what_a_template_wrote_itself_is_called_safe():
    """A filter `safe` behind anything but a text would switch the escaping off."""
    for room in ("common", "harness", "diagnosis", "package", "fmus"):
        for path in (ROOT / room).rglob("*.html"):
            marked = re.findall(r"(\S+)\|safe", path.read_text(encoding="utf-8"))
            assert all(each == "svg" or each.endswith('"') for each in marked), path
