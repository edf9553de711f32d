"""Records: what is wrong with one is repaired and reported, or the record is refused in one
line.
"""

import subprocess
import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from bristle import records
from bristle.records import Record, Requirements
from bristle.records.clock import must_agree
from bristle.records.intake import must_show
from bristle.records.layout import LayoutTable, layout_of
from bristle.records.resolution import common_step

NEEDS = Requirements(
    samples=200, duration=2.0, shortest_period=1e-5, longest_period=0.1, identification=True
)
read_records = partial(records.read_records, needs=NEEDS)
records_from_arrays = partial(records.records_from_arrays, needs=NEEDS)
H = 1e-3
N = 6000
STEP = 2 * np.pi / 4096


@pytest.fixture
def tree():
    """The tables of a model file that describe its records, to be changed."""
    return {
        "time": {"column": "t", "unit": "s"},
        "input": {"column": "u", "kind": "torque", "unit": "N.m"},
        "output": {"column": "theta", "kind": "position", "unit": "rad"},
    }


def from_tree(tree):
    return layout_of(LayoutTable.model_validate(tree), "tree")


@pytest.fixture
def layout(tree):
    """A servo driven by a torque, with its position measured."""
    return from_tree(tree)


def motion(n=N, h=H, seed=0):
    """A smooth motion over two turns, and a torque."""
    t = np.arange(n) * h
    y = 6.0 * np.sin(1.3 * t + seed) + 0.8 * np.sin(5.1 * t)
    u = 0.3 * np.sin(2.1 * t) + 0.2 * np.sin(7.3 * t + 1)
    return t, u, y


def counts(y, step=STEP):
    return np.floor(y / step) * step


def holes(values, where, with_=np.nan):
    """Return values with others that are not finite at some samples."""
    values = values.copy()
    values[list(where)] = with_
    return values


def one(layout, t, u, y):
    [record] = records_from_arrays(layout, [("run", t, u, y)])
    return record


def said(record):
    """Return the findings, but for that on the steps of the output."""
    return tuple(
        line for line in record.findings if not line.startswith("the output moves in steps")
    )


def only(record, *words):
    """The record has one finding, with these words, and it names the record."""
    [line] = said(record)
    assert line.startswith("record run")
    assert "\n" not in line
    for word in words:
        assert word in line, line


# -- what is right stays as it is ------------------------------------------------------------------


