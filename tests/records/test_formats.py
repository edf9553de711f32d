"""Tables: all formats give the same numbers, fast, and a bad file is one line that says where."""

import bz2
import gzip
import json
import lzma
import os
import sys
import tracemalloc
import zipfile

import numpy as np
import pytest

from bristle.common.columns import LARGEST_CONTENT, MOST_COLUMNS
from bristle.common.errors import BristleError
from bristle.common.table import factor_to, si_column
from bristle.records.formats import text as delimited
from bristle.records.formats.reading import READERS, read_columns
from bristle.records.formats.text import read_rows

T = np.arange(300) * 1e-3
TABLE = {"t": T, "u": np.sin(3 * T) / 3, "theta": np.cos(T) * 1e-7}


LOGS = (".mcap", ".bag", ".db3", ".tdms", ".mf4", ".mdf", ".ulg", ".wpilog")  # test_logs.py
TEXT = (".csv", ".txt", ".tsv", ".dat", ".asc", ".log", ".lvm", ".prn")


def write(path):
    """Write `TABLE` and, where the format allows it, a column of text."""
    if path.suffix in TEXT:
        np.savetxt(
            path,
            np.column_stack(list(TABLE.values())),
            delimiter=",",
            header="t,u,theta",
            comments="",
            fmt="%.17g",
        )
    elif path.suffix == ".npz":
        np.savez(path, **TABLE, word=np.array("text"))
    elif path.suffix == ".npy":
        np.save(path, np.array(list(TABLE.values())))
    elif path.suffix == ".mat":
        from scipy.io import savemat

        savemat(path, {name: values[:, None] for name, values in TABLE.items()} | {"word": "text"})
    elif path.suffix == ".json":
        path.write_text(
            json.dumps({name: x.tolist() for name, x in TABLE.items()} | {"word": "text"})
        )
    elif path.suffix in (".jsonl", ".ndjson"):
        rows = zip(*(x.tolist() for x in TABLE.values()), strict=True)
        lines = [json.dumps(dict(zip(TABLE, row, strict=True)) | {"word": "text"}) for row in rows]
        path.write_text("\n".join(lines) + "\n")
    elif path.suffix in (".h5", ".hdf5"):
        import h5py

        with h5py.File(path, "w") as file:
            for name, values in TABLE.items():
                file[name] = values[None, :]
            file["word"] = "text"
    elif path.suffix in (".xlsx", ".xlsm"):
        from openpyxl import Workbook

        book = Workbook()
        book.create_sheet("empty", 0)
        book["Sheet"].append([*TABLE, "word"])
        for row in zip(*TABLE.values(), strict=True):
            book["Sheet"].append([*map(float, row), "text"])
        book.save(path)
    else:
        import pyarrow as pa
        import pyarrow.parquet as pq

        pq.write_table(pa.table(TABLE | {"word": ["text"] * len(T)}), path)
    return path


@pytest.mark.parametrize("suffix", [each for each in READERS if each not in LOGS])
def test_all_formats_give_the_same_numbers(suffix, tmp_path):
    columns = read_columns(write(tmp_path / f"record{suffix}"))
    names = {name: f"array[:, {k}]" if suffix == ".npy" else name for k, name in enumerate(TABLE)}
    assert set(columns) == set(names.values())
    for name, values in TABLE.items():
        # 16 digits
        np.testing.assert_allclose(
            columns[names[name]], values, rtol=1e-15 if suffix in (".xlsx", ".xlsm") else 0
        )
        assert columns[names[name]].dtype == float


def test_a_long_csv_is_read_by_c(tmp_path, monkeypatch):
    """Not field by field, by what looks for mistakes: that gives the same 20 000 numbers."""
    path = tmp_path / "long.csv"
    table = np.random.default_rng(1).standard_normal((20000, 3))
    np.savetxt(path, table, delimiter=",", header="a,b,c", comments="")
    by_field = read_rows(path, [line.split(",") for line in path.read_text().splitlines()])

    def never(*_):
        raise AssertionError("read field by field")

    monkeypatch.setattr(delimited, "_columns", never)
    columns = read_columns(path)
    assert list(columns) == ["a", "b", "c"]
    for name, values in columns.items():
        np.testing.assert_array_equal(values, by_field[name])


