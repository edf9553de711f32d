"""What `bristle.run` and `bristle.reproduce` return."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, cast

from bristle.common.arguments import as_choice
from bristle.common.errors import BristleError

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd
    import pyarrow as pa
    import xarray as xr
    from numpy.typing import NDArray

    from bristle.harness.sweep.store import Store

__all__ = ["Reproduction", "Result", "SweepResult"]

TABLES = ("signals", "estimates", "checks")  # of a result, in the form of pandas
# of an estimate, in the form of xarray
ESTIMATE_NUMBERS = ("final", "sd", "true", "error_percent", "settling_s", "valid")


@dataclass(frozen=True, repr=False)
class _Answer:
    data: Mapping[str, Any] = field(compare=False)
    folder: Path

    @property
    def verdict(self) -> str:
        """``"pass"`` if all checks pass and every run reached the end that is expected of it, else
        ``"fail"``.
        """
        return str(self.data["verdict"])

    @property
    def passed(self) -> bool:
        """Whether the verdict is pass."""
        return self.verdict == "pass"

    @property
    def report(self) -> Path:
        """The report, one self-contained HTML file."""
        return self.folder / "report.html"


@dataclass(frozen=True, repr=False)
class Result(_Answer):
    """The result of a scenario: `print` shows it as a table.

    Attributes
    ----------
    data : mapping of str to object
        The content of result.json.
    folder : pathlib.Path
        The result folder, with result.json, signals.csv, report.html and the figures.
    """

    @property
    def scenario(self) -> str:
        """Name of the scenario."""
        return str(self.data["scenario"])

    @property
    def estimates(self) -> Mapping[str, Mapping[str, Any]]:
        """Of each estimated parameter: unit, true value (None if there is none), final value and
        its standard deviation (None if the observer gives none), whether it is valid and adapted,
        error [%], settling time [s]."""
        found: Mapping[str, Mapping[str, Any]] = self.data["estimates"]
        return found

    @property
    def checks(self) -> Sequence[Mapping[str, Any]]:
        """Of each check: name, value, limit, and whether it passes."""
        found: Sequence[Mapping[str, Any]] = self.data["checks"]
        return found

    def signals(self) -> dict[str, NDArray[np.float64]]:
        """Read the signals of signals.csv.

        Returns
        -------
        dict of str to ndarray, shape (n,)
            ``time`` [s] and every signal (SI units), thinned to at most 2000 rows; not a number
            where there is no value.
        """
        import numpy as np

        file = self.folder / "signals.csv"
        with file.open(encoding="utf-8") as lines:
            names = lines.readline().strip().split(",")
            table = np.loadtxt(lines, delimiter=",", ndmin=2)
        return dict(zip(names, table.T, strict=True))

    def to_pandas(
        self, table: Literal["signals", "estimates", "checks"] = "signals"
    ) -> pd.DataFrame:
        """Return signals, estimates or checks as a table of pandas, which the extra ``frames``
        installs.

        Parameters
        ----------
        table : {"signals", "estimates", "checks"}, optional
            ``"signals"``: a column a signal (SI units), over the time [s]; ``"estimates"``: a row a
            parameter, as in `estimates`; ``"checks"``: a row a check, as in `checks`.

        Returns
        -------
        pandas.DataFrame

        Raises
        ------
        BristleError
            If there is no such table, or pandas is not installed.
        """
        pandas: Any = _frames("pandas")
        if as_choice("table", table, TABLES) == "signals":
            columns = self.signals()
            found = pandas.DataFrame(columns, index=pandas.Index(columns.pop("time"), name="time"))
        elif table == "estimates":
            found = pandas.DataFrame.from_dict(self.estimates, orient="index").rename_axis(
                "parameter"
            )
        else:
            found = pandas.DataFrame(list(self.checks))
        return cast("pd.DataFrame", found)

    def to_xarray(self) -> xr.Dataset:
        """Return signals and estimates as a data set of xarray, which the extra ``frames``
        installs.

        Returns
        -------
        xarray.Dataset
            The signals over the coordinate ``time`` [s]; over the coordinate ``parameter`` the
            numbers of the estimates, such as ``estimate_final`` and ``estimate_true``, in the units
            of the coordinate ``unit``, not a number where there is none. Attributes: ``scenario``
            and ``verdict``.

        Raises
        ------
        BristleError
            If xarray is not installed.
        """
        xarray: Any = _frames("xarray")
        columns, estimates = self.signals(), self.estimates
        coordinates: dict[str, Any] = {
            "time": ("time", columns.pop("time"), {"units": "s"}),
            "parameter": list(estimates),
        }
        coordinates["unit"] = ("parameter", [e["unit"] for e in estimates.values()])
        variables: dict[str, Any] = {name: ("time", values) for name, values in columns.items()}
        for key in ESTIMATE_NUMBERS:
            numbers = [
                float("nan") if e[key] is None else float(e[key]) for e in estimates.values()
            ]
            variables[f"estimate_{key}"] = ("parameter", numbers)
        attributes = {"scenario": self.scenario, "verdict": self.verdict}
        return cast("xr.Dataset", xarray.Dataset(variables, coordinates, attributes))

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the verdict, a table of the estimates, and one of the
        checks.
        """
        from bristle.common import pages
        from bristle.harness.metrics.checks import SIGNS

        return pages.render("bristle/result.html", result=self, signs=SIGNS)

    def __repr__(self) -> str:
        good = sum(bool(check["pass"]) for check in self.checks)
        return (
            f"<Result {self.scenario!r}: {self.verdict}, {good} of {len(self.checks)} checks pass,"
            f" in {str(self.folder)!r}>"
        )

    def __str__(self) -> str:
        lines = [f"{self.scenario}: {self.verdict}"]
        for name, e in self.estimates.items():
            state = "valid    " if e["valid"] else "not valid"
            line = (
                f"  {name:<10} {_number(e['final'])} {e['unit']:<12} sd {_number(e['sd'])}  "
                f" {state}"
            )
            compared = (
                ""
                if e["true"] is None
                else f"   true {_number(e['true'])}   error {_number(e['error_percent'])} %"
            )
            lines.append(line + compared)
        lines += [
            f"  {'ok    ' if check['pass'] else 'FAILED'} {check['name']}:"
            f" {_number(check['value'])}"
            for check in self.checks
        ]
        return "\n".join([*lines, f"  {self.report}"])


