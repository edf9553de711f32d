"""[record] of a scenario: what is read, and one line for every record that cannot be used."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bristle.harness.scenario.reading import load
from bristle.harness.scenario.samples import Samples, read_samples

Message = Callable[[Callable[[], object]], str]
Maker = Callable[..., Path]

TIME = np.arange(200) * 2e-3
THETA = np.sin(5 * TIME)
V = 5 * np.cos(5 * TIME)
U = 2 * np.cos(3 * TIME)
OBSERVER = '[observer]\nmethod = "rls"\n'
INPUT = '[record.input]\ncolumn = "volt"\nkind = "voltage"\nunit = "V"\n'
POSITION = '[record.output]\ncolumn = "pos"\nkind = "position"\nunit = "rad"\n'
SPEED = '[record.output]\ncolumn = "speed"\nkind = "velocity"\nunit = "rad/s"\n'
BESIDES = '[record.velocity]\ncolumn = "speed"\nunit = "rad/s"\n'


def text(file: str, output: str = POSITION, time_unit: str = "s") -> str:
    return (
        f'[record]\nfile = "{file}"\n[record.time]\ncolumn = "t"\nunit ='
        f' "{time_unit}"\n{INPUT}{output}{OBSERVER}'
    )


@pytest.fixture
def read(scenario_file: Maker) -> Callable[..., Samples]:
    """Return what reads the record of a scenario."""
    return lambda *arguments, **named: read_samples(load(scenario_file(text(*arguments, **named))))


def write_csv(path: Path, header: str = "t,volt,pos,speed", **changed: np.ndarray) -> Path:
    columns = {"t": TIME, "volt": U, "pos": THETA, "speed": V, **changed}
    np.savetxt(
        path,
        np.column_stack(list(columns.values())),
        delimiter=",",
        header=header,
        comments="",
        fmt="%.17g",
    )
    return path


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".mat"])
def test_formats_give_the_same_numbers(
    suffix: str, tmp_path: Path, read: Callable[..., Samples]
) -> None:
    from scipy.io import savemat

    path = tmp_path / f"record{suffix}"
    columns = {"t": TIME, "volt": U, "pos": THETA, "speed": V}
    if suffix == ".csv":
        write_csv(path)
    elif suffix == ".npz":
        np.savez(path, **columns)
    else:
        savemat(path, {name: values[:, None] for name, values in columns.items()} | {"gain": 3.0})
    samples = read(path.name, POSITION + BESIDES)
    assert samples.h == pytest.approx(2e-3)
    assert samples.findings == ()
    for have, want in ((samples.u, U), (samples.theta, THETA), (samples.v, V)):
        assert np.array_equal(have, want)


def test_units_are_converted(tmp_path: Path, read: Callable[..., Samples]) -> None:
    write_csv(tmp_path / "r.csv", t=TIME * 1000, pos=np.degrees(THETA))
    samples = read("r.csv", POSITION.replace('"rad"', '"deg"'), time_unit="ms")
    assert samples.h == pytest.approx(2e-3)
    assert np.allclose(samples.theta, THETA, rtol=0, atol=1e-14)


def test_a_scale_turns_metres_into_radians_and_counts_into_seconds(
    tmp_path: Path, read: Callable[..., Samples]
) -> None:
    write_csv(tmp_path / "r.csv", pos=THETA * 0.05, t=np.arange(200.0))
    samples = read(
        "r.csv",
        POSITION.replace('"rad"', '"m"\nscale = "20 rad/m"'),
        time_unit='1"\nscale = "2e-3 s',
    )
    assert np.allclose(samples.theta, THETA)
    assert samples.h == pytest.approx(2e-3)


def test_position_and_velocity_follow_from_each_other(
    tmp_path: Path, read: Callable[..., Samples]
) -> None:
    write_csv(tmp_path / "r.csv")
    from_theta = read("r.csv")
    assert from_theta.measured == ("theta",)
    assert np.allclose(from_theta.v[1:], np.diff(THETA) / 2e-3)
    from_v = read("r.csv", SPEED)
    assert from_v.measured == ("v",)
    assert np.allclose(from_v.theta, THETA - THETA[0], atol=1e-4)
    assert read("r.csv", POSITION + BESIDES).measured == ("theta", "v")


def test_an_uneven_time_is_resampled_and_reported(
    tmp_path: Path, read: Callable[..., Samples]
) -> None:
    uneven = TIME + 2e-3 * 0.1 * np.sin(1.7 * np.arange(200))
    columns = {
        "t": uneven,
        "volt": 2 * np.cos(3 * uneven),
        "pos": np.sin(5 * uneven),
        "speed": 5 * np.cos(5 * uneven),
    }
    write_csv(tmp_path / "r.csv", **columns)
    samples = read("r.csv", POSITION + BESIDES)
    [line] = samples.findings
    assert "record r: sampling intervals scatter by" in line
    assert "interpolated to uniform ones" in line
    time = uneven[0] + samples.h * np.arange(len(samples))
    np.testing.assert_allclose(samples.theta[:-1], np.sin(5 * time)[:-1], atol=1e-5)
    np.testing.assert_allclose(samples.v[:-1], 5 * np.cos(5 * time)[:-1], atol=1e-4)
    np.testing.assert_allclose(samples.u[1:-1], 2 * np.cos(3 * time)[1:-1], atol=1e-2)


def test_samples_stay_as_recorded(tmp_path: Path, read: Callable[..., Samples]) -> None:
    """A spike, a wrap and an output at rest are what the observer is to meet: only a diagnosis
    repairs or refuses them.
    """
    strange = replaced(np.mod(THETA, 2 * np.pi), 70, 99.0)
    write_csv(tmp_path / "r.csv", pos=strange)
    samples = read("r.csv")
    assert np.array_equal(samples.theta, strange)
    assert samples.findings == ()
    write_csv(tmp_path / "still.csv", pos=0 * THETA, volt=0 * U)
    assert not read("still.csv").theta.any()


def replaced(values: np.ndarray, index: int | slice, value: float) -> np.ndarray:
    out = values.copy()
    out[index] = value
    return out


HEAD = "t,volt,pos,speed\n"
NO_MAT = (
    "not a mat file at all, only some words that are long enough to look at, and then some more of"
    " them here, and more"
)
BROKEN = {  # content of a file, and what its error says
    "broken.mat": (NO_MAT, "cannot be read"),
    "ragged.csv": (f"{HEAD}0,1,2,3\n0.1,1,2\n0.2,1,2,3\n", "line 3 has 3 values"),
    "words.csv": (f"{HEAD}0,1,2,fast\n0.1,1,2,slow\n", "fast"),
    "short.csv": (f"{HEAD}0,1,2,3\n0.1,1,2,3\n", "2 samples; at least 10 are needed"),
}


def test_every_bad_record_is_one_line(
    tmp_path: Path, read: Callable[..., Samples], message: Message
) -> None:
    gap = TIME.copy()
    gap[100:] += 0.01
    cases: list[tuple[Path, list[str]]] = [
        (
            write_csv(tmp_path / "gap.csv", t=gap),
            ["a gap of 0.012 s after sample 99 (0.198 s)", "cut the record there"],
        ),
        (
            write_csv(tmp_path / "back.csv", t=replaced(TIME, 50, 0.0)),
            ["time decreases at sample 50", "sort the record"],
        ),
        (
            write_csv(tmp_path / "twice.csv", t=np.round(TIME, 2)),
            ["time stamps repeat", "more digits"],
        ),
        (
            write_csv(tmp_path / "nan.csv", volt=replaced(U, slice(7, 27), np.nan)),
            ["first at sample 7", "cut the record"],
        ),
        (
            write_csv(tmp_path / "name.csv", "t,volts,pos,speed"),
            ["input: no column 'volt'", "did you mean 'volts'"],
        ),
        (write_csv(tmp_path / "none.csv", "0,1,2,3"), ["no column 't'", "column 1"]),
        (tmp_path / "nowhere.csv", ["No such file"]),
        (tmp_path / "record.xlsx", ["No such file"]),
    ]
    for name, (text, word) in BROKEN.items():
        (tmp_path / name).write_text(text)
        cases.append((tmp_path / name, [word]))
    for path, expected in cases:
        line = message(lambda path=path: read(path.name, POSITION + BESIDES))
        assert line.startswith(
            f'{tmp_path / "case.toml"}: record.file = "{path.name}": record {path}'
        )
        for word in expected:
            assert word in line, line


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            'unit = "rad"',
            'unit = "m"',
            ['record.velocity.unit = "rad/s"', "a unit like 'm/s' is needed"],
        ),
        (
            'unit = "rad"',
            'unit = "kg"',
            ["record.output.unit = \"kg\": does not fit kind 'position'", "write rad, deg"],
        ),
        (
            'unit = "rad/s"',
            'unit = "rad"',
            ['record.velocity.unit = "rad"', "a unit like 'rad/s' is needed"],
        ),
        ('unit = "V"', 'unit = "A"', ['record.input.unit = "A"', "a unit like 'V' is needed"]),
        ('"voltage"', '"current"', ['record.input.unit = "V"', "a unit like 'A' is needed"]),
        (
            '"voltage"',
            '"force"',
            ['record.input.kind = "force": the output turns', 'write "torque"'],
        ),
        (
            '"voltage"',
            '"volt"',
            ["record.input.kind", "choose one of: 'torque', 'force', 'voltage', 'current'"],
        ),
        (
            'kind = "position"',
            'kind = "velocity"',
            ["record.output.unit", "does not fit kind 'velocity'"],
        ),
        (POSITION, SPEED, ["record.output.kind", "[record.velocity] is given as well"]),
        (
            'column = "speed"',
            'column = "pos"',
            ["record.velocity.column", "is the column of [record.output] already"],
        ),
        ('column = "speed"\n', "", ["record.velocity.column: missing; add it"]),
        (
            'column = "volt"',
            'colum = "volt"',
            ["record.input.colum", "did you mean 'column'", "column, unit, scale, kind"],
        ),
        (POSITION, "", ["record.output: missing; add it"]),
        (
            "[record.velocity]",
            "[record.speed]",
            ["record.speed", "unknown key", "time, input, output, file, velocity"],
        ),
        (
            "[record.velocity]",
            '[record.u]\nunit = "V"\n[record.velocity]',
            ["record.u: is the deprecated name of [record.input]"],
        ),
    ],
)
def test_a_mistake_in_the_tables_is_one_line(
    old: str, new: str, words: list[str], tmp_path: Path, scenario_file: Maker, message: Message
) -> None:
    write_csv(tmp_path / "r.csv")
    whole = text("r.csv", POSITION + BESIDES)
    assert old in whole
    path = scenario_file(whole.replace(old, new, 1))
    line = message(lambda: read_samples(load(path)))
    assert line.startswith(f"{path}: ")
    for word in words:
        assert word in line, line


@pytest.mark.parametrize(
    ("keys", "tables", "words"),
    [
        (
            'theta = { column = "pos", unit = "deg" }',
            POSITION.replace('"rad"', '"deg"'),
            '[record.output] with kind = "position"',
        ),
        (
            'v = { column = "speed", unit = "rad/s" }',
            SPEED,
            '[record.output] with kind = "velocity"',
        ),
        (
            'theta = { column = "pos", unit = "rad" }\nv = { column = "speed", unit = "rad/s" }',
            POSITION + BESIDES,
            'kind = "position", v as [record.velocity]',
        ),
    ],
)
def test_deprecated_keys_are_read_and_named(
    keys: str, tables: str, words: str, tmp_path: Path, scenario_file: Maker
) -> None:
    write_csv(tmp_path / "r.csv")
    old = (
        '[record]\nfile = "r.csv"\ntime = { column = "t", unit = "s" }\nu = { column = "volt",'
        f' unit = "V" }}\n{keys}\n'
    )
    path = scenario_file(old + OBSERVER)
    with pytest.warns(FutureWarning, match="deprecated") as caught:
        loaded = load(path)
    [line] = loaded.notes
    assert [str(each.message) for each in caught] == [line]
    assert line.startswith(f"{path}: record: the keys u, ")
    assert words in line
    have, want = (
        read_samples(loaded),
        read_samples(load(scenario_file(text("r.csv", tables), "new"))),
    )
    assert (have.h, have.measured) == (want.h, want.measured)
    for one, other in ((have.u, want.u), (have.theta, want.theta), (have.v, want.v)):
        assert np.array_equal(one, other)


def test_notes_on_the_record_are_in_the_report(tmp_path: Path, scenario_file: Maker) -> None:
    from bristle.harness.run.run import run

    t = np.arange(2000) * 1e-3
    write_csv(
        tmp_path / "r.csv",
        t=np.delete(t, 700),
        volt=np.delete(np.sin(3 * t), 700),
        pos=np.delete(np.sin(2 * t), 700),
        speed=np.delete(t, 700),
    )
    done = run(scenario_file(text("r.csv")), tmp_path / "out")
    assert done.result["steps"] == 2000
    assert (
        "record r: one or two samples are missing at 1 places (first after 0.699 s); interpolated"
        in done.result["notes"]
    )
    assert "one or two samples are missing" in (done.folder / "report.html").read_text(
        encoding="utf-8"
    )


@pytest.mark.usefixtures("undrawn")
def test_rls_on_the_emps_record(tmp_path: Path) -> None:
    """The published least-squares model of this axis: M 95.1 kg, Fv 203.5 N.s/m, Fc 20.4 N, 35.15
    N/V.
    """
    from bristle.harness.run.run import run

    folder = Path(
        os.environ.get("BRISTLE_DATA", Path(__file__).resolve().parents[4] / "shared" / "data")
    )
    record = folder / "emps" / "DATA_EMPS.mat"
    if not record.exists():
        pytest.skip(f"no measured data: {record} is not there (set BRISTLE_DATA)")
    path = tmp_path / "emps.toml"
    path.write_text(f"""
[record]
file = {str(record)!r}
time = {{ column = "t", unit = "s" }}
input = {{ column = "vir", kind = "voltage", unit = "V" }}
output = {{ column = "qm", kind = "position", unit = "m", scale = "1 rad/m" }}
[observer]
method = "rls"
[observer.parameters]
rls.vc = "0.02 rad/s"
[[checks]]
quantity = "estimates.b.final"
min = {0.9 * 35.1507 / 95.1089}
max = {1.1 * 35.1507 / 95.1089}
""")
    done = run(path, tmp_path / "out")
    assert done.passed
    assert done.result["notes"] == []
    assert done.result["steps"] == 24841
    last = np.genfromtxt(done.folder / "signals.csv", delimiter=",", names=True)[-1]
    for name, published in (("alpha2", 203.5034 / 95.1089), ("Fc", 20.3935 / 95.1089)):
        found, sd = last[f"{name}_hat"], done.result["estimates"][name]["sd"]
        assert found == pytest.approx(published, rel=0.15), name
        assert abs(found - published) < 2 * sd < found, (
            f"{name}: the axis has more than three parameters, and sd says so"
        )
    assert done.result["estimates"]["b"]["true"] is None