@pytest.mark.parametrize(
    "header",
    ["# rig 3, Monday\n\n# 2 runs\nt,u", "# t,u", "# rig 3\n# t,u", "\ufefft,u", "\r\nt,u"],
)
@pytest.mark.parametrize("rows", ["1,2\n3,4\n", "1,2\n3,\n"])
def test_remarks_above_the_header(header, rows, tmp_path):
    path = tmp_path / "record.csv"
    path.write_text(f"{header}\n{rows}", encoding="utf-8")
    columns = read_columns(path)
    assert list(columns) == ["t", "u"]
    np.testing.assert_array_equal(columns["t"], [1.0, 3.0])


@pytest.mark.parametrize("suffix", [*READERS, ""])
def test_what_is_not_there_and_what_is_no_file(suffix, tmp_path):
    """The likeliest mistake of all is a mistyped path."""
    if suffix:
        with pytest.raises(BristleError, match="No such file"):
            read_columns(tmp_path / f"none{suffix}")
    (tmp_path / f"folder{suffix}").mkdir()
    with pytest.raises(BristleError, match="is a folder"):
        read_columns(tmp_path / f"folder{suffix}")


@pytest.mark.parametrize("pack", [gzip.open, bz2.open, lzma.open], ids=lambda f: f.__module__)
def test_a_packed_file_is_read_as_what_it_holds(pack, tmp_path):
    plain = write(tmp_path / "record.csv")
    packed = (
        tmp_path / f"record.csv.{ {'gzip': 'gz', 'bz2': 'bz2', 'lzma': 'xz'}[pack.__module__] }"
    )
    with pack(packed, "wb") as stream:
        stream.write(plain.read_bytes())
    np.testing.assert_array_equal(read_columns(packed)["u"], TABLE["u"])


def test_an_archive_holds_one_record(message, tmp_path):
    path = tmp_path / "record.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(write(tmp_path / "record.npz"), "logs/record.npz")
        archive.writestr("readme.md", "no record")
    np.testing.assert_array_equal(read_columns(path)["u"], TABLE["u"])
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("other.csv", "t,u\n0,1\n")
    said = message(lambda: read_columns(path))
    assert "holds 2 files of a known format, allowed 1 (logs/record.npz, other.csv)" in said


def test_an_error_in_a_packed_file_names_the_file(message, tmp_path):
    with gzip.open(tmp_path / "bad.csv.gz", "wt") as stream:
        stream.write("t,u\non,off\n")
    said = message(lambda: read_columns(tmp_path / "bad.csv.gz"))
    assert said.startswith(f"record {tmp_path / 'bad.csv.gz'}: no data below")


def test_columns_of_one_name_are_numbered(tmp_path):
    path = tmp_path / "record.csv"
    path.write_text("t,unused [V],unused [V],u,u\n0,1,2,3,4\n1,1,2,3,4\n")
    assert list(read_columns(path)) == ["t", "unused #1 [V]", "unused #2 [V]", "u #1", "u #2"]


def test_rows_without_data_are_left_out_and_said(tmp_path):
    path = tmp_path / "record.csv"
    path.write_text("t,u\nnan,nan\n1,0\n2,0\n3,5\n0,0\n0,0\n0,0\n")
    columns = read_columns(path)
    assert columns["t"].tolist() == [1.0, 2.0, 3.0]
    assert columns.findings == ("rows without data: 1 at the start and 3 at the end; left out",)


def test_a_single_row_of_zeros_is_a_sample(tmp_path):
    path = tmp_path / "record.csv"
    path.write_text("u,theta\n1,2\n0,0\n")
    assert read_columns(path)["u"].tolist() == [1.0, 0.0]


