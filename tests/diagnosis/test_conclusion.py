"""The verdict where no effect was named: what the records leave open depends on how varied the
motion is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bristle.diagnosis.answer import Assessment, Estimate, Gap, Outcome, Unexplained
from bristle.diagnosis.report.text.statement import undetected
from bristle.diagnosis.selection.candidates import EffectFit
from bristle.diagnosis.selection.criterion import TrialRound
from bristle.diagnosis.selection.detection_limit import detection_limits
from bristle.diagnosis.selection.null_distribution import Null
from bristle.diagnosis.stages.conclusion import (
    choices_of,
    known_floor,
    reported_limits,
    unidentified_parameters,
    unnamed,
)

UNIFORM = "one oscillation"
QUIET, LEFT = Unexplained(False, None, 0.0), Unexplained(True, "theta", 0.5)


def round_of(
    best: str | None = None, ties: tuple[str, ...] = (), outcome: Outcome = "none"
) -> TrialRound:
    candidate = EffectFit(best, None) if best else None
    empty = TrialRound.of((), Null(np.zeros(1), {}), 0.0, candidate, 20.0)
    return empty.with_said(ties=ties, outcome=outcome)


@pytest.mark.parametrize(
    ("last", "uniform", "left", "verdict"),
    [
        (round_of(), "", QUIET, "none"),
        (round_of(), "", LEFT, "none"),
        (round_of("bias"), "", LEFT, "none"),  # certain but small
        (round_of(), UNIFORM, QUIET, "none"),
        (round_of(), UNIFORM, LEFT, "not_identifiable"),
        (round_of("bias"), UNIFORM, QUIET, "not_identifiable"),
        (round_of("bias", ("gravity",)), "", LEFT, "tie"),
        (round_of("bias", ("gravity",)), UNIFORM, LEFT, "tie"),
        (round_of("bias", ("gravity", "cogging")), "", LEFT, "tie"),
        (round_of("bias", ("gravity", "cogging")), UNIFORM, LEFT, "not_identifiable"),
        (round_of("bias", ("gravity", "cogging", "stribeck")), "", LEFT, "not_identifiable"),
        # of two classes
        (round_of("bias", ("asymmetric_coulomb", "gravity")), UNIFORM, LEFT, "tie"),
        (round_of("bias", outcome="withdrawn"), UNIFORM, LEFT, "not_identifiable"),
        # it stands in for something else
        (round_of("bias", outcome="limit"), "", QUIET, "not_identifiable"),
        (round_of(), "", replace(LEFT, disturbance=0.49), "none"),
        (round_of(), "", replace(LEFT, disturbance=0.51), "not_identifiable"),
    ],
)
def test_verdict_without_a_name(
    last: TrialRound, uniform: str, left: Unexplained, verdict: str
) -> None:
    assert unnamed(last.said, bool(uniform), left) == verdict


@pytest.mark.parametrize(
    ("intervals", "mute"),
    [
        ({"J": (-0.02, 0.04), "Fc": (-0.2, 0.4)}, ("J", "Fc")),
        ({"J": (0.002, 0.028), "Fc": (-0.2, 0.4)}, ("J", "Fc")),
        ({"J": (0.012, 0.018), "Fc": (-0.2, 0.4)}, ()),
        ({"J": (-0.02, 0.04), "Fc": None}, ("J", "Fc")),
        ({}, ()),
    ],
)
def test_records_that_determine_no_parameter(
    intervals: dict[str, tuple[float, float] | None], mute: tuple[str, ...]
) -> None:
    middle = {name: sum(ends) / 2 if ends else 0.1 for name, ends in intervals.items()}
    assert (
        unidentified_parameters(
            {name: Estimate(middle[name], "1", ends) for name, ends in intervals.items()}
        )
        == mute
    )


def test_an_estimate_at_a_bound_is_unidentified() -> None:
    plain = {
        "J": Estimate(0.05, "kg.m2", (-0.02, 0.12)),
        "Fc": Estimate(0.5, "N.m", (0.49, 0.51), at_bound=True),
    }
    assert unidentified_parameters(plain) == ("J", "Fc")


def test_what_may_be_chosen_is_an_open_tie_or_what_the_last_name_stands_for() -> None:
    tried = tuple(EffectFit(name, None) for name in ("bias", "asymmetric_coulomb", "gravity"))
    first = replace(round_of("bias", ("asymmetric_coulomb",), "added"), trials=tried)
    second = replace(round_of("gravity", outcome="added"), trials=tried)
    last = replace(round_of(), trials=tried)

    def names(
        rounds: list[TrialRound], undecided: tuple[str, ...], named: tuple[str, ...]
    ) -> list[str]:
        return [c.name for c in choices_of(rounds, undecided, named)]

    assert names([last], ("bias", "gravity"), ()) == ["bias", "gravity"]
    assert names([first, last], (), ("bias",)) == ["asymmetric_coulomb"]
    # gravity was fitted beside the bias
    assert names([first, second, last], (), ("bias", "gravity")) == []
    assert names([first, last], (), ("gravity",)) == []  # the bias was dropped later
    assert names([last], (), ()) == []


@pytest.mark.sampled(4)
def test_what_was_found_or_ties_is_not_reported_as_undetected(case) -> None:
    """And what gained before another was added shows no more beside that."""
    fitted = case(None).base
    tried = [EffectFit(name, fitted.fit) for name in ("bias", "gravity", "cogging")]
    null, model = Null(np.zeros(1), {}), case(None).model
    base = fitted.fit.total - 50
    found = detection_limits(tried, null, base)
    lines = undetected(reported_limits(found, ("bias",)), model)
    assert list(lines) == ["gravity", "cogging"]
    assert (
        "it gains 50 nats, more than chance, but gains far less than another effect"
        in lines["gravity"]
    )
    for worth, why in (
        (Assessment(20.0, 1.1, 30.0), "but lowers the squared error too little"),
        (
            Assessment(20.0, 2.0, 15.0),
            "but does not make segments likelier that its parameters were not fitted to",
        ),
        (
            Assessment(20.0, 2.0, 30.0, 12.0),
            "but makes others so much less likely that its gain may be chance",
        ),
        (Assessment(20.0, 2.0, 30.0), "but was rejected by the search"),
        (
            Assessment(20.0, 2.0, 30.0, deficit=(9.0, 2.0)),
            "but explains the residual less well than another effect",
        ),
    ):
        [compared] = detection_limits([replace(tried[1], assessment=worth)], null, base)
        assert undetected([compared], model)["gravity"].endswith(why)
    assert undetected(reported_limits(found, ("bias", "gravity"), "bias"), model) == {
        "cogging": (
            "before constant torque (bias) was added it gained 50 nats; beside that nothing"
            " shows it"
        )
    }
    more = detection_limits([*tried, EffectFit("stribeck", fitted.fit)], null, base)
    drifting = undetected(reported_limits(more, unaligned=True), model)
    assert [
        "start at the same position" in drifting[name]
        for name in ("gravity", "cogging", "bias", "stribeck")
    ] == [1, 1, 0, 0]


def test_no_noise_floor_is_given_where_it_is_not_known():
    known = Gap(4.0, 1.0, 0.5, "rad")
    assert known_floor(known, True) == known_floor(known, False) == known
    all_noise = replace(known, noise_floor=1.0)
    assert known_floor(all_noise, False) == all_noise
    # what is unexplained was taken for noise
    assert known_floor(all_noise, True).noise_floor is None
    assert known_floor(Gap(2.1, 2.8, 2.8, "rad"), False).noise_floor is None  # 2.1 was reached
