"""The store of a sweep: a folder of Parquet files, one a chunk of runs, each written whole or not
at all.

    STORE/sweeps/<hash>.json    what was asked for: scenario, varied values, seeds, FMUs, provenance
    STORE/runs/<hash>.parquet   one row a run; the hash is that of the keys of its runs

The key of a run is the hash of all that decides its result: scenario, FMUs, options, version,
values and seed. Files are only ever added, so several sweeps may write into one store at once; of a
run that is there several times, one that is no error counts.
"""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bristle.common.cache import digest
from bristle.common.errors import BristleError
from bristle.common.output import replace_file, to_json
from bristle.common.work import TemporaryFolder

try:
    import pyarrow as pa
    import pyarrow.dataset
    import pyarrow.parquet as pq
except ImportError:
    raise BristleError(
        "store of a sweep: needs pyarrow; run: pip install 'bristle[parquet]'"
    ) from None

SWEEPS, RUNS = "sweeps", "runs"  # folders of a store
# least that is known of a sweep
DESCRIBED = {"scenario", "scenario_sha256", "vary", "runs", "fmus", "provenance"}
ERROR_VERDICT = "error"
ROW_NUMBER = f"row_number() OVER (PARTITION BY key ORDER BY verdict = '{ERROR_VERDICT}')"


class Store:
    """A folder of sweeps.

    Parameters
    ----------
    path : Path
        The folder.

    Raises
    ------
    BristleError
        If it exists and is no store.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.absolute()  # the working directory changes while FMUs are loaded
        if path.exists() and not path.is_dir():
            raise BristleError(f"{path}: is a file; give a folder for the store")
        if path.is_dir() and any(path.iterdir()) and not (path / SWEEPS).is_dir():
            raise BristleError(
                f"{path}: is no store of bristle sweep, and not empty; give another folder"
            )

    def require(self) -> None:
        """Raise `BristleError` if it holds no run."""
        if not self.files():
            raise BristleError(
                f"{self.path}: no store, or one without runs; make one with bristle sweep"
            )

    def files(self) -> list[Path]:
        """Return the files of runs."""
        return sorted(path for path in (self.path / RUNS).glob("*.parquet") if path.is_file())

    def sweeps(self) -> list[dict[str, Any]]:
        """Return what was asked for, sweep by sweep in the order of their dates.

        Raises
        ------
        BristleError
            If one of their files is damaged.
        """
        return sorted(
            map(_description, (self.path / SWEEPS).glob("*.json")),
            key=lambda each: str(each["provenance"]["date"]),
        )

    def describe(self, name: str, content: Mapping[str, Any]) -> None:
        """Write what is asked for, and make the folders."""
        try:
            for folder in (SWEEPS, RUNS):
                (self.path / folder).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise self._full(error) from None
        replace_file(self.path / SWEEPS / f"{name}.json", to_json(content).encode())

    def add(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Write the runs of a chunk as one file, through to the disk."""
        if not rows:
            return
        name = f"{digest(*(row['key'] for row in rows))[:24]}.parquet"
        try:
            with TemporaryFolder("chunk", self.path / RUNS) as folder:
                with (Path(folder) / name).open("wb") as file:
                    pq.write_table(
                        table_of(rows), file, compression="zstd", write_page_checksum=True
                    )
                    file.flush()
                    os.fsync(file.fileno())
                os.replace(Path(folder) / name, self.path / RUNS / name)
        except OSError as error:
            first = error.__context__
            if first is not None and not isinstance(first, Exception):
                # an interrupt, after which the file could not be closed properly
                raise first from None
            raise self._full(error) from None

    def _full(self, error: OSError) -> BristleError:
        return BristleError(
            f"store {self.path}: {error.strerror or error}; make room, then resume the sweep"
            " (finished chunks are kept)"
        )

    def _damaged(self, error: Exception) -> BristleError:
        return BristleError(
            f"store {self.path}: {_line(error)}; resume the sweep, which repairs it"
        )

    def done(self) -> dict[str, str]:
        """Return the keys of the runs that are done, with their verdicts.

        What ended in an error is not done; a file that is damaged is removed, and its runs count as
        not done.

        Raises
        ------
        BristleError
            If a file is not one of a sweep.
        """
        keys: dict[str, str] = {}
        for path in self.files():
            try:
                # all of it, so that all is verified
                runs = pq.read_table(path, page_checksum_verification=True)
            except (OSError, pa.ArrowException):
                path.unlink(missing_ok=True)
                continue
            _must_have_runs(path, runs.schema)
            pairs = zip(runs["key"].to_pylist(), runs["verdict"].to_pylist(), strict=True)
            keys.update((key, verdict) for key, verdict in pairs if verdict != ERROR_VERDICT)
        return keys

    def dataset(self) -> pyarrow.dataset.Dataset:
        """Return all files as one, with all their columns; pages are compared with their checksums
        as they are read.
        """
        self.require()
        try:
            schemas = [_must_have_runs(path, pq.read_schema(path)) for path in self.files()]
            schema = pa.unify_schemas(schemas, promote_options="permissive")
            checked = pyarrow.dataset.ParquetFragmentScanOptions(page_checksum_verification=True)
            form = pyarrow.dataset.ParquetFileFormat(default_fragment_scan_options=checked)
            return pyarrow.dataset.dataset(
                [str(path) for path in self.files()], schema=schema, format=form
            )
        except (OSError, pa.ArrowException) as error:
            raise self._damaged(error) from None

    def table(self) -> pa.Table:
        """Return the runs, each once, in the order of their places in their sweeps."""
        try:
            runs = self.dataset().to_table()
        except (OSError, pa.ArrowException) as error:
            raise self._damaged(error) from None
        errors = [verdict == ERROR_VERDICT for verdict in runs["verdict"].to_pylist()]
        chosen: dict[str, int] = {}
        for row, key in enumerate(runs["key"].to_pylist()):
            if key not in chosen or errors[chosen[key]]:
                chosen[key] = row
        return runs.take(sorted(chosen.values())).sort_by(
            [("sweep", "ascending"), ("run", "ascending")]
        )

    def query(self, sql: str) -> tuple[list[str], list[tuple[Any, ...]]]:
        """Return names of columns and rows of an SQL query on the table `runs`.

        Raises
        ------
        BristleError
            If DuckDB is not installed, or does not understand the query.
        """
        dataset = self.dataset()
        try:
            import duckdb
        except ImportError:
            raise BristleError("query: needs DuckDB; run: pip install 'bristle[query]'") from None
        try:
            with duckdb.connect() as connection:
                connection.register("files", dataset)
                once = (
                    f"SELECT * EXCLUDE (_copy) FROM (SELECT *, {ROW_NUMBER} AS _copy FROM files)"
                    " WHERE _copy = 1"
                )
                connection.execute(f"CREATE VIEW runs AS {once}")
                # a query reads runs, and neither reads nor writes files
                connection.execute("SET enable_external_access = false")
                connection.execute("SET lock_configuration = true")
                answer: Any = connection.execute(sql)
                if answer is None:
                    raise BristleError(
                        "query: says nothing; write for example SELECT verdict, count(*) FROM runs"
                        " GROUP BY 1"
                    )
                return [str(column[0]) for column in answer.description], answer.fetchall()
        except (duckdb.Error, OSError, pa.ArrowException) as error:
            raise BristleError(f"query: {_line(error)}") from None