@pytest.mark.parametrize(
    ("line", "rate"),
    [
        ("# fs = 200 Hz", 200.0),
        ("Sampling time interval(ms),5", 200.0),
        ("Sample rate (kHz);2", 2000.0),
        ("SampleRate=1e3", 1000.0),
        ("dt: 0.5 ms", 2000.0),
        ("Interval,0.005,Interval,0.005", 200.0),
        ("Number of sampling data,4000", None),
        ("Time 12:33:01", None),
        ("rate = 0 Hz", None),
        ("interval = 5 kg", None),
    ],
)
def test_a_rate_above_the_numbers(line, rate, tmp_path):
    path = tmp_path / "record.csv"
    path.write_text(f"{line}\ntau,q\n1,2\n3,4\n")
    assert read_columns(path).rate == (rate if rate is None else pytest.approx(rate))


def test_lines_above_the_names_may_be_as_wide_as_the_table(tmp_path):
    """As an export fills them up; a number in one of them makes it no sample."""
    path = tmp_path / "trace.csv"
    path.write_text("Trace;axis;;\nSampling time;1 ms;;\nState;Mode;q;tau\na;8;1,5;2\nb;8;;4\n")
    columns = read_columns(path)
    assert columns.rate == pytest.approx(1000.0)
    np.testing.assert_array_equal(columns["tau"], [2.0, 4.0])
    assert set(columns.unusable) == {"State"}


def test_samples_that_lack_values_begin_the_table(tmp_path):
    path = tmp_path / "late.csv"
    path.write_text("t;a;b;c\n0;;;\n1;;;\n2;5;6;7\n3;5;6;7\n4;5;6;8\n")
    np.testing.assert_array_equal(read_columns(path)["t"], [0, 1, 2, 3, 4])


def test_a_rate_and_named_channels_in_a_mat_file(tmp_path):
    from scipy.io import savemat

    tree = {"OutputData": TABLE["theta"], "InputData": TABLE["u"], "Ts": 0.005}
    names = {
        f"{which}Name": np.array([name], object)
        for which, name in (("Input", "Torque"), ("Output", "Angle"))
    }
    savemat(tmp_path / "r.mat", {"data": tree | names})
    columns = read_columns(tmp_path / "r.mat")
    assert columns.rate == pytest.approx(200.0)
    np.testing.assert_array_equal(columns["data.Torque"], TABLE["u"])
    np.testing.assert_array_equal(columns["data.Angle"], TABLE["theta"])


def test_json_of_samples_within_other_data(tmp_path):
    path = tmp_path / "log.json"
    samples = [{"t": k, "joint": {"q": 2.0 * k}, "list": [k, None], "on": True} for k in range(3)]
    path.write_text(json.dumps({"motor": "x", "mass": 0.5, "entries": samples}))
    columns = read_columns(path)
    assert {name: x.tolist() for name, x in columns.items() if name != "list[1]"} == {
        "t": [0.0, 1.0, 2.0],
        "joint.q": [0.0, 2.0, 4.0],
        "list[0]": [0.0, 1.0, 2.0],
    }
    assert columns.unusable["on"] == "booleans"


def test_lines_of_json_that_break_off(message, tmp_path):
    path = tmp_path / "log.jsonl"
    path.write_text('{"t": 0, "u": 1}\n{"t": 1, "u": 2}\n{"t": 2, "u"')
    columns = read_columns(path)
    assert columns["u"].tolist() == [1.0, 2.0]
    assert columns.findings == ("the last line breaks off; left out",)
    path.write_text('{"t": 0}\n{"t"\n{"t": 2}\n')
    assert "line 2 is no JSON" in message(lambda: read_columns(path))


