"""How an answer that a user holds comes by its sentences, and by what a notebook shows of it."""

from __future__ import annotations

from html import escape
from typing import Any

from bristle.common import html
from bristle.diagnosis.answer import Diagnosis, Excitation, Line, Validation
from bristle.diagnosis.report.content import (
    diagnosis_content,
    excitation_content,
    validation_content,
)
from bristle.diagnosis.report.headline import VERDICTS, headline
from bristle.diagnosis.report.text import statement
from bristle.diagnosis.report.text.said import said


class ReportWriter:
    """Writes sentences and content as the report does; a `Writer` of answers."""

    def lines(self, lines: tuple[Line, ...]) -> tuple[str, ...]:
        """Return each line as a sentence."""
        return tuple(map(said, lines))

    def statement(self, diagnosis: Diagnosis) -> tuple[str, ...]:
        """Return the result in sentences."""
        return statement.statement(diagnosis)

    def findings(self, diagnosis: Diagnosis) -> tuple[str, ...]:
        """Return lines about records and model."""
        return statement.findings(diagnosis)

    def experiment(self, diagnosis: Diagnosis) -> str:
        """Return what to measure next, or an empty text."""
        return statement.experiment(diagnosis)

    def undetected(self, diagnosis: Diagnosis) -> dict[str, str]:
        """Return what would have been detected of each effect that was not found."""
        return statement.undetected(diagnosis.limits, diagnosis.model)

    def excitation(self, excited: Excitation) -> dict[str, Any]:
        """Return what the records excite, in numbers and words."""
        return excitation_content(excited)

    def content(self, answer: Diagnosis | Validation) -> dict[str, Any]:
        """Return the content of diagnosis.json or validation.json."""
        if isinstance(answer, Diagnosis):
            return diagnosis_content(answer)
        return validation_content(answer)

    def notebook(self, answer: Diagnosis | Validation) -> str:
        """Return what a notebook shows."""
        return _diagnosis(answer) if isinstance(answer, Diagnosis) else _validation(answer)


def _diagnosis(d: Diagnosis) -> str:
    """Return the verdict, the answer in sentences, and a table of the effects."""
    rows = []
    for effect in d.effects:
        for name, e in effect.parameters.items():
            numbers = map(html.number, (e.value, *(e.ci95 or (None, None))))
            names = html.identifier(effect.name), html.identifier(name)
            rows.append([*names, *numbers, html.unit(e.unit)])
    heads = ["effect", "parameter", "value", "95 %, from", "to", "unit"]
    parts = [f"<p><b>{escape(headline(d))}</b> ({escape(VERDICTS[d.verdict])})</p>"]
    parts += [f"<p>{escape(sentence)}</p>" for sentence in d.statement]
    return "\n".join([*parts, *([html.table(heads, rows, (2, 3, 4))] if rows else [])])


def _validation(validation: Validation) -> str:
    """Return the errors of each record."""
    rows = []
    for r in validation.records:
        numbers = map(html.number, (r.rms, r.fit_percent, r.mse_percent))
        rows.append([escape(r.name), *numbers, html.unit(r.unit)])
    head = ["record", "rms error", "FIT, %", "eq. (25), %", "unit of the rms error"]
    table = html.table(head, rows, (1, 2, 3))
    return f"<p><b>{escape(validation.name)}</b>, in open loop</p>\n{table}"
