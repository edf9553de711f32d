"""Sweeps: the digits of single runs, whatever makes them, and nothing lost."""

from __future__ import annotations

import ctypes
import dataclasses
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bristle.common.errors import BristleError
from bristle.fmus.host import Slave
from bristle.harness.run.checked import RunOptions
from bristle.harness.run.run import run
from bristle.harness.sweep.chunk import run_chunk
from bristle.harness.sweep.design import Design, design
from bristle.harness.sweep.executor import Means
from bristle.harness.sweep.ship import packed
from bristle.harness.sweep.spec import prepare_sweep
from bristle.harness.sweep.store import Store
from bristle.harness.sweep.sweep import Summary, run_sweep
from bristle.harness.sweep.sweep_page import (
    PassingShare,
    Runs,
    _places,
    render,
    statistics,
    summary,
)

Maker = Callable[..., Path]
Message = Callable[[Callable[[], object]], str]
VARY = ("plant.parameters.J=uniform(0.0008, 0.0012) kg.m2", "sensor=[clean, encoder]")


@pytest.fixture
def path(base: str, scenario_file: Maker) -> Path:
    return scenario_file(base.replace("bastin_gevers", "rls"))


def swept(path: Path, store: Path, asked: Design, **means: Any) -> tuple[Store, Summary]:
    made = Store(store)
    return made, run_sweep(prepare_sweep(path, asked, RunOptions()), asked, made, Means(**means))


def table(store: Store) -> pa.Table:
    """The table without what depends on the time of day."""
    return store.table().drop_columns(["wall_s"])


@pytest.mark.slow
def test_a_row_has_the_numbers_of_the_run_alone_and_its_command(path: Path, tmp_path: Path) -> None:
    """To the last bit, though FMUs are reset between runs and not loaded anew."""
    asked = design(VARY, seeds=[1, 2], samples=3)
    store, found = swept(path, tmp_path / "store", asked, jobs=2)
    assert found.runs == found.verdicts["pass"] == 12
    rows = store.table().to_pylist()
    assert [each["run"] for each in rows] == list(range(12))
    for each in rows:
        words = shlex.split(each["command"])
        overrides = [words[k + 1] for k, word in enumerate(words) if word == "--set"]
        assert words[:3] == ["bristle", "run", str(path)]
        alone = run(
            path,
            tmp_path / "alone",
            RunOptions(overrides=overrides, seed=int(words[words.index("--seed") + 1])),
        ).result
        assert each["verdict"] == alone["verdict"]
        assert each["steps"] == 2000
        for name, estimate in alone["estimates"].items():
            for key in ("final", "sd", "error_percent", "settling_s", "valid"):
                assert each[f"estimates.{name}.{key}"] == pytest.approx(
                    estimate[key], rel=0, abs=0, nan_ok=True
                ) or (estimate[key] is None or estimate[key] != estimate[key])
        assert each["sha256.plant"] == alone["fmus"]["plant"]["sha256"]
        assert each["plant.parameters.J"] == pytest.approx(1e-3, rel=0.2)
    assert len({each["key"] for each in rows}) == 12


@pytest.mark.sampled(4)
def test_the_number_of_threads_changes_nothing(path: Path, tmp_path: Path) -> None:
    asked = design(VARY, samples=8)
    one, _ = swept(path, tmp_path / "one", asked, jobs=1)
    three, _ = swept(path, tmp_path / "three", asked, jobs=3)
    assert table(one).equals(table(three))


