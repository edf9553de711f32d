"""How an answer that a user holds comes by its sentences, and by what a notebook shows of it."""

from __future__ import annotations

from typing import Any

from bristle.common import pages
from bristle.diagnosis.answer import Diagnosis, Excitation, Line, Validation
from bristle.diagnosis.report.content import (
    diagnosis_content,
    excitation_content,
    validation_content,
)
from bristle.diagnosis.report.headline import VERDICT_WORDS, headline
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
        """Return what a notebook shows: the answer, and a table of its numbers."""
        if isinstance(answer, Validation):
            page = "bristle.diagnosis.report/validation_notebook.html"
            return pages.render(page, validation=answer)
        return pages.render(
            "bristle.diagnosis.report/notebook.html",
            diagnosis=answer,
            heading=headline(answer),
            verdict=VERDICT_WORDS[answer.verdict],
        )