def test_a_good_record_is_not_touched(layout):
    t, u, y = motion()
    record = one(layout, t + 7.0, u, counts(y))
    assert isinstance(record, Record)
    assert record.findings == ("the output moves in steps of 0.00153 rad (4096 a turn)",)
    assert record.name == "run"
    assert record.h == pytest.approx(H, rel=1e-12)
    np.testing.assert_allclose(record.time, t + 7.0, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(record.u, u)
    np.testing.assert_array_equal(record.y, counts(y))
    assert record.resolution == pytest.approx(STEP, rel=1e-6)
    assert not record.wrapped
    assert not record.resampled
    assert len(record) == N


def test_files_in_their_own_units(tree, tmp_path):
    runs = {"one": motion(), "two": motion(seed=1)}
    tree["time"]["unit"] = "ms"
    tree["input"] |= {"unit": "mN.m", "scale": "-1"}
    tree["output"] |= {"unit": "1", "scale": "0.087890625 deg", "resolution": 1}
    layout = from_tree(tree)
    for folder, (t, u, y) in runs.items():
        (tmp_path / folder).mkdir()
        table = np.column_stack([t * 1e3, -u * 1e3, np.floor(y / STEP)])
        np.savetxt(
            tmp_path / folder / "run.csv",
            table,
            delimiter=",",
            header="t,u,theta",
            comments="",
            fmt="%.12g",
        )
    records = read_records(layout, [tmp_path / "one" / "run.csv", tmp_path / "two" / "run.csv"])
    assert [r.name for r in records] == ["one/run", "two/run"]
    for record, (_, u, y) in zip(records, runs.values(), strict=True):
        assert record.findings == ()
        assert record.h == pytest.approx(H)
        np.testing.assert_allclose(record.u, u, atol=1e-9)
        np.testing.assert_allclose(record.y, counts(y), atol=1e-9)
        assert record.resolution == pytest.approx(layout.resolution, rel=1e-6)


def test_records_that_share_a_name_keep_their_folders(layout, tmp_path):
    places = ["a/rig/run.csv", "b/rig/run.csv", "a/run.csv", "a/rest.csv", "a/rest.npz"]
    for seed, place in enumerate(places):
        path = tmp_path / place
        path.parent.mkdir(parents=True, exist_ok=True)
        t, u, theta = motion(seed=seed)
        if path.suffix == ".npz":
            np.savez(path, t=t, u=u, theta=theta)
        else:
            np.savetxt(
                path, np.column_stack([t, u, theta]), delimiter=",", header="t,u,theta", comments=""
            )
    names = [record.name for record in read_records(layout, [tmp_path / place for place in places])]
    assert names == ["a/rig/run", "b/rig/run", "a/run", "rest.csv", "rest.npz"]


def test_a_velocity_is_neither_unwrapped_nor_mistaken(tree):
    tree["output"] |= {"kind": "velocity", "unit": "rad/s"}
    t, u, _ = motion()
    v = np.where(np.arange(N) // 1500 % 2 == 0, 3.0, -3.2831853) + 0.001 * np.sin(t)
    record = one(from_tree(tree), t, u, v)
    np.testing.assert_array_equal(record.y, v)


# -- time ------------------------------------------------------------------------------------------


def test_jitter_is_interpolated_away(layout):
    rng = np.random.default_rng(1)
    n, h = 1200, 5.4e-3
    t = np.cumsum(h * (1 + 0.05 * rng.standard_normal(n)))
    y, u = np.sin(3 * t), 0.3 * np.sin(2 * t)
    record = one(layout, t, u, y)
    only(record, "scatter by 5.", "rms", "interpolated")
    assert record.resampled
    np.testing.assert_allclose(np.diff(record.time), record.h, rtol=1e-9)
    np.testing.assert_allclose(record.y, np.sin(3 * record.time), atol=2e-4)
    # the input is held: u[k] stands for what lay in the interval after it
    middle = record.time + record.h / 2
    held = 0.3 * np.sin(2 * (middle - h / 2))
    np.testing.assert_allclose(record.u[5:-5], held[5:-5], atol=3e-3)


def test_a_rounded_clock_is_no_jitter(layout):
    t, u, y = motion(n=2400, h=2.5e-3)
    record = one(layout, np.round(t + 1e-6, 3), u, y)
    only(record, "steps of 0.001 s", "0.0025 s a sample")
    assert record.h == pytest.approx(2.5e-3, rel=1e-5)
    np.testing.assert_array_equal(record.y, y)


def test_a_missing_sample_is_bridged(layout):
    t, u, y = motion()
    keep = np.ones(N, dtype=bool)
    keep[[1000, 3000]] = False
    record = one(layout, t[keep], u[keep], y[keep])
    assert len(record) == N
    assert "missing at 2 places (first after 0.999 s)" in record.findings[0]
    np.testing.assert_allclose(record.y, y, atol=1e-4)


def test_a_gap_cuts_the_record(layout):
    t, u, y = motion(n=9000)
    keep = np.ones(9000, dtype=bool)
    keep[4000:4100] = False
    keep[8000:8050] = False
    first, second = records_from_arrays(layout, [("run", t[keep], u[keep], y[keep])])
    assert (first.name, second.name) == ("run[1]", "run[2]")
    assert len(first) == 4000
    assert second.time[0] == pytest.approx(4.1)
    assert any(
        "gaps in time: 2" in line and "0.101 s after 3.999 s" in line for line in first.findings
    )
    assert any("run[3] left out: only 0.949 s" in line for line in first.findings)
    np.testing.assert_array_equal(second.y, y[4100:8000])


def test_gaps_that_leave_nothing(layout, message):
    t, u, y = motion()
    t = t + 0.05 * (np.arange(N) // 1500)
    text = message(lambda: one(layout, t, u, y))
    assert "no piece between gaps lasts 2 s" in text
    assert text.startswith("record run: ")


def test_repeated_time_stamps(layout, message):
    t, u, y = motion()
    twice = np.insert(np.arange(N), 2000, 2000)
    record = one(layout, t[twice], u[twice], y[twice])
    only(record, "1 time stamps repeat", "sample 2001")
    np.testing.assert_array_equal(record.y, y)
    text = message(lambda: one(layout, np.round(t, 2), u, y))
    assert "of 6000 time stamps repeat" in text
    assert "more digits" in text


def test_time_of_the_day_is_counted_from_the_first_record(layout):
    t, u, y = motion()
    start = 1.7e9
    records = records_from_arrays(layout, [("a", t + start, u, y), ("b", t + start + 60, u, y)])
    assert records[0].time[0] == 0.0
    assert records[1].time[0] == pytest.approx(60.0)
    assert "counted from the first record" in records[0].findings[0]
    logger = records_from_arrays(
        layout, [("a", t + 500, u, y), ("b", t + 560, u, y), ("c", t, u, -y)]
    )
    # the last has a clock of its own
    assert [record.time[0] for record in logger] == pytest.approx([0.0, 60.0, 0.0])
    mixed = records_from_arrays(layout, [("a", t, u, y), ("b", t + start, u, y)])
    assert [record.time[0] for record in mixed] == pytest.approx([0.0, 0.0])
    later = records_from_arrays(layout, [("a", t, u, y), ("b", t + 60, u, y)])
    assert later[1].time[0] == pytest.approx(60.0)
    assert later[1].findings == ()


def test_records_of_different_rates_get_the_coarser(layout):
    t, u, y = motion()
    slow = motion(n=1500, h=4e-3)
    fast, other = records_from_arrays(layout, [("fast", t, u, y), ("slow", *slow)])
    assert fast.h == other.h == pytest.approx(4e-3)
    assert "sampled every 0.001 s, another record every 0.004 s" in fast.findings[0]
    assert other.findings == ()
    np.testing.assert_array_equal(other.y, slow[2])
    np.testing.assert_allclose(fast.y, slow[2][: len(fast)], atol=1e-6)
    np.testing.assert_allclose(
        fast.u[:-1], u.reshape(-1, 4).mean(axis=1)[: len(fast) - 1], atol=1e-12
    )


def test_nearly_the_same_rate_is_the_same(layout):
    t, u, y = motion()
    one_, two = records_from_arrays(layout, [("a", t, u, y), ("b", t * 1.0002, u, y)])
    assert one_.h == two.h
    assert not two.resampled
    assert one_.findings == two.findings == ()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t, u, y: (t[:150], u[:150], y[:150]), ["150 samples", "at least 200"]),
        (
            lambda t, u, y: (t[:900], u[:900], y[:900]),
            ["lasts 0.899 s", "at least 2 s", "[time] unit"],
        ),
        (lambda t, u, y: (t * 1000, u, y), ["sampled every 1 s", "[time] unit", "ms"]),
        (lambda t, u, y: (t / 1000, u, y), ["sampled every 1e-06 s", "[time] unit"]),
        (lambda t, u, y: (t / 101, u, y), ["sampled every 9.90099e-06 s; allowed are 1e-05"]),
        # 1e-5 s, as far as a float can tell
        (lambda t, u, y: (t / 100, u, y), ["lasts 0.05999 s", "[time] unit"]),
        (lambda t, u, y: (t[::-1], u, y), ["decreases at sample 1", "sort"]),
        (
            lambda t, u, y: (np.where(t > 3, t - 3, t), u, y),
            ["decreases at sample 3001", "two runs"],
        ),
        (lambda t, u, y: (t + 0.8 * H * np.random.default_rng(1).random(N) ** 4, u, y), None),
        (
            lambda t, u, y: (t + 0.8 * H * (np.arange(N) % 2), u, y),
            ["scatter by 63%", "steady clock"],
        ),
        (
            lambda t, u, y: (t, holes(u, range(71, 77)), y),
            ["input is not finite at 6 of 6000 samples (first at sample 71, at most 6 in a"],
        ),
        (
            lambda t, u, y: (t, u, holes(y, range(72, N - 1, 40))),
            ["output is not finite at 149", "2% in all are interpolated"],
        ),
        (lambda t, u, y: (t, u, y * np.nan), ["no sample is finite"]),
        (lambda t, u, y: (t, 0 * u + 0.2, y), ["input is constant (0.2 N.m)", "[input] column"]),
        (lambda t, u, y: (t, u, 0 * y + 3.0), ["nothing moves", "[output] column"]),
        (lambda t, u, y: (t, u, counts(1e-3 * y, 5e-3)), ["nothing moves", "resolution"]),
        (lambda t, u, y: (t, u[:-1], y), ["different length", "input 5999"]),
        (
            lambda t, u, y: (t, u, 1e300 * y),
            ["output reaches 6.6", "e+300 rad, allowed 1e-30 to 1e+30"],
        ),
        (
            lambda t, u, y: (t, 1e-300 * u, y),
            ["input reaches", "e-301 N.m, allowed 1e-30 to 1e+30"],
        ),
        (lambda t, u, y: (t, 1e300 * u, y), ["input reaches", "e+299 N.m", "check its column"]),
        (lambda t, u, y: (t, u, np.column_stack([y, y])), ["output has shape (6000, 2)"]),
        (lambda t, u, y: (t, u, ["fast"] * N), ["output is not an array of numbers"]),
    ],
)
def test_what_cannot_be_repaired_is_refused_in_one_line(change, words, layout, message):
    data = change(*motion())
    if words is None:  # jitter that is moderate
        assert one(layout, *data).resampled
        return
    text = message(lambda: one(layout, *data))
    assert text.startswith("record run: ")
    for word in words:
        assert word in text, text


