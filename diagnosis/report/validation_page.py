"""validation.json and report.html of a validation."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from bristle.common import pages
from bristle.common.drawing import ESTIMATE, STYLE, Drawing, svg
from bristle.common.output import (
    check_no_folder,
    check_not_replaced,
    check_page,
    check_writable,
    replace_files,
    to_json,
)
from bristle.common.provenance import provenance
from bristle.diagnosis.answer import AfterStart, ValidatedRecord, Validation
from bristle.diagnosis.report.figures.whole_records import (
    DrawnModel,
    horizon_figure,
    horizons_seen,
    open_loop_figure,
)

VALIDATION_FILES = ("validation.json", "report.html")
DRAWN_RECORDS = 8  # records that are drawn, each of which takes 0.1 MB of the page


def write_validation(
    validation: Validation, out: Path, made: Mapping[str, Any] | None = None
) -> list[Path]:
    """Write validation.json and report.html into the folder `out`, in the place of older ones.

    Parameters
    ----------
    validation : Validation
        From `validate` or `validate_fmu`.
    out : Path
        The folder; created if it is missing.
    made : mapping, optional
        The key `provenance`, as of `provenance_of`.

    Raises
    ------
    BristleError
        If the folder cannot be written; it is then as it was.
    """
    check_writable(out)
    check_page(out, "validation.json")
    check_no_folder(out, VALIDATION_FILES)
    made = provenance() if made is None else made
    content = {
        "validation.json": to_json(validation.to_dict() | {"provenance": made}),
        "report.html": render(validation, made),
    }
    return replace_files(
        out, {name: text.encode() for name, text in content.items()}, VALIDATION_FILES
    )


def check_validation_places(out: Path, inputs: Iterable[Path]) -> None:
    """Raise `BristleError` if writing into `out` would take the place of an input."""
    check_not_replaced(out, VALIDATION_FILES, inputs)


def sentences(validation: Validation) -> list[str]:
    """Return the result in a sentence a record."""
    return [
        f"{validation.name} over {r.name}, open loop: {_error(r, r.unit)}.{_after_start(r)}"
        for r in validation.records
    ]


def _error(errors: ValidatedRecord | AfterStart, unit: str) -> str:
    if not math.isfinite(errors.rms):
        return "the simulation fails"
    return f"rms error {errors.rms:.3g} {unit}, FIT {errors.fit_percent:.4g} %"


def _after_start(r: ValidatedRecord) -> str:
    if r.after_start is None:
        return ""
    first = f"With the start fitted to the first {r.after_start.samples} samples alone"
    return f" {first}, and from there on: {_error(r.after_start, r.unit)}."


def render(validation: Validation, made: Mapping[str, Any]) -> str:
    """Return the page; `made` is the key `provenance`."""
    drawn = validation.records[:DRAWN_RECORDS]
    return pages.render(
        "bristle.diagnosis.report/validation.html",
        name=validation.name,
        sentences=sentences(validation)[:3],
        records=validation.records,
        after_start=[(r.name, r.unit, r.after_start) for r in validation.records if r.after_start],
        drawn=[
            (each.name, *_drawn(validation.kind, each, place)) for place, each in enumerate(drawn)
        ],
        findings=validation.findings,
        made=made,
    )


def _drawn(kind: str, record: ValidatedRecord, place: int) -> tuple[Drawing, Drawing | None]:
    """Return the figures of a record, along it and of the error against the horizon."""
    from matplotlib import rc_context

    curve = DrawnModel("simulated", ESTIMATE, record.simulated, record.horizons)
    with rc_context(STYLE):
        along = svg(open_loop_figure(record.trace, [curve], (kind, record.unit)), f"record{place}")
        horizons = horizon_figure([curve], record.unit)
        against = None if horizons is None else svg(horizons, f"horizons{place}")
    error = (
        f"rms error {record.rms:.3g} {record.unit}"
        if math.isfinite(record.rms)
        else "the simulation fails"
    )
    along.seen = f"{record.name}: {error}"
    if against is not None:
        against.seen = horizons_seen([curve], record.unit)
    return along, against
