"""Tables of text: CSV, tab-separated and aligned columns as loggers, spreadsheets and oscilloscopes
write them.
"""

from __future__ import annotations

import csv
import re
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bristle.common.columns import Array, Columns, is_number, must_fit
from bristle.common.errors import BristleError
from bristle.common.unit_names import unit_symbol
from bristle.records.formats.rate import rate_in
from bristle.records.formats.timestamps import is_stamp, seconds

# lines: from the first ones the separator, the header and the columns of numbers are found
SNIFFED_LINES = 500
SEPARATORS = ("\t", ";", ",", "")  # between columns; the empty one stands for spaces
REMARK = "#%"  # a line of the header or above may begin with these
# fields without a value
BLANKS = frozenset({"", "-", "--", "---", "nan", "na", "n/a", "#n/a", "#nv", "null", "none"})
SHOWN_FIELD = 30  # letters of a field that an error shows at most

_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?$")
# a field that is a list of one number, as tables of Rerun's have them
_LIST_OF_ONE = re.compile(
    r'(?<![^",;\t])\[\s*([+-]?(?:\d+\.\d*|\.\d+)(?:e[+-]?\d+)?)\s*\](?![^",;\t])', re.IGNORECASE
)
_BRACKETED = re.compile(r"[\[(].*[\])]$")
# of a time, in a row of units: hh:mm:ss.fff
_CLOCK_FORMAT = re.compile(r"(?=.*h)(?=.*m)[ymdhsfzt:.,/ -]+$", re.IGNORECASE)
_UNIT_AT_END = re.compile(r"(?:\s*[\[(][^\])]*[\])])?$")
_WORD_WITH_UNIT = re.compile(r"\S+(?:\s?\[[^\]]*\]|\s?\([^)]*\))?")
Rows = Sequence[Sequence[str]]


@dataclass(frozen=True)
class _Heading:
    """What stands above the numbers: names and units of columns, index of their first row."""

    names: list[str]
    units: dict[str, str]
    first: int


def read_delimited(path: Path) -> Columns:
    """Return the columns of a file of text."""
    must_fit(path, path.stat().st_size)
    lines = _text(path).splitlines()
    if not any(map(str.strip, lines)):
        raise BristleError(
            f"record {path}: is empty; write the column names in the first line and numbers below"
        )
    if any(map(_LIST_OF_ONE.search, lines[:SNIFFED_LINES])):
        lines = [_LIST_OF_ONE.sub(r"\1", line) for line in lines]
    sample = lines[:SNIFFED_LINES]
    mark = _separator(sample)
    if mark != ";":  # some end their lines with it, besides
        lines = [line.rstrip("; ") for line in lines]
        sample = lines[:SNIFFED_LINES]
    split = list(_split(sample, mark))
    must_fit(path, 0, max(map(len, split)))
    heading = _heading(path, split, mark, sample)
    comma = mark != "," and any(
        _COMMA.match(field.strip()) for row in split[heading.first :] for field in row
    )
    table = _fast(lines[heading.first :], mark, comma)
    if table.shape[1] == len(heading.names):
        named = {name: np.ascontiguousarray(table[:, k]) for k, name in enumerate(heading.names)}
        columns = Columns(named, units=heading.units)
    else:
        columns = _columns(path, list(_split(lines, mark)), heading)
    columns.rate = rate_in(lines[: heading.first])
    return columns


def read_rows(path: Path, rows: Rows) -> Columns:
    """Return the columns of a table whose fields are separated already, as in a spreadsheet."""
    must_fit(path, 0, max(map(len, rows), default=0))
    return _columns(path, rows, _heading(path, rows[:SNIFFED_LINES], ",", []))


def _text(path: Path) -> str:
    """Return the text of a file, in UTF-8, in UTF-16, or in the code of Western spreadsheets."""
    content = path.read_bytes()
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return content.decode("utf-16")
    zeros = content[:2000].count(0)
    if zeros > len(content[:2000]) // 4:
        return content.decode("utf-16-be" if content[0] == 0 else "utf-16-le")
    if zeros:
        raise BristleError(
            f"record {path}: is no text; give it the suffix of its format, or save it as CSV"
        )
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")


# -- fields ----------------------------------------------------------------------------------------
def _split(lines: Sequence[str], mark: str) -> Iterator[list[str]]:
    """Give the fields of each line."""
    for line in lines:
        if not mark:
            yield line.split()
        elif '"' in line:
            yield next(csv.reader([line], delimiter=mark), [])
        else:
            yield line.split(mark) if line.strip() else []


