"""One reader for all formats of files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bristle.common.columns import Columns
from bristle.common.errors import BristleError
from bristle.common.files import check_regular
from bristle.records.formats.containers import (
    read_hdf5,
    read_mat,
    read_npy,
    read_npz,
    read_xlsx,
)
from bristle.records.formats.json_records import read_json, read_json_lines
from bristle.records.formats.packed import STREAMS, ZIP, is_packed, unpacked
from bristle.records.formats.padding import without_padding
from bristle.records.formats.parquet import read_parquet
from bristle.records.formats.text import read_delimited
from bristle.records.logs.channels import read_mdf, read_tdms, read_ulog
from bristle.records.logs.mcap_log import read_mcap
from bristle.records.logs.ros_bag import is_bag, read_ros_bag
from bristle.records.logs.wpi_log import read_wpi_log


def read_columns(path: Path) -> Columns:
    """Return all numeric columns of a file by name, of shape (n,); an empty field of a CSV is NaN.

    Raises
    ------
    BristleError
        If the file cannot be read or is of no known format.
    """
    if path.is_dir() and not is_bag(path):
        raise BristleError(
            f"record {path}: is a folder; give a file, or the pattern '{path}/*.csv'"
        )
    if not path.is_dir():
        check_regular(path, f"record {path}")
    try:
        columns = without_padding(_read(path))
    except BristleError:
        raise
    except OSError as error:
        if error.strerror is None:  # pyarrow's own errors are OSErrors without an error number
            raise _unreadable(path, error) from None
        raise BristleError(f"record {path}: {error.strerror}; check the path") from None
    except Exception as error:  # each format's reader has its own exceptions
        raise _unreadable(path, error) from None
    if not columns:
        held = "".join(f"; '{name}' holds {what}" for name, what in columns.unusable.items())
        raise BristleError(
            f"record {path}: no column of numbers{held}; give plain vectors of equal length"
        )
    return columns


def _read(path: Path) -> Columns:
    if is_packed(path):
        with unpacked(path, READERS) as inner:
            try:
                return _read(inner)
            except BristleError as error:  # of the copy, which nobody knows
                raise BristleError(str(error).replace(str(inner), str(path))) from None
    if path.is_dir():
        return read_ros_bag(path)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        known = ", ".join((*READERS, *STREAMS, ZIP))
        raise BristleError(f"record {path}: unknown format '{path.suffix}'; known: {known}")
    with path.open("rb") as file:  # what cannot be read says so before a library does
        if not file.read(1):
            raise BristleError(f"record {path}: is empty; record it anew")
    return reader(path)


def _unreadable(path: Path, error: Exception) -> BristleError:
    return BristleError(
        f"record {path}: cannot be read: {' '.join(str(error).split())}; check the file"
    )


READERS: dict[str, Callable[[Path], Columns]] = {
    **dict.fromkeys(
        (".csv", ".txt", ".tsv", ".dat", ".asc", ".log", ".lvm", ".prn"), read_delimited
    ),
    ".mat": read_mat,
    **dict.fromkeys((".h5", ".hdf5"), read_hdf5),
    ".npz": read_npz,
    ".npy": read_npy,
    ".parquet": read_parquet,
    **dict.fromkeys((".xlsx", ".xlsm"), read_xlsx),
    ".json": read_json,
    ".mcap": read_mcap,
    **dict.fromkeys((".bag", ".db3"), read_ros_bag),
    ".tdms": read_tdms,
    **dict.fromkeys((".mf4", ".mdf"), read_mdf),
    ".ulg": read_ulog,
    ".wpilog": read_wpi_log,
    **dict.fromkeys((".jsonl", ".ndjson"), read_json_lines),
}
