"""Baselines: a rerun passes, and what is wrong with a run is found, signal by signal."""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest

from bristle.common.signals import Array, table_text
from bristle.harness.baseline.baseline import (
    Baseline,
    Judged,
    make_baseline,
    measured_quantities,
    quantities_of,
    read_baseline,
    read_json,
    write_baseline,
)
from bristle.harness.baseline.comparison import (
    compare_folders,
    compare_sides,
    judge_quantity,
    judge_signal,
    write_comparison,
)
from bristle.harness.baseline.comparison_page import PAGE_BYTES, render
from bristle.harness.baseline.repeats import (
    Repeat,
    built,
    repeats,
    run_again,
    run_rounded,
    toolchains,
)
from bristle.harness.baseline.tube import SAFETY
from bristle.harness.baseline.verdicts import (
    RunComparison,
    SignalCourse,
    comparison_json,
    differences,
)
from bristle.harness.run.checked import Checked, RunOptions
from bristle.harness.run.results import thinned
from bristle.harness.run.run import build_and_check, run

Message = Callable[[Callable[[], Any]], str]
Maker = Callable[..., Path]

# A slow reference through an encoder: the shaft stands still, breaks away, and what the controller
# sees comes in counts.
STICK_SLIP = """
duration = "6 s"
sensor = "encoder"
controller_sensor = "encoder"
[plant]
law = "coulomb"
[controller.parameters]
seed = 3
[observer]
method = "rls"
[[stimuli]]
variable = "reference_scale"
points = [["0 s", 0.05]]
[[checks]]
quantity = "behaviour.stick_share.value"
min = 0.001
"""