def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(BristleError, match="pipe or device"):
        read_columns(tmp_path / "pipe.csv")


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_separators_quotes_and_blank_lines(mark, tmp_path):
    path = tmp_path / "record.csv"
    path.write_text(f'\ufeff\n"t"{mark} u \n1{mark}2\n\n"3"{mark}4e0\n', encoding="utf-8")
    assert {name: values.tolist() for name, values in read_columns(path).items()} == {
        "t": [1.0, 3.0],
        "u": [2.0, 4.0],
    }


def test_fields_that_are_lists_of_one_number(tmp_path):
    """As Rerun's tables have them, with a text beside; a unit in brackets stays one."""
    path = tmp_path / "rerun.csv"
    rows = [f'{k},[{k / 2:g}.],"[-{k}.5e-1]",a' for k in range(0, 40, 2)]
    path.write_text("log_tick,/servo/goal,/servo/position [1],name\n" + "\n".join(rows))
    columns = read_columns(path)
    assert list(columns) == ["log_tick", "/servo/goal", "/servo/position [1]"]
    assert columns["/servo/goal"].tolist() == list(range(20))
    assert columns["/servo/position [1]"][-1] == pytest.approx(-3.85)


def test_an_empty_field_is_nan(tmp_path):
    path = tmp_path / "record.csv"
    path.write_text("t,u\n1,2\n3,\n")
    columns = read_columns(path)
    assert np.isnan(columns["u"][1])
    assert columns["t"].tolist() == [1.0, 3.0]


def test_a_missing_value_of_parquet_is_nan(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table({"u": [1, None, 3]}), tmp_path / "r.parquet")
    np.testing.assert_array_equal(read_columns(tmp_path / "r.parquet")["u"], [1.0, np.nan, 3.0])


@pytest.mark.parametrize("names", [["hip.pos", "knee.pos"], {"motors": ["hip.pos", "knee.pos"]}])
def test_the_joints_of_a_lerobot_data_set_are_columns_and_its_episodes_have_gaps(tmp_path, names):
    import pyarrow as pa
    import pyarrow.parquet as pq

    folder = tmp_path / "data" / "chunk-000"
    folder.mkdir(parents=True)
    (tmp_path / "meta").mkdir()
    info = {"features": {"action": {"names": names}, "timestamp": {"names": None}}}
    (tmp_path / "meta" / "info.json").write_text(json.dumps(info))
    table = {
        "action": [[0.1, 0.2], [0.3, 0.4], None, [0.7, 0.8]],
        "observation.state": [[1.0], [2.0], [3.0], [4.0]],
        "timestamp": [0.0, 0.1, 0.0, 0.1],
        "episode_index": [0, 0, 1, 1],
        "observation.image": [[0.0] * 100] * 4,
    }
    pq.write_table(pa.table(table), folder / "file-000.parquet")
    columns = read_columns(folder / "file-000.parquet")
    np.testing.assert_array_equal(columns["action.knee.pos"], [0.2, 0.4, np.nan, 0.8])
    np.testing.assert_array_equal(columns["observation.state[0]"], [1.0, 2.0, 3.0, 4.0])
    assert "observation.image" in columns.unusable
    assert np.diff(columns["timestamp"]) == pytest.approx([0.1, 100.0, 0.1])
    assert "2 episodes" in columns.findings[0]
    # without the description of the data set, elements have numbers
    (tmp_path / "meta" / "info.json").write_text("[")
    assert "action[1]" in read_columns(folder / "file-000.parquet")


