"""Many runs of scenarios: bristle test, what it writes, and scenario files as items of pytest."""

import json
import multiprocessing
import signal
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from bristle.common.errors import BristleError
from bristle.harness.scenario.vary import seeds_of, values_of
from bristle.harness.suite.suite import CaseResult, SuiteCase, find_cases, run_suite, summaries
from bristle.harness.suite.suite_page import failures, junit, render, to_tree, verdict

SCENARIO = """
duration = "2 s"
sensor = "encoder"
[plant]
law = "modified"
[controller.parameters]
order = 1
[observer]
method = "rls"
[[checks]]
quantity = "estimates.b.error_percent"
max_abs = LIMIT
"""


def scenario(folder: Path, name: str, limit: float = 50.0) -> Path:
    path = folder / f"{name}.toml"
    path.write_text(SCENARIO.replace("LIMIT", str(limit)), encoding="utf-8")
    return path


def check(value, kind="max_abs", limit=2.0, holds=True):
    return {
        "name": "error",
        "quantity": "estimates.b.error_percent",
        "kind": kind,
        "value": value,
        "limit": limit,
        "pass": holds,
    }


@pytest.mark.parametrize(
    ("given", "expected"),
    [("1-3", [1, 2, 3]), ("1,4,7-9", [1, 4, 7, 8, 9]), (" 2 , 2-3", [2, 3]), ("12", [12])],
)
def test_seeds(given, expected):
    assert seeds_of(given) == expected


@pytest.mark.parametrize("given", ["", "0-2", "3-1", "a", "1-", "1;2", "-1", "1-999999999"])
def test_seeds_that_cannot_be(given):
    with pytest.raises(BristleError, match="seeds"):
        seeds_of(given)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("plant.parameters.J=0.001:0.002:3 kg.m2", ["0.001 kg.m2", "0.0015 kg.m2", "0.002 kg.m2"]),
        ("x.y=1:2:2", ["1", "2"]),
        ('step=["1 ms", "2 ms"]', ["1 ms", "2 ms"]),
        ("step=[1 ms, 2 ms]", ["1 ms", "2 ms"]),
        ("plant.law=[lugre]", ["lugre"]),
        ("x=[1, 2.5]", ["1", "2.5"]),
        ("x=[true]", ["true"]),
    ],
)
def test_values(given, expected):
    path = given.partition("=")[0]
    assert values_of(given) == [f"{path}={value}" for value in expected]


@pytest.mark.parametrize(
    "given",
    [
        "x",
        "x=",
        "=1:2:3",
        "x=1:2",
        "x=1:2:0",
        "x=1:inf:2",
        "x=a:b:2",
        "x=[]",
        "x=[1",
        "x=1:2:99999",
    ],
)
def test_values_that_cannot_be(given):
    with pytest.raises(BristleError, match="vary"):
        values_of(given)


def test_cases_are_all_combinations(tmp_path):
    for name in ("one", "two"):
        scenario(tmp_path, name)
    (tmp_path / "model.toml").write_text('friction = "coulomb"', encoding="utf-8")  # not a scenario
    cases = find_cases([tmp_path], [1, 2], [["a=1", "a=2"], ["b=3"]])
    assert [c.path.stem for c in cases] == ["one"] * 4 + ["two"] * 4
    assert {(c.seed, c.values) for c in cases} == {
        (s, (a, "b=3")) for s in (1, 2) for a in ("a=1", "a=2")
    }
    assert len({c.folder / c.path.stem for c in cases}) == 8
    with pytest.raises(BristleError, match="twice"):
        find_cases([tmp_path, tmp_path / "one.toml"], [], [])
    with pytest.raises(BristleError, match="no scenario file"):
        find_cases([Path(__file__).parent], [], [])
    with pytest.raises(BristleError, match="a is set for all runs as well"):
        find_cases([tmp_path], [], [["a=1", "a=2"]], ["a=3"])


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (
            ["title=a b", "title=a_b"],
            "vary 'title=a_b': its result folder would be that of 'title=a b', title=a_b",
        ),
        (["title=A", "title=a"], "vary 'title=a': its result folder would be that of 'title=A'"),
        (
            ["title=b", "title=" + "x" * 20000],
            r"vary 'title=x{54}\.\.\.': .* 20006 bytes, allowed are 255",
        ),
        (["title=" + "é" * 130], r"of 266 bytes"),
    ],
)
def test_values_that_cannot_name_result_folders(tmp_path, values, said):
    with pytest.raises(BristleError, match=said):
        find_cases([scenario(tmp_path, "one")], [], [["step=1 ms"], values])