@dataclass(frozen=True, repr=False)
class SweepResult:
    """What came of a sweep.

    Attributes
    ----------
    folder : pathlib.Path
        The store.
    verdicts : mapping of str to int
        How many of the runs that were made have the verdict ``"pass"``, ``"fail"`` or ``"error"``.
    kept : int
        Runs that the store had before.
    """

    folder: Path
    verdicts: Mapping[str, int]
    kept: int = 0

    @property
    def table(self) -> pa.Table:
        """All runs of the store, a row each, with the columns that docs/sweeps.md lists."""
        return self._store().table()

    def query(self, sql: str) -> list[dict[str, Any]]:
        """Return the rows of an SQL query on the table ``runs``; DuckDB, which answers it, comes
        with the extra ``query``.

        Raises
        ------
        BristleError
            If the query is wrong, or DuckDB is not installed.
        """
        names, rows = self._store().query(sql)
        return [dict(zip(names, row, strict=True)) for row in rows]

    def to_pandas(self) -> pd.DataFrame:
        """Return all runs as a table of pandas, which the extra ``frames`` installs.

        Raises
        ------
        BristleError
            If pandas is not installed.
        """
        _frames("pandas")
        return cast("pd.DataFrame", self.table.to_pandas())

    def _store(self) -> Store:
        from bristle.harness.sweep.store import Store

        return Store(self.folder)

    def __repr__(self) -> str:
        counts = ", ".join(f"{count} {word}" for word, count in self.verdicts.items())
        return f"<SweepResult: {counts}, in {str(self.folder)!r}>"


@dataclass(frozen=True, repr=False)
class Reproduction(_Answer):
    """The paper's figures and numbers beside ours: `print` shows eq. (25) of all models.

    Attributes
    ----------
    data : mapping of str to object
        The content of reproduce.json.
    folder : pathlib.Path
        The folder, with reproduce.json, report.html and the figures.
    """

    @property
    def estimates(self) -> Mapping[str, Mapping[str, Mapping[str, Any]]]:
        """Of each plant and scheme the estimates by parameter, as in `Result.estimates`."""
        found: Mapping[str, Mapping[str, Mapping[str, Any]]] = self.data["estimates"]
        return found

    @property
    def eq25(self) -> Sequence[Mapping[str, Any]]:
        """Eq. (25) of all models [%], an entry for each plant and order of the reference; None
        where there is none.
        """
        found: Sequence[Mapping[str, Any]] = self.data["eq25"]
        return found

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the verdict, and eq. (25) of all models."""
        from bristle.common import pages
        from bristle.harness.paper.schemes import COMPARED

        return pages.render("bristle/reproduction.html", result=self, compared=COMPARED)

    def __repr__(self) -> str:
        return f"<Reproduction: {self.verdict}, in {str(self.folder)!r}>"

    def __str__(self) -> str:
        from bristle.harness.paper.schemes import COMPARED

        lines = [
            f"{self.verdict}; eq. (25), %",
            f"  {'':<12}" + "".join(f"{name:>11}" for name in COMPARED),
        ]
        for row in self.eq25:
            values = "".join(f" {_number(row[name])}" for name in COMPARED)
            lines.append(f"  {row['plant'] + ', order ' + str(row['order']):<12}{values}")
        return "\n".join([*lines, f"  {self.report}"])


def _frames(name: str) -> ModuleType:
    """Return pandas or xarray."""
    try:
        return import_module(name)
    except ModuleNotFoundError:
        raise BristleError(f"{name} is not installed; run: pip install 'bristle[frames]'") from None


def _number(value: float | None) -> str:
    return f"{'-' if value is None else format(value, '.4g'):>10}"
