"""The whole way through the command line: what is refused, what is proposed instead of an answer,
what is named.
"""

from __future__ import annotations

import json
import re
import signal
import sys
from collections.abc import Callable, Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from threadpoolctl import threadpool_info, threadpool_limits

from bristle.cli import main as cli
from bristle.common.errors import BristleError
from bristle.diagnosis import Model, diagnose, fmu_model, records_from_arrays, write
from bristle.diagnosis.checks import preparation as prepare
from bristle.diagnosis.estimation import fitted_model as fitting_module
from bristle.diagnosis.modelfile import model_text
from bristle.diagnosis.report.text.said import said
from bristle.diagnosis.stages import conclusion
from bristle.fmus import build

Call = Callable[..., tuple[int, dict[str, Any], str]]
Columns = tuple[np.ndarray, np.ndarray, np.ndarray]


@pytest.fixture
def call(
    tree: dict[str, Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Iterator[Call]:
    """Return what diagnoses arrays through the command line: (exit code, diagnosis.json, standard
    error).
    """
    kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def run(*records: Columns, **changes: Any) -> tuple[int, dict[str, Any], str]:
        (tmp_path / "model.toml").write_text(
            model_text(Model.from_dict(deepcopy(tree) | changes)), encoding="utf-8"
        )
        files: list[object] = []
        for i, (t, u, y) in enumerate(records):
            path = tmp_path / f"r{i}.npz"
            np.savez(path, t=t, u=u, theta=y)
            files += ["--data", path]
        out = tmp_path / "out"
        monkeypatch.setattr(
            sys,
            "argv",
            ["bristle", "diagnose", *map(str, (tmp_path / "model.toml", *files, "--out", out))],
        )
        with pytest.raises(SystemExit) as done:
            cli.main()
        assert isinstance(done.value.code, int)
        answer = out / "diagnosis.json"
        content = json.loads(answer.read_text(encoding="utf-8")) if answer.exists() else {}
        content["page"] = (out / "report.html").read_text(encoding="utf-8") if content else ""
        return (
            done.value.code,
            content | {"files": sorted(p.name for p in out.glob("*"))},
            capsys.readouterr().err,
        )

    yield run
    for number, handler in kept.items():
        signal.signal(number, handler)


@pytest.fixture(scope="module")
def plain(measured: Callable[..., Any]) -> list[Columns]:
    return [measured("bias", seed, plain=True)[:3] for seed in (1, 2)]


REFUSED: dict[str, tuple[Callable[[Columns], Columns], str, str]] = {
    "too short": (lambda c: (c[0][:900], c[1][:900], c[2][:900]), "lasts 0.899 s", "record longer"),
    "too few": (lambda c: (c[0][:150], c[1][:150], c[2][:150]), "150 samples", "record longer"),
    "constant input": (
        lambda c: (c[0], 0.1 + 0 * c[1], c[2]),
        "input is constant",
        "give a record in which it varies",
    ),
    "no motion": (lambda c: (c[0], c[1], 0 * c[2]), "nothing moves", "give a record with motion"),
    "NaN": (
        lambda c: (c[0], np.where(np.arange(len(c[1])) % 500 < 20, np.nan, c[1]), c[2]),
        "not finite",
        "repair",
    ),
    "time runs back": (
        lambda c: (np.where(c[0] < 5, c[0], c[0] - 1), c[1], c[2]),
        "time decreases",
        "sort the record",
    ),
    "milliseconds": (
        lambda c: (c[0] * 1e3, c[1], c[2]),
        "sampled every 1 s",
        "unit right (ms, us)",
    ),
}


@pytest.mark.parametrize("what", list(REFUSED))
def test_what_is_refused_is_refused_in_one_line(
    what: str, call: Call, plain: list[Columns]
) -> None:
    change, found, advice = REFUSED[what]
    code, answer, error = call(*(change(each) for each in plain))
    assert code == 2
    assert len(error.splitlines()) == 1
    assert found in error
    assert advice in error
    assert answer["files"] == []


PROPOSED: dict[str, tuple[Callable[[Columns], Columns], str]] = {
    "sign": (lambda c: (c[0], -c[1], c[2]), "input sign looks flipped"),
    "milli": (lambda c: (c[0], 1e3 * c[1], c[2]), "a unit of milli"),
    "degrees": (lambda c: (c[0], c[1], np.degrees(c[2])), "position looks a factor"),
    "swapped": (lambda c: (c[0], c[2], c[1]), "columns of input and output look swapped"),
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("what", list(PROPOSED))
def test_a_mistake_in_the_data_is_proposed_and_nothing_is_named(
    what: str, call: Call, measured: Callable[..., Any]
) -> None:
    change, words = PROPOSED[what]
    data = [change(measured("gravity", seed)[:3]) for seed in (1, 2)]
    code, answer, error = call(*data)
    assert (code, error) == (0, "")
    assert answer["verdict"] == "not_identifiable"
    assert (answer["effects"], answer["ties"], answer["rounds"]) == ([], [], [])
    assert answer["files"] == ["diagnosis.json", "report.html"]
    [proposal] = answer["proposals"]
    assert words in proposal
    assert proposal.rstrip("?") in answer["statement"][0]


@pytest.mark.usefixtures("few")
@pytest.mark.long
def test_an_output_that_has_nothing_to_do_with_the_input_is_no_good_model(
    call: Call, plain: list[Columns]
) -> None:
    noise = np.random.default_rng(3)
    short = [(t[:5000], u[:5000]) for t, u, _ in plain]
    code, answer, error = call(
        *((t, u, lfilter([1.0], [1.0, -0.5], noise.standard_normal(len(t)))) for t, u in short)
    )
    assert (code, error) == (0, "")
    assert (answer["verdict"], answer["effects"]) == ("not_identifiable", [])
    assert "these records do not determine J, a2 or coulomb.Fc" in " ".join(answer["statement"])
    assert answer["files"] == ["diagnosis.json", "report.html"]


def test_what_is_no_model_and_what_is_no_record_is_said(model: Model, plain: list[Columns]) -> None:
    given = [(model, "r.csv"), (model, [("r", *plain[0])]), (model, None), ("model.toml", [])]
    for wrong, records in given:
        with pytest.raises(BristleError, match="give what load_"):
            diagnose(wrong, records)  # type: ignore[arg-type]  # the wrong types are the test


@pytest.mark.sampled(4)
@pytest.mark.usefixtures("few")
def test_records_of_different_rates_are_brought_to_one(call: Call, plain: list[Columns]) -> None:
    (t, u, y), other = plain
    code, answer, _ = call((t[::2], u.reshape(-1, 2).mean(axis=1), y[::2]), other)
    assert code == 0
    assert answer["excitation"]["sampling_period"]["value"] == pytest.approx(2e-3)
    steps, resampled = answer["findings"]
    assert "resampled" in resampled
    assert steps == "the output moves in steps of 0.000383 rad (16384 a turn)"
    assert answer["verdict"] == "none"


TIGHT = {
    "parameters": {"J": 0.008, "a2": 0.02, "Fc": 0.12},
    "bounds": {"J": [0.007, 0.009], "Fc": [0.0, 0.6]},
}


@pytest.mark.long
def test_a_bound_that_explains_the_gap_is_proposed_in_place_of_an_effect(
    call: Call, plain: list[Columns], search_among: Callable[..., None]
) -> None:
    # the first two make up for the bound best
    search_among("gear_loss", "dead_zone", "bias", "stribeck")
    code, answer, error = call(plain[0], **TIGHT)
    assert (code, error) == (0, "")
    assert (answer["verdict"], answer["effects"]) == ("not_identifiable", [])
    [proposal] = answer["proposals"]
    assert re.search(
        r"J near 0\.0(099\d|10) kg\.m2, outside its bounds \[0\.007, 0\.009\]", proposal
    )
    assert answer["rounds"]  # effects were tried
    assert answer["statement"][0].startswith(
        "Effects explain these records, but they only make up for bounds"
    )
    assert answer["gap"]["before"] == answer["gap"]["after"]
    assert "First widen the bounds" in answer["page"]
    assert "took no part in the search" in answer["page"]
    assert not any(
        words in answer["page"] for words in ("Unexplained residual", "Effects that were not found")
    )
    assert answer["files"] == ["diagnosis.json", "report.html"]


@pytest.mark.usefixtures("few")
@pytest.mark.long
def test_a_bound_that_the_base_refit_ends_at_is_said(
    call: Call, measured: Callable[..., Any]
) -> None:
    """What is missing is larger than what the bound costs: it is suspected, for the bound may be
    what it makes up for.
    """
    tighter = {**TIGHT, "bounds": {"J": [0.006, 0.008], "Fc": [0.0, 0.6]}}
    code, answer, error = call(measured("gravity", 1)[:3], **tighter)
    assert (code, error) == (0, "")
    assert answer["effects"] == []
    assert "gravity" in [e["name"] for e in answer["suspects"]]
    assert answer["base"]["J"]["at_bound"]
    assert any(
        line.startswith("the base refit of J ends at its bound") for line in answer["findings"]
    )
    assert "augmented.fmu" not in answer["files"]


@pytest.mark.sampled(2)
@pytest.mark.usefixtures("few")
def test_what_was_named_is_no_candidate_of_the_model_that_has_it(
    measured: Callable[..., Any], model: Model, tmp_path: Path
) -> None:
    """The augmented model goes back in: its effect is refitted with the rest, and nothing more is
    missing.
    """
    from bristle.diagnosis import load_model
    from bristle.diagnosis.report.export import augment

    records = records_from_arrays(
        model, [(f"r{seed}", *measured("gravity", seed)[:3]) for seed in (1, 2)]
    )
    first = diagnose(model, records)
    assert first.effects[0].name == "gravity"
    augmented = augment(first)
    assert augmented is not None
    (tmp_path / "augmented.toml").write_text(model_text(augmented.model), encoding="utf-8")
    again = diagnose(load_model(tmp_path / "augmented.toml"), records)
    assert again.effects == ()
    assert not any(c.name == "gravity" for r in again.rounds for c in r.candidates)
    assert again.parameters["gravity.amplitude"].value == pytest.approx(
        first.effects[0].parameters["amplitude"].value, rel=0.02
    )
    # what a prior holds differs a little
    assert again.gap.before == pytest.approx(first.gap.after, rel=0.5)


@pytest.mark.long
def test_a_linear_axis_has_nothing_that_turns(
    measured: Callable[..., Any], tree: dict[str, Any], search_among: Callable[..., None]
) -> None:
    search_among(
        "hard_stop", "gravity", "eccentric_encoder", "cogging", "compliance", "bias", "saturation"
    )
    tree["input"] = {"column": "u", "kind": "force", "unit": "N"}
    tree["output"] = {"column": "x", "kind": "position", "unit": "m"}
    model = Model.from_dict(tree)
    records = records_from_arrays(model, [("r", *measured("hard_stop", 1)[:3])])
    found = diagnose(model, records)
    assert [e.name for e in found.effects] == ["hard_stop"]
    assert found.effects[0].parameters["stiffness"].unit == "N/m"
    refused = {
        c.name: said(c.reason)
        for r in found.rounds
        for c in r.candidates
        if c.reason and said(c.reason).startswith("needs")
    }
    assert (
        refused["gravity"]
        == refused["eccentric_encoder"]
        == "needs a shaft that turns: this axis is linear"
    )
    assert found.undetected["gravity"] == refused["gravity"]
    assert not any("in a turn" in said(view.label) for view in found.where)


@pytest.mark.long
def test_a_model_that_diverges_is_compared_over_shorter_segments_if_there_are_any(
    measured: Callable[..., Any], model: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fitting_module, "DIVERGED_SHARE", -1.0)
    t, u, y, _ = measured("gravity", 1)
    for every, seconds in ((1, 0.1), (50, 0.4)):  # eight samples are the shortest segment
        records = records_from_arrays(model, [("r", t[::every], u[::every], y[::every])])
        case = prepare.prepared_case(model, records, (), lambda text, share: None)
        assert isinstance(case, prepare.PreparedCase)
        case = case.otherwise() if case.otherwise else case
        lines = [said(note) for note in case.later]
        assert case.dataset.segments.seconds == pytest.approx(seconds)
        assert [
            line for line in lines if f"segments of {seconds:g} s were compared" in line
        ] == lines
        assert len(lines) == (every == 1)


LUGRE = {"sigma0": 100.0, "sigma1": 0.5, "Fc": 0.12, "Fs": 0.15, "vs": 0.2}


@pytest.mark.parametrize(
    ("friction", "own", "kind", "output"),
    [
        ("lugre", LUGRE, "torque", "position"),
        ("viscous", {}, "torque", "position"),
        ("coulomb", {"Fc": 0.12}, "voltage", "velocity"),
        ("coulomb", {"Fc": 0.12}, "current", "position"),
    ],
)
@pytest.mark.usefixtures("few")
@pytest.mark.long
def test_any_law_input_and_output(
    friction: str,
    own: dict[str, float],
    kind: str,
    output: str,
    measured: Callable[..., Any],
    tree: dict[str, Any],
) -> None:
    gain = 1.0 if kind == "torque" else 0.5
    tree |= {
        "friction": friction,
        "parameters": {"J": 0.01, "a2": 0.02} | own | ({} if gain == 1.0 else {"b": gain}),
    }
    tree["input"] |= {"kind": kind, "unit": {"torque": "N.m", "voltage": "V", "current": "A"}[kind]}
    tree["output"] |= {"kind": output, "unit": "rad" if output == "position" else "rad/s"}
    tree.pop("bounds")
    model = Model.from_dict(tree)
    t, u, y, v = (column[:5000] for column in measured("gravity", 1))
    noise = 2e-3 * np.random.default_rng(1).standard_normal(len(v))
    found = diagnose(
        model,
        records_from_arrays(model, [("r", t, u / gain, y if output == "position" else v + noise)]),
    )
    assert found.proposals == ()
    assert found.gap.after < found.gap.before
    names = [e.name for e in found.effects]
    if friction == "viscous":  # it lacks dry friction too, which no effect tried here is
        gravity = next(e for e in (*found.effects, *found.suspects) if e.name == "gravity")
        low, high = gravity.parameters["amplitude"].ci95
        assert low < 0.3 < high
    elif output == "position":
        assert names == ["gravity"]
        assert found.effects[0].parameters["amplitude"].value == pytest.approx(0.3, rel=0.03)


@pytest.mark.sampled(4)
@pytest.mark.usefixtures("few")
def test_linear_algebra_has_one_thread_in_a_diagnosis_and_its_own_again_afterwards(
    model: Model, plain: list[Columns]
) -> None:
    """Several sum in another order, so that a notebook's digits would not be the command line's."""
    seen: list[set[int]] = []

    def threads() -> set[int]:
        return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}

    with threadpool_limits(2, user_api="blas"):
        diagnose(
            model,
            records_from_arrays(model, [("r", *plain[0])]),
            lambda text, share: seen.append(threads()),
        )
        assert seen
        assert all(each == {1} for each in seen)
        assert threads() == {2}


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda model, out: fmu_model(None), "the FMU is a NoneType; give the path"),
        (lambda model, out: write(None, out), "the diagnosis is a NoneType; give what diagnose"),
        (
            lambda model, out: build("plant", out, law="coulomb", effects="bias"),
            r"give a list of names: \['bias'\]",
        ),
        (
            lambda model, out: build(
                "plant", out, law="gms", effects=["bias"], parameters={"bias.torque": ""}
            ),
            "is not a number",
        ),
    ],
)
def test_arguments_of_a_wrong_type_are_one_line(model, tmp_path, call, words):
    with pytest.raises(BristleError, match=words):
        call(model, tmp_path / "out")


@pytest.mark.slow
@pytest.mark.usefixtures("few")
def test_effects_whose_strength_may_be_nothing_in_the_end_are_withdrawn(
    model, measured, monkeypatch
):
    """A refit to whole records may take what segments had shown: then something is missing, and it
    has no name.
    """
    columns = [(f"run {seed}", *(x[:5000] for x in measured("bias", seed)[:3])) for seed in (1, 2)]
    records = records_from_arrays(model, columns)
    assert [e.name for e in diagnose(model, records).effects] == ["bias"]
    monkeypatch.setattr(conclusion, "ANY_STRENGTH", 0.0)
    found = diagnose(model, records)
    assert (found.verdict, found.effects, found.remains.flag) == ("not_identifiable", (), True)
    said = "'bias' would explain most, but with a strength that may be nothing"
    assert any(said in line for line in found.statement)
    assert found.whole.horizons[-1].before == found.whole.horizons[-1].after