def test_parquet_without_pyarrow_says_how_to_get_it(tmp_path, monkeypatch, message):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    (tmp_path / "r.parquet").write_bytes(b"PAR1")
    said = message(lambda: read_columns(tmp_path / "r.parquet"))
    assert said.endswith(
        "r.parquet: Parquet needs pyarrow; run: pip install 'bristle[parquet]', or save it as CSV"
    )


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("t,u\n0,1\n1,2,3\n", ["line 3 has 3 values, most have 2"]),
        ("t,u\n0,1\n\n1,2,3\n", ["line 4 has 3 values"]),
        ("t,u\non,off\n", ["no data below"]),
        ("t\0,u\n0,1\n", ["is no text"]),
        ("t,u\n", ["no data below the line of column names"]),
        ("", ["is empty"]),
        ("\n\n", ["is empty"]),
    ],
)
def test_a_bad_csv_says_where(content, words, tmp_path):
    path = tmp_path / "bad.csv"
    path.write_text(content)
    with pytest.raises(BristleError) as caught:
        read_columns(path)
    text = str(caught.value)
    assert "\n" not in text
    assert str(path) in text
    for word in words:
        assert word in text


@pytest.mark.parametrize("suffix", [each for each in READERS if each not in TEXT])
def test_a_file_of_another_kind_is_one_line(suffix, tmp_path):
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(
        b"these are only some words, and then some more, so that there is something to look at " * 4
    )
    with pytest.raises(
        BristleError,
        match=r"cannot be read|is no (NPZ|array|XLSX workbook|JSON|MDF)|no (column|metadata)",
    ) as caught:
        read_columns(path)
    assert "\n" not in str(caught.value)
    assert "pickle" not in str(caught.value)


OTHERS = {
    "text": np.array(["a", "b", "c"]),
    "complex numbers": np.ones(3) * 1j,
    "booleans": np.ones(3, dtype=bool),
    "an array of shape (2, 3)": np.ones((2, 3)),
    "timestamps": np.array(["2020-01-01"] * 3, dtype="datetime64[s]"),
}


@pytest.mark.parametrize("what", OTHERS)
def test_a_column_that_holds_no_numbers_is_named_with_what_it_holds(what, tmp_path):
    path = tmp_path / "odd.npz"
    np.savez(path, t=np.arange(3.0), u=OTHERS[what])
    columns = read_columns(path)
    with pytest.raises(BristleError, match="column 'u' holds") as caught:
        si_column("record odd", columns, "u", "1", None, "1")
    assert what in str(caught.value)
    if what == "timestamps":  # they may be the time
        return
    np.savez(path, u=OTHERS[what])
    with pytest.raises(BristleError, match="no column of numbers; 'u' holds"):
        read_columns(path)


def test_a_parquet_column_of_another_type_is_named(tmp_path):
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    parquet.write_table(pyarrow.table({"t": [0.0, 1.0], "u": ["a", "b"]}), tmp_path / "r.parquet")
    with pytest.raises(BristleError, match="column 'u' holds string values"):
        si_column("record r", read_columns(tmp_path / "r.parquet"), "u", "1", None, "1")


def test_a_unit_without_its_dot_is_guessed():
    with pytest.raises(BristleError, match=r"did you mean 'N\.m'"):
        factor_to("Nm", None, "N.m")
    with pytest.raises(BristleError, match=r"did you mean 'kg\.m2'"):
        factor_to("kgm2", None, "kg.m2")


def test_units_and_scales():
    assert factor_to("deg", None, "rad") == pytest.approx(np.pi / 180)
    assert factor_to("rpm", None, "rad/s") == pytest.approx(2 * np.pi / 60)
    assert factor_to("1", "0.088 deg", "rad") == pytest.approx(0.088 * np.pi / 180)
    assert factor_to("N.m", "-1", "N.m") == -1.0
    columns = {"u": np.ones(3)}
    assert si_column("record r: input", columns, "u", "mN.m", None, "N.m").tolist() == [1e-3] * 3
    with pytest.raises(BristleError, match=r"record r: input: no column 'v'; there are: u"):
        si_column("record r: input", columns, "v", "V", None, "V")
    with pytest.raises(BristleError, match=r"record r: input: unit 'V' does not fit"):
        si_column("record r: input", columns, "u", "V", None, "N.m")
    with pytest.raises(
        BristleError, match=r"unit 'N\.m' with scale '3 rad' gives none like 'N\.m'"
    ):
        factor_to("N.m", "3 rad", "N.m")
    with pytest.raises(BristleError, match=r"x{40}\.\.\., c1, .* and 11 more$"):
        si_column(
            "record r: input",
            {"x" * 10_000: np.ones(3)} | {f"c{i}": np.ones(3) for i in range(1, 31)},
            "v",
            "V",
            None,
            "V",
        )
    with pytest.raises(BristleError, match="is not a number with a unit"):
        factor_to("V", "much", "V")


