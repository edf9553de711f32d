"""How many effects are tried at a time changes no digit; a time budget ends the search, and the
answer says what is missing.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bristle.cli import terminal
from bristle.cli.commands.diagnose import search_options
from bristle.common.deadline import OutOfTime, check_deadline, until
from bristle.common.errors import BristleError
from bristle.diagnosis import Model, diagnose, records_from_arrays, workflow
from bristle.diagnosis.answer import Diagnosis
from bristle.diagnosis.checks.preparation import prepared_case
from bristle.diagnosis.selection.start_values import SearchOptions
from bristle.diagnosis.workflow import SEARCH_SHARE
from bristle.plant.effects import effects


def found(model: Model, measured: Any, options: SearchOptions, progress: Any = None) -> Diagnosis:
    """Return the diagnosis of two short records of a servo with a bias."""
    columns = [(f"run {seed}", *(x[:5000] for x in measured("bias", seed)[:3])) for seed in (1, 2)]
    return diagnose(model, records_from_arrays(model, columns), progress, options)


def numbers(answer: Diagnosis) -> list[float]:
    """Return every likelihood gain and every estimate."""
    gains = [c.gain for r in answer.rounds for c in r.candidates if c.gain is not None]
    return [
        *gains,
        *(e.value for e in answer.base.values()),
        *(e.value for e in answer.parameters.values()),
        answer.gap.before,
    ]


@pytest.mark.usefixtures("few")
@pytest.mark.long
def test_the_answer_is_the_same_for_any_number_of_jobs(model: Model, measured: Any) -> None:
    one, three = (found(model, measured, SearchOptions(jobs=jobs)) for jobs in (1, 3))
    assert one.verdict == three.verdict == "named"
    assert len(numbers(one)) > 10
    assert np.array_equal(numbers(one), numbers(three))


@pytest.mark.long
def test_a_budget_that_is_used_up_leaves_an_answer_that_says_what_was_not_tried(
    model: Model, measured: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With none left from the start, nothing can be named, and nothing is said to be missing or
    not; nor is a case prepared another way.
    """

    def prepared(*arguments: Any) -> Any:
        again = "prepared again without time"
        return replace(prepared_case(*arguments), otherwise=lambda: pytest.fail(again))

    monkeypatch.setattr(workflow, "prepared_case", prepared)
    answer = found(model, measured, SearchOptions(budget=1e-3))
    assert answer.verdict == "not_identifiable"
    [line] = [each for each in answer.findings if "time budget" in each]
    assert line.startswith(
        "the time budget of 0.001 s was used up: effects not tried to the end in the last round:"
        " asymmetric_coulomb, "
    )
    later = (
        "parameters were not refitted to whole records",
        "no unnamed torque",
        "records were not compared for their parameters",
    )
    assert line.endswith("; ".join([*later, "no input of a further record"]))
    tried = f"before {len(effects())} effects were tried"
    assert any(tried in each for each in answer.statement)
    assert not answer.effects


class Ticks:
    """A clock that goes on by one second whenever it is read."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        self.now += 1.0
        return self.now


@pytest.mark.long
def test_what_is_being_tried_ends_with_the_budget(
    model: Model, measured: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each simulation of the search reads the clock: a budget in a clock's readings is kept
    wherever it ends.
    """
    clock = Ticks()
    monkeypatch.setattr(time, "perf_counter", clock)
    whole = found(model, measured, SearchOptions(jobs=1, budget=1e9))
    needed, clock.now = clock.now, 0.0
    assert whole.verdict == "named"
    assert needed > 500
    for share in (0.3, 1.6):
        clock.now = 0.0
        cut = found(model, measured, SearchOptions(jobs=1, budget=share * needed))
        assert clock.now < 1.2 * share * needed
        # for the whole search; an effect is the best one only of those that were tried
        enough = share * SEARCH_SHARE > 0.9
        assert [e.name for e in cut.effects] == ([e.name for e in whole.effects] if enough else [])
    assert cut.verdict in (["named"] if enough else ["not_identifiable", "tie"])
    assert enough or any("not tried to the end in the last round" in each for each in cut.findings)


def test_a_deadline_holds_in_threads_and_ends_with_its_block() -> None:
    def begins(_: int) -> bool:
        try:
            check_deadline()
        except OutOfTime:
            return False
        return True

    with until(0.0), until(math.inf):  # the earlier one of the two
        assert SearchOptions(jobs=2).map(begins, range(4)) == [False] * 4
    assert SearchOptions(jobs=2).map(begins, range(4)) == [True] * 4


def test_a_budget_is_a_time_above_zero() -> None:
    assert (
        search_options(0, "60s")
        == search_options(0, "1 min")
        == replace(SearchOptions(), budget=60.0)
    )
    assert search_options(2, None) == SearchOptions(jobs=2)
    for wrong in ("60", "0 s", "-5s", "fast", "3 rad"):
        with pytest.raises(BristleError, match=r"^--budget"):
            search_options(0, wrong)


def test_progress_is_printed_line_by_line_where_there_is_no_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(terminal, "SECONDS_BETWEEN_LINES", -1.0)
    with terminal.fraction("diagnose") as tell:
        tell("trying bias", 0.25)
    assert capsys.readouterr().err == "diagnose: trying bias, 25%\n"
    monkeypatch.setattr(terminal, "SECONDS_BETWEEN_LINES", 60.0)
    with terminal.fraction("diagnose") as tell:
        tell("trying bias", 0.25)
    assert capsys.readouterr().err == ""