RNG = np.random.default_rng(5)
WHITE = RNG.standard_normal(N)


@pytest.mark.parametrize(
    "noise", [1e-4 * WHITE + 2.0, STEP * RNG.integers(0, 2, N), 1e-3 * RNG.standard_t(2, N)]
)
def test_noise_alone_is_no_motion(noise, layout, message):
    t, u, _ = motion()
    for input_ in (u, RNG.standard_normal(N)):
        text = message(lambda input_=input_: one(layout, t, input_, noise))
        assert text.startswith("record run: nothing moves: all that the output shows is noise of ")
        assert "[output] column, and give a record with motion" in text


@pytest.mark.parametrize(
    "y",
    [
        WHITE + 0.5 * np.linspace(0, 1, N),  # creep
        WHITE + 0.4 * (np.arange(N) > 4000),  # a slip
        STEP * np.round(0.6 * WHITE + 0.5 * motion()[1]),  # presliding of a fraction of a count
        STEP * np.floor(3 * np.sin(motion()[0])),
        motion()[2] + 1e9 * (np.arange(N) == 3),  # the spectrum of an outlier is even
    ],
)
def test_motion_far_below_the_noise_is_motion(y, layout):
    t, u, _ = motion()
    assert len(one(layout, t, u, y)) == N


def test_a_servo_that_rests_nearly_all_of_the_time_moves(layout):
    """A bump of ten samples is as good as white, and ranks do not tell how large it is."""
    t = 0.01 * np.arange(6000)
    y = 1e-4 * np.random.default_rng(5).standard_normal(6000)
    y[3000:3030] += 0.1 * np.hanning(30)
    assert len(one(layout, t, 0.5 * (np.arange(6000) // 700 % 2) - 0.25, y)) == 6000


def test_an_output_as_white_as_noise_that_follows_the_input_is_motion(tree):
    tree["output"] |= {"kind": "velocity", "unit": "rad/s"}
    t, _, _ = motion()
    u = RNG.standard_normal(N)
    assert len(one(from_tree(tree), t, u, WHITE + 0.2 * np.roll(u, 1))) == N


def test_no_record_and_wrong_entries(layout, message, tmp_path):
    assert "no record" in message(lambda: read_records(layout, []))
    assert "no record" in message(lambda: records_from_arrays(layout, []))
    for entry in (("a", [0.0], [0.0]), 1, "abcd"):
        assert "is not (name, time, u, y)" in message(
            lambda entry=entry: records_from_arrays(layout, [entry])
        )
    assert "the records are no list" in message(lambda: records_from_arrays(layout, None))
    assert "the layout is a str; give a Layout" in message(
        lambda: records_from_arrays("model.toml", [])
    )
    assert "the layout is a str; give a Layout" in message(
        lambda: read_records("model.toml", tmp_path / "r.csv")
    )
    t, u, y = motion()
    assert "b: is the same as a" in message(
        lambda: records_from_arrays(layout, [("a", t, u, y), ("b", t, u, y)])
    )
    assert "input is not an array of numbers" in message(
        lambda: records_from_arrays(layout, [("a", t, u * 1j, y)])
    )
    np.savetxt(
        tmp_path / "r.csv",
        np.column_stack(motion()),
        delimiter=",",
        header="t,torque,theta",
        comments="",
    )
    text = message(lambda: read_records(layout, [tmp_path / "r.csv"]))
    assert "r.csv: input: no column 'u'" in text
    assert "t, torque, theta" in text


def test_arguments_of_another_kind_are_one_line(layout, message):
    t, u, y = motion()
    for wrong, named in (
        ([3], "paths[0] is 3"),
        (3, "paths is 3"),
        (["", None], "paths[0] is ''"),
        (None, "paths is None"),
    ):
        assert f"{named}; give a path" in message(lambda wrong=wrong: read_records(layout, wrong))
    assert "record 3: its name is a int" in message(
        lambda: records_from_arrays(layout, [(3, t, u, y)])
    )
    assert "record a: two records have this name" in message(
        lambda: records_from_arrays(layout, [("a", t, u, y), ("a", t, y, u)])
    )
    assert "record a: holds no sample" in message(
        lambda: records_from_arrays(layout, [("a", [], [], [])])
    )
    dated = (t * 1e6).astype("datetime64[us]")
    assert "time is not an array of numbers but of timestamps" in message(
        lambda: one(layout, dated, u, y)
    )


def test_the_same_record_in_another_format_is_a_copy(layout, message):
    t, u, y = motion()
    written = [np.array([float(f"{x:.7g}") for x in column]) for column in (t, u, y)]
    assert "record b: is the same as a" in message(
        lambda: records_from_arrays(layout, [("a", t, u, y), ("b", *written)])
    )
    assert len(records_from_arrays(layout, [("a", t, u, y), ("b", t, u, y + 1e-4 * WHITE)])) == 2


def test_masked_samples_are_missing(layout, message):
    t, u, y = motion()
    assert len(one(layout, t, u, np.ma.masked_where(t < 0.01, y))) == N - 10
    only(
        one(layout, t, np.ma.masked_where(t == t[70], u), y),
        "input is not finite at 1 of 6000 samples (first at sample 70",
    )


def test_a_record_made_by_hand_is_checked(message):
    t, u, y = motion()
    made = Record("run", t.tolist(), H, u.tolist(), y.tolist())
    assert all(column.dtype == float and len(column) == N for column in (made.time, made.u, made.y))
    for change, words in (
        ({"u": u[:-5]}, "columns of different length (time 6000, input 5995, output 6000 samples)"),
        ({"u": u[:, None]}, "input has shape (6000, 1)"),
        ({"y": np.where(t == t[50], np.nan, y)}, "output is not finite at sample 50"),
        ({"u": "fast"}, "input is not an array of numbers"),
        ({"h": 0.0}, "h is 0.0; give the sampling period"),
        ({"h": None}, "h is None; give the sampling period"),
        ({"name": 3}, "its name is a int; give text"),
        ({"resolution": "fine"}, "resolution is fine; give a number of at least 0"),
        ({"resolution": -1.0}, "resolution is -1.0; give a number of at least 0"),
        ({"ahead": np.nan}, "ahead is nan; give a number of at least 0 and below 1"),
        ({"findings": None}, "findings are None; give a tuple of texts"),
    ):
        assert words in message(lambda change=change: replace(made, **change))


def test_records_must_agree(message):
    t, u, y = motion()
    made = Record("run", t, H, u, y)
    for other, words in (
        (
            Record("b", t, 2e-3, u, y),
            "record b: h is 0.002 s, but from sample 0 to the next it is 0.001 s",
        ),
        (
            Record("b", 2 * t, 2e-3, u, y),
            "record b: sampled every 0.002 s, record run every 0.001 s; use records_from_arrays",
        ),
    ):
        assert words in message(lambda other=other: must_agree([made, other]))


def test_a_record_must_show_something(layout, message):
    t, u, y = motion()
    made = Record("run", t, H, u, y)
    for change, words in (
        ({"y": np.full(N, 0.3)}, "record run: nothing moves: the output stays within 0 rad"),
        (
            {"y": 1e-3 * WHITE},
            "record run: nothing moves: all that the output shows is noise of 0.001 rad rms",
        ),
        ({"y": 1e200 * y}, "record run: output reaches"),
        ({"u": np.full(N, 0.5)}, "record run: input is constant (0.5 N.m) in every record"),
        (
            {"time": t[:5], "u": u[:5], "y": y[:5]},
            "record run: lasts 0.004 s; at least 2 s are needed",
        ),
    ):
        assert words in message(
            lambda change=change: must_show(layout, [replace(made, **change)], NEEDS)
        )
    # beside another that shows something
    for kept in ({"y": np.full(N, 0.3)}, {"u": np.full(N, 0.5)}):
        must_show(layout, [replace(made, **kept), made], NEEDS)
    coarse = np.linspace(0.0, 30.0, 301)
    brief = records_from_arrays(
        layout,
        [("a", t[:2001], u[:2001], y[:2001]), ("b", coarse, np.sin(coarse), np.cos(0.7 * coarse))],
    )
    assert len(brief[0]) == 21  # at the rate of the other one
    must_show(layout, brief, NEEDS)


def test_one_path_is_a_list_of_one_and_none_counts_twice(layout, message, tmp_path):
    np.savetxt(
        tmp_path / "r.csv",
        np.column_stack(motion()),
        delimiter=",",
        header="t,u,theta",
        comments="",
    )
    [alone] = read_records(layout, tmp_path / "r.csv")
    [same] = read_records(layout, str(tmp_path / "r.csv"))
    assert alone.name == same.name == "r"
    still = tmp_path / "still.csv"
    np.savetxt(
        still, np.column_stack(motion()) * [1, 1, 0], delimiter=",", header="t,u,theta", comments=""
    )
    assert message(lambda: read_records(layout, still)).startswith(f"record {still}: nothing moves")
    twice = [tmp_path / "r.csv", tmp_path / "." / "r.csv"]
    assert "is given twice" in message(lambda: read_records(layout, twice))


# -- samples ---------------------------------------------------------------------------------------


def test_holes_at_the_ends_are_cut_off(layout):
    t, u, y = motion()
    y = np.where((np.arange(N) < 3) | (np.arange(N) >= N - 5), np.nan, y)
    record = one(layout, t, u, y)
    only(record, "3 samples at the start and 5 at the end")
    assert len(record) == N - 8
    assert record.time[0] == pytest.approx(3 * H)


def test_a_few_holes_are_interpolated_and_said(layout):
    t, u, y = motion()
    record = one(layout, holes(t, [70], np.inf), holes(u, [900, 901]), holes(y, range(72, 77)))
    assert [line.split(" of ")[0] for line in said(record)] == [
        "record run: time is not finite at 1",
        "record run: input is not finite at 2",
        "record run: output is not finite at 5",
    ]
    assert "first at sample 72, at most 5 in a row); interpolated" in said(record)[2]
    np.testing.assert_allclose(record.y, y, atol=1e-4)
    np.testing.assert_allclose(record.u, u, atol=1e-4)
    np.testing.assert_allclose(record.time, t, atol=1e-9)
    assert len(record) == N


def test_interpolated_readings_keep_the_steps_and_the_wraps_of_the_sensor(layout):
    t, u, y = motion()
    wrapped = counts(y) % (2 * np.pi)
    jumps = np.flatnonzero(np.abs(np.diff(wrapped)) > np.pi)
    record = one(layout, t, u, holes(wrapped, [*jumps[:2], *range(1000, 1005), 2000]))
    assert record.wrapped
    assert record.resolution == pytest.approx(STEP, rel=1e-6)
    # over a wrap, one sample late
    np.testing.assert_allclose(record.y, counts(y), atol=STEP + np.max(np.abs(np.diff(y))))


def test_what_the_reader_repaired_is_said(layout, tmp_path):
    np.savetxt(
        tmp_path / "r.csv",
        np.column_stack(motion()),
        delimiter=",",
        header="t,u,theta",
        comments="",
        footer="9.9,1",
    )
    (tmp_path / "r.csv").write_text((tmp_path / "r.csv").read_text().rstrip())
    only_one = read_records(layout, tmp_path / "r.csv")[0]
    assert "record r: the last line has 2 of 3 values; left out" in only_one.findings


def test_a_coasting_record_beside_a_driven_one(layout):
    t, u, y = motion()
    driven, coasting = records_from_arrays(layout, [("a", t, u, y), ("b", t, 0 * u, y)])
    assert driven.findings == ()
    assert "record b: input is constant (0 N.m)" in coasting.findings[0]


@pytest.mark.parametrize("offset", [0.0, -np.pi, 100.0])
def test_a_wrapped_position_is_unwrapped(offset, layout):
    t, u, y = motion()
    record = one(layout, t, u, offset + np.mod(counts(y), 2 * np.pi))
    only(record, "wraps by 6.28319 rad", "unwrapped")
    assert record.wrapped
    np.testing.assert_allclose(record.y - record.y[0], counts(y) - counts(y)[0], atol=1e-9)
    assert record.resolution == pytest.approx(STEP, rel=1e-5)


def test_one_wrap_is_enough(layout):
    t, u, _ = motion()
    y = 1.0 + t  # crosses 2 pi once
    record = one(layout, t, u, np.mod(y, 2 * np.pi))
    assert record.wrapped
    np.testing.assert_allclose(record.y, y, atol=1e-9)


def test_a_counter_that_wraps_once_is_unwrapped(layout):
    t, u, _ = motion()
    y = 31.0 + np.round(t / 1e-3) * 1e-3  # 16 bits in steps of 1 mrad wrap at 32.768 rad
    record = one(layout, t, u, np.where(y < 32.768, y, y - 65.536))
    only(record, "wraps by 65.536 rad 1 times", "unwrapped")
    np.testing.assert_allclose(record.y, y, atol=1e-9)


def test_a_single_jump_of_another_size_is_reported(layout):
    t, u, y = motion()
    record = one(layout, t, u, y + np.where(t > 3.0, 50.0, 0.0))
    only(record, "position jumps once by 50 rad after 3 s", "cut the record there")
    assert not record.wrapped


def test_a_position_that_wraps_by_360_is_proposed_to_be_in_degrees(layout):
    t, u, y = motion()
    record = one(layout, t, u, np.mod(np.degrees(y), 360.0))
    only(record, "wraps by 360 rad", "[output] unit ('rad')", "a turn has 6.283 rad")
    np.testing.assert_allclose(np.diff(record.y), np.diff(np.degrees(y)), atol=1e-6)
    # of 12 bits: a turn all the same
    coarse = one(layout, t, u, np.floor(np.mod(np.degrees(y), 360.0) * 4096 / 360) * 360 / 4096)
    assert any("[output] unit ('rad')" in line for line in coarse.findings)


def test_fast_motion_is_not_unwrapped(layout):
    t, u, _ = motion()
    y = 3.0 * np.tanh(40 * np.sin(4 * t))  # swings by 6 rad within a few samples
    assert one(layout, t, u, y).findings == ()


def test_spikes_are_taken_out(layout):
    t, u, y = motion()
    bad = counts(y)
    bad[1000] += 0.5
    bad[3000:3002] -= 2.0
    record = one(layout, t, u, bad)
    only(record, "at 2 places", "first at sample 1000, 1 s")
    np.testing.assert_allclose(record.y, y, atol=4 * STEP)


def test_noise_and_steps_are_no_spikes(layout):
    t, u, y = motion()
    rng = np.random.default_rng(3)
    noisy = y + 1e-3 * rng.standard_normal(N)
    assert one(layout, t, u, noisy).findings == ()
    heavy = y + 1e-3 * rng.standard_t(5, N)  # with tails, as disturbances have
    assert one(layout, t, u, heavy).findings == ()
    slow = counts(0.02 * np.sin(t))  # flickers between neighbouring counts
    flicker = slow + STEP * (rng.random(N) < 0.01)
    assert said(one(layout, t, u, flicker)) == ()


def test_a_saturated_input_is_reported(layout):
    t, u, y = motion()
    only(one(layout, t, np.minimum(u, 0.4), y), "largest value 0.4 for", "limit")
    switched = np.sign(u)  # of two values: nothing hints at a limit
    assert one(layout, t, switched, y).findings == ()
    coarse = np.round(u / 0.02) * 0.02  # dwells at its crests, as steps do
    assert one(layout, t, coarse, y).findings == ()


def test_the_resolution_is_compared_with_the_declared_one(tree):
    t, u, y = motion()
    tree["output"]["resolution"] = STEP
    assert one(from_tree(tree), t, u, counts(y)).findings == ()
    only(
        one(from_tree(tree), t, u, y),
        "shows no such steps",
        "filtered, interpolated or written with too few digits",
    )
    tree["output"]["resolution"] = STEP / 4
    only(
        one(from_tree(tree), t, u, counts(y)),
        "comes in steps of 0.001534 rad",
        "correct the resolution or the unit",
    )


@pytest.mark.parametrize("step", [0.7e-4, 3.3e-3, 0.1])
@pytest.mark.parametrize("offset", [0.0, 0.123456789, -1000.0])
def test_the_resolution_is_found(step, offset, layout):
    t, u, y = motion()
    assert one(layout, t, u, counts(y, step) + offset).resolution == pytest.approx(step, rel=1e-4)
    assert one(layout, t, u, y + offset).resolution is None


def printed(x, digits):
    """Return values as a file has them that is written with so many significant digits."""
    return np.array([float(f"{value:.{digits}g}") for value in x])


def test_the_resolution_is_found_in_few_digits():
    """Of degrees a digit is a part of a step; a speed that is the difference of such readings is
    written in several ways.
    """
    _, _, y = motion()
    step = 360 / 131072
    degrees = printed(counts(10 + 10 * y, step), 6)
    assert len(np.unique(np.diff(np.unique(degrees)))) > 10
    assert common_step(degrees) == pytest.approx(step, rel=1e-4)
    count = 2 * np.pi / 20000
    speed = np.gradient(printed(counts(0.5 * y, count), 6), 0.002) * 30 / np.pi
    assert common_step(printed(speed, 6)) == pytest.approx(count / 0.004 * 30 / np.pi, rel=1e-3)


def test_the_resolution_is_found_in_few_values_and_the_digits_of_a_time_in_spite_of_its_period():
    values = 1e-5 * np.cumsum(np.random.default_rng(2).integers(3, 2000, 300))
    values[1] = values[0] + 3e-5
    assert common_step(values) == pytest.approx(1e-5, rel=1e-6)
    time = 1e-3 * np.arange(5000)
    time[1::300] += 7e-4  # fewer than one in a hundred
    assert common_step(time, finest=True) == pytest.approx(1e-4, rel=1e-6)
    assert common_step(time) == pytest.approx(1e-3, rel=1e-4)


def test_single_counts_of_a_slow_speed_are_no_lost_readings(tree):
    """Nor is a slow creep a frozen reading, where the step is declared and not to be seen."""
    tree["output"] |= {"kind": "velocity", "unit": "rpm"}
    t, u, y = motion()
    unit = 30 / np.pi
    speed = printed(counts(np.gradient(y, t), 14.6484375 / unit) * unit, 5)
    speed[::7] = np.where(speed[::7] == 14.648, 14.649, speed[::7])
    record = one(from_tree(tree), t, u, speed / unit)
    assert record.resolution == pytest.approx(14.6484375 / unit, rel=1e-4)
    assert not any("jumps away" in line or "freezes" in line for line in record.findings)
    rough = speed + 1e-3 * np.random.default_rng(0).standard_normal(len(speed))
    tree["output"]["resolution"] = 14.6484375
    record = one(from_tree(tree), t, u, rough / unit)
    assert record.resolution is None
    assert not any("jumps away" in line or "freezes" in line for line in record.findings)


def test_the_steps_of_the_output_are_reported_once_where_the_layout_does_not_declare_them(tree):
    t, u, y = motion()

    def found(layout, step):
        records = records_from_arrays(
            layout, [("a", t, u, counts(y, step)), ("b", t, u, counts(motion(seed=1)[2], step))]
        )
        return [line for record in records for line in record.findings]

    layout = from_tree(tree)
    assert found(layout, STEP / 16) == ["the output moves in steps of 9.59e-05 rad (65536 a turn)"]
    assert found(layout, 3e-3) == ["the output moves in steps of 0.003 rad"]
    assert found(layout, 4e-6) == found(replace(layout, resolution=STEP), STEP) == []
    assert found(replace(layout, linear=True), STEP) == ["the output moves in steps of 0.00153 m"]


def test_a_lost_reading_is_reported(layout):
    t, u, y = motion()
    stuck = counts(y)
    stuck[4500:4540] = stuck[4499]
    only(one(layout, t, u, stuck), "freezes in motion and then catches up", "from 4.499 to 4.539 s")


def test_rest_under_a_sweeping_input_is_reported(layout):
    t, u, y = motion(n=9000)
    resting = np.concatenate([y[:3000], np.full(3000, y[3000]), y[6000:] - y[6000] + y[3000]])
    line = [each for each in one(layout, t, u, counts(resting)).findings if "stands still" in each]
    assert len(line) == 1
    quiet = np.where((t > 3) & (t < 6), 0.1 * u, u)  # stiction under a small input is ordinary
    assert said(one(layout, t, quiet, counts(resting))) == ()


# -- as recorded -----------------------------------------------------------------------------------


def test_without_identification_the_samples_stay(layout, message):
    """A spike, a wrap, an output at rest, a constant input and a late start are no business of a
    reader.
    """
    t, u, y = motion()
    strange = np.where(np.arange(N) == 1000, 99.0, np.mod(y, 2 * np.pi))
    [record] = records.records_from_arrays(layout, [("run", t + 1e9, u, strange)])
    np.testing.assert_array_equal(record.y, strange)
    assert record.time[0] == 1e9
    assert record.findings == ()
    [still] = records.records_from_arrays(layout, [("run", t[:10], 0 * u[:10], 0 * y[:10])])
    assert not still.y.any()
    text = message(lambda: records.records_from_arrays(layout, [("run", t[:9], u[:9], y[:9])]))
    assert "9 samples; at least 10 are needed" in text
    text = message(
        lambda: records.records_from_arrays(layout, [("run", np.where(t < 3, t, t + 0.1), u, y)])
    )
    assert (
        "run: a gap of 0.101 s after sample 2999 (2.999 s), allowed 3.5 sampling intervals of"
        " 0.001 s" in text
    )


def test_an_uneven_time_gives_the_same_record_to_all(layout, tmp_path):
    """[record] of a scenario and `diagnose` read one and the same record."""
    t, u, y = motion()
    uneven = t + 0.1 * H * np.sin(1.7 * np.arange(N))
    np.savez(tmp_path / "r.npz", t=uneven, u=u, theta=y)
    alone = records.read_record(layout, tmp_path / "r.npz")
    [found] = read_records(layout, tmp_path / "r.npz")
    assert alone.resampled
    assert alone.h == found.h
    assert alone.findings == found.findings
    for one_, other in ((alone.time, found.time), (alone.u, found.u), (alone.y, found.y)):
        np.testing.assert_array_equal(one_, other)


def test_a_velocity_besides_the_position_is_treated_alike(tree, tmp_path, message):
    table = LayoutTable.model_validate(tree)
    layout = layout_of(
        table, "tree", velocity=table.output.model_copy(update={"column": "v", "unit": "rpm"})
    )
    t, u, y = motion()
    v = np.gradient(y, H)
    uneven = t + 0.1 * H * np.sin(1.7 * np.arange(N))
    columns = {"t": uneven, "u": u, "theta": y, "v": v * 60 / (2 * np.pi)}
    np.savez(tmp_path / "r.npz", **columns)
    record = records.read_record(layout, tmp_path / "r.npz")
    assert record.velocity is not None
    assert len(record.velocity) == len(record.y)
    np.testing.assert_allclose(record.velocity, np.interp(record.time, uneven, v), atol=2e-3)
    for long, words in ((1, "1 of 6000 samples (first at sample 70"), (6, None)):
        np.savez(tmp_path / "hole.npz", **columns | {"v": holes(v, range(70, 70 + long))})
        if words:
            assert (
                f"velocity is not finite at {words}"
                in records.read_record(layout, tmp_path / "hole.npz").findings[0]
            )
        else:
            assert "velocity is not finite at 6" in message(
                lambda: records.read_record(layout, tmp_path / "hole.npz")
            )
    np.savez(tmp_path / "end.npz", **columns | {"v": np.where(np.arange(N) > N - 4, np.nan, v)})
    assert (
        "and 3 at the end are not finite"
        in records.read_record(layout, tmp_path / "end.npz").findings[0]
    )


@pytest.mark.sampled(4)
def test_records_need_no_diagnosis():
    """Whoever reads a record, a scenario for one, does not load the diagnosis and the plants."""
    code = (
        "import sys, bristle.records; print([m for m in sys.modules if m.startswith(('bristle.d',"
        " 'bristle.pl', 'bristle.m'))])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
