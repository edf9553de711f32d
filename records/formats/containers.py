"""Files that hold arrays: MAT of all versions, HDF5, NPZ, NPY, and spreadsheets."""

from __future__ import annotations

import math
import warnings
import zlib
from collections.abc import Iterator, Mapping
from datetime import date, datetime, timedelta
from pathlib import Path
from typing import Any, BinaryIO, Literal
from zipfile import ZipFile, is_zipfile

import numpy as np

from bristle.common.columns import LARGEST_CONTENT, Columns, columns_of, must_fit
from bristle.common.errors import BristleError
from bristle.records.formats.matlab_objects import read_objects
from bristle.records.formats.rate import rate_in
from bristle.records.formats.structs import flat_structs
from bristle.records.formats.text import read_rows

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
HDF5_OFFSETS = (0, 512)  # bytes: where it stands; before it, MATLAB writes a line of text
MATLAB_NUMBERS = ("double", "single", "int", "uint")  # begin of the classes of numbers
NPY_MAGIC = b"\x93NUMPY"
# bytes before the first element of a MAT file; type of a compressed element
MAT_HEADER, MAT_COMPRESSED = 128, 15
MAT_ORDERS: dict[Literal["little", "big"], bytes] = {
    "little": b"\x00\x01IM",
    "big": b"\x01\x00MI",
}  # end of that header: version and order of the bytes
# what holds the objects of classes: in MAT files before 7.3, and in HDF5
MAT_OBJECTS, HDF5_OBJECTS = "__function_workspace__", "#subsystem#"
UNPACKED_CHUNK = 2**20  # bytes unpacked at a time