def _description(path: Path) -> dict[str, Any]:
    """Return what was asked for in one sweep."""
    try:
        description = json.loads(path.read_text(encoding="utf-8"))
        if not description.keys() >= DESCRIBED:
            raise ValueError("entries are missing")
    except (OSError, ValueError, AttributeError) as error:
        why = (
            f"is damaged ({_line(error)}); make its sweep again with --resume, which writes it"
            " anew, or remove it"
        )
        raise BristleError(f"{path}: {why}") from None
    return dict(description)


def _must_have_runs(path: Path, schema: pa.Schema) -> pa.Schema:
    """Return the schema of a file of runs; raise `BristleError` if it is another file's."""
    if not {"key", "sweep", "run", "verdict"} <= set(schema.names):
        raise BristleError(f"{path}: holds no runs of bristle sweep; remove it from the store")
    return schema


def table_of(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Return rows as a table; a column has Booleans, whole numbers, numbers or text, and null where
    a row has none of it.
    """
    names = dict.fromkeys(itertools.chain.from_iterable(rows))
    columns = {name: [row.get(name) for row in rows] for name in names}
    return pa.table({name: pa.array(values, _kind(values)) for name, values in columns.items()})


def _kind(values: Sequence[object]) -> pa.DataType:
    kinds = {type(value) for value in values if value is not None}
    if kinds == {bool}:
        return pa.bool_()
    if kinds == {int}:
        return pa.int64()
    if kinds <= {int, float, bool}:
        return pa.float64()
    return pa.string()


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:300]