# -- as loggers write them -------------------------------------------------------------------------


def text(path, content, encoding="utf-8"):
    path.write_bytes(content.encode(encoding))
    return read_columns(path)


@pytest.mark.parametrize(
    "encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16", "utf-16-le", "utf-16-be"]
)
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_text_of_any_encoding(encoding, end, tmp_path):
    columns = text(
        tmp_path / "r.csv", end.join(["Zeit [s];Größe [°]", "0,5;-1,5e1", "1;2", ""]), encoding
    )
    assert {name: values.tolist() for name, values in columns.items()} == {
        "Zeit [s]": [0.5, 1.0],
        "Größe [°]": [-15.0, 2.0],
    }


@pytest.mark.parametrize(
    ("content", "found", "units"),
    [
        ("t;u\n0;1,5\n1;2,5\n", {"t": [0, 1], "u": [1.5, 2.5]}, {}),
        ("t\tu\n0,5\t1,5\n1,5\t2,5\n", {"t": [0.5, 1.5], "u": [1.5, 2.5]}, {}),
        ('t,u\n"0,5","1,5"\n"1,5",2\n', {"t": [0.5, 1.5], "u": [1.5, 2]}, {}),
        ("t,u\ns,N.m\n0,1\n1,2\n", {"t": [0, 1], "u": [1, 2]}, {"t": "s", "u": "N.m"}),
        (
            "Time,Channel A\n(ms),(V)\n\n0,1\n1,2\n",
            {"Time": [0, 1], "Channel A": [1, 2]},
            {"Time": "(ms)", "Channel A": "(V)"},
        ),
        (
            "x-axis,1\nsecond,Volt\n0,1\n1,2\n",
            {"x-axis": [0, 1], "1": [1, 2]},
            {"x-axis": "second", "1": "Volt"},
        ),
        (
            "Model,TDS2024\nSample Interval,1e-6\n\nTIME,CH1\n0,1\n1,2\n2,3\n3,4\n",
            {"TIME": [0, 1, 2, 3], "CH1": [1, 2, 3, 4]},
            {},
        ),
        (
            "% rig 3; day 2\n%time,field.effort0\n0,1\n1,2\n",
            {"time": [0, 1], "field.effort0": [1, 2]},
            {},
        ),
        (
            "  Time [s]  Angle [deg]\n   0.0   1.0\n   1.0   2.0\n",
            {"Time [s]": [0, 1], "Angle [deg]": [1, 2]},
            {},
        ),
        (
            "# Time [s] Angle [deg]\n0.0 1.0\n1.0 2.0\n",
            {"Time [s]": [0, 1], "Angle [deg]": [1, 2]},
            {},
        ),
        ("t;u;\n0;1;\n1;2;\n", {"t": [0, 1], "u": [1, 2]}, {}),
        (
            "t;u;state\nhh:mm:ss;V;\n0;1;off\n1;2;on\n",
            {"t": [0, 1], "u": [1, 2]},
            {"t": "hh:mm:ss", "u": "V"},
        ),
        ("t;u;\n0;1;5\n1;2;6\n", {"t": [0, 1], "u": [1, 2], "column 3": [5, 6]}, {}),
        ("0,1\n1,2\n", {"column 1": [0, 1], "column 2": [1, 2]}, {}),
        ("# log of rig 3\n0 1\n1 2\n", {"column 1": [0, 1], "column 2": [1, 2]}, {}),
        (",t,u\n0,5,6\n1,6,7\n", {"column 1": [0, 1], "t": [5, 6], "u": [6, 7]}, {}),
    ],
)
def test_the_styles_of_loggers(content, found, units, tmp_path):
    columns = text(tmp_path / "r.txt", content)
    assert {name: values.tolist() for name, values in columns.items()} == found
    assert columns.units == units