def test_the_worst_value_is_that_next_to_or_beyond_its_limit():
    runs = [
        CaseResult(SuiteCase(Path("s.toml"), k), "pass", (check(v), check(v, "min", -5.0)))
        for k, v in enumerate((1.0, -3.0, 0.5), 1)
    ]
    largest, smallest = summaries(runs)
    assert (largest.worst, largest.worst_run, largest.median, largest.count) == (
        -3.0,
        "seed 2",
        1.0,
        3,
    )
    assert (smallest.worst, smallest.worst_run, smallest.median) == (-3.0, "seed 2", 0.5)
    [lost, _] = summaries(
        [
            *runs,
            CaseResult(
                SuiteCase(Path("s.toml"), 4),
                "fail",
                (check(None, holds=False), check(0.0, "min", -5.0)),
            ),
        ]
    )
    # a number that does not exist is the worst
    assert (lost.passed, lost.count, lost.worst_run) == (3, 4, "seed 4")


@pytest.mark.slow
def test_one_process_and_two_give_the_same(tmp_path):
    paths = [scenario(tmp_path, "good"), scenario(tmp_path, "strict", 1e-9)]
    cases = find_cases(paths, [1, 2], [])
    alone = run_suite(cases[::3], tmp_path / "alone", jobs=1)
    told = []
    both = run_suite(cases, tmp_path / "both", jobs=2, progress=lambda *given: told.append(given))
    assert [(t.case, t.verdict, t.checks) for t in alone] == [
        (t.case, t.verdict, t.checks) for t in both[::3]
    ]
    assert [t.verdict for t in both] == ["pass", "pass", "fail", "fail"]
    assert [done for _, done, _ in told] == [1, 2, 3, 4]
    assert both[0].checks[0]["value"] != both[1].checks[0]["value"]  # another seed
    for t in both:
        folder = (tmp_path / "both" / t.report).parent
        result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
        assert (result["verdict"], result["provenance"]["seed"]) == (t.verdict, t.case.seed)
        assert t.origin["scenario_sha256"] == result["provenance"]["scenario_sha256"]
        assert t.origin["fmus_sha256"] == {
            name: fmu["sha256"] for name, fmu in result["fmus"].items()
        }
    [text] = failures(both[2])
    assert "estimates.b.error_percent" in text
    assert "must be |·| ≤ 1e-09" in text
    tree = to_tree(both, {})
    assert (tree["verdict"], [r["verdict"] for r in tree["runs"]]) == (
        "fail",
        ["pass", "pass", "fail", "fail"],
    )
    assert tree["runs"][0]["origin"] == both[0].origin
    root = ElementTree.fromstring(junit(both))
    assert [(s.get("tests"), s.get("failures"), s.get("errors")) for s in root] == [
        ("2", "0", "0"),
        ("2", "2", "0"),
    ]
    page = render(both, {})
    assert all(t.report.as_posix() in page for t in both)
    assert "2 of 4 runs pass" in page


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize("ignoring", [signal.SIG_DFL, signal.SIG_IGN])
def test_a_killed_process_loses_only_the_runs_under_way(tmp_path, ignoring):
    cases = find_cases([scenario(tmp_path, "good")], range(1, 10), [])

    def kill(name, done, total):
        if done == 1:
            multiprocessing.active_children()[0].kill()

    before = signal.signal(signal.SIGTERM, ignoring)  # which processes inherit, but for a handler
    try:
        tested = run_suite(cases, tmp_path / "out", jobs=2, progress=kill)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert [t.case for t in tested] == cases
    lost = [t for t in tested if t.verdict != "pass"]
    assert len(lost) <= 2
    assert all("was killed" in t.message for t in lost)