def test_fmus_are_loaded_once_a_chunk(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loads: list[str] = []
    load = Slave._load

    def counted(slave: Slave) -> None:
        loads.append(slave.name)
        load(slave)

    monkeypatch.setattr(Slave, "_load", counted)
    asked = design(VARY, samples=5)
    assert len(run_chunk(prepare_sweep(path, asked, RunOptions()), list(asked.points()))) == 10
    assert sorted(loads) == ["controller", "observer", "plant"]


@pytest.mark.sampled(4)
def test_a_resumed_sweep_makes_what_is_missing_and_nothing_else(
    path: Path, tmp_path: Path, message: Message
) -> None:
    asked = design(VARY, samples=8)
    store, _ = swept(path, tmp_path / "store", asked)
    whole = table(store)
    lost = store.files()[1]
    missing = pq.read_metadata(lost).num_rows
    lost.unlink()
    assert "resume it" in message(lambda: swept(path, tmp_path / "store", asked))
    _, found = swept(path, tmp_path / "store", asked, resume=True)
    assert (found.runs, found.kept) == (missing, 16 - missing)
    assert table(store).equals(whole)
    assert swept(path, tmp_path / "store", asked, resume=True)[1].runs == 0
    more = design(VARY, seeds=[2], samples=8)  # others join those that are there
    assert swept(path, tmp_path / "store", more, resume=True)[1].runs == 16
    assert len(store.table()) == 32


def test_another_scenario_or_option_is_another_run(path: Path, tmp_path: Path) -> None:
    asked = design((), seeds=[1])
    swept(path, tmp_path / "store", asked)
    path.write_text(path.read_text(encoding="utf-8").replace('"2 s"', '"1 s"'), encoding="utf-8")
    assert swept(path, tmp_path / "store", asked, resume=True)[1].runs == 1


def test_a_value_that_cannot_be_run_is_said_before_anything_runs(
    path: Path, tmp_path: Path
) -> None:
    asked = design(["plant.law=[modified, modfied]", "step=[1 ms, 3 ms]"])
    with pytest.raises(BristleError) as caught:
        swept(path, tmp_path / "store", asked)
    lines = str(caught.value).splitlines()
    assert ["did you mean 'modified'" in lines[0], "whole number of steps" in lines[1]] == [
        True,
        True,
    ]
    assert not (tmp_path / "store").exists()


def test_a_value_that_fails_only_at_run_time_is_a_row(path: Path, tmp_path: Path) -> None:
    """The trials see each value alone; here two of them do not go together."""
    asked = design(["duration=[2 s, 2.001 s]", "step=[1 ms, 2 ms]"])
    store, found = swept(path, tmp_path / "store", asked)
    assert found.verdicts == {"pass": 3, "fail": 0, "error": 1}
    assert "whole number of steps" in "".join(store.table()["message"].to_pylist())


@pytest.mark.slow
def test_a_foreign_fmu_that_crashes_costs_its_own_runs_only(
    base: str, scenario_file: Maker, tiny_fmu: Maker, tmp_path: Path
) -> None:
    good, bad = tiny_fmu(), tiny_fmu("segfault")
    text = (
        base.replace('law = "modified"', f'fmu = "{good}"')
        .replace('J = "0.001 kg.m2"', "gain = 6.5")
        .replace("estimates.b", "states.v")
    )
    text = text.replace("states.v.error_percent", "steps")
    path = scenario_file(text)
    asked = design([f"plant.fmu=[{good}, {bad}]"], seeds=[1, 2, 3])
    store, found = swept(path, tmp_path / "store", asked, jobs=2)
    assert found.verdicts == {"pass": 3, "fail": 0, "error": 3}
    for each in store.table().to_pylist():
        assert ("SIGSEGV" in each["message"]) == (str(bad) in each["plant.fmu"])


def command(path: Path, store: Path, *more: str) -> Sequence[str]:
    words = [
        sys.executable,
        "-m",
        "bristle",
        "sweep",
        str(path),
        "--vary",
        VARY[0],
        "--samples",
        "80",
        "--set",
        "duration=4 s",
    ]
    return [*words, "--out", str(store), *more]


@pytest.mark.slow
def test_kill_and_interrupt_lose_at_most_the_chunks_in_flight(path: Path, tmp_path: Path) -> None:
    reference = tmp_path / "reference"
    assert (
        subprocess.run(
            command(path, reference, "-j", "2"), check=False, capture_output=True
        ).returncode
        == 0
    )
    for number in (signal.SIGKILL, signal.SIGINT):
        place = tmp_path / f"store-{number}"
        child = subprocess.Popen(
            command(path, place, "-j", "2"),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        store, begun = Store(place), time.monotonic()
        while len(store.files()) < 3 and time.monotonic() < begun + 60:
            time.sleep(0.02)
        assert child.poll() is None
        os.kill(child.pid, number)
        _, said = child.communicate(timeout=30)
        if number == signal.SIGINT:
            assert said.strip().splitlines()[-1] == "bristle: interrupted"
        kept = store.done()
        assert 0 < len(kept) < 80
        subprocess.run(command(path, place, "--resume", "-j", "2"), check=True, capture_output=True)
        whole, expected = table(store), table(Store(reference))
        assert whole.equals(expected)


@pytest.mark.slow
def test_two_sweeps_at_once_do_not_harm_a_store(path: Path, tmp_path: Path) -> None:
    place = tmp_path / "store"
    both = [
        subprocess.Popen(command(path, place, "--resume", "-j", "1", "--seeds", seeds))
        for seeds in ("1-2", "2-3")
    ]
    assert [each.wait(timeout=120) for each in both] == [0, 0]
    found = Store(place).table()
    assert len(found) == 240
    assert len(set(found["key"].to_pylist())) == 240


@pytest.mark.slow
def test_a_cluster_gives_the_same_digits_also_when_a_worker_is_killed(
    path: Path, tmp_path: Path
) -> None:
    pytest.importorskip("distributed")
    script = f"""
import os, signal, threading, time
from pathlib import Path
from distributed import LocalCluster
from bristle.harness.sweep.design import design
from bristle.harness.run.checked import RunOptions
from bristle.harness.sweep.executor import Means
from bristle.harness.sweep.spec import prepare_sweep
from bristle.harness.sweep.store import Store
from bristle.harness.sweep.sweep import run_sweep
if __name__ == "__main__":
    asked = design({VARY!r}, samples=32)
    sweep = prepare_sweep(Path({str(path)!r}), asked, RunOptions(overrides=("duration=8 s",)))
    run_sweep(sweep, asked, Store(Path({str(tmp_path / "local")!r})), Means(2))
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        store = Store(Path({str(tmp_path / "cluster")!r}))
        def kill():
            while len(store.files()) < 2:
                time.sleep(0.02)
            os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
        killer = threading.Thread(target=kill)
        killer.start()
        means = Means(1, cluster.scheduler_address)
        verdicts = run_sweep(sweep, asked, store, means).verdicts
        print("DONE", verdicts["pass"], killer.is_alive())
        class Full(Store):
            def add(self, rows):
                raise OSError("no room for a chunk")
        try:
            run_sweep(sweep, asked, Full(Path({str(tmp_path / "full")!r})), means)
        except OSError as error:
            print("SAID", error)
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=240
    )
    assert "DONE 64 False" in done.stdout, done.stderr[-3000:]
    assert "SAID no room for a chunk" in done.stdout, done.stderr[-3000:]
    assert table(Store(tmp_path / "local")).equals(table(Store(tmp_path / "cluster")))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the C library of Linux")
def test_a_worker_of_dask_keeps_memory_from_run_to_run(path: Path) -> None:
    """Dask starts workers with this variable; each array of a run is then new to the process, which
    shows as page faults.
    """
    if not hasattr(ctypes.CDLL(None), "mallopt"):
        pytest.skip("the C library is not that of GNU")
    script = f"""
import resource
from pathlib import Path
from bristle.harness.sweep.design import design
from bristle.harness.run.checked import RunOptions
from bristle.harness.sweep.chunk import run_chunk
from bristle.harness.sweep.ship import packed
from bristle.harness.sweep.spec import prepare_sweep
def faults(sweep):
    run_chunk(sweep, points)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    run_chunk(sweep, points)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
asked = design({VARY!r}, samples=2)
points = list(asked.points())
sweep = prepare_sweep(Path({str(path)!r}), asked, RunOptions(overrides=("duration=20 s",)))
print(faults(sweep), faults(packed(sweep)))
"""
    environment = {**os.environ, "MALLOC_TRIM_THRESHOLD_": "65536"}
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, env=environment
    )
    here, on_a_worker = map(int, done.stdout.split())
    assert on_a_worker < here / 5


def test_a_worker_reads_the_fmus_of_a_sweep_once(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = design(VARY, samples=2)
    shipped, points = packed(prepare_sweep(path, asked, RunOptions())), list(asked.points())
    expected = run_chunk(shipped, points[:2])
    monkeypatch.setattr("bristle.harness.sweep.ship.Fmu", None)  # what reads one again fails
    again = run_chunk(shipped, points[:2])
    assert [row | {"wall_s": 0} for row in again] == [row | {"wall_s": 0} for row in expected]
    assert {row["verdict"] for row in again} == {"pass"}


# -- the report ------------------------------------------------------------------------------------


def test_the_share_of_passing_runs_has_its_interval() -> None:
    """Clopper and Pearson's interval for 0 of n is 0 to 1 - (alpha / 2)^(1 / n); for k of n it is
    symmetric to n - k of n.
    """
    low, high = PassingShare(0, 20).interval
    assert (low, high) == (0.0, pytest.approx(1 - 0.025 ** (1 / 20)))
    low, high = PassingShare(6, 20).interval
    assert (1 - high, 1 - low) == pytest.approx(PassingShare(14, 20).interval)


@pytest.mark.sampled(4)
def test_the_report_counts_covers_and_links(path: Path, tmp_path: Path) -> None:
    text = (
        path.read_text(encoding="utf-8")
        + '\n[[checks]]\nname = "J <is> small"\nquantity = "estimates.b.final"\nmin = 6.5\n'
    )
    path.write_text(text, encoding="utf-8")
    asked = design([VARY[0], "plant.parameters.b=uniform(0.005, 0.008) N.m/V", VARY[1]], samples=20)
    store, found = swept(path, tmp_path / "store", asked, jobs=2)
    runs = Runs(store)
    assert runs.varied == ["plant.parameters.J", "plant.parameters.b", "sensor"]
    page, told = render(runs), summary(runs)
    assert told["verdicts"] == {word: count for word, count in found.verdicts.items() if count}
    assert told["failed_checks"] == {"J <is> small": found.verdicts["fail"]}
    assert f"{found.verdicts['pass']} of 40 runs pass" in page
    assert "J &lt;is&gt; small" in page
    assert page.count("bristle run ") == 40
    assert all(f'href="#run-{row}"' in page and f'id="run-{row}"' in page for row in range(40))
    rows = store.table().to_pylist()
    by_hand = [
        abs(each["estimates.b.final"] - each["estimates.b.true"]) <= 1.96 * each["estimates.b.sd"]
        for each in rows
        if each["estimates.b.final"] is not None and each["estimates.b.sd"] is not None
    ]
    coverage = next(each for each in statistics(runs) if each["parameter"] == "b")["coverage"]
    assert (coverage.count, coverage.total) == (sum(by_hand), len(by_hand))
    assert len(by_hand) > 10


def test_a_sweep_that_is_not_finished_says_so(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, add = design([VARY[0]], samples=6), Store.add

    def interrupted(self: Store, rows: Any) -> None:
        add(self, rows)
        raise KeyboardInterrupt

    monkeypatch.setattr(Store, "add", interrupted)
    with pytest.raises(KeyboardInterrupt):
        swept(path, tmp_path / "store", asked)
    monkeypatch.undo()
    runs = Runs(Store(tmp_path / "store"))
    [line] = runs.unfinished
    assert "of 6 runs" in line
    assert f"the store has {len(runs)} runs; resume it" in line
    assert summary(runs)["unfinished"] == [line]
    assert "is not finished" in render(runs)
    runs = Runs(swept(path, tmp_path / "store", asked, resume=True)[0])
    assert (len(runs), runs.unfinished) == (6, [])
    assert "not finished" not in render(runs)


def test_runs_at_one_place_of_a_map_are_one_point(path: Path, tmp_path: Path) -> None:
    """Runs that fail hide none that pass: the colour says what all of them do, whatever their
    seed.
    """
    store = Store(tmp_path / "store")
    words = {
        "a": ("pass", "pass"),
        "b": ("pass", "fail"),
        "c": ("fail", "error"),
        "d": ("error", "error"),
    }
    cases = [(x, word, seed) for x, verdicts in words.items() for seed, word in enumerate(verdicts)]
    made = [
        {
            "key": f"{x}{k}",
            "sweep": "s",
            "run": 2 * "abcd".index(x) + k,
            "verdict": v,
            "x": x,
            "y": 2.0,
        }
        for x, v, k in cases
    ]
    told = {
        "scenario": "quick",
        "scenario_sha256": "",
        "runs": 8,
        "fmus": [],
        "provenance": {"date": ""},
    }
    store.describe("s", {**told, "vary": {"x": "text", "y": "kg.m2"}})
    store.add(made)
    runs = Runs(store)
    found = {x: said for (x, _), said in _places(runs, "x", "y", runs.index).items()}
    assert found == {
        "a": ("all pass", 0),
        "b": ("some pass", 3),
        "c": ("none passes", 4),
        "d": ("error", 6),
    }
    assert [runs.label(name) for name in ("x", "y")] == ["x", "y [kg.m2]"]


@pytest.mark.sampled(4)
def test_runs_of_several_versions_are_told_apart(path: Path, tmp_path: Path) -> None:
    asked = design([VARY[0]], samples=3)
    store, _ = swept(path, tmp_path / "store", asked)
    assert "The runs are of" not in render(Runs(store))
    path.write_text(path.read_text(encoding="utf-8") + "\n# a later version\n", encoding="utf-8")
    swept(path, tmp_path / "store", asked, resume=True)
    page = render(Runs(store))
    assert "The runs are of 2 versions of the scenario or its FMUs" in page
    # of either version, Clopper and Pearson for 3 of 3
    assert page.count("100.0 % [29.2, 100.0]") >= 2


def test_a_resumed_sweep_tells_what_those_that_were_there_do(path: Path, tmp_path: Path) -> None:
    text = (
        path.read_text(encoding="utf-8")
        + '\n[[checks]]\nname = "never"\nquantity = "estimates.b.final"\nmax = -1.0\n'
    )
    path.write_text(text, encoding="utf-8")
    _, found = swept(path, tmp_path / "store", design([VARY[0]], samples=3))
    assert found.worst == "fail"
    _, found = swept(path, tmp_path / "store", design([VARY[0]], samples=3), resume=True)
    assert (found.runs, found.there, found.worst) == (0, {"fail": 3}, "fail")


@pytest.mark.sampled(4)
def test_a_sweep_that_is_stopped_returns_what_it_has(path: Path) -> None:
    from bristle.harness.sweep.chunk import Watcher

    asked = design(VARY, samples=50)
    sweep = prepare_sweep(
        path, asked, dataclasses.replace(RunOptions(), overrides=("duration=20 s",))
    )

    class Soon(Watcher):
        def control(self) -> Any:
            made = super().control()
            self.stop()
            return made

    assert run_chunk(sweep, list(asked.points()), Soon()) == []


@pytest.mark.sampled(4)
def test_python_has_the_same(path: Path, tmp_path: Path) -> None:
    import bristle

    vary = {"sensor": ["clean", "encoder"], "plant.parameters.J": "0.001:0.002:2 kg.m2"}
    found = bristle.sweep(path, vary, tmp_path / "store", jobs=1)
    assert found.verdicts == {"pass": 4, "fail": 0, "error": 0}
    assert found.table["plant.parameters.J"].to_pylist() == [0.001, 0.002, 0.001, 0.002]
    assert found.table["sensor"].to_pylist() == ["clean", "clean", "encoder", "encoder"]
    again = bristle.sweep(
        path, {"sensor": ["clean"]}, tmp_path / "store", seeds=[1, 2], resume=True
    )
    assert (again.verdicts["pass"], len(again.table)) == (2, 6)


@pytest.mark.parametrize(
    ("vary", "seeds", "overrides", "said"),
    [
        (["x=[1]", "x=[2]"], (), (), "given twice"),
        (
            ['plant.parameters."modified.c"=[1 1/rad]', "plant.parameters.modified.c=[2 1/rad]"],
            (),
            (),
            "given twice",
        ),
        (["controller.parameters.seed=[1, 2]"], (1,), (), "seeds are given as well"),
        (
            ["plant.parameters.J=[0.001 kg.m2]"],
            (),
            ("plant.parameters.J=0.002 kg.m2",),
            "is set for all runs as well",
        ),
    ],
)
def test_a_key_cannot_have_two_values(
    path: Path,
    vary: list[str],
    seeds: tuple[int, ...],
    overrides: tuple[str, ...],
    said: str,
    message: Message,
) -> None:
    assert said in message(
        lambda: prepare_sweep(path, design(vary, seeds), RunOptions(overrides=overrides))
    )


def test_a_column_is_named_without_quotes(path: Path, tmp_path: Path) -> None:
    asked = design(['plant.parameters."modified.sigma0"=[600 1/s2, 700 1/s2]'])
    store, _ = swept(path, tmp_path / "store", asked)
    assert store.table()["plant.parameters.modified.sigma0"].to_pylist() == [600.0, 700.0]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"jobs": 0}, "jobs 0"),
        ({"seeds": 3}, "seeds is 3"),
        ({"vary": {"sensor": 3}}, "vary['sensor'] is 3"),
        ({"vary": ["sensor=[clean]"]}, "vary is a list"),
        ({"cluster": "foo", "seeds": [1]}, "no address of a Dask scheduler"),
    ],
)
def test_python_says_what_is_wrong_and_leaves_nothing(
    path: Path, tmp_path: Path, arguments: dict[str, Any], said: str, message: Message
) -> None:
    import bristle

    assert said in message(lambda: bristle.sweep(path, out=tmp_path / "store", **arguments))
    assert not (tmp_path / "store").exists()