# -- MAT and HDF5 ----------------------------------------------------------------------------------
def read_mat(path: Path) -> Columns:
    """Return the vectors of a MAT file, those of structs as ``struct.field``."""
    from scipy.io import loadmat

    with path.open("rb") as stream:
        if _is_hdf5(stream):
            return read_objects(path) if _holds_objects(path) else read_hdf5(path)
        must_fit(path, _unpacked_size(stream))
        stream.seek(0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of objects, which are read below
            found = loadmat(stream, simplify_cells=True)
    if MAT_OBJECTS in found:
        return read_objects(path)
    flat = dict(flat_structs({k: v for k, v in found.items() if not k.startswith("__")}))
    columns = columns_of(path, _named_channels(flat), "(:,{})")
    columns.rate = _own_rate(flat)
    return columns


def _named_channels(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Return the same with the data of an identification toolbox's struct as one vector a channel,
    by the name of the channel.
    """
    found = dict(flat)
    for name in flat:
        prefix, _, last = name.rpartition(".")
        if last not in ("InputData", "OutputData"):
            continue
        given = flat.get(f"{prefix}.{last.replace('Data', 'Name')}")
        labels = [str(each) for each in np.ravel(given)] if given is not None else []
        table = np.asarray(flat[name])
        table = table[:, None] if table.ndim == 1 else table
        if table.ndim == 2 and len(labels) == table.shape[1] == len(set(labels)):
            del found[name]
            found |= {f"{prefix}.{label}": table[:, k] for k, label in enumerate(labels)}
    return found


def _own_rate(flat: Mapping[str, Any]) -> float | None:
    """Return the sampling rate [Hz] that a number such as Ts or fs gives, or None."""
    numbers = {
        name.rpartition(".")[2]: float(value)
        for name, value in flat.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }
    return rate_in([f"{name} = {value!r}" for name, value in numbers.items()])


def _is_hdf5(stream: BinaryIO) -> bool:
    for offset in HDF5_OFFSETS:
        stream.seek(offset)
        if stream.read(len(HDF5_MAGIC)) == HDF5_MAGIC:
            return True
    return False


def _holds_objects(path: Path) -> bool:
    import h5py

    with path.open("rb") as stream, h5py.File(stream, "r") as file:
        return HDF5_OBJECTS in file


def _unpacked_size(stream: BinaryIO) -> int:
    """Return how many bytes the elements of a MAT file hold, as far as the limit: each is unpacked
    once and not kept.
    """
    stream.seek(MAT_HEADER - len(MAT_ORDERS["little"]))
    mark = stream.read(len(MAT_ORDERS["little"]))
    order = next((order for order, written in MAT_ORDERS.items() if written == mark), None)
    if order is None:  # version 4, which is not compressed, or no MAT file
        return stream.seek(0, 2)
    size = 0
    while len(tag := stream.read(8)) == 8 and size <= LARGEST_CONTENT:
        kind, length = (int.from_bytes(part, order) for part in (tag[:4], tag[4:]))
        content = stream.read(length)
        if kind != MAT_COMPRESSED:
            size += length
            continue
        unpacker = zlib.decompressobj()
        while content and size <= LARGEST_CONTENT:
            size += len(unpacker.decompress(content, UNPACKED_CHUNK))
            content = unpacker.unconsumed_tail
    return size


def read_hdf5(path: Path) -> Columns:
    """Return the vectors of an HDF5 file, which a MAT file of version 7.3 is; those of groups as
    ``group.name``.
    """
    import h5py

    found: dict[str, Any] = {}
    other: dict[str, str] = {}
    size = 0
    with path.open("rb") as stream, h5py.File(stream, "r") as file:

        def visit(name: str, item: Any) -> None:
            nonlocal size
            if name.startswith("#") or not isinstance(item, h5py.Dataset):
                return
            name, numeric = name.replace("/", "."), item.dtype.kind in "fiu"
            kind = item.attrs.get("MATLAB_class", "double" if numeric else "char")
            kind = kind.decode() if isinstance(kind, bytes) else str(kind)
            if not numeric or not kind.startswith(MATLAB_NUMBERS):
                other[name] = "text" if kind == "char" else f"a MATLAB {kind}"
                return
            size += 8 * math.prod(item.shape or (0,))
            must_fit(path, size, len(found))
            found[name] = item[()]

        file.visititems(visit)
    columns = columns_of(path, found, "(:,{})")
    columns.unusable.update(other)
    return columns


# -- NumPy -----------------------------------------------------------------------------------------
def read_npz(path: Path) -> Columns:
    """Return the vectors of an NPZ archive."""
    with path.open("rb") as stream:
        if not is_zipfile(stream):
            raise BristleError(f"record {path}: is no NPZ archive; save it with numpy.savez")
        must_fit(path, *_zip_size(stream))
        stream.seek(0)
        with np.load(stream, allow_pickle=False) as archive:
            return columns_of(path, dict(archive))


def read_npy(path: Path) -> Columns:
    """Return the columns, or the rows if these are the longer, of a matrix."""
    must_fit(path, path.stat().st_size)
    with path.open("rb") as stream:
        if stream.read(len(NPY_MAGIC)) != NPY_MAGIC:
            raise BristleError(f"record {path}: is no array; save it with numpy.save")
        stream.seek(0)
        return columns_of(path, {"array": np.load(stream, allow_pickle=False)})


def _zip_size(stream: BinaryIO) -> tuple[int, int]:
    """Return the unpacked size [bytes] and the number of the files in an archive."""
    with ZipFile(stream) as archive:
        files = archive.infolist()
    return sum(each.file_size for each in files), len(files)


# -- spreadsheets ---------------------------------------------------------------------------------
def read_xlsx(path: Path) -> Columns:
    """Return the columns of the first sheet of a workbook that holds a table."""
    from openpyxl import load_workbook

    with path.open("rb") as stream:
        if not is_zipfile(stream):
            raise BristleError(f"record {path}: is no XLSX workbook; save it as .xlsx or .csv")
        must_fit(path, _zip_size(stream)[0])
        stream.seek(0)
        book = load_workbook(stream, read_only=True, data_only=True)
        try:
            for sheet in book.worksheets:
                sheet.reset_dimensions()  # some programs write wrong ones
                if rows := list(_rows(path, sheet)):
                    return read_rows(path, rows)
        finally:
            book.close()
    raise BristleError(
        f"record {path}: no sheet holds a table; write the column names in the first line and"
        " numbers below"
    )


def _rows(path: Path, sheet: Any) -> Iterator[list[str]]:
    """Give the rows of a sheet as text, as far as a file may hold."""
    count = 0
    for row in sheet.iter_rows(values_only=True):
        count += len(row)
        must_fit(path, 8 * count, len(row))
        yield [_cell(value) for value in row]


def _cell(value: object) -> str:
    """Return the value of a cell as text."""
    if value is None:
        return ""
    if isinstance(value, timedelta):
        return repr(value.total_seconds())
    return value.isoformat() if isinstance(value, date | datetime) else str(value)
