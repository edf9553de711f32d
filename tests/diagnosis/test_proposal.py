"""What bristle init proposes from measured files alone, as ten loggers write those of one known
servo.
"""

import math
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from loggers import SERVO, STYLES, draw_scene, mistakes, servo_records, write_pair

from bristle.common.errors import BristleError
from bristle.diagnosis import diagnose, load_model, load_records
from bristle.diagnosis.init.proposal import propose
from bristle.diagnosis.report.proposed_model import model_text, summary, write_model
from bristle.diagnosis.report.text.said import said
from bristle.plant.servo import J

SECONDS = 7.0  # of each record: the regression needs no more
RNG = np.random.default_rng(1)


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    """The files of each logger, written when they are first asked for."""
    made = {}

    def of(name):
        if name not in made:
            made[name] = write_pair(STYLES[name], tmp_path_factory.mktemp("pair"), SECONDS)
        return made[name]

    return of


def plain(folder, header="t,u,theta", change=lambda t, u, y: (t, u, y)):
    """Write one record of the servo with other names, changed; return the file."""
    record = servo_records()[0]
    n = round(SECONDS * 1e3)
    columns = change(np.arange(n) * 1e-3, record.u[:n], record.theta[:n])
    np.savetxt(
        folder / "run.csv",
        np.column_stack(columns),
        delimiter=",",
        header=header,
        comments="",
        fmt="%.9g",
    )
    return folder / "run.csv"


@pytest.mark.parametrize("late", [0.0, 0.23e-3], ids=["at the same times", "later"])
def test_signals_may_have_rows_of_their_own(tmp_path, late):
    """As plotting tools write them: each sample is a row, in which all other fields are empty."""
    record, n = servo_records()[0], round(SECONDS * 1e3)
    t, empty = np.arange(n) * 1e-3, np.full(n, "")
    inputs = np.column_stack([t, record.u[:n], empty])
    outputs = np.column_stack([t + late, empty, record.theta[:n]])
    rows = np.stack([inputs, outputs], axis=1).reshape(-1, 3)
    path = tmp_path / "run.csv"
    np.savetxt(path, rows, delimiter=",", header="t,torque,angle", comments="", fmt="%s")
    found = propose([path])
    roles = [each.column.column for each in (found.time, found.input, found.output)]
    assert roles == ["t", "torque", "angle"]
    (tmp_path / "model.toml").write_text(model_text(found, "bristle init"))
    model = load_model(tmp_path / "model.toml")
    [given] = load_records(model, [path])
    assert np.array_equal(given.y, record.theta[:n])
    assert np.array_equal(given.u, record.u[:n])
    assert any(
        "rows of their own; taken at those of 'angle'" in said(line) for line in given.findings
    )


def test_a_column_that_nobody_uses_may_be_nearly_empty(tmp_path):
    battery = np.where(np.arange(round(SECONDS * 1e3)) % 100, np.nan, 24.0)
    path = plain(tmp_path, "t,u,theta,battery", lambda t, u, y: (t, u, y, battery))
    (tmp_path / "model.toml").write_text(model_text(propose([path]), "bristle init"))
    [given] = load_records(load_model(tmp_path / "model.toml"), [path])
    assert not any("rows of their own" in said(line) for line in given.findings)


def test_a_second_position_is_offered_as_that_of_the_load(tmp_path):
    def change(t, u, y):
        return t, u, y, y + 0.01 * np.sign(np.gradient(y))

    path = plain(tmp_path, "t [s],torque [N.m],motor angle [rad],load angle [rad]", change)
    text = model_text(propose([path]), "bristle init")
    before, offer = text.split("# [output.load]")
    written = "[output.load]" + offer.replace("\n# ", "\n")
    (tmp_path / "model.toml").write_text(before + written)
    model = load_model(tmp_path / "model.toml")
    assert {model.output.column, model.load.column} == {"motor angle [rad]", "load angle [rad]"}
    assert "[output.load]" not in model_text(propose([plain(tmp_path)]), "bristle init")


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", list(STYLES))
def test_a_pair_of_log_files_gives_a_model_that_reads_them(name, pairs, tmp_path):
    paths = pairs(name)
    found = propose(paths)
    assert mistakes(STYLES[name], found) == []
    write_model(found, tmp_path / "model.toml")
    model = load_model(tmp_path / "model.toml")
    records = load_records(model, paths)
    assert [len(record) for record in records] == [round(SECONDS * 1e3)] * 2
    for name_, rough in found.rough.items():
        full = f"coulomb.{name_}" if name_ == "Fc" else name_
        assert model.parameters[full] == rough.value
        assert model.bounds[full] == (rough.low, rough.high)


