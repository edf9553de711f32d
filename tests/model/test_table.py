"""Tables: all formats give the same numbers, fast, and a bad file is one line that says where."""

import os
import time

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.common.table import READERS, _read_rows, factor_to, read_columns, si_column

T = np.arange(300) * 1e-3
TABLE = {"t": T, "u": np.sin(3 * T) / 3, "theta": np.cos(T) * 1e-7}


def write(path):
    if path.suffix == ".csv":
        np.savetxt(path, np.column_stack(list(TABLE.values())), delimiter=",", header="t,u,theta", comments="", fmt="%.17g")
    elif path.suffix == ".npz":
        np.savez(path, **TABLE, word=np.array("text"))
    elif path.suffix == ".mat":
        from scipy.io import savemat

        savemat(path, {name: values[:, None] for name, values in TABLE.items()} | {"word": "text"})
    else:
        import pyarrow as pa
        import pyarrow.parquet as pq

        pq.write_table(pa.table(TABLE | {"word": ["text"] * len(T)}), path)
    return path


@pytest.mark.parametrize("suffix", list(READERS))
def test_all_formats_give_the_same_numbers(suffix, tmp_path):
    columns = read_columns(write(tmp_path / f"record{suffix}"))
    assert set(columns) == set(TABLE)
    for name, values in TABLE.items():
        np.testing.assert_array_equal(columns[name], values)
        assert columns[name].dtype == float


def test_a_long_csv_is_read_at_the_speed_of_c(tmp_path):
    """20 000 lines of three numbers against the loop over rows that looks for mistakes."""
    path = tmp_path / "long.csv"
    np.savetxt(path, np.random.default_rng(1).standard_normal((20000, 3)), delimiter=",", header="a,b,c", comments="")

    def best(read):
        took = []
        for _ in range(5):
            start = time.perf_counter()
            read()
            took.append(time.perf_counter() - start)
        return min(took)

    assert best(lambda: read_columns(path)) < 0.9 * best(lambda: _read_rows(path, ",", 3, 1))
    np.testing.assert_array_equal(np.column_stack(list(read_columns(path).values())), _read_rows(path, ",", 3, 1))


@pytest.mark.parametrize("header", ["# rig 3, Monday\n\n# 2 runs\nt,u", "# t,u", "# rig 3\n# t,u", "\ufefft,u", "\r\nt,u"])
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


def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(BristleError, match="pipe or device"):
        read_columns(tmp_path / "pipe.csv")


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_separators_quotes_and_blank_lines(mark, tmp_path):
    path = tmp_path / "record.csv"
    path.write_text(f'\ufeff\n"t"{mark} u \n1{mark}2\n\n"3"{mark}4e0\n', encoding="utf-8")
    assert {name: values.tolist() for name, values in read_columns(path).items()} == {"t": [1.0, 3.0], "u": [2.0, 4.0]}


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


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("t,u\n0,1\n1,2,3\n", ["line 3 has 3 values, the header 2"]),
        ("t,u\n0,1\n\n1,2,3\n", ["line 4 has 3 values"]),
        ("t,u\n0,1\n1,off\n", ["line 3", "'off' is no number"]),
        ("t;u\n0;1,5\n1;2,5\n", ["line 2", "'1,5' is no number", "decimal point"]),
        ("t,t\n0,1\n", ["'t' is there twice"]),
        ("0,1\n1,2\n", ["first line holds numbers"]),
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


@pytest.mark.parametrize("suffix", [".mat", ".npz", ".parquet"])
def test_a_file_of_another_kind_is_one_line(suffix, tmp_path):
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(b"these are only some words, and then some more, so that there is something to look at " * 4)
    with pytest.raises(BristleError, match=r"cannot be read|is no NPZ archive") as caught:
        read_columns(path)
    assert "\n" not in str(caught.value)
    assert "pickle" not in str(caught.value)


OTHERS = {
    "text": np.array(["a", "b", "c"]), "complex numbers": np.ones(3) * 1j, "booleans": np.ones(3, dtype=bool),
    "an array of shape (2, 3)": np.ones((2, 3)), "timestamps": np.array(["2020-01-01"] * 3, dtype="datetime64[s]"),
}  # fmt: skip


@pytest.mark.parametrize("what", OTHERS)
def test_a_column_that_holds_no_numbers_is_named_with_what_it_holds(what, tmp_path):
    path = tmp_path / "odd.npz"
    np.savez(path, t=np.arange(3.0), u=OTHERS[what])
    columns = read_columns(path)
    with pytest.raises(BristleError, match="column 'u' holds") as caught:
        si_column("record odd", columns, "u", "1", None, "1")
    assert what in str(caught.value)
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
    with pytest.raises(BristleError, match=r"unit 'N\.m' with scale '3 rad' gives none like 'N\.m'"):
        factor_to("N.m", "3 rad", "N.m")
    with pytest.raises(BristleError, match=r"x{40}\.\.\., c1, .* and 11 more$"):
        si_column("record r: input", {"x" * 10_000: np.ones(3)} | {f"c{i}": np.ones(3) for i in range(1, 31)}, "v", "V", None, "V")
    with pytest.raises(BristleError, match="is not a number with a unit"):
        factor_to("V", "much", "V")


def test_a_csv_in_another_encoding_is_distinguished_from_a_corrupt_one(tmp_path):
    path = tmp_path / "r.csv"
    path.write_bytes("t,Größe\n0,1\n".encode("latin-1"))
    with pytest.raises(BristleError, match=r"r\.csv: is not UTF-8 text; save it as CSV in UTF-8"):
        read_columns(path)