def _number(text: str) -> float:
    """Return a number with a decimal point or comma; raise ValueError if it is none."""
    text = text.strip()
    return float(text.replace(",", ".", 1)) if _COMMA.match(text) else float(text)


def _usable(text: str) -> bool:
    """Return whether a field is a number or a timestamp."""
    return is_number(text) or _COMMA.match(text.strip()) is not None or is_stamp(text)


def _blank(text: str) -> bool:
    return text.strip().lower() in BLANKS


def _separator(lines: Sequence[str]) -> str:
    """Return the separator that makes most fields of the last lines numbers, in several columns."""
    filled = [line for line in lines if line.strip()]
    best, most = ",", 0.0
    for mark in SEPARATORS:
        rows = list(_split(filled[len(filled) // 2 :], mark))
        width = _width(rows)
        fields = [field for row in rows if len(row) == width for field in row if field.strip()]
        share = (
            sum(map(_usable, fields))
            / max(len(fields), 1)
            * sum(len(row) == width for row in rows)
            / len(rows)
        )
        if width > 1 and share > most:
            best, most = mark, share
    return best


def _width(rows: Rows) -> int:
    """Return the usual number of fields of a row."""
    return Counter(len(row) for row in rows).most_common(1)[0][0] if rows else 0


# -- header ----------------------------------------------------------------------------------------
def _heading(path: Path, rows: Rows, mark: str, lines: Sequence[str]) -> _Heading:
    """Find the names of columns, the row of units below, if any, and the first row of numbers."""
    filled = _filled(rows, 0)
    below = [rows[k] for k in filled[len(filled) // 2 :]]
    width = _width(below)
    numeric = _numeric(below, width)
    data = [k for k in filled if _is_data(rows[k], width, numeric)]
    if not data:
        raise BristleError(
            f"record {path}: no data below the line of column names; write numbers there"
        )
    above, first = _above(rows, filled, data, numeric)
    header, units = _header(rows, above, mark, lines, width)
    # a separator at the end of each line makes a column without a name
    spare = all(not row[-1].strip() for row in below if len(row) == width)
    if above and not spare and len(rows[above[-1]]) == width:  # the last columns have no name
        header += [""] * (width - len(header))
    if len(header) not in ((width, width - 1) if spare else (width,)):
        raise BristleError(
            f"record {path}: line {first + 1} has {width} values, the header {len(header)}; correct"
            " that line"
        )
    names = _names(header)
    return _Heading(names, dict(filter(all, zip(names, units, strict=False))), first)


def _above(
    rows: Rows, filled: Sequence[int], data: Sequence[int], numeric: Sequence[int]
) -> tuple[list[int], int]:
    """Return the places of the rows above the numbers, and the first of the numbers: samples that
    lack values are some, too.
    """
    full = next((k for k in data if _is_full(rows[k], numeric)), data[0])
    *above, first = [k for k in filled if k <= full]
    while above and (above[-1] in data or all(map(_blank, rows[above[-1]]))):
        first = above.pop()
    return above, first


def _filled(rows: Rows, first: int) -> list[int]:
    """Return the places of the rows, from the first on, that are not blank."""
    return [k for k in range(first, len(rows)) if any(map(str.strip, rows[k]))]


def _names(header: Sequence[str]) -> list[str]:
    """Return the names of all columns; those that are there twice are numbered, ``u #1 [V]``."""
    names = [name or f"column {k}" for k, name in enumerate(header, start=1)]
    count, seen = Counter(names), Counter[str]()
    for k, name in enumerate(names):
        if count[name] > 1:
            seen[name] += 1
            names[k] = _UNIT_AT_END.sub(f" #{seen[name]}\\g<0>", name, count=1)
    return names


def _numeric(below: Rows, width: int) -> list[int]:
    """Return the columns of which at least half the fields that are filled are usable."""
    found = []
    for j in range(width):
        fields = [row[j] for row in below if len(row) == width and not _blank(row[j])]
        if fields and 2 * sum(map(_usable, fields)) >= len(fields):
            found.append(j)
    return found


def _header(
    rows: Rows, above: Sequence[int], mark: str, lines: Sequence[str], width: int
) -> tuple[list[str], list[str]]:
    """Return (names, units) of the rows above the numbers; no names for what is at most a title."""
    if not above:
        return [""] * width, []
    last = above[-1]
    header = _fields(rows, last, mark, lines, width)
    remark = rows[last][0].startswith(tuple(REMARK))
    if len(header) < min(width, 2) or (len(header) != width and remark):
        return [""] * width, []
    if len(above) > 1 and _is_units(header):
        named = _fields(rows, above[-2], mark, lines, width)
        if len(named) >= len(header) and not _is_units(named):
            return named, header
    return header, []


def _is_data(row: Sequence[str], width: int, numeric: Sequence[int]) -> bool:
    """Return whether a row holds numbers where the rows below it do."""
    if len(row) != width:
        return False
    fields = [row[j] for j in numeric if not _blank(row[j])]
    return bool(fields) and all(map(_usable, fields))


def _is_full(row: Sequence[str], numeric: Sequence[int]) -> bool:
    """Return whether a row has most of its numbers; one above the names, such as ``Sampling time;1
    ms;;``, has a single one.
    """
    return 2 * sum(not _blank(row[j]) for j in numeric) >= len(numeric)


def _fields(rows: Rows, k: int, mark: str, lines: Sequence[str], width: int) -> list[str]:
    """Return the fields of a row of names or units; between spaces, a unit in brackets belongs to
    the name before it.
    """
    row = list(rows[k])
    if not mark:
        text = lines[k].strip().lstrip(REMARK).strip()
        splits: list[list[str]] = [
            re.split(r"\s{2,}|\t", text),
            _WORD_WITH_UNIT.findall(text),
            text.split(),
        ]
        row = next((each for each in splits if len(each) == width), splits[-1])
    elif row:
        row[0] = row[0].lstrip(REMARK + " ")
    row = [field.strip() for field in row]
    while row and not row[-1] and len(row) > 1:
        row.pop()
    return row


def _is_units(row: Sequence[str]) -> bool:
    """Return whether all fields of a row are units, or in brackets as units are."""
    fields = [field for field in row if not _blank(field)]
    return bool(fields) and all(
        _BRACKETED.match(field) or _CLOCK_FORMAT.match(field) or unit_symbol(field)
        for field in fields
    )


# -- numbers ---------------------------------------------------------------------------------------
def _fast(lines: list[str], mark: str, comma: bool) -> Array:
    """Return a table of only numbers, read at the speed of C; else a table without columns."""
    if comma:
        lines = [line.replace(",", ".") for line in lines]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of no data
            return np.loadtxt(lines, delimiter=mark or None, comments=None, quotechar='"', ndmin=2)
    except ValueError:
        return np.empty((0, 0))


def _columns(path: Path, rows: Rows, heading: _Heading) -> Columns:
    """Read field by field: slower, but fields may be blank, and what holds no numbers is named."""
    places, found, findings = _complete(path, rows, heading)
    columns, unusable, clocks = {}, {}, []
    for j, name in enumerate(heading.names):
        fields = [row[j] for row in found]
        values = _numbers(fields)
        if values is None:
            values = seconds(["" if _blank(field) else field for field in fields])
            if values is not None:
                clocks.append(name)
        if values is None:
            unusable[name] = _text_among(fields, places)
        else:
            columns[name] = values
    return Columns(columns, unusable, units=heading.units, clocks=clocks, findings=findings)


def _complete(
    path: Path, rows: Rows, heading: _Heading
) -> tuple[list[int], list[Sequence[str]], list[str]]:
    """Return (places, rows) of the data, and findings; a last line that breaks off is left out."""
    width, found, findings = len(heading.names), [], []
    filled = _filled(rows, heading.first)
    for k in filled:
        row = rows[k]
        surplus = len(row) - width
        if surplus > 0 and all(_blank(field) for field in row[width:]):
            row = row[:width]
        elif surplus < 0 and k == filled[-1] and k > heading.first:
            findings.append(f"the last line has {len(row)} of {width} values; left out")
            break
        elif surplus:
            raise BristleError(
                f"record {path}: line {k + 1} has {len(row)} values, most have {width}; correct"
                " that line"
            )
        found.append(row)
    return filled, found, findings


def _text_among(fields: Sequence[str], places: Sequence[int]) -> str:
    """Say which field is no number, and in which line it is."""
    texts = (k for k, field in enumerate(fields) if not _blank(field) and not _usable(field))
    bad = next(texts, 0)
    return f"text ('{fields[bad].strip()[:SHOWN_FIELD]}' in line {places[bad] + 1})"


def _numbers(fields: Sequence[str]) -> Array | None:
    """Return fields as numbers, NaN where they are blank; None if one is neither."""
    try:
        return np.array(fields).astype(float)
    except ValueError:
        pass
    try:
        return np.array([np.nan if _blank(field) else _number(field) for field in fields])
    except ValueError:
        return None