@pytest.mark.sampled(4)
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_processes_end_with_their_parent():
    script = """
import os, signal, time
from bristle.harness.suite.suite import _workers
with _workers(1) as pool:
    print(pool.submit(os.getpid).result(), flush=True)
    pool.submit(time.sleep, 120)
    os.kill(os.getpid(), signal.SIGKILL)
"""
    # till the last one ends
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, timeout=60, check=False
    )
    assert done.returncode == -signal.SIGKILL
    assert int(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_an_interrupt_leaves_the_results_and_no_empty_folders(tmp_path, jobs):
    cases = find_cases([scenario(tmp_path, "good")], range(1, 8), [["step=1 ms", "step=2 ms"]])

    def interrupt(name, done, total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_suite(cases, tmp_path / "out", jobs=jobs, progress=interrupt)
    left = [path for path in (tmp_path / "out").rglob("*") if path.is_dir()]
    assert all(any(path.iterdir()) for path in left)
    assert 2 <= sum(path.name == "good" for path in left) < len(cases)


def test_nothing_runs_where_one_scenario_cannot(tmp_path):
    good, bad = scenario(tmp_path, "good"), scenario(tmp_path, "bad")
    bad.write_text(
        bad.read_text(encoding="utf-8").replace("error_percent", "eror_percent"), encoding="utf-8"
    )
    with pytest.raises(BristleError, match="did you mean"):
        run_suite(find_cases([good, bad], [], []), tmp_path / "out")
    assert not list(tmp_path.glob("out/**/result.json"))


def test_an_error_of_one_run_is_a_verdict_of_its_own():
    broken = CaseResult(SuiteCase(Path("s.toml")), "error", message="s.toml: the disk is full")
    assert verdict([broken, CaseResult(SuiteCase(Path("t.toml")), "fail")]) == "error"
    root = ElementTree.fromstring(junit([broken]))
    assert root[0][0][0].tag == "error"
    assert to_tree([broken], {})["runs"][0]["folder"] is None
    assert "the disk is full" in render([broken], {})


def test_runs_without_result_count_where_checks_hold():
    runs = [CaseResult(SuiteCase(Path("s.toml"), k), "pass", (check(1.0),)) for k in (1, 2)]
    runs.append(
        CaseResult(SuiteCase(Path("s.toml"), 3), "error", message="s.toml: the disk is full")
    )
    [found] = summaries(runs)
    assert (found.passed, found.count, found.worst, found.worst_run) == (2, 3, 1.0, "seed 1")
    page = render(runs, {})
    assert "2 of 3 checks, 1 run without result" in page
    assert 'badge good">2' not in page
    # of which no check is known
    lost = CaseResult(SuiteCase(Path("t.toml")), "error", message="t.toml: the disk is full")
    assert 'badge bad">2 of 2 checks, 1 run without result' in render([*runs[:2], lost], {})


def run_pytest(folder: Path, *arguments: str) -> subprocess.CompletedProcess:
    """Run pytest on a folder that is its root, results to `out` in it."""
    (folder / "pyproject.toml").write_text("[tool.pytest.ini_options]\n", encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "no:bristle",
        "-p",
        "bristle.harness.suite.pytest_plugin",
        "-p",
        "no:cacheprovider",
        *arguments,
        str(folder),
        "--bristle-out",
        str(folder / "out"),
    ]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_pytest_keeps_results_of_scenarios_of_one_name_apart(tmp_path):
    for place, name in (("a", "same"), ("b", "same"), ("b", "other")):
        (tmp_path / place).mkdir(exist_ok=True)
        scenario(tmp_path / place, name)
    done = run_pytest(tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    found = {
        p.parent.relative_to(tmp_path / "out").as_posix()
        for p in (tmp_path / "out").rglob("result.json")
    }
    assert found == {"a/same", "b/same", "other"}


@pytest.mark.sampled(4)
def test_pytest_shows_no_report_of_a_scenario_that_cannot_run(tmp_path):
    path = scenario(tmp_path, "typo")
    path.write_text(path.read_text(encoding="utf-8").replace("rls", "rlss"), encoding="utf-8")
    done = run_pytest(tmp_path)
    assert done.returncode == 1
    assert "did you mean" in done.stdout
    assert "report:" not in done.stdout


@pytest.mark.slow
def test_pytest_collects_scenario_files_and_shows_the_verdict_table(tmp_path):
    scenario(tmp_path, "good")
    scenario(tmp_path, "strict", 1e-9)
    (tmp_path / "broken.toml").write_text("this is [no TOML", encoding="utf-8")
    (tmp_path / "model.toml").write_text('friction = "coulomb"', encoding="utf-8")  # not a scenario
    (tmp_path / "other").mkdir()
    # of tools of Python
    (tmp_path / "other" / "pyproject.toml").write_text("this is [no TOML", encoding="utf-8")
    done = run_pytest(tmp_path, "-n", "2")
    assert done.returncode == 1, done.stdout + done.stderr
    assert "2 failed, 1 passed" in done.stdout
    assert "broken.toml: not valid TOML: " in done.stdout
    assert "estimates.b.error_percent" in done.stdout
    assert "FAIL" in done.stdout
    assert "Traceback" not in done.stdout
    assert {p.parent.name for p in (tmp_path / "out").glob("*/result.json")} == {"good", "strict"}