def uncompiled(checked: Checked) -> list[Repeat]:
    """The repeated runs that need no compiler."""
    names = ("start values", "internal steps")
    return [way for way in repeats(checked.setup) if way.name.startswith(names)]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("baselines")
    (folder / "stick.toml").write_text(STICK_SLIP, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def accepted(place: Path) -> tuple[Path, Baseline]:
    """The baseline of the stick-slip scenario, as a folder and as it was made."""
    checked = build_and_check(place / "stick.toml", place, RunOptions(full=True))
    found = make_baseline(checked, ways=uncompiled(checked))
    return write_baseline(place / "kept", "stick", found, checked.setup.loaded.text), found


@pytest.fixture(scope="module")
def full(place: Path) -> Path:
    """A result folder at full rate."""
    return run(place / "stick.toml", place / "full", RunOptions(full=True)).folder


@pytest.fixture
def altered(full: Path, tmp_path: Path) -> Callable[[Callable[[dict[str, Array]], None]], Path]:
    """Return what writes a copy of the result folder with other signals."""

    def change(edit: Callable[[dict[str, Array]], None]) -> Path:
        folder = tmp_path / "altered"
        shutil.copytree(full, folder)
        head = (full / "signals.csv").read_text(encoding="utf-8").split("\n", 1)[0].split(",")
        table = np.loadtxt(full / "signals.csv", delimiter=",", skiprows=1)
        columns = {name: table[:, k].copy() for k, name in enumerate(head)}
        edit(columns)
        (folder / "signals.csv").write_text(table_text(columns, 10), encoding="utf-8")
        return folder

    return change


def failed(found: RunComparison) -> set[str]:
    return {each.name for each in found.signals if not each.passed}


def test_what_is_stored_is_what_was_made(accepted: tuple[Path, Baseline]) -> None:
    folder, made = accepted
    read = read_baseline(folder)
    assert {path.name for path in folder.iterdir()} == {
        "baseline.json",
        "result.json",
        "scenario.toml",
        "signals.npz",
    }
    assert (folder / "scenario.toml").read_text(encoding="utf-8") == STICK_SLIP
    assert read.quantities == dict(made.quantities)
    for name, values in made.signals.values.items():
        np.testing.assert_array_equal(read.signals.values[name], values)
        assert (read.signals.lower[name] <= made.signals.lower[name]).all()
        assert (read.signals.upper[name] >= made.signals.upper[name]).all()
    assert len(read.runs) == 10
    assert not any(each["why"] for each in read.runs)


@pytest.mark.sampled(4)
def test_a_rerun_passes_at_full_rate_and_thinned(
    accepted: tuple[Path, Baseline], full: Path, place: Path
) -> None:
    fewer = run(place / "stick.toml", place / "thinned").folder
    for folder, rows in (
        (full, len(accepted[1].signals.rows)),
        (fewer, 2000),
        (accepted[0], len(accepted[1].signals.rows)),
    ):
        found = compare_folders(accepted[0], folder)
        assert found.passed, differences(found)
        assert found.rows == rows
        assert found.notes == ()


def test_rounding_that_the_baseline_has_not_seen_stays_inside(
    accepted: tuple[Path, Baseline], place: Path
) -> None:
    """The tube holds events that sticking moves: the run is not the same to the last digit, and not
    wider than allowed.
    """
    checked = build_and_check(place / "stick.toml", place)
    again = run_rounded(checked.setup, 77)
    signals = accepted[1].signals
    differing = 0
    for name, values in signals.values.items():
        got = again.signals[name][signals.rows]
        differing += not np.array_equal(got, values, equal_nan=True)
        known = np.isfinite(values)
        assert ((got >= signals.lower[name]) & (got <= signals.upper[name]))[known].all(), name
    assert differing > 5
    assert accepted[1].quantities["behaviour.stick_share"].value


def test_a_signal_that_is_off_fails_and_its_worst_point_is_named(
    accepted: tuple[Path, Baseline], altered: Any
) -> None:
    def edit(columns: dict[str, Array]) -> None:
        columns["theta"][3210] += 1e-3

    found = compare_folders(accepted[0], altered(edit))
    assert failed(found) == {"theta"}
    [worst] = [each for each in found.signals if each.name == "theta"]
    assert worst.time == pytest.approx(3.21)
    assert worst.share is not None
    assert worst.share > 1
    assert worst.low is not None
    assert worst.reference is not None
    assert worst.low < worst.reference
    [line] = differences(found)
    assert line.startswith("theta at 3.21 s: ")
    assert ", reference " in line


def test_a_signal_without_a_number_fails(accepted: tuple[Path, Baseline], altered: Any) -> None:
    def edit(columns: dict[str, Array]) -> None:
        columns["b_hat"][100] = np.nan

    found = compare_folders(accepted[0], altered(edit))
    assert failed(found) == {"b_hat"}
    assert "b_hat at 0.1 s: it is nan" in differences(found)[0]


def test_what_is_infinite_fails_in_b_and_is_not_judged_in_a(full: Path, altered: Any) -> None:
    """No warning of numpy is said of either: the tests turn them into errors."""

    def edit(columns: dict[str, Array]) -> None:
        columns["v"][100] = np.inf

    folder = altered(edit)
    assert failed(compare_folders(full, folder)) == {"v"}
    assert compare_folders(folder, full).passed


def test_a_missing_signal_fails_and_a_new_one_is_said(
    accepted: tuple[Path, Baseline], altered: Any
) -> None:
    def edit(columns: dict[str, Array]) -> None:
        columns["F_new"] = columns.pop("F")

    found = compare_folders(accepted[0], altered(edit))
    assert failed(found) == {"F"}
    assert differences(found) == ["F: B has no such signal"]
    assert found.notes == ("signals that only B has, not judged: F_new",)


def test_an_event_that_is_late_by_more_than_was_measured_fails(
    accepted: tuple[Path, Baseline], altered: Any
) -> None:
    def edit(columns: dict[str, Array]) -> None:
        columns["theta_enc"][:] = np.roll(columns["theta_enc"], 100)

    assert failed(compare_folders(accepted[0], altered(edit))) == {"theta_enc"}


@pytest.mark.sampled(4)
def test_a_percent_in_a_parameter_is_seen(accepted: tuple[Path, Baseline], place: Path) -> None:
    other = RunOptions(overrides=["plant.parameters.coulomb.Fc=0.01616 N.m"])
    found = compare_folders(accepted[0], run(place / "stick.toml", place / "percent", other).folder)
    assert not found.passed
    assert {"theta", "v", "u"} <= failed(found)
    assert any(each.passed is False for each in found.quantities)
    assert "values set by --set" in " ".join(found.notes)


@pytest.mark.sampled(4)
def test_another_duration_and_another_rate_are_said_in_one_line(
    accepted: tuple[Path, Baseline], place: Path
) -> None:
    for key, line in (
        ("duration=5 s", "A lasts 6 s, B 5 s"),
        ("step=2 ms", "the communication step is 0.001 s in A and 0.002 s in B"),
    ):
        folder = run(
            place / "stick.toml", place / key.partition("=")[0], RunOptions(overrides=[key])
        ).folder
        found = compare_folders(accepted[0], folder)
        assert not found.passed
        assert found.refused == (line,)
        assert json.loads(comparison_json(found))["verdict"] == "differs"


@pytest.mark.parametrize(
    ("kept", "said"),
    [
        # a row of thinned tables, too
        (slice(0, 1), "1999 of 2000 instants are missing, the first at 0.003 s"),
        (slice(0, 2700), "3301 of 6001 instants are missing, the first at 2.7 s"),
        (slice(1, None), "1 of 6001 instants are missing, the first at 0 s"),
        (
            np.delete(np.arange(6001), slice(1000, 1700)),
            "700 of 6001 instants are missing, the first at 1 s",
        ),
        (
            np.delete(thinned(6001), slice(500, 1200)),
            "700 of 2000 instants are missing, the first at 1.501 s",
        ),
    ],
)
def test_a_run_of_which_rows_are_missing_is_refused_on_both_sides(
    accepted: tuple[Path, Baseline],
    full: Path,
    altered: Any,
    message: Message,
    kept: Any,
    said: str,
) -> None:
    def edit(columns: dict[str, Array]) -> None:
        columns.update({name: values[kept] for name, values in columns.items()})

    folder = altered(edit)
    for sides in ((accepted[0], folder), (folder, full)):
        assert f"signals.csv: {said}; run the scenario again" in message(
            lambda sides=sides: compare_folders(*sides)
        )


def test_sides_without_the_instants_of_the_reference_are_refused(
    accepted: tuple[Path, Baseline],
) -> None:
    made = accepted[1]
    few = replace(made, signals=replace(made.signals, rows=made.signals.rows[:1]))
    assert compare_sides(made, few).refused == (
        "B lacks 1999 of 2000 instants of A, the first at 0.003 s; run the scenario of B again",
    )


@pytest.mark.sampled(4)
def test_how_many_instants_were_compared_is_said(full: Path, place: Path, tmp_path: Path) -> None:
    found = compare_folders(full, run(place / "stick.toml", place / "counted").folder)
    assert (found.rows, found.instants) == (2000, 6001)
    assert "at 2000 of the 6001 instants of A" in write_comparison(found, tmp_path).read_text(
        encoding="utf-8"
    )
    tree = json.loads((tmp_path / "compare.json").read_text(encoding="utf-8"))
    assert (tree["rows"], tree["instants"]) == (2000, 6001)


def test_where_results_come_from_is_said_in_words(
    accepted: tuple[Path, Baseline], full: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "other"
    shutil.copytree(full, folder)
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    result["provenance"] |= {"version": "9.9", "seed": 8, "scenario_sha256": "a" * 64}
    result["fmus"]["plant"]["sha256"] = "b" * 64
    (folder / "result.json").write_text(json.dumps(result), encoding="utf-8")
    found = compare_folders(accepted[0], folder)
    assert found.passed
    notes = " | ".join(found.notes)
    for words in (
        "version of bristle: ",
        "in A, 9.9 in B",
        "scenario file",
        "aaaaaaaaaaaa...",
        "seed: 3 in A, 8 in B",
        "FMU of the plant",
    ):
        assert words in notes


def test_a_run_as_reference_leaves_only_the_written_digits_open(
    full: Path, place: Path, altered: Any
) -> None:
    same = compare_folders(full, run(place / "stick.toml", place / "again").folder)
    assert same.passed
    assert "is no baseline" in same.notes[0]

    def edit(columns: dict[str, Array]) -> None:
        columns["v"] *= 1 + 1e-7

    assert failed(compare_folders(full, altered(edit))) == {"v"}


@pytest.mark.sampled(4)
def test_the_report_shows_each_signal_and_the_numbers(
    accepted: tuple[Path, Baseline], altered: Any, tmp_path: Path
) -> None:
    def edit(columns: dict[str, Array]) -> None:
        columns["u"][2000:2010] = np.nan
        columns["v"][3000] = 50.0

    page = write_comparison(
        compare_folders(accepted[0], altered(edit)), tmp_path / "report"
    ).read_text(encoding="utf-8")
    assert "u at 2 s: it is nan" in page
    assert "v at 3 s: 50" in page
    assert "behaviour.<wbr>stick_<wbr>share" in page
    assert page.index('alt="u"') < page.index('alt="theta"')  # what differs first
    tree = json.loads((tmp_path / "report" / "compare.json").read_text(encoding="utf-8"))
    assert {row["name"] for row in tree["signals"] if not row["pass"]} == {"u", "v"}


def a_comparison(courses: dict[str, SignalCourse], units: dict[str, str]) -> RunComparison:
    signals = tuple(judge_signal(name, course) for name, course in courses.items())
    return RunComparison(
        "A", "B", "case", 9000, 9000, (), signals, (), (), courses, ({}, {}), units=units
    )


def noise(scale: float, shift: float = 0.0) -> SignalCourse:
    """A signal that fills its tube at all times, which takes as many bytes as any."""
    values = shift + scale * np.random.default_rng(1).uniform(-1, 1, 9000)
    return SignalCourse(
        np.arange(9000) * 1e-3, np.full(9000, shift), values - 2 * scale, values + 2 * scale, values
    )


@pytest.mark.sampled(4)
def test_the_report_is_no_larger_than_a_megabyte() -> None:
    page = render(a_comparison({f"s{k}": noise(1.0) for k in range(30)}, {}))
    assert 0.8 * PAGE_BYTES < len(page.encode()) <= PAGE_BYTES
    drawn = page.count("<figure>")
    assert drawn >= 18
    assert f"Not drawn: {30 - drawn} more signals that move" in page


def test_drawings_have_units_and_no_power_of_ten_over_their_titles() -> None:
    page = unquote(
        render(
            a_comparison(
                {"large": noise(1e9), "far": noise(1e-9, 3.0)}, {"large": "N.m", "far": "rad/s2"}
            )
        )
    )
    assert not re.search(r"<!-- \S*\de\S* -->", page)  # what is written into a picture
    assert "<!-- 10⁹ N·m -->" in page
    assert "<!-- 10⁻⁹ rad/s² -->" in page
    assert page.count("<!-- +3 -->") == 2  # at the right of both titles
    assert "<!-- time, s -->" in page


def test_what_must_be_0_is_said_so_and_a_tube_as_its_half_width() -> None:
    time, zero = np.arange(3.0), np.zeros(3)
    least = np.full(3, float(np.nextafter(np.float32(0), np.float32(1))))  # as a baseline keeps it
    found = a_comparison(
        {
            "rest": SignalCourse(time, zero, -least, least, zero),
            "moves": SignalCourse(time, zero, -least, least, np.array([0.0, 0.0, 1.0])),
            "even": SignalCourse(time, zero + 2, zero + 1.5, zero + 2.5, zero + 2.25),
            "uneven": SignalCourse(time, zero + 2, zero + 1, zero + 2.5, zero + 2.25),
        },
        {"even": "N.m"},
    )
    assert differences(found) == ["moves at 2 s: 1, reference 0, allowed exactly 0"]
    page = render(found)
    assert page.count("exactly 0</td>") == 2
    assert "e-45" not in page
    assert "<sup>-45" not in page
    assert "10⁻⁴⁵" not in unquote(page)
    assert "over 1.00·10<sup>6</sup> %" in page
    assert "± 0.5</td>" in page
    assert "−1 to +0.5</td>" in page
    assert ">N·m</td>" in page


def test_a_result_has_the_units_of_its_signals(full: Path) -> None:
    units = json.loads((full / "result.json").read_text(encoding="utf-8"))["units"]
    head = (full / "signals.csv").read_text(encoding="utf-8").split("\n", 1)[0].split(",")
    assert {*units, "time"} == set(head)
    known = {
        "u": "V",
        "theta_enc": "rad",
        "F": "N.m",
        "reference_scale": "1",
        "b_hat": "rad/(s2.V)",
        "b_sd": "rad/(s2.V)",
        "b_valid": "1",
    }
    assert {name: units[name] for name in known} == known


def test_numbers_exist_in_all_repeated_runs_in_none_or_are_not_judged() -> None:
    def result(value: float | None) -> dict[str, Any]:
        return {
            "step_s": 1e-3,
            "estimates": {},
            "behaviour": {"x": {"unit": "s", "value": value, "why": "no x"}},
        }

    def judged(first: float | None, *others: float | None) -> Judged:
        return measured_quantities(result(first), [result(each) for each in others])["behaviour.x"]

    assert judged(1.0, 1.1, 0.95).tolerance == pytest.approx(SAFETY * 0.1)
    assert judged(None, None) == Judged("s", None, None, "no x")
    for unclear in (judged(1.0, 1.0, None), judged(None, 1.0)):
        assert not unclear.judged
        assert judge_quantity("behaviour.x", unclear, Judged("s", 5.0)).passed is None
    known = judged(1.0, 1.1)
    assert judge_quantity("behaviour.x", known, Judged("s", 1.0 + 0.099 * SAFETY)).passed
    assert judge_quantity("behaviour.x", known, Judged("s", 1.0 + 0.101 * SAFETY)).passed is False
    assert judge_quantity("behaviour.x", known, Judged("s", None)).passed is False
    assert judge_quantity("behaviour.x", known, None).passed is False
    assert judge_quantity("behaviour.x", judged(None, None), Judged("s", 1.0)).passed is False
    assert judge_quantity("behaviour.x", judged(None, None), Judged("s", None)).passed is None


def test_a_number_that_does_not_exist_has_its_own_reason() -> None:
    def whys(behaviour: Any = 1.0, **changed: Any) -> dict[str, str]:
        estimate = {
            "unit": "1/s",
            "valid": True,
            "true": 2.0,
            "final": 2.1,
            "error_percent": 5.0,
            "settling_s": 0.5,
        } | changed
        found = quantities_of(
            {"estimates": {"p": estimate}, "behaviour": {"x": {"unit": "s", "value": behaviour}}}
        )
        return {
            path.rpartition(".")[2]: each.why for path, each in found.items() if each.value is None
        }

    assert whys() == {}
    assert whys(math.nan, final="2.1", error_percent=math.nan, settling_s=True) == {
        "final": 'result.json has "2.1" there, no number',
        "error_percent": "result.json has NaN there, no number",
        "settling_s": "result.json has true there, no number",
        "x": "result.json has NaN there, no number",
    }
    assert whys(final=None, error_percent=None, settling_s=None) == {
        "final": "result.json has null there, no number",
        "error_percent": "result.json has null there, no number",
        "settling_s": "it is not settled at the end",
    }
    invalid = "the observer calls the estimate not valid at the end"
    assert whys(valid=False, final=None, settling_s=None) == {
        "final": invalid,
        "settling_s": "it is not settled at the end",
    }
    for true, why in ((None, "there is no true value"), (0.0, "the true value is 0")):
        assert whys(true=true, error_percent=None, settling_s=None) == {
            "error_percent": why,
            "settling_s": why,
        }


@pytest.mark.slow
def test_other_compilers_and_flags_make_other_files_and_only_fusing_changes_digits(
    place: Path,
) -> None:
    checked = build_and_check(place / "stick.toml", place)
    reference = run_again(checked.setup)
    plain, *fused = [each for each in toolchains() if "," not in each.name]
    assert plain.name == "without optimisation"
    other = built(checked.setup, plain)
    assert other.fmus["plant"].path != checked.setup.fmus["plant"].path
    again = run_again(other)
    assert all(
        np.array_equal(again.signals[name], values, equal_nan=True)
        for name, values in reference.signals.items()
    )
    for toolchain in [each for each in fused if each.name.startswith("fused")]:
        rounded = run_again(built(checked.setup, toolchain))
        assert not np.array_equal(rounded.signals["theta"], reference.signals["theta"])
        np.testing.assert_allclose(rounded.signals["theta"], reference.signals["theta"], atol=1e-3)


def test_a_record_is_judged_by_what_the_observer_says(scenario_file: Maker, tmp_path: Path) -> None:
    t = np.arange(0, 2, 1e-3)
    v = np.sin(2 * np.pi * t)
    columns = {
        "t": t,
        "u": 0.3 * v + 0.15 * np.sign(v),
        "theta": -np.cos(2 * np.pi * t) / (2 * np.pi),
    }
    (tmp_path / "log.csv").write_text(table_text(columns), encoding="utf-8")
    text = """
[record]
file = "log.csv"
[record.time]
column = "t"
unit = "s"
[record.input]
column = "u"
kind = "voltage"
unit = "V"
[record.output]
column = "theta"
kind = "position"
unit = "rad"
[observer]
method = "rls"
"""
    checked = build_and_check(scenario_file(text), tmp_path)
    found = make_baseline(checked, ways=uncompiled(checked))
    assert len(found.runs) == 8
    assert all(each["differs"] for each in found.runs)
    assert not any(path.startswith("behaviour") for path in found.quantities)
    folder = write_baseline(tmp_path / "kept", "case", found, text)
    compared = compare_folders(folder, run(tmp_path / "case.toml", tmp_path / "out").folder)
    assert compared.passed, differences(compared)


@pytest.mark.slow
def test_an_fmu_from_elsewhere_is_run_as_it_is(
    scenario_file: Maker, tiny_fmu: Maker, base: str, tmp_path: Path
) -> None:
    parameters = base[base.index("[plant.parameters]") : base.index("[observer]")]
    text = base.replace(parameters, "").replace('law = "modified"', f'fmu = "{tiny_fmu()}"')
    checked = build_and_check(scenario_file(text), tmp_path)
    plain = next(each for each in toolchains() if each.name == "without optimisation")
    assert built(checked.setup, plain).fmus["plant"] == checked.setup.fmus["plant"]
    found = make_baseline(checked, ways=uncompiled(checked))
    assert len(found.runs) == 8  # it has no steps of an integrator to change
    assert all(each["differs"] for each in found.runs)
    assert (
        found.quantities["behaviour.drive_work"].why
        == "the plant has no J and no b and no output F"
    )


@pytest.mark.sampled(4)
def test_a_run_that_ends_early_is_no_reference(
    scenario_file: Maker, tiny_fmu: Maker, base: str, tmp_path: Path, message: Message
) -> None:
    parameters = base[base.index("[plant.parameters]") : base.index("[observer]")]
    text = base.replace(parameters, "").replace('law = "modified"', f'fmu = "{tiny_fmu("error")}"')
    checked = build_and_check(scenario_file(text), tmp_path)
    assert "a reference needs a run that reaches its end" in message(
        lambda: make_baseline(checked, ways=[])
    )
    early = run(tmp_path / "case.toml", tmp_path / "early").folder
    whole = run(
        tmp_path / "case.toml", tmp_path / "whole", RunOptions(overrides=["duration=0.3 s"])
    ).folder
    assert compare_folders(early, early).passed  # up to where both ended
    assert "A lasts 0.3 s, B 0.5 s; B ended early: " in compare_folders(whole, early).refused[0]
    assert "A lasts 0.5 s, B 0.3 s; A ended early: " in compare_folders(early, whole).refused[0]


def test_what_is_no_reference_and_no_result_is_refused_in_one_line(
    accepted: tuple[Path, Baseline], full: Path, tmp_path: Path, message: Message
) -> None:
    assert "result.json: No such file" in message(lambda: compare_folders(tmp_path, full))
    damaged = tmp_path / "damaged"
    shutil.copytree(accepted[0], damaged)
    (damaged / "signals.npz").write_bytes((accepted[0] / "signals.npz").read_bytes()[:500])
    assert "is no complete baseline" in message(lambda: compare_folders(damaged, full))
    with np.load(accepted[0] / "signals.npz") as content:
        short = {
            name: values[..., :900] if values.ndim == 2 or name == "rows" else values
            for name, values in content.items()
        }
    np.savez_compressed(damaged / "signals.npz", **short)
    assert "is no complete baseline" in message(lambda: compare_folders(damaged, full))
    other = tmp_path / "other"
    shutil.copytree(full, other)
    (other / "signals.csv").write_text("time,u\n0,1\n0,2\n", encoding="utf-8")
    assert "its times must rise" in message(lambda: compare_folders(other, full))
    (other / "signals.csv").write_text("time,u\n0,1\n0.0015,2\n", encoding="utf-8")
    assert "no multiples of the step" in message(lambda: compare_folders(other, full))
    (other / "signals.csv").write_text("time,u\n", encoding="utf-8")
    assert "no numbers below its head" in message(lambda: compare_folders(other, full))
    for outside in ("0,1\n1e300,1", "-0.001,1\n0,1", "0,1\n6.001,1"):  # one step is enough
        (other / "signals.csv").write_text(f"time,u\n{outside}\n", encoding="utf-8")
        assert "its times must rise, from 0 to 6 s" in message(lambda: compare_folders(other, full))
    (other / "signals.csv").write_text("time,u\n0,one\n", encoding="utf-8")
    assert "no table of numbers" in message(lambda: compare_folders(other, full))
    (other / "result.json").write_text("[]", encoding="utf-8")
    assert "holds no object" in message(lambda: compare_folders(other, full))
    (other / "result.json").write_text("{}", encoding="utf-8")
    assert "is no result of bristle run" in message(lambda: compare_folders(other, full))
    assert "is no baseline of bristle" in message(
        lambda: write_baseline(full.parent, full.name, accepted[1], "")
    )


def test_json_with_too_many_brackets_is_no_baseline(tmp_path: Path, message: Message) -> None:
    (tmp_path / "result.json").write_text('{"a":' + 100_000 * "[", encoding="utf-8")
    assert message(lambda: read_json(tmp_path / "result.json")).startswith(
        f"{tmp_path / 'result.json'}: no JSON ("
    )