@pytest.mark.long
@pytest.mark.parametrize("name", ["german spreadsheet", "MATLAB 7.3"])
def test_a_diagnosis_takes_the_proposal_as_it_is(name, pairs, tmp_path):
    paths = pairs(name)
    write_model(propose(paths), tmp_path / "model.toml")
    model = load_model(tmp_path / "model.toml")
    found = diagnose(model, load_records(model, paths))
    assert [effect.name for effect in found.effects] == ["cogging"]


def test_the_comparison_with_the_truth_can_fail(pairs):
    style = STYLES["german spreadsheet"]
    found = propose(pairs("german spreadsheet"))
    assert (
        mistakes(replace(style, gain=2.2), found) == ["J x2.25", "a2 x2.47", "Fc x2.03"]
        or len(mistakes(replace(style, gain=2.2), found)) > 1
    )
    assert mistakes(replace(style, step=0.05), found) == [f"step {360 / 16384:.6g}"]
    assert mistakes(replace(style, units=("s", "N.m", "rad")), found) == [
        "units ('s', 'N.m', 'deg')"
    ]


def test_what_cannot_be_told_is_said_and_kept_as_a_comment(tmp_path):
    def two(t, u, y):
        return t, np.roll(u, 40), u, y

    found = propose(plain(tmp_path, "t [s],torque A [Nm],torque B [Nm],angle [rad]", two))
    assert found.input.column.column == "torque B [Nm]"
    assert any(
        line.startswith("2 columns may be the input: 'torque B [Nm]' is taken")
        for line in [said(each) for each in found.doubts]
    )
    text = model_text(found, "bristle diagnose")
    assert '# column = "torque A [Nm]"' in text
    assert tomllib.loads(text)["input"] == {
        "column": "torque B [Nm]",
        "unit": "N.m",
        "kind": "torque",
    }
    assert any("2 columns may be the input" in line for line in summary(found))
    assert (
        propose(tmp_path / "run.csv", {"input": "torque A [Nm]"}).input.column.column
        == "torque A [Nm]"
    )


def test_a_torque_comes_before_a_current_and_a_position_before_a_speed(tmp_path):
    def more(t, u, y):
        return t, u * 4, np.gradient(y, t), y, u

    found = propose(plain(tmp_path, "t [s],i [A],speed [rad/s],angle [rad],torque [Nm]", more))
    assert [each.column.column for each in (found.input, found.output)] == [
        "torque [Nm]",
        "angle [rad]",
    ]
    assert [each.column.column for each in found.others["input"]] == ["i [A]"]
    assert "input   'torque [Nm]' in N.m, torque (or 'i [A]')" in summary(found)
    assert '# kind = "current"' in model_text(found, "")


def test_a_setpoint_is_no_output_and_a_counter_no_input(tmp_path):
    def more(t, u, y):
        return np.arange(len(t)), 9 + RNG.random(len(t)), t, np.round(y), y, u

    found = propose(plain(tmp_path, "index,cycle time [ms],time,angle_ref,angle,torque", more))
    assert [each.column.column for each in (found.time, found.input, found.output)] == [
        "time",
        "torque",
        "angle",
    ]


def test_an_input_against_the_motion_is_turned(tmp_path):
    found = propose(plain(tmp_path, change=lambda t, u, y: (t, -u, y)))
    assert found.input.column.scale == "-1"
    assert found.rough["J"].value == pytest.approx(0.01, rel=0.1)
    assert "a positive 'u' moves the output backwards; its sign is turned by scale" in [
        said(each) for each in found.doubts
    ]
    assert propose(plain(tmp_path)).input.column.scale is None


def test_a_speed_without_its_sign_is_a_doubt(tmp_path):
    def unsigned(t, u, y):
        return t, u, np.abs(np.gradient(y, t))

    found = propose(plain(tmp_path, "t [s],u [V],speed [rad/s]", unsigned))
    assert any(
        "was the speed measured without its sign?" in line
        for line in [said(each) for each in found.doubts]
    )


@pytest.mark.parametrize(("lead", "output"), [(0.003, "a"), (0.06, "angle")])
def test_names_that_say_nothing_are_compared_by_what_they_explain(lead, output, tmp_path):
    """A reference and the output that follows it are one quantity, so that neither is the input of
    the other.
    """

    def unnamed(t, u, y):
        return t, y, np.interp(t + lead, t, y), u

    found = propose(plain(tmp_path, f"t,{output},b,c", unnamed))
    assert found.input.column.column == "c"
    assert found.output.column.column in (output, "b")
    assert found.output.kind == "position"


