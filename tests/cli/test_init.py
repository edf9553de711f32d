"""bristle init as a user meets it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bristle.diagnosis import load_model

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A record of an inertia of 0.01 kg.m2 with friction, from an exact motion."""
    t = np.arange(6000) * 1e-3
    theta = 3 * np.sin(1.3 * t) + 0.8 * np.sin(5.1 * t)
    v = 3.9 * np.cos(1.3 * t) + 4.08 * np.cos(5.1 * t)
    a = -5.07 * np.sin(1.3 * t) - 20.808 * np.sin(5.1 * t)
    u = 0.01 * a + 0.02 * v + 0.12 * np.sign(v)
    path = tmp_path / "run 1.csv"
    np.savetxt(
        path,
        np.column_stack([t, u, theta]),
        delimiter=";",
        header="Zeit [s];Moment [Nm];Winkel [rad]",
        comments="",
        fmt="%.9f",
    )
    return path


def test_it_writes_a_model_and_says_what_comes_next(call: Call, log: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "model.toml"
    code, said, error = call("init", log, "--out", out)
    assert (code, error) == (0, "")
    lines = said.splitlines()
    assert lines[0] == "time    'Zeit [s]' in s, every 1 ms"
    assert lines[-1] == f"{out}  next: bristle diagnose {out} --data '{log}'"
    model = load_model(out)
    assert model.parameters["J"] == pytest.approx(0.01, rel=0.05)
    assert model.parameters["coulomb.Fc"] == pytest.approx(0.12, rel=0.05)
    assert model.input.column == "Moment [Nm]"


def test_it_replaces_a_file_only_if_forced(call: Call, log: Path, tmp_path: Path) -> None:
    out = tmp_path / "model.toml"
    out.write_text("mine")
    code, _, error = call("init", log, "--out", out)
    assert code == 2
    assert (
        error == f"bristle: {out}: exists already; give another name, or allow it to be replaced\n"
    )
    assert out.read_text() == "mine"
    assert call("init", tmp_path / "*.csv", "--out", out, "--force")[0] == 0
    assert load_model(out).friction == "coulomb"


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (
            ["--input", "Strom"],
            (
                "input 'Strom': is no column of numbers in every file; there are: Moment [Nm],"
                " Winkel [rad]"
            ),
        ),
        (["--unit", "rad"], "--unit 'rad': is not NAME=VALUE"),
        (["--unit", "Moment [Nm]=lbf"], "unit 'lbf' of 'Moment [Nm]' is not known"),
        (["--out", "model.csv"], "model.csv: is no name of a model file"),
        (["none*.csv"], "none*.csv: no file matches this pattern"),
    ],
)
def test_mistakes_are_one_line(
    call: Call, log: Path, tmp_path: Path, args: list[str], words: str
) -> None:
    out = [] if "--out" in args else ["--out", tmp_path / "model.toml"]
    code, said, error = call("init", log, *args, *out)
    assert (code, said, len(error.splitlines())) == (2, "", 1)
    assert words in error
    assert not (tmp_path / "model.toml").exists()


def test_columns_and_units_may_be_given(call: Call, log: Path, tmp_path: Path) -> None:
    asked = (
        "--input",
        "Moment [Nm]",
        "--output",
        "Winkel [rad]",
        "--time",
        "Zeit [s]",
        "--unit",
        "Winkel [rad]=deg",
    )
    assert call("init", log, *asked, "--out", tmp_path / "model.toml")[0] == 0
    assert load_model(tmp_path / "model.toml").output.unit == "deg"