def test_a_column_of_text_is_no_obstacle(tmp_path):
    columns = text(
        tmp_path / "r.csv",
        "t,state,u,note\n0,run,1,\n1,run,,7\n2,stop,3,see, below\n".replace("see, below", "see"),
    )
    assert sorted(columns) == ["t", "u"]
    np.testing.assert_array_equal(columns["u"], [1, np.nan, 3])
    with pytest.raises(
        BristleError,
        match=r"column 'note' holds text \('see' in line 4\); give one number a sample",
    ):
        si_column("record r: input", columns, "note", "V", None, "V")


def test_a_last_line_that_was_cut_off_is_left_out(tmp_path):
    columns = text(tmp_path / "r.csv", "t,u\n0,1\n1,2\n2")
    assert columns["t"].tolist() == [0, 1]
    assert columns.findings == ("the last line has 1 of 2 values; left out",)


@pytest.mark.parametrize(
    ("stamps", "first"),
    [
        (["2026-11-24T17:50:41.250Z", "2026-11-24T17:50:41.750Z"], 1795542641.25),
        (["2026-11-24 18:50:41,250+01:00", "2026-11-24 18:50:41,750+01:00"], 1795542641.25),
        (["24.11.2026 17:50:41,25", "24.11.2026 17:50:41,75"], 1795542641.25),
        (["23:59:59.75", "00:00:00.25"], 86399.75),
        (["0.25 sec", "0.75 sec"], 0.25),
        (["250 ms", "750 ms"], 0.25),
    ],
)
def test_timestamps_are_seconds(stamps, first, tmp_path):
    columns = text(
        tmp_path / "r.csv", "Zeit;u\n" + "".join(f"{stamp};{k}\n" for k, stamp in enumerate(stamps))
    )
    assert columns["Zeit"].tolist() == [first, first + 0.5]
    assert si_column("record r: time", columns, "Zeit", "s", None, "s").tolist() == [
        first,
        first + 0.5,
    ]
    with pytest.raises(BristleError, match=r"timestamps, which are read in s; write unit = \"s\""):
        si_column("record r: time", columns, "Zeit", "ms", None, "s")
    assert (
        text(tmp_path / "no.csv", "t,u\n" + 2 * " 2026-13-45 10:00:00,1\n")
        .unusable["t"]
        .startswith("text ('2026-13-45")
    )


