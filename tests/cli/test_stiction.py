"""The friction of a slow axis, from the command line."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import pytest


def test_the_command(tmp_path: Path, call: Callable[..., tuple[int, str, str]]) -> None:
    """A valve that stays where it is until its input is 4 % away, and jumps 3."""
    at, rows = 50.0, list[tuple[int, float, float]]()
    for t in range(2000):
        told = 50 + 20 * math.sin(t / 40)
        at = at if abs(told - at) <= 4 else told - math.copysign(1.0, told - at)
        rows.append((t, told, at))
    path, numbers = tmp_path / "valve.csv", tmp_path / "numbers.json"
    path.write_text("t_s,OP [%],MV [%]\n" + "".join(f"{t},{a:.6f},{b:.6f}\n" for t, a, b in rows))
    asked = ["stiction", path, "--input", "OP [%]", "--output"]
    code, said, _ = call(*asked, "MV [%]", "--json", numbers)
    assert code == 0
    assert said.startswith("The axis sticks and slips\n")
    assert json.loads(numbers.read_text())["static"] == pytest.approx(4.0, rel=0.05)
    code, said, complaint = call(*asked, "flow")
    assert (code, said) == (2, "")
    assert "lacks the column 'flow'; there are: t_s, OP [%], MV [%]" in complaint
    code, _, complaint = call("init", path, "--out", tmp_path / "m.toml")
    assert code == 2
    assert "bristle stiction" in complaint
