"""validation.json and report.html of a validation."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path
from typing import Any

from bristle.common.drawing import ESTIMATE, STYLE, svg
from bristle.common.html import beside, figure, number, page, table, unit
from bristle.common.output import (
    check_no_folder,
    check_not_replaced,
    check_writable,
    replace_files,
    to_json,
)
from bristle.common.provenance import provenance
from bristle.diagnosis.answer import ValidatedRecord, Validation
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
        (
            f"{validation.name} over {r.name}, open loop: rms error {r.rms:.3g} {r.unit}, FIT"
            f" {r.fit_percent:.4g} %."
            if math.isfinite(r.rms)
            else f"{validation.name} over {r.name}, open loop: the simulation fails."
        )
        for r in validation.records
    ]


def render(validation: Validation, made: Mapping[str, Any]) -> str:
    """Return the page; `made` is the key `provenance`."""
    rows = [
        (
            escape(r.name),
            number(float(len(r.time)) * _period(r), 4),
            number(r.rms, 4),
            unit(r.unit),
            number(r.fit_percent, 4),
            number(r.mse_percent, 3),
        )
        for r in validation.records
    ]
    head = ("record", "length, s", "rms error", "unit", "FIT, %", "eq. (25), %")
    lead = "".join(f'<p class="lead">{escape(line)}</p>' for line in sentences(validation)[:3])
    findings = "".join(f"<li>{escape(line)}</li>" for line in validation.findings)
    parts = [
        (
            f'<header><p class="name">validation</p><h1>{escape(validation.name)} in open'
            f" loop</h1>{lead}{beside(VALIDATION_FILES[:1])}</header>"
        ),
        f"<h2>Whole records</h2>{table(head, rows, (1, 2, 4, 5))}",
        (
            '<p class="sub">Each record is simulated from its start to its end with nothing but the'
            " input; only position and velocity at the start are fitted. FIT: 100 % less the rms"
            " error in per cent of the rms deviation of the output from its mean. Eq. (25):"
            " variance of the error in per cent of that of the output.</p>"
        ),
        "".join(
            _drawn(validation.kind, r, k) for k, r in enumerate(validation.records[:DRAWN_RECORDS])
        ),
        f"<h2>Findings</h2><ul>{findings}</ul>" if findings else "",
        f"<h2>Where it comes from</h2>{table(('', ''), _made(made))}",
    ]
    return page(f"validation of {validation.name}", "\n".join(part for part in parts if part))


def _period(record: ValidatedRecord) -> float:
    return float(record.time[1] - record.time[0])


def _drawn(kind: str, record: ValidatedRecord, place: int) -> str:
    from matplotlib import rc_context

    curve = DrawnModel("simulated", ESTIMATE, record.simulated, record.horizons)
    with rc_context(STYLE):
        drawn = svg(open_loop_figure(record.trace, [curve], (kind, record.unit)), f"record{place}")
        horizons = horizon_figure([curve], record.unit)
        against = None if horizons is None else svg(horizons, f"horizons{place}")
    error = (
        f"rms error {record.rms:.3g} {record.unit}"
        if math.isfinite(record.rms)
        else "the simulation fails"
    )
    drawn.seen = f"{record.name}: {error}"
    text = figure(record.name, drawn, "Measured and simulated, and the error, along the record.")
    if against is not None:
        against.seen = horizons_seen([curve], record.unit)
        caption = (
            "The rms error where the simulation begins anew, with a fitted start, after so many"
            " seconds; the last point is that of the whole record."
        )
        text += figure("Error against horizon", against, caption)
    return f"<h2>{escape(record.name)}</h2>{text}"


def _made(made: Mapping[str, Any]) -> list[tuple[str, str]]:
    rows = []
    for key, value in made.items():
        if isinstance(value, Mapping):
            rows += [
                (escape(str(name)), f"<code>{escape(str(text))}</code>")
                for name, text in value.items()
            ]
        else:
            rows.append((escape(key.replace("_", " ")), f"<code>{escape(str(value))}</code>"))
    return rows