def test_timestamps_of_parquet_and_spreadsheets_are_seconds(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq
    from openpyxl import Workbook

    stamps = np.datetime64("2026-11-24T17:50:41.250", "ms") + np.array([0, 500])
    pq.write_table(pa.table({"t": stamps, "u": [1, 2]}), tmp_path / "r.parquet")
    book = Workbook()
    for row in (["t", "u"], [stamps[0].item(), 1], [stamps[1].item(), 2]):
        book.active.append(row)
    book.save(tmp_path / "r.xlsx")
    for name in ("r.parquet", "r.xlsx"):
        columns = read_columns(tmp_path / name)
        assert columns["t"] == pytest.approx([1795542641.25, 1795542641.75], abs=1e-3)
        assert columns.clocks == {"t"}


def test_structs_and_matrices_of_matlab(tmp_path):
    from scipy.io import savemat

    signals = np.array(
        [({"label": "u", "values": T},), ({"label": "y", "values": 2 * T},)], dtype=object
    )[:, 0]
    savemat(
        tmp_path / "r.mat",
        {
            "log": {"t": T[:, None], "data": {"u": 3 * T}},
            "M": np.column_stack([T, -T]),
            "scope": signals,
        },
    )
    columns = read_columns(tmp_path / "r.mat")
    assert sorted(columns) == [
        "M(:,1)",
        "M(:,2)",
        "log.data.u",
        "log.t",
        "scope.u.values",
        "scope.y.values",
    ]
    np.testing.assert_array_equal(columns["log.data.u"], 3 * T)
    np.testing.assert_array_equal(columns["M(:,2)"], -T)
    np.testing.assert_array_equal(columns["scope.y.values"], 2 * T)


def test_mat_files_of_version_73(tmp_path):
    import h5py

    with h5py.File(tmp_path / "r.mat", "w", userblock_size=512) as file:
        file["log/t"], file["log/M"] = T[None, :], np.array([T, -T])
        file["name"] = np.array([[82, 49]], dtype=np.uint16)
        file["name"].attrs["MATLAB_class"] = np.bytes_("char")
        file["run"] = np.arange(6, dtype=np.uint32)
        file["run"].attrs["MATLAB_class"] = np.bytes_("timeseries")
    with (tmp_path / "r.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    columns = read_columns(tmp_path / "r.mat")
    assert sorted(columns) == ["log.M(:,1)", "log.M(:,2)", "log.t"]
    np.testing.assert_array_equal(columns["log.M(:,2)"], -T)
    assert columns.unusable == {"name": "text", "run": "a MATLAB timeseries"}


# -- limits ----------------------------------------------------------------------------------------


def bombs():
    """Give the suffix of each format that is packed, and what writes a small file of it that holds
    too much.
    """
    rows = LARGEST_CONTENT // 8 + 1

    def mat(path):
        from scipy.io import savemat

        savemat(
            path,
            {
                "t": np.zeros(LARGEST_CONTENT // 2, dtype=np.int8),
                "u": np.zeros(LARGEST_CONTENT // 2 + 99, dtype=np.int8),
            },
            do_compression=True,
        )

    def npz(path):
        np.savez_compressed(path, t=np.zeros(LARGEST_CONTENT + 1, dtype=np.int8))

    def parquet(path):
        import pyarrow as pa
        import pyarrow.parquet as pq

        pq.write_table(pa.table({"t": pa.array(np.zeros(rows, dtype=np.int8))}), path)

    def hdf5(path):
        import h5py

        with h5py.File(path, "w") as file:
            file.create_dataset("t", (rows,), dtype="i1", chunks=(2**20,), compression="gzip")

    def xlsx(path):
        import zipfile

        write(path)
        with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("xl/more.xml", bytes(LARGEST_CONTENT))

    return {".mat": mat, ".npz": npz, ".parquet": parquet, ".h5": hdf5, ".xlsx": xlsx}


@pytest.mark.slow
@pytest.mark.parametrize("suffix", list(bombs()))
def test_a_small_file_that_holds_too_much_is_refused(suffix, tmp_path):
    path = tmp_path / f"bomb{suffix}"
    bombs()[suffix](path)
    assert path.stat().st_size < LARGEST_CONTENT / 100
    tracemalloc.start()
    with pytest.raises(
        BristleError, match=r"MiB unpacked, allowed 512; cut the record or leave out columns"
    ):
        read_columns(path)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < LARGEST_CONTENT / 10


def test_a_file_of_too_many_columns_is_refused(tmp_path):
    names = [f"c{k}" for k in range(100_003)]
    (tmp_path / "r.csv").write_text(
        "\n".join([",".join(names), *2 * [",".join(["0"] * len(names))]])
    )
    np.savez(tmp_path / "r.npz", **{name: np.zeros(2) for name in names[: MOST_COLUMNS + 1]})
    for name, count in (("r.csv", 100_003), ("r.npz", MOST_COLUMNS + 1)):
        with pytest.raises(
            BristleError, match=f"has {count} columns, allowed {MOST_COLUMNS}; leave out those"
        ):
            read_columns(tmp_path / name)
