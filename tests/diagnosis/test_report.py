"""The report says what the diagnosis says, to a person, in the units of the rig, and in one
file.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest

from bristle.common.drawing import OTHER
from bristle.diagnosis.answer import (
    OUTLIERS,
    BetweenSensors,
    Diagnosis,
    Estimate,
    Excitation,
    Gap,
    Named,
    RecordTrace,
    Undetected,
    Unexplained,
)
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.report.figures.of_diagnosis import captions, draw, view_axis, worst_part
from bristle.diagnosis.report.headline import headline, mark
from bristle.diagnosis.report.html import interval, render
from bristle.diagnosis.report.text.names import NATS, reported_parameters, value, view_name
from bristle.diagnosis.report.text.statement import (
    answer_lines,
    undetected,
    what_to_measure,
)
from bristle.diagnosis.selection.candidates import EffectFit
from bristle.diagnosis.selection.detection_limit import detection_limits
from bristle.diagnosis.selection.null_distribution import Null
from bristle.plant.effects import effect
from bristle.plant.wording import Wording

CASES = ("named", "tie", "none", "not_identifiable", "proposals")
MOST_BYTES = 1_000_000  # of a page
VOID = {"meta", "img", "br"}


TABLE = {
    "friction": "coulomb",
    "parameters": {"J": 0.011, "a2": 0.015, "Fc": 0.1},
    "time": {"column": "t", "unit": "s"},
    "input": {"column": "u", "kind": "torque", "unit": "N.m"},
    "output": {"column": "theta", "kind": "position", "unit": "rad"},
}


# -- helpers ---------------------------------------------------------------------------------------


def bare(verdict, gap, remains, effects=(), ties=(), parameters=None):
    """Return an answer with this and nothing else."""
    return Diagnosis(
        verdict,
        gap,
        Excitation({}),
        Model.from_dict(TABLE),
        tuple(effects),
        tuple(ties),
        remains=remains,
        fitted=parameters or {},
    )


class Balance(HTMLParser):
    """Collects the text; every element must be closed in its turn."""

    def __init__(self):
        super().__init__()
        self.open, self.text = [], []

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"style", "script"} & set(self.open):
            self.text.append(data)


def text_of(page):
    """Return what a reader sees, and check the tags on the way."""
    parser = Balance()
    parser.feed(page)
    assert parser.open == []
    return " ".join(" ".join(parser.text).split())


def page_of(diagnosis, **more):
    return render(diagnosis, {}, {"diagnosis.json": "numbers"}, **more)


def svg_texts(svg):
    """Return the texts of a figure, which matplotlib draws as curves with the text beside them as a
    comment.
    """
    return re.findall(r"<!-- (.*?) -->", svg)


# -- the page --------------------------------------------------------------------------------------


@pytest.mark.sampled(4)
@pytest.mark.parametrize("case", CASES)
def test_every_verdict_makes_one_self_contained_page(answer, case):
    diagnosis = answer(case)
    page = render(diagnosis, draw(diagnosis), {})
    text = text_of(page)
    for line in (
        *diagnosis.statement,
        *diagnosis.findings,
        *diagnosis.proposals,
        diagnosis.experiment,
    ):
        assert line in text
    assert page.count("<img") == len(draw(diagnosis)) >= 2
    assert len(page.encode()) <= MOST_BYTES
    assert not re.search(r'src="(?!data:)|href="(?!#)', page)
    assert not re.search(r"\bnan\b|\bNone\b|\binf\b", text)


@pytest.mark.parametrize("case", CASES)
def test_json_is_complete_and_holds_no_nan(answer, case):
    content = json.loads(json.dumps(answer(case).to_dict(), allow_nan=False))
    contract = {"verdict", "effects", "ties", "experiment", "where", "remains", "gap", "excitation"}
    assert contract <= content.keys()


def test_a_named_effect_comes_with_its_parameters_and_the_shrink(answer):
    text = text_of(page_of(answer("named")))
    assert "The model lacks: cogging torque named" in text
    assert "amplitude amplitude of the first term 0.0600 ± 0.0018 N·m" in text
    assert "shrank by 99.8 %" in text
    assert "coulomb.Fc N·m 0.1 0.1270 ± 0.0038 0.12000 ± 0.00084" in text


def test_where_something_remains_the_gap_shrank_by_at_most_so_much(answer):
    flagged = replace(answer("named"), remains=Unexplained(True, "theta", 0.4))
    text = text_of(page_of(flagged))
    assert "shrank by at most 99.8 %" in text
    assert "the mean squared error was at least" in text
    assert "at least" not in text_of(page_of(answer("named")))


def test_a_gap_that_did_not_shrink_is_not_said_to_fall(answer):
    named = answer("named")
    worse = replace(named, gap=Gap(1.1e-6, 1.3e-6, 1.3e-6, "rad"))
    text = text_of(page_of(worse))
    assert "the error did not fall" in text
    assert "shrank" not in text.split("Before and after")[0].split("Error of the model")[1]
    said = answer_lines(bare("named", worse.gap, worse.remains, named.effects))
    assert any("does not fall (0.00105 rad before, 0.00114 rad after)" in line for line in said)
    said = answer_lines(bare("named", named.gap, named.remains, named.effects))
    assert any("falls from 0.00286 to 0.000332" in line for line in said)


@pytest.mark.sampled(4)
def test_a_floor_that_is_not_known_is_neither_said_nor_drawn(answer):
    none = answer("none")
    unknown = replace(none, gap=replace(none.gap, noise_floor=None))
    [line] = answer_lines(bare("none", unknown.gap, unknown.remains))[1:2]
    assert line.endswith(
        "disturbance and sensor noise alone account for less; how much less is not known."
    )
    assert not any("floor" in text for text in svg_texts(draw(unknown)["gap"]))
    quiet = replace(none, remains=Unexplained(False, None, 0.0))
    assert "noise floor 0.0181 deg" in [text.strip() for text in svg_texts(draw(quiet)["gap"])]
    assert (
        "The noise floor, which disturbance and sensor noise alone would leave, is not known."
        in text_of(page_of(unknown))
    )


# -- the heading -----------------------------------------------------------------------------------


@pytest.mark.sampled(4)
@pytest.mark.parametrize("case", ["named", "tie", "none", "not_identifiable"])
def test_where_much_is_unexplained_the_heading_says_so_and_no_name_is_amber(answer, case):
    diagnosis = replace(answer(case), remains=Unexplained(True, "v", 0.6))
    if case == "named":
        assert headline(diagnosis).endswith("; something else stays unexplained")
    else:
        assert headline(diagnosis).startswith("Best of what I know, not enough: ")
    colour = "good" if case == "named" else "open"
    assert mark(diagnosis)[0] == colour
    assert f'class="badge {colour}"' in page_of(diagnosis)
    assert not any("floor" in text for text in svg_texts(draw(diagnosis)["gap"]))
    assert "Green band" not in captions(diagnosis)["gap"][1]
    quiet = replace(diagnosis, remains=Unexplained(False, None, 0.0))
    assert "not enough" not in headline(quiet)
    assert (mark(quiet)[0] == "good") == (case == "named")


def test_what_two_positions_show_at_once_comes_first(answer):
    play = {"backlash": {"play": Estimate(0.02, "rad", (0.019, 0.021))}}
    diagnosis = replace(answer("none"), between=BetweenSensors(play, 1e-2, 1e-4, "rad"))
    assert headline(diagnosis).startswith("Between motor and load: a play; best of")
    assert diagnosis.statement[0].startswith("Between the positions of motor and load: a play of")
    nothing = replace(diagnosis, between=BetweenSensors({}, 1e-2, 1e-2, "rad"))
    assert headline(nothing) == headline(answer("none"))
    assert "nothing is seen" in nothing.statement[-1]


@pytest.mark.parametrize("case", ["named", "tie", "none"])
def test_the_heading_has_words_and_no_identifiers(answer, case):
    assert not re.search(r"\(|_", headline(answer(case)))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("case", ["named", "tie", "none"])
def test_nats_are_explained_where_they_first_stand(answer, case):
    diagnosis = answer(case)
    text = text_of(render(diagnosis, draw(diagnosis), {}))
    assert text.index("nats") == text.index(f"nats ({NATS})")


# -- what remains, and what is not enough ----------------------------------------------------------


def test_what_remains_is_what_the_table_above_it_says(answer):
    named = answer("named")
    noisy = replace(named.where[1], view="du", share_after=0.08, p_after=0.001)
    text = text_of(
        page_of(
            replace(
                named, where=(named.where[0], noisy), remains=Unexplained(False, "history", 0.04)
            )
        )
    )
    assert (
        "Nothing that matters: rate of the input predicts 8 % of the residual that is left" in text
    )
    assert "no motion variable predicts more of the residual than chance does" in text_of(
        page_of(named)
    )


def test_what_is_predicted_is_not_taken_for_noise(answer):
    """A quarter of the residual is too little beside the effect to be reported, and too much to be
    called noise or nothing.
    """
    named = answer("named")
    gap = replace(named.gap, noise_floor=named.gap.after)
    part = replace(named.where[1], view="theta x u", share_after=0.25, p_after=0.001)
    left = Unexplained(False, "theta x u", 0.25)
    text = text_of(page_of(replace(named, gap=gap, where=(named.where[0], part), remains=left)))
    assert "Nothing that matters" not in text
    assert (
        "Small beside what was explained, but more than chance: position × input predicts 25 %"
        in text
    )
    assert "down to what disturbance and sensor noise alone account for" not in text
    assert any(
        "account for at most as much" in line
        for line in answer_lines(bare("named", gap, left, named.effects))
    )
    assert any(
        "account for as much" in line
        for line in answer_lines(bare("named", gap, replace(left, share=0.1), named.effects))
    )


@pytest.mark.parametrize(
    ("end", "said"),
    [
        (0.0, "The refit of a2 ends at 0: these records show none of it."),
        (0.2, "The refit of a2 ends at a bound: widen"),
    ],
)
def test_a_parameter_that_ends_at_0_is_absent_and_no_bound_to_widen(answer, end, said):
    named = answer("named")
    stuck = {"a2": Estimate(end, "1", None, True)}
    [line] = [
        line
        for line in answer_lines(bare("named", named.gap, named.remains, (), parameters=stuck))
        if "a2" in line
    ]
    assert line.startswith(said)


def test_what_an_open_tie_would_explain_is_not_said_to_be_explained_by_nothing(answer):
    tie, left = answer("tie"), Unexplained(True, "theta", 0.54)
    without = (
        "Unexplained residual: 54 % of the residual can be predicted from position, with none of"
        " the tied effects added."
    )
    assert without in answer_lines(bare("tie", tie.gap, left, ties=tie.ties))
    assert without in answer_lines(bare("not_identifiable", tie.gap, left, ties=tie.ties))
    assert "with none of the tied effects added" in text_of(page_of(replace(tie, remains=left)))
    named = answer("named")
    after = answer_lines(bare("named", named.gap, left, named.effects, tie.ties))
    assert any(
        line.endswith("from position, and no effect that was tried explains it.") for line in after
    )


def test_a_tone_is_reported_with_its_frequency_and_an_experiment(answer):
    tone = Unexplained(True, "tone", 0.9, 0.0, "3 Hz")
    facts = bare("none", answer("none").gap, tone)
    assert "90 % of the residual can be predicted from oscillation in time (3 Hz)" in " ".join(
        answer_lines(facts)
    )
    assert "oscillation in time (3 Hz)" in text_of(page_of(replace(answer("none"), remains=tone)))
    assert "with the input at zero" in what_to_measure(facts)
    assert "with the input at zero" not in what_to_measure(
        replace(facts, ties=(("bias", "gravity"),))
    )
    few = Unexplained(True, OUTLIERS, 0.7, 0.0, "16 of 180 segments, the worst at 1.4 s")
    said = " ".join(answer_lines(replace(facts, remains=few)))
    assert (
        "70 % of the residual's power is in segments with a large error (16 of 180 segments, the"
        " worst at 1.4 s)" in said
    )


def test_the_views_are_listed_by_their_share_what_chance_gives_last(answer):
    first, second = answer("named").where
    burst = replace(first, view=OUTLIERS, label="3 of 75 segments, the worst at 0.5 s", share=0.99)
    text = text_of(
        page_of(replace(answer("named"), where=(replace(first, share=1.0, p=0.9), second, burst)))
    )
    assert (
        text.index("segments with a large error (3 of 75 segments")
        < text.index("velocity 5 %")
        < text.index("position 100 %")
    )


# -- names, tables and proposals -------------------------------------------------------------------


def test_a_record_may_have_any_name(answer, recwarn):
    named = answer("named")
    draw(replace(named, traces=(replace(named.traces[0], name="\u2603 \u540d.csv"),)))
    assert not recwarn.list


def test_a_name_that_stands_for_its_class_says_so(answer):
    named = replace(answer("named"), ties=(("cogging", "gravity"),))
    assert "The model lacks: cogging torque or gravity on an unbalanced mass named" in text_of(
        page_of(named)
    )
    lines = answer_lines(bare("named", named.gap, named.remains, named.effects, named.ties))
    assert lines[1].endswith(
        "from gravity on an unbalanced mass (gravity), which fits equally well."
    )


@pytest.mark.sampled(4)
def test_tied_effects_are_red_whatever_the_verdict(answer):
    named = answer("named")
    assert OTHER.lower() not in draw(named)["candidates"].lower()
    assert (
        OTHER.lower() in draw(replace(named, ties=(("cogging", "gravity"),)))["candidates"].lower()
    )
    assert OTHER.lower() in draw(answer("tie"))["candidates"].lower()


def test_a_proposal_is_no_fit(answer):
    diagnosis = answer("proposals")
    text = text_of(render(diagnosis, draw(diagnosis), {}))
    assert "of the model as it was given" in text
    assert "took no part in the search" not in text
    assert "Before and after" not in text
    assert "refitted without effects" not in text


def test_excitation_is_a_table_in_words_with_its_caveats(answer):
    text = text_of(page_of(answer("named")))
    assert "time at rest 4 %" in text
    assert "speed −6.1 … 5.9 rad/s" in text
    assert "sampling period 0.002 s" in text
    assert "Less than one turn" in text


def test_a_parameter_at_its_bound_is_flagged(answer):
    assert "at its bound" not in page_of(answer("named"))
    assert "6 at its bound" in text_of(page_of(answer("not_identifiable")))


def test_a_tie_says_what_separates_it_before_anything_else(answer):
    diagnosis = answer("tie")
    text = text_of(page_of(diagnosis))
    assert "constant torque (bias) or direction-dependent dry friction (asymmetric_coulomb)" in text
    assert text.index(diagnosis.experiment) < text.index("Error of the model")
    assert "--choose NAME" in text
    chosen = text_of(page_of(diagnosis, choose="bias"))
    assert "Chosen by hand for the augmented model: constant torque (bias)" in chosen
    assert "with bias (chosen)" in chosen


def test_what_remains_is_an_alarm_only_when_flagged(answer):
    assert '<p class="alarm">Unexplained residual: 41 %' in page_of(answer("none"))
    assert "Unexplained residual:" not in page_of(answer("named"))


def test_proposals_stand_above_all_figures(answer):
    page = render(answer("proposals"), draw(answer("proposals")), {})
    assert page.index("Correct this first") < page.index("<img")
    assert "First correct the data" in page


def test_what_could_not_be_written_is_said_at_the_top(answer):
    text = text_of(page_of(answer("named"), notes=["augmented.fmu was not written: no compiler"]))
    assert text.index("no compiler") < text.index("What is missing")


def test_a_file_that_this_answer_has_not_is_no_link(answer):
    page = page_of(answer("named"), absent={"correction.fmu": "it acts on the sensor"})
    assert "no correction.fmu" in text_of(page)
    assert "it acts on the sensor" in text_of(page)
    assert 'href="diagnosis.json"' in page
    assert "correction.fmu" not in " ".join(re.findall(r'href="[^"]*"', page))


# -- units -----------------------------------------------------------------------------------------


def test_a_linear_axis_reads_in_metres_newtons_and_kilograms(answer):
    diagnosis = answer("not_identifiable")
    text = text_of(page_of(diagnosis))
    assert "J kg 2 6" in text
    assert "a2 N·s/m 8 7.0 ± 5.6" in text
    assert not re.search(r"\brad\b|N·m\b", text)
    texts = svg_texts(draw(diagnosis)["overlay"])
    assert "position, mm" in texts
    assert "error, mm" in texts
    assert view_axis(diagnosis.model, "theta") == (1e3, "position, mm")
    assert view_axis(diagnosis.model, "u") == (1.0, "input, N")
    assert view_axis(diagnosis.model, "theta", 0.0032) == (
        1e3,
        "position within one period of 3.2 mm, mm",
    )


def test_a_turning_axis_reads_in_degrees(answer):
    figures = draw(answer("named"))
    assert "position, deg" in svg_texts(figures["overlay"])
    assert "residual torque, N·m" in svg_texts(figures["maps"])
    assert "before: 0.164 deg (0.00286 rad)" in svg_texts(figures["gap"])


def test_the_axis_of_what_repeats_says_how_long_a_period_is(fabricated):
    turning = fabricated.model()
    assert (
        view_axis(turning, "theta x u", 2 * math.pi / 7)[1] == "position within 1/7 of a turn, deg"
    )
    assert view_axis(turning, "theta", 2 * math.pi)[1] == "position within a turn, deg"
    assert view_axis(turning, "tone", 0.3891)[1] == "time within one period of 0.389 s, s"
    assert view_axis(turning, "tone")[1] == "time, s"


def test_the_units_follow_the_input(answer, fabricated):
    driven = fabricated.model(
        parameters={"J": 0.01, "a2": 0.02, "b": 0.5, "Fc": 0.1},
        input={"column": "i", "kind": "current", "unit": "A"},
    )
    zone = Named(
        "dead_zone",
        "dead_zone",
        {"width": Estimate(0.3, driven.unit("dead_zone.width"), (0.28, 0.32))},
        50.0,
        0.001,
    )
    text = text_of(page_of(replace(answer("named"), model=driven, effects=(zone,))))
    assert "0.300 ± 0.020 A" in text


# -- figures ---------------------------------------------------------------------------------------


@pytest.mark.sampled(4)
def test_only_what_changed_has_a_before_and_an_after(answer):
    assert "after: 0.019 deg (0.000332 rad)" in svg_texts(draw(answer("named"))["gap"])
    for case in ("none", "not_identifiable"):
        assert not any(
            text.startswith(("after", "before"))
            for svg in draw(answer(case)).values()
            for text in svg_texts(svg)
        )


def test_bars_show_the_level_of_chance_and_the_best_first(answer):
    texts = svg_texts(draw(answer("named"))["candidates"])
    names = [text for text in texts if text.endswith(")") and "  " not in text]
    assert names[:2] == ["cogging torque (cogging)", "gravity on an unbalanced mass (gravity)"]
    assert "round 1: cogging torque (cogging) added; 3 more gain less" in texts
    assert "41  (stiffness at its bound)" in texts


@pytest.mark.parametrize(("output", "squared"), [("m", "m2"), ("rad/s", "(rad/s)2")])
def test_the_unit_of_a_squared_error_is_read_in_one_way_only(output, squared):
    assert Gap(1.0, 1.0, None, output).unit == squared


def test_an_effect_that_was_not_tried_has_no_gain_and_a_short_reason(answer):
    named = answer("named")
    refused = replace(
        named.rounds[0].candidates[-1],
        gain=math.nan,
        reason="effects 'backlash' and 'compliance' " + 9 * "a load ",
    )
    rounds = (replace(named.rounds[0], candidates=(*named.rounds[0].candidates[:1], refused)),)
    [text] = [
        text
        for text in svg_texts(draw(replace(named, rounds=rounds))["candidates"])
        if "not tried" in text
    ]
    assert text.startswith("not tried  (effects 'backlash'")
    assert text.endswith("…)")


def test_a_name_from_outside_cannot_become_markup(answer):
    bad = replace(
        answer("named"),
        notes=("<script>alert(1)</script>",),
        leads=("a < b",),
        limits=(Undetected("<b>", "&"),),
    )
    page = page_of(bad)
    assert "<script>" not in page
    assert "a &lt; b" in page


@pytest.mark.sampled(4)
def test_figures_are_the_same_every_time(answer):
    assert draw(answer("tie")) == draw(answer("tie"))


def test_small_torques_are_given_in_thousandths(answer):
    named = answer("named")
    small = tuple(
        replace(view, before=0.1 * view.before, after=0.1 * view.after) for view in named.where
    )
    texts = svg_texts(draw(replace(named, where=small))["maps"])
    assert "residual torque, 10⁻³ N·m" in texts
    assert not any(
        len(text) > 5 and text.replace("−", "").replace(".", "").isdigit() for text in texts
    )


def test_the_overlay_shows_where_it_was_worst():
    time = np.arange(10_000) * 1e-3
    still = np.zeros(10_000)
    error = np.where((time > 6) & (time < 7), 1.0, 0.1)
    error[::7] = np.nan
    quiet = RecordTrace("quiet", time, still, still, 0.2 * still, still, still > 0)
    loud = RecordTrace("loud", time, still, still, error, still, still > 0)
    found = worst_part([quiet, loud], 2.0)
    assert found is not None
    trace, part = found
    assert trace.name == "loud"
    assert time[part][0] <= 6.0
    assert time[part][-1] >= 6.99
    assert len(time[part]) == 2000
    assert worst_part([]) is None
    assert worst_part([replace(loud, before=np.full(10_000, np.nan))]) is None


def test_a_record_shorter_than_the_window_is_shown_whole(answer):
    trace = answer("named").traces[0]
    short = replace(
        trace,
        **{
            k: getattr(trace, k)[:300]
            for k in ("time", "input", "measured", "before", "after", "held_out")
        },
    )
    found = worst_part([short])
    assert found is not None
    assert found[1] == slice(0, 300)


# -- numbers and words -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "low", "high", "expected"),
    [
        (0.06, 0.0582, 0.0618, "0.0600 ± 0.0018"),
        (-1.2, -2.3, -0.1, "−1.2 ± 1.1"),
        (6e-4, -3e-4, 15e-4, "(6.0 ± 9.0)·10<sup>−4</sup>"),
        (123456.0, 123356.0, 123556.0, "(1.2346 ± 0.0010)·10<sup>5</sup>"),
        (1.0, 0.9, 2.0, '1.00 <span class="sub">[0.90 … 2.00]</span>'),
        (5.0, 5.0, 5.0, "5"),
        (5.0, float("-inf"), 6.0, "5"),
        (0.0, -0.02, 0.02, "0.000 ± 0.020"),
        (5095.1, 4795.0, 5395.2, "5095 ± 300"),
        (706437.0348, 706437.0348 - 5e-9, 706437.0348 + 5e-9, "(7.06437 ± 0.00001)·10<sup>5</sup>"),
    ],
)
def test_an_interval_has_two_figures(value, low, high, expected):
    assert interval(value, low, high) == expected


@pytest.mark.parametrize(
    ("estimate", "expected"),
    [
        (Estimate(0.249953, "N.m", (0.249906, 0.25)), "0.249953 N.m (0.249906 to 0.250000)"),
        (Estimate(7.0000012, "1", (6.99998, 7.00002)), "7.00000 (6.99998 to 7.00002)"),
        (Estimate(7.0, "1", (7.0 - 1e-9, 7.0 + 1e-9)), "7.00000 (6.99999 to 7.00001)"),
        (Estimate(0.04228, "N.m", (0.03224, 0.05545)), "0.042 N.m (0.032 to 0.055)"),
        (Estimate(123456.0, "1", (123356.0, 123556.0)), "1.2346e5 (1.2336e5 to 1.2356e5)"),
        (Estimate(0.3, "1", None), "0.3 (uncertain)"),
        (Estimate(123456.0, "1", (0.0, 1.38e8)), "0.01e7 (0.00e7 to 13.80e7)"),
        (
            Estimate(250.0, "rad/m", (248.0, 252.0)),
            "250.0 rad/m (248.0 to 252.0), a period of 25.133 mm",
        ),
    ],
)
def test_a_sentence_gives_the_digits_that_the_interval_calls_for(estimate, expected):
    assert value(estimate) == expected


def test_a_sentence_leaves_out_a_second_term_that_may_not_be_there(answer):
    [cogging] = answer("named").effects
    assert list(reported_parameters(cogging)) == ["amplitude", "phase", "periods"]
    there = {**cogging.parameters, "amplitude2": Estimate(0.01, "N.m", (0.009, 0.011))}
    assert list(reported_parameters(replace(cogging, parameters=there))) == list(cogging.parameters)
    sine, cosine = Estimate(0.01, "1", (-0.01, 0.03)), Estimate(0.1, "1", (0.08, 0.12))
    one_term = Named("gravity", "", {"amplitude": cosine, "sine2": sine, "cosine2": sine}, 9.0, 0.1)
    assert list(reported_parameters(one_term)) == ["amplitude"]
    two_terms = replace(one_term, parameters={**one_term.parameters, "cosine2": cosine})
    assert list(reported_parameters(two_terms)) == ["amplitude", "sine2", "cosine2"]


def test_words_are_those_of_the_axis_and_of_its_input(fabricated):
    bias = Named(
        "bias", "bias", {"torque": Estimate(0.06, "N", (0.05, 0.07), at_bound=True)}, 9.0, 0.001
    )
    gap, left = Gap(2.0, 1.0, 0.5, "m"), Unexplained(True, None, 0.4, 0.6)
    facts = bare(
        "named",
        gap,
        left,
        [bias],
        [("bias", "asymmetric_coulomb")],
        {"bias.torque": bias.parameters["torque"]},
    )
    turning = " ".join(answer_lines(facts)) + what_to_measure(facts)
    assert "Missing: constant torque (bias). " in turning
    assert "60 % of the torque of the input" in turning
    assert "a constant torque stays what it is" in turning
    facts = replace(facts, model=fabricated.linear_model())
    linear = " ".join(answer_lines(facts)) + what_to_measure(facts)
    assert re.findall(r"\S*torque", linear) == ["torque", "bias.torque"]  # names of parameters
    assert (
        effect("back_emf", Wording(input_kind="current")).description
        == "current that the turning motor takes from the drive"
    )


def test_what_was_not_found_is_not_said_to_need_what_the_records_have(fabricated):
    [found] = detection_limits(
        [EffectFit("backlash", SimpleNamespace(total=0.0, free=()))], Null(np.zeros(1), {}), 0.0
    )
    assert undetected([found], fabricated.model()) == {
        "backlash": "tried; the likelihood gain does not exceed chance; what shows it: reversals"
    }


def test_a_linear_axis_has_no_torque(answer):
    bias = Named("bias", "bias", {"torque": Estimate(0.06, "N.m", (0.05, 0.07))}, 9.0, 0.001)
    text = text_of(page_of(replace(answer("not_identifiable"), effects=(bias,), verdict="named")))
    assert "constant force, positive forward" in text
    assert "constant torque" not in text


def test_an_effect_is_described_once(answer):
    bias = Named("bias", "bias", {"torque": Estimate(0.06, "N.m", (0.05, 0.07))}, 9.0, 0.001)
    page = text_of(page_of(replace(answer("named"), effects=(bias,))))
    assert "constant torque (bias) gain 9 nats" in page
    assert "cogging torque (cogging) torque that repeats" in text_of(page_of(answer("named")))


def test_views_are_named_in_words():
    assert view_name("theta x direction") == "position × sign of the velocity"
    assert view_name("theta", "7 in a turn") == "position (7 in a turn)"
    assert view_name("something new") == "something new"
