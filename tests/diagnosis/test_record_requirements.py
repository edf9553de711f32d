"""What a diagnosis demands of records and model, beyond what tests/records shows of the reader."""

from dataclasses import replace

import numpy as np
import pytest

from bristle.diagnosis import Model, Record, diagnose, load_model, load_records, records_from_arrays

T = np.arange(6000) * 1e-3
U, Y = 0.3 * np.sin(2.1 * T), 6.0 * np.sin(1.3 * T)


@pytest.mark.parametrize(
    ("t", "words"),
    [
        (T[:150], "150 samples; at least 200 are needed"),
        (T[:1900], "lasts 1.899 s; at least 2 s are needed"),
        (T * 1000, "allowed are 1e-05 to 0.1 s"),
        (T / 1000, "allowed are 1e-05 to 0.1 s"),
    ],
)
def test_a_record_must_be_long_enough_and_sampled_as_a_servo_is(t, words, model, message):
    assert words in message(
        lambda: records_from_arrays(model, [("run", t, U[: len(t)], Y[: len(t)])])
    )


def test_something_must_move(model, message):
    assert "nothing moves" in message(lambda: records_from_arrays(model, [("run", T, U, 0 * Y)]))
    assert "input is constant" in message(
        lambda: records_from_arrays(model, [("run", T, 0 * U, Y)])
    )


def test_diagnose_checks_records_that_were_made_by_hand(model, message):
    made = Record("run", T, 1e-3, U, Y)
    assert "sampled every 0.002 s" in message(
        lambda: diagnose(model, [made, replace(made, time=2 * T, h=2e-3)])
    )
    assert "nothing moves" in message(
        lambda: diagnose(model, [replace(made, y=np.full(6000, 0.3))])
    )
    assert "at least 2 s are needed" in message(
        lambda: diagnose(model, [Record("run", T[:5], 1e-3, U[:5], Y[:5])])
    )


def test_a_model_is_a_model(message, tmp_path):
    assert "the model is a str; give what load_model" in message(
        lambda: records_from_arrays("model.toml", [])
    )
    assert "the model is a str; give what load_model" in message(
        lambda: load_records("model.toml", tmp_path / "r.csv")
    )
    assert "model is None; give a path" in message(lambda: load_model(None))
    assert "model: is a NoneType; give a dict" in message(lambda: Model.from_dict(None))
