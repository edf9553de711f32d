"""Records of rigs: any SI units, any speed, the sensor's step, the last sample, and a verdict
without checks.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from bristle.common.units import parse_unit
from bristle.harness.run.checked import RunOptions
from bristle.harness.run.run import FinishedRun, run
from bristle.harness.scenario.parts import build_fmus
from bristle.harness.scenario.plan import RunSetup, identification, prepare
from bristle.harness.scenario.reading import load
from bristle.harness.scenario.rig import NORMAL_INPUT, NORMAL_SPEED, Rig, normalising
from bristle.model.normalised import OBSERVED
from bristle.records import Column, Layout
from bristle.records.resolution import noise_step

Array = NDArray[np.float64]
Maker = Callable[..., Path]
Message = Callable[[Callable[[], object]], str]

PERIOD, SECONDS = 1e-3, 12.0
AXIS = {"alpha2": 2.1, "b": 0.0105, "Fc": 0.21}  # of the axis in m and N
STEP = 1e-6  # m, of its sensor


@pytest.fixture(scope="module")
def axis() -> dict[str, Array]:
    """A linear axis of 95 kg with friction like that of EMPS: time [s], force [N], position [m]."""
    rng = np.random.default_rng(5)
    n, sub = round(SECONDS / PERIOD), 10
    time = np.arange(n) * PERIOD
    force = sum(
        45.0 * np.sin(2 * math.pi * f * time + rng.uniform(0, 2 * math.pi))
        for f in (0.31, 0.83, 1.7)
    )
    x = v = w = 0.0
    position = np.empty(n)
    for k in range(n):
        position[k] = x
        for _ in range(sub):
            h = PERIOD / sub
            w += h * (AXIS["Fc"] * 5000.0 * v - 5000.0 * abs(v) * w)
            v += h * (AXIS["b"] * force[k] - w - AXIS["alpha2"] * v)
            x += h * v
    return {"t": time, "u": force, "y": np.floor(position / STEP) * STEP}


def scenario(folder: Path, columns: Mapping[str, Array], text: str, name: str = "rig") -> Path:
    """Write a record and a scenario on it."""
    np.savetxt(
        folder / f"{name}.csv",
        np.column_stack(list(columns.values())),
        delimiter=",",
        header="t,u,y",
        comments="",
        fmt="%.17g",
    )
    path = folder / f"{name}.toml"
    path.write_text(
        f'[record]\nfile = "{name}.csv"\n[record.time]\ncolumn = "t"\nunit = "s"\n{text}'
    )
    return path


def tables(
    kind: str = "force", unit: str = "N", position: str = "m", method: str = "rls", more: str = ""
) -> str:
    return (
        f'[record.input]\ncolumn = "u"\nkind = "{kind}"\nunit = "{unit}"\n[record.output]\ncolumn ='
        f' "y"\nkind = "position"\nunit = "{position}"\n{more}[observer]\nmethod = "{method}"\n'
    )


def prepared(path: Path) -> RunSetup:
    loaded = load(path)
    return prepare(loaded, build_fmus(loaded))


# -- units -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rig", "units"),
    [
        (Rig("m", "N"), ["1/s", "m/(s2.N)", "m/s2", "1/s2", "1/m", "s", "m/s"]),
        (Rig("rad", "N.m"), ["1/s", "rad/(s2.N.m)", "rad/s2", "1/s2", "1/rad", "s", "rad/s"]),
        (Rig("m", "A"), ["1/s", "m/(s2.A)", "m/s2", "1/s2", "1/m", "s", "m/s"]),
        (Rig(), ["1/s", "rad/(s2.V)", "rad/s2", "1/s2", "1/rad", "s", "rad/s"]),
    ],
)
def test_units_are_those_of_the_rig(rig: Rig, units: list[str]) -> None:
    names = ("alpha2", "b", "Fc", "sigma0", "c", "tau", "vc")
    assert [rig.unit(OBSERVED[name][0]) for name in names] == units


def test_every_published_unit_is_read_by_the_scaling() -> None:
    """b u, c v, Fc, sigma_i v keep their meaning: what one unit is worth follows from the equations
    of motion.
    """
    angle, voltage = 7.0, 3.0
    rig = Rig("m", "N", angle, voltage)
    worth = {name: rig.worth(unit) for name, (unit, _) in OBSERVED.items()}
    assert worth["b"] * voltage == pytest.approx(angle)  # b u is an acceleration
    assert worth["c"] * angle == pytest.approx(1.0)  # c v is a rate
    assert worth["Fc"] == worth["load"] == angle
    assert (
        worth["alpha2"]
        == worth["sigma0"]
        == worth["tau"]
        == worth["delay"]
        == worth["width"]
        == 1.0
    )
    for unit, _ in OBSERVED.values():
        parse_unit(rig.unit(unit))


LAYOUT = Layout(
    time=Column(column="t", unit="s"),
    input=Column(column="u", unit="N"),
    input_kind="force",
    output=Column(column="y", unit="m"),
    output_kind="position",
    linear=True,
)


def test_a_record_is_scaled_to_the_speed_and_input_that_observers_are_made_for() -> None:
    time = np.arange(20_000) * 1e-3
    y, u = 0.03 * np.sin(2 * time), 40.0 * np.cos(2 * time)
    rig = normalising(LAYOUT, 1e-3, y, u)
    assert (rig.position, rig.input) == ("m", "N")
    moving = np.abs(np.cos(2 * time)) > 0.1 * math.sqrt(0.5)
    speed = 0.06 * math.sqrt(np.mean(np.cos(2 * time[moving]) ** 2))
    assert rig.angle * speed == pytest.approx(NORMAL_SPEED, rel=1e-3)
    assert rig.voltage * np.sqrt(np.mean(u**2)) == pytest.approx(NORMAL_INPUT)
    rested = np.concatenate([np.full(40_000, y[0]), y])
    assert normalising(LAYOUT, 1e-3, rested, u).angle == pytest.approx(rig.angle, rel=0.02)


def test_the_steps_of_a_sensor_hardly_count_in_the_speed() -> None:
    """At 0.5 ms a count of this sensor is as fast as the axis."""
    time = np.arange(40_000) * 5e-4
    y = 0.03 * np.sin(2 * time)
    coarse = np.floor(y / 3e-5) * 3e-5
    exact = normalising(LAYOUT, 5e-4, y, time + 1)
    assert normalising(LAYOUT, 5e-4, coarse, time + 1).angle == pytest.approx(exact.angle, rel=0.02)


def test_a_record_at_rest_is_not_scaled() -> None:
    rig = normalising(LAYOUT, 1e-3, np.full(100, 0.3), np.zeros(100))
    assert (rig.angle, rig.voltage) == (1.0, 1.0)


def same_answers(
    one: FinishedRun, other: FinishedRun, position: float = 1.0, drive: float = 1.0
) -> None:
    """Compare all estimates; the other record has the numbers of position and input times these
    factors.
    """
    worth = {"b": position / drive, "c": 1 / position, "Fc": position, "load": position}
    assert set(one.result["estimates"]) == set(other.result["estimates"])
    for name, each in one.result["estimates"].items():
        twin = other.result["estimates"][name]
        assert (each["valid"], each["adapted"]) == (twin["valid"], twin["adapted"])
        for key in ("final", "sd", "moved"):
            if each[key] is None or math.isnan(each[key]):
                assert twin[key] is None or math.isnan(twin[key])
            else:
                assert twin[key] == pytest.approx(worth.get(name, 1.0) * each[key], rel=1e-5), (
                    name,
                    key,
                )


@pytest.mark.sampled(4)
@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("method", ["rls", "self_starting_ekf"])
def test_answers_do_not_depend_on_the_units_of_the_file(
    method: str, axis: dict[str, Array], tmp_path: Path
) -> None:
    plain = run(scenario(tmp_path, axis, tables(method=method)), tmp_path / "out")
    small = {**axis, "u": axis["u"] * 1e3, "y": axis["y"] * 1e3}
    same_answers(
        plain,
        run(
            scenario(tmp_path, small, tables("force", "mN", "mm", method), "small"),
            tmp_path / "out",
        ),
    )
    turning = {**axis, "u": axis["u"] * 0.02, "y": np.degrees(axis["y"] * 40)}
    same_answers(
        plain,
        run(
            scenario(tmp_path, turning, tables("torque", "N.m", "deg", method), "turning"),
            tmp_path / "out",
        ),
        40.0,
        0.02,
    )
    for name, value in AXIS.items():
        assert plain.result["estimates"][name]["final"] == pytest.approx(value, rel=0.1), name


@pytest.mark.usefixtures("undrawn")
def test_estimates_signals_and_csv_are_in_the_units_of_the_rig(
    axis: dict[str, Array], tmp_path: Path
) -> None:
    done = run(
        scenario(tmp_path, axis, tables(method="self_starting_ekf")),
        tmp_path / "out",
        RunOptions(full=True),
    )
    assert {
        name: done.result["estimates"][name]["unit"] for name in ("b", "c", "Fc", "alpha2")
    } == {
        "b": "m/(s2.N)",
        "c": "1/m",
        "Fc": "m/s2",
        "alpha2": "1/s",
    }
    table = np.genfromtxt(done.folder / "signals.csv", delimiter=",", names=True)
    assert len(table) == len(axis["t"])
    np.testing.assert_allclose(table["theta"], axis["y"], atol=1e-9)
    np.testing.assert_allclose(table["u"], axis["u"], rtol=1e-9)
    np.testing.assert_allclose(table["theta_hat"][5000:], axis["y"][5000:], atol=2 * STEP)
    speed = np.gradient(axis["y"], PERIOD)[5000:]
    assert np.sqrt(np.mean((table["v_hat"][5000:] - speed) ** 2)) < 0.05 * np.sqrt(
        np.mean(speed**2)
    )
    assert table["b_hat"][-1] == pytest.approx(done.result["estimates"]["b"]["final"], rel=1e-6)


def test_parameters_are_given_in_the_units_of_the_rig(
    axis: dict[str, Array], tmp_path: Path, message: Message
) -> None:
    given = tables() + '[observer.parameters]\nrls.vc = "20 mm/s"\n'
    setup = prepared(scenario(tmp_path, axis, given))
    assert setup.values["observer"]["rls.vc"] == pytest.approx(0.02 * setup.rig.angle)
    wrong = scenario(tmp_path, axis, given.replace("20 mm/s", "20 rad/s"))
    assert 'observer.parameters.rls.vc = "20 rad/s": unit' in message(lambda: prepared(wrong))
    far = scenario(tmp_path, axis, given.replace("20 mm/s", "-1 m/s"))
    line = message(lambda: prepared(far))
    assert f"outside [0, {1e3 / setup.rig.angle:g}] m/s" in line


def test_a_foreign_observer_reads_the_record_as_it_is(
    axis: dict[str, Array], tmp_path: Path, tiny_fmu: Maker
) -> None:
    """Nobody knows what speed it is made for."""
    text = tables().replace('method = "rls"', f'fmu = "{tiny_fmu()}"')
    setup = prepared(scenario(tmp_path, axis, text))
    [values] = identification(setup).series.values()
    assert np.array_equal(values, axis["u"])


# -- the sensor ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("more", "given", "step"),
    [
        ("resolution = 3e-6\n", "", 3e-6),
        ('resolution = "2 um"\n', "", 2e-6),
        ("", "", STEP),
        (
            "resolution = 3e-6\n",
            '[observer.parameters]\nself_starting_ekf.resolution = "5 um"\n',
            5e-6,
        ),
    ],
)
def test_the_observer_is_told_the_step_of_the_sensor(
    more: str, given: str, step: float, axis: dict[str, Array], tmp_path: Path
) -> None:
    setup = prepared(
        scenario(tmp_path, axis, tables(method="self_starting_ekf", more=more) + given)
    )
    assert setup.values["observer"]["self_starting_ekf.resolution"] == pytest.approx(
        step * setup.rig.angle, rel=0.05
    )


def test_noise_counts_as_the_step_of_a_sensor() -> None:
    time = np.arange(20_000) * 1e-3
    motion = np.sin(3 * time)
    noise = np.random.default_rng(1).normal(size=len(time))
    assert noise_step(motion + 1e-3 * noise) == pytest.approx(1e-3 * math.sqrt(12), rel=0.03)
    assert noise_step(np.floor(motion / 1e-4) * 1e-4) == pytest.approx(1e-4, rel=0.05)
    assert noise_step(motion) < 1e-12
    assert noise_step(motion[:4]) == 0.0


def test_no_step_is_told_where_no_position_is_measured(
    axis: dict[str, Array], tmp_path: Path
) -> None:
    text = (
        tables(method="self_starting_ekf")
        .replace('"position"', '"velocity"')
        .replace('"m"', '"m/s"')
    )
    setup = prepared(scenario(tmp_path, {**axis, "y": np.gradient(axis["y"], PERIOD)}, text))
    assert "self_starting_ekf.resolution" not in setup.values["observer"]


# -- sampling --------------------------------------------------------------------------------------


@pytest.mark.sampled(4)
@pytest.mark.usefixtures("undrawn")
def test_the_last_sample_counts(axis: dict[str, Array], tmp_path: Path) -> None:
    """A position that jumps in the last sample reaches the estimate of the velocity there, which is
    a difference.
    """
    jump = axis["y"].copy()
    jump[-1] += 0.05
    steady, jumped = (
        run(
            scenario(tmp_path, {**axis, "y": y}, tables(), name),
            tmp_path / "out",
            RunOptions(full=True),
        )
        for name, y in (("steady", axis["y"]), ("jumped", jump))
    )
    assert steady.result["steps"] == steady.result["record"]["samples"] == len(axis["t"])
    before, after = (
        np.genfromtxt(done.folder / "signals.csv", delimiter=",", names=True)
        for done in (steady, jumped)
    )
    assert len(before) == len(axis["t"])
    assert before["time"][-1] == pytest.approx(axis["t"][-1])
    np.testing.assert_allclose(before["v_hat"][:-1], after["v_hat"][:-1], rtol=1e-3, atol=1e-4)
    assert after["v_hat"][-1] - before["v_hat"][-1] == pytest.approx(0.05 / PERIOD, rel=1e-3)


@pytest.mark.parametrize(
    ("h", "noted"), [(0.5e-3, False), (20e-3, False), (0.2e-3, True), (50e-3, True)]
)
def test_a_period_at_which_observers_are_not_tried_is_noted(
    h: float, noted: bool, tmp_path: Path
) -> None:
    time = np.arange(400) * h
    setup = prepared(
        scenario(tmp_path, {"t": time, "u": np.sin(3 * time), "y": np.cos(2 * time)}, tables())
    )
    assert setup.samples is not None
    assert [
        line for line in setup.samples.findings if "observers are tried at 0.0005 to 0.02 s" in line
    ] == (
        [
            f"record rig: sampled every {h:g} s; observers are tried at 0.0005 to 0.02 s: read"
            " their estimates with care"
        ]
        * noted
    )


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("every", [5, 20])
def test_slow_sampling_gives_the_same_parameters(
    every: int, axis: dict[str, Array], tmp_path: Path
) -> None:
    """An input that is held longer than a sample would be seen late; this one is averaged over
    each, as a drive's log may be.
    """
    n = len(axis["t"]) // every * every
    held = axis["u"][:n].reshape(-1, every).mean(axis=1)
    slow = {"t": axis["t"][:n:every], "u": held, "y": axis["y"][:n:every]}
    found = run(scenario(tmp_path, slow, tables()), tmp_path / "out").result["estimates"]
    assert found["b"]["final"] == pytest.approx(AXIS["b"], rel=0.1)


# -- the verdict -----------------------------------------------------------------------------------


def test_without_checks_the_observer_itself_says_whether_it_holds(
    axis: dict[str, Array], tmp_path: Path
) -> None:
    done = run(scenario(tmp_path, axis, tables(method="self_starting_ekf")), tmp_path / "out")
    assert [(check["name"], check["pass"]) for check in done.result["checks"]] == [
        ("adapted", True),
        ("innovation", True),
        ("alpha2 valid", True),
        ("b valid", True),
    ]
    assert done.passed
    assert done.findings == ()


def test_a_record_that_teaches_nothing_fails_and_says_why(
    axis: dict[str, Array], tmp_path: Path
) -> None:
    short = {key: values[:300] for key, values in axis.items()}
    done = run(scenario(tmp_path, short, tables(method="self_starting_ekf")), tmp_path / "out")
    assert not done.passed
    [line] = done.findings
    assert line.startswith(
        "No checks are given, so the verdict is what the observer says of itself: it has not"
        " adapted"
    )
    assert line in done.result["notes"]
    assert "has not adapted since the start" in (done.folder / "report.html").read_text()


@pytest.mark.usefixtures("undrawn")
def test_innovations_beyond_the_claim_fail(axis: dict[str, Array], tmp_path: Path) -> None:
    """A sensor that is called a thousand times finer than it is makes every innovation too
    large.
    """
    text = tables(method="self_starting_ekf", more="resolution = 1e-9\n")
    done = run(scenario(tmp_path, axis, text), tmp_path / "out")
    assert not done.passed
    innovation = next(check for check in done.result["checks"] if check["name"] == "innovation")
    assert innovation["value"] == done.result["innovation"] > innovation["limit"] == 4.0
    wide = run(
        scenario(
            tmp_path,
            axis,
            text + "[observer.parameters]\nself_starting_ekf.innovation_limit = 1e9\n",
        ),
        tmp_path / "out",
    )
    assert (
        next(check for check in wide.result["checks"] if check["name"] == "innovation")["limit"]
        == 1e9
    )
    assert "its mean squared innovation is" in done.findings[-1]


def test_what_is_not_valid_fails_a_check_on_it(axis: dict[str, Array], tmp_path: Path) -> None:
    short = {key: values[:300] for key, values in axis.items()}
    text = (
        tables(method="self_starting_ekf")
        + '[[checks]]\nquantity = "estimates.b.final"\nmin = -1e300\n'
    )
    done = run(scenario(tmp_path, short, text), tmp_path / "out")
    assert not done.passed
    assert done.findings == ()


# -- the report ------------------------------------------------------------------------------------


def test_the_report_of_a_record_speaks_of_no_truth(axis: dict[str, Array], tmp_path: Path) -> None:
    done = run(scenario(tmp_path, axis, tables(method="self_starting_ekf")), tmp_path / "out")
    page = (done.folder / "report.html").read_text(encoding="utf-8")
    words = page[page.index("<body>") : page.index("The scenario file")]
    words = " ".join(
        part.partition(">")[2] for part in words.split("<") if not part.startswith("img")
    )
    for word in ("true value", "error", "settled", "plant", "simulated"):
        assert word not in words.lower(), word
    assert "standard deviation" in words
    assert "m/(s²·N)" in words


@pytest.mark.usefixtures("undrawn")
def test_two_runs_differ_in_nothing_but_date_and_time_taken(
    axis: dict[str, Array], tmp_path: Path
) -> None:
    path = scenario(tmp_path, axis, tables(method="self_starting_ekf"))
    texts = []
    for _ in range(2):
        result = json.loads((run(path, tmp_path / "out").folder / "result.json").read_text())
        del result["wall_s"], result["timing"], result["provenance"]["date"]
        texts.append(result)
    assert texts[0] == texts[1]