@pytest.mark.parametrize(
    ("header", "scale", "unit"),
    [
        ("t,u,y", (1.0, 1.0, 1.0), "s"),
        ("t,u,y", (1e3, 1.0, 1.0), "ms"),
        ("t,u,y", (1e6, 1.0, 1.0), "us"),
        ("t,u,y", (1000.001, 1.0, 1.0), "ms"),
        ("time (ms),u,y", (1e3, 1.0, 1.0), "ms"),
        ("a,u,y", (1.0, 1.0, 1.0), "s"),
    ],
)
def test_the_unit_of_the_time(header, scale, unit, tmp_path):
    found = propose(
        plain(
            tmp_path,
            header,
            lambda *columns: tuple(x * k for x, k in zip(columns, scale, strict=True)),
        )
    )
    assert found.time.column.unit == unit
    assert found.records[0].h == pytest.approx(1e-3, rel=1e-5)
    assert any(
        "no column is called a time" in line for line in [said(each) for each in found.doubts]
    ) == (header[0] == "a")


def test_units_that_the_user_gives(tmp_path):
    found = propose(plain(tmp_path), units={"theta": "mm", "u": "N"})
    assert (found.output.linear, found.input.kind, found.output.column.unit) == (
        True,
        "force",
        "mm",
    )
    assert found.rough["J"].value == pytest.approx(0.01e3, rel=0.1)
    load_text = tomllib.loads(model_text(found, ""))
    assert load_text["input"]["kind"] == "force"
    turned = propose(plain(tmp_path), units={"theta": "mm", "u": "Nm"})
    assert (turned.input.kind, turned.input.column.scale) == ("force", "1 1/m")
    assert any(
        "a lever of 1 m is assumed" in line for line in [said(each) for each in turned.doubts]
    )


def test_bounds_of_a_tiny_motor_stay_within_what_a_parameter_may_be(tmp_path):
    plain_file = plain(tmp_path, "t,torque,angle")
    usual = propose(plain_file).rough["J"]
    factor = 2e-9 / usual.value
    tiny = propose(plain(tmp_path, "t,torque,angle", lambda t, u, y: (t, factor * u, y)))
    assert tiny.rough["J"].value == pytest.approx(2e-9, rel=0.02)
    assert tiny.rough["J"].low == J.minimum > usual.low * factor
    tomllib.loads(model_text(tiny, "none"))


def test_what_is_no_motion_leaves_wide_bounds_and_a_guess(tmp_path):
    def steady(t, u, y):
        return t, 0.1 + 0.01 * np.sin(40 * t), 3.0 * t + 1e-3 * np.sin(40 * t + 1)

    found = propose(plain(tmp_path, "t,torque,angle", steady))
    assert found.rough["J"].error is None
    assert found.rough["J"].high > 100 * found.rough["J"].low
    assert "the records hardly show the inertia; J is a guess" in [
        said(each) for each in found.doubts
    ]


@pytest.mark.parametrize(
    ("header", "change", "asked", "words"),
    [
        (
            "a,b,c",
            lambda t, u, y: (u, y, u + y),
            {},
            "no column is likely to be the time; give it with --time COLUMN, or the sampling rate",
        ),
        (
            "t,torque,angle",
            lambda t, u, y: (t % 1.0, u, y),
            {},
            "to be the time: 't' goes back in ",
        ),
        (
            "t,torque,angle",
            lambda t, u, y: (np.floor(100 * t), u, y),
            {},
            "to be the time: 't' repeats ",
        ),
        (
            "t,speed,angle",
            lambda t, u, y: (t, y, y),
            {},
            "motion alone does not tell what moved it",
        ),
        (
            "t,torque,temp",
            None,
            {},
            "no column is likely to be the output; give it with --output COLUMN",
        ),
        (
            "t,torque,angle",
            None,
            {"input": "torq"},
            "input 'torq': is no column of numbers in every file (did you mean 'torque'?)",
        ),
        ("t,torque,angle", None, {"input": "t"}, "input 't': is another role's already"),
        (
            "t,torque,angle",
            lambda t, u, y: (t, u, 0 * y + np.sin(t) * 1e-12),
            {},
            "give the right units of the columns",
        ),
        (
            "t,torque,angle",
            lambda t, u, y: (t, u, RNG.standard_normal(len(t))),
            {},
            "nothing moves",
        ),
        ("t [s],torque,angle", lambda t, u, y: (t / 1e3, u, y), {}, "is [time] unit right"),
    ],
)
def test_where_nothing_can_be_proposed(header, change, asked, words, tmp_path):
    with pytest.raises(BristleError) as caught:
        propose(plain(tmp_path, header, change or (lambda *columns: columns)), asked)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_columns_without_names_are_told_by_their_motion(tmp_path):
    """A velocity is the derivative of a position, and no input."""

    def unnamed(t, u, y):
        return t, y, np.gradient(y, 1e-3), u

    path = plain(tmp_path, "", unnamed)
    path.write_text("\n".join(path.read_text().splitlines()[1:]))
    found = propose(path)
    assert [found.time.column.column, found.input.column.column] == ["column 1", "column 4"]
    assert (found.output.column.column, found.output.kind) == ("column 2", "position")
    assert found.rough["J"].value == pytest.approx(propose(plain(tmp_path)).rough["J"].value)


