"""Tables of numbers: one reader for CSV, MAT, NPZ and Parquet, and columns converted to SI."""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TextIO
from zipfile import is_zipfile

import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import BristleError, suggest
from bristle.common.units import parse_unit

Array = NDArray[np.float64]

SEPARATORS = ",;\t"  # of the columns of a CSV file
SHOWN_LETTERS, SHOWN_NAMES = 40, 20  # letters of a column name, and column names, that an error message shows at most


class Columns(dict[str, Array]):
    """Columns by name, each of shape (n,); `unusable` gives for all others what they hold instead of numbers."""

    def __init__(self, columns: Mapping[str, Array], unusable: Mapping[str, str]) -> None:
        super().__init__(columns)
        self.unusable = dict(unusable)


def read_columns(path: Path) -> Columns:
    """Return all numeric columns of a file by name, each of shape (n,); an empty field of a CSV is NaN.

    Raises
    ------
    BristleError
        If the file cannot be read or is of no known format.
    """
    if path.is_dir():
        raise BristleError(f"record {path}: is a folder; give a file, and each file with an option of its own")
    if path.exists() and not path.is_file():
        raise BristleError(f"record {path}: is a pipe or device, no regular file; write it to one first")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise BristleError(f"record {path}: unknown format '{path.suffix}'; known: {', '.join(READERS)}")
    try:
        columns = reader(path)
    except BristleError:
        raise
    except OSError as error:
        if error.strerror is None:  # pyarrow's own errors are OSErrors without an error number
            raise _unreadable(path, error) from None
        raise BristleError(f"record {path}: {error.strerror}; check the path") from None
    except UnicodeDecodeError:
        raise BristleError(f"record {path}: is not UTF-8 text; save it as CSV in UTF-8") from None
    except Exception as error:  # each format's reader has its own exceptions
        raise _unreadable(path, error) from None
    if not columns:
        held = "".join(f"; '{name}' holds {what}" for name, what in columns.unusable.items())
        raise BristleError(f"record {path}: no column of numbers{held}; give plain vectors of equal length")
    return columns


def _unreadable(path: Path, error: Exception) -> BristleError:
    return BristleError(f"record {path}: cannot be read: {' '.join(str(error).split())}; check the file")


def _read_csv(path: Path) -> Columns:
    with path.open(newline="", encoding="utf-8-sig") as stream:
        first, above = _header(stream)
        if not first.strip():
            raise BristleError(f"record {path}: is empty; write the column names in the first line and numbers below")
        # spreadsheets also write semicolons or tabs between columns
        separator = next((mark for mark in SEPARATORS if mark in first), ",")
        header = [name.strip() for name in next(csv.reader([first.lstrip("# ")], delimiter=separator), [])]
        if any(_is_number(name) for name in header):
            raise BristleError(f"record {path}: the first line holds numbers; write the column names there")
        twice = sorted({name for name in header if header.count(name) > 1})
        if twice:
            raise BristleError(f"record {path}: column '{twice[0]}' is there twice; give each column its own name")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # of no data, which is an error below
                table = np.loadtxt(stream, delimiter=separator, comments=None, quotechar='"', ndmin=2)
        except ValueError:
            table = np.empty((0, 0))
    if table.shape[1] != len(header) or not len(table):
        table = _read_rows(path, separator, len(header), above)
    return Columns({name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(header)}, {})


def _header(stream: TextIO) -> tuple[str, int]:
    """Return the line of the column names and its number, and leave the stream behind it: the first line that is no comment.

    A comment begins with #. So does a header that numpy.savetxt has written, but numbers follow it.
    """
    first, number = stream.readline(), 1
    while first:
        begin = stream.tell()
        following = stream.readline()
        stream.seek(begin)
        remark = first.startswith("#") and not _is_number(re.split(f"[{SEPARATORS}]", following)[0])
        if first.strip() and not remark:
            break
        first, number = stream.readline(), number + 1
    return first, number


def _read_rows(path: Path, separator: str, width: int, above: int) -> Array:
    """Read a CSV row by row below so many lines: slower, but it finds the line of a mistake and accepts empty fields."""
    rows: list[list[float]] = []
    with path.open(newline="", encoding="utf-8-sig") as stream:
        for _ in range(above):
            stream.readline()
        reader = csv.reader(stream, delimiter=separator)
        found = ((above + reader.line_num, row) for row in reader if row and any(field.strip() for field in row))
        for line, row in found:
            if len(row) != width:
                raise BristleError(f"record {path}: line {line} has {len(row)} values, the header {width}; correct that line")
            try:
                rows.append([float(field) if field.strip() else np.nan for field in row])
            except ValueError:
                word = next(field for field in row if field.strip() and not _is_number(field))
                comma = _is_number(word.replace(",", "."))
                hint = "write a decimal point" if comma else "keep only numbers below the header"
                raise BristleError(f"record {path}: line {line}: '{word}' is no number; {hint}") from None
    if not rows:
        raise BristleError(f"record {path}: no data below the line of column names; write numbers there")
    return np.array(rows)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _read_mat(path: Path) -> Columns:
    from scipy.io import loadmat

    with path.open("rb") as stream:
        try:
            found = loadmat(stream)
        except NotImplementedError:  # version 7.3 is HDF5
            raise BristleError(f"record {path}: MAT file of version 7.3; save it with -v7") from None
    return _vectors({name: value for name, value in found.items() if not name.startswith("__")})


