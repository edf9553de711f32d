"""The verdicts of a comparison: of each signal, of each number and of the whole, in words too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bristle.common.output import plain, to_json
from bristle.common.provenance import provenance
from bristle.common.signals import Array
from bristle.harness.baseline.tube import EXACT_MARGIN


@dataclass(frozen=True)
class SignalVerdict:
    """A signal at its worst point: distance from the reference over what is allowed (1: at the
    edge), or why there is none.
    """

    name: str
    passed: bool
    share: float | None = None
    time: float | None = None
    value: float | None = None
    reference: float | None = None
    low: float | None = None
    high: float | None = None
    why: str = ""

    @property
    def margins(self) -> tuple[float, float] | None:
        """How far the signal may be below and above the reference at its worst point: 0 where it
        must be exactly 0.
        """
        if self.reference is None or self.low is None or self.high is None:
            return None
        below, above = self.reference - self.low, self.high - self.reference
        return (0.0, 0.0) if max(below, above) < EXACT_MARGIN else (below, above)


@dataclass(frozen=True)
class QuantityVerdict:
    """A number of both results, how far apart it may be, and whether it is; None if not judged."""

    path: str
    unit: str
    first: float | None
    second: float | None
    tolerance: float | None
    passed: bool | None
    why: str = ""


@dataclass(frozen=True)
class SignalCourse:
    """What a figure shows of a signal: times [s], reference, bounds, run, shape (n,) each."""

    time: Array
    reference: Array
    lower: Array
    upper: Array
    values: Array


@dataclass(frozen=True)
class RunComparison:
    """Verdicts of all signals and numbers, what makes both incomparable, and what is said without
    being judged.

    `rows` instants were compared, of `instants` that A has; `made` holds where A and B come from,
    as of their result.json; `command` repeats the comparison; `units` are those of the signals, as
    far as they are known.
    """

    first: str
    second: str
    scenario: str
    rows: int
    instants: int
    refused: tuple[str, ...]
    signals: tuple[SignalVerdict, ...]
    quantities: tuple[QuantityVerdict, ...]
    notes: tuple[str, ...]
    courses: Mapping[str, SignalCourse]
    made: tuple[Mapping[str, Any], Mapping[str, Any]]
    command: str = ""
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether B is where A allows it to be: everywhere, and in every number that is judged."""
        signals = bool(self.signals) and all(each.passed for each in self.signals)
        return (
            not self.refused
            and signals
            and all(each.passed is not False for each in self.quantities)
        )


def comparison_json(comparison: RunComparison) -> bytes:
    """Return the content of compare.json."""
    return to_json(
        plain(
            {
                "scenario": comparison.scenario,
                "verdict": "pass" if comparison.passed else "differs",
                "first": comparison.first,
                "second": comparison.second,
                "rows": comparison.rows,
                "instants": comparison.instants,
                "refused": list(comparison.refused),
                "notes": list(comparison.notes),
                "signals": [_row(each) for each in comparison.signals],
                "quantities": [_row(each) for each in comparison.quantities],
                "provenance": {
                    **provenance(),
                    "command": comparison.command,
                    "first": comparison.made[0],
                    "second": comparison.made[1],
                },
            }
        )
    ).encode()


def _row(each: SignalVerdict | QuantityVerdict) -> dict[str, Any]:
    row = dict(vars(each))
    row["pass"] = row.pop("passed")
    return row


def differences(comparison: RunComparison) -> list[str]:
    """Return a line for each thing that differs."""
    lines = list(comparison.refused)
    for signal in (each for each in comparison.signals if not each.passed):
        at = "" if signal.time is None else f" at {signal.time:g} s"
        lines.append(f"{signal.name}{at}: {signal.why or f'{signal.value:.6g}'}{_allowed(signal)}")
    for each in (each for each in comparison.quantities if each.passed is False):
        lines.append(f"{each.path}: {each.why or quantity_text(each)}")
    return lines


def _allowed(signal: SignalVerdict) -> str:
    """Return the reference at the worst point and how far the signal may be below and above it."""
    if signal.margins is None:
        return ""
    below, above = signal.margins
    allowed = f"{-below:.2g} to {above:+.2g}" if above else "exactly 0"
    return f", reference {signal.reference:.6g}, allowed {allowed}"


def quantity_text(each: QuantityVerdict) -> str:
    """Return a number of B beside that of A."""
    unit = "" if each.unit == "1" else f" {each.unit}"
    return (
        f"{each.second:.6g}{unit} in B, {each.first:.6g}{unit} in A, allowed ± {each.tolerance:.2g}"
    )


def counts(signals: Sequence[SignalVerdict]) -> tuple[int, int]:
    """Return how many signals are in their tubes, of how many that were judged or are missing."""
    judged = [each for each in signals if not (each.passed and each.why)]
    return sum(each.passed for each in judged), len(judged)