def test_a_goal_is_neither_input_nor_output(tmp_path):
    def commanded(t, u, y):
        ahead = np.interp(t + 0.02, t, y)
        return t, ahead, y, np.gradient(y, 1e-3), np.gradient(ahead, 1e-3), u

    header = "time,s.set_point,s.process_value,s.process_value_dot,s.commanded_velocity,s.effort"
    found = propose(plain(tmp_path, header, commanded))
    assert found.output.column.column == "s.process_value"
    assert found.input.column.column == "s.effort"


@pytest.mark.parametrize("rate", ["1 kHz", "1 ms", None], ids=["rate", "interval", "in the file"])
def test_a_rate_stands_for_a_time(rate, tmp_path):
    path = plain(tmp_path, "tau,q", lambda t, u, y: (u, y))
    if rate is None:
        path.write_text(f"# fs = 1 kHz\n{path.read_text()}")
    found = propose(path, rate=rate)
    write_model(found, tmp_path / "model.toml")
    model = load_model(tmp_path / "model.toml")
    assert (model.time, model.rate) == (None, pytest.approx(1e3))
    [record] = load_records(model, [path])
    assert record.h == pytest.approx(1e-3)
    assert found.rough == propose(plain(tmp_path)).rough


def test_no_time_says_how_to_give_the_rate(tmp_path):
    path = plain(tmp_path, "tau,q", lambda t, u, y: (u, y))
    with pytest.raises(BristleError, match='or the sampling rate, --rate "200 Hz"'):
        propose(path)
    with pytest.raises(BristleError, match="rate '5': '5' has no unit"):
        propose(path, rate="5")


def test_units_of_no_column_and_no_unit(tmp_path):
    path = plain(tmp_path)
    for units, words in (
        ({"x": "m"}, "unit of 'x': is no column"),
        ({"u": "furlong"}, "unit 'furlong' of 'u' is not known"),
    ):
        with pytest.raises(BristleError, match=words):
            propose(path, units=units)
    with pytest.raises(BristleError, match="no record is given"):
        propose([])
    with pytest.raises(BristleError, match="is given twice"):
        propose([path, path])


def test_the_cell_that_makes_a_column_a_text_is_named(tmp_path):
    path = plain(tmp_path, "t,torque,angle")
    lines = path.read_text().splitlines()
    lines[700] = lines[700].rpartition(",")[0] + ",ERR"
    path.write_text("\n".join(lines))
    with pytest.raises(
        BristleError, match=r"likely to be the output: 'angle' holds text \('ERR' in line 701\)"
    ):
        propose(path)


def test_files_of_other_columns_are_named(tmp_path):
    (tmp_path / "more").mkdir()
    paths = [
        plain(tmp_path, "t,torque,angle"),
        plain(tmp_path / "more", "t,torque,winkel", lambda t, u, y: (t, y, u)),
    ]
    with pytest.raises(
        BristleError,
        match=r"likely to be the output.*: torque; not in every file, .*: angle, winkel",
    ):
        propose(paths)


def test_the_loop_of_the_records_is_said(pairs):
    """Its frequency by the gain of the controller that made the records, on their inertia."""
    loop = draw_scene(np.random.default_rng(5), "rich").loop
    true = math.sqrt(loop["kp"] / SERVO["J"]) / (2 * math.pi)
    found = propose(pairs("german spreadsheet"))
    assert true / 2 < found.loop < 2 * true
    [line] = [line for line in summary(found) if line.startswith("loop")]
    assert f"about {found.loop:.2g} Hz" in line
    assert not any(line.startswith("loop") for line in summary(replace(found, loop=None)))