def _read_npz(path: Path) -> Columns:
    with path.open("rb") as stream:
        if not is_zipfile(stream):
            raise BristleError(f"record {path}: is no NPZ archive; save it with numpy.savez")
        stream.seek(0)
        with np.load(stream, allow_pickle=False) as archive:
            return _vectors(dict(archive))


def _read_parquet(path: Path) -> Columns:
    import pyarrow as pa
    import pyarrow.parquet as pq

    with path.open("rb") as stream:
        table = pq.read_table(stream)
    numeric = [field.name for field in table.schema if pa.types.is_integer(field.type) or pa.types.is_floating(field.type)]
    other = {field.name: f"{field.type} values" for field in table.schema if field.name not in numeric}
    return Columns({name: table[name].to_numpy().astype(float) for name in numeric}, other)


def _vectors(found: Mapping[str, NDArray[np.generic]]) -> Columns:
    arrays = {name: np.asarray(value) for name, value in found.items()}
    unusable = {name: why for name, value in arrays.items() if (why := _no_vector(value))}
    return Columns({name: value.astype(float).ravel() for name, value in arrays.items() if name not in unusable}, unusable)


KINDS = {"U": "text", "S": "text", "c": "complex numbers", "M": "timestamps", "m": "durations", "V": "a struct", "b": "booleans"}


def _no_vector(value: NDArray[np.generic]) -> str:
    """Return what an array holds if it cannot serve as a column; an empty text if it can."""
    if value.dtype.kind not in "fiu":
        return KINDS.get(value.dtype.kind, "objects")
    return "" if value.size == max(value.shape, default=0) else f"an array of shape {value.shape}"


READERS: dict[str, Callable[[Path], Columns]] = {
    ".csv": _read_csv,
    ".mat": _read_mat,
    ".npz": _read_npz,
    ".parquet": _read_parquet,
}


def factor_to(unit: str, scale: str | None, si_unit: str) -> float:
    """Return the factor that converts a value in `unit` to `si_unit`; `scale` is such as ``"1 rad/m"``.

    Raises
    ------
    BristleError
        If a unit is not known or does not fit.
    """
    have, want = parse_unit(unit), parse_unit(si_unit)
    factor, exponents = have.factor / want.factor, np.array(have.exponents)
    if scale is not None:
        number, _, text = scale.strip().partition(" ")
        over = parse_unit(text or "1")
        if not _is_number(number) or not np.isfinite(float(number)):
            raise BristleError(f"scale '{scale}' is not a number with a unit; write for example \"20 rad/m\"")
        if float(number) == 0.0:
            raise BristleError(f"scale '{scale}' is zero; write what one of the unit is worth, for example \"20 rad/m\"")
        factor, exponents = factor * float(number) * over.factor, exponents + np.array(over.exponents)
    if tuple(exponents) != want.exponents:
        if scale is not None:
            raise BristleError(f"unit '{unit}' with scale '{scale}' gives none like '{si_unit}', which is needed; correct either")
        raise BristleError(
            f"unit '{unit}' does not fit, a unit like '{si_unit}' is needed; "
            f'correct it, or add scale = "... {si_unit}" over that unit'
        )
    return factor


def _listed(names: Iterable[str]) -> str:
    """Return names in short, for one line of an error message."""
    short = [name if len(name) <= SHOWN_LETTERS else f"{name[:SHOWN_LETTERS]}..." for name in names]
    return ", ".join(short[:SHOWN_NAMES]) + (f" and {len(short) - SHOWN_NAMES} more" if len(short) > SHOWN_NAMES else "")


def si_column(where: str, columns: Mapping[str, Array], name: str, unit: str, scale: str | None, si_unit: str) -> Array:
    """Return a column in SI units, shape (n,); `where` begins the line of an error."""
    if what := getattr(columns, "unusable", {}).get(name):
        raise BristleError(f"{where}: column '{name}' holds {what}; give one number a sample")
    if name not in columns:
        raise BristleError(f"{where}: no column '{name}'{suggest(name, list(columns))}; there are: {_listed(columns)}")
    try:
        return columns[name] * factor_to(unit, scale, si_unit)
    except BristleError as error:
        raise BristleError(f"{where}: {error}") from None
