"""The gallery: each effect has its picture, and the residual torque that is drawn is that of the
effect.
"""

from __future__ import annotations

import importlib.util
import tomllib
from pathlib import Path

import numpy as np

from bristle.plant.effects import effect

DOCS = Path(__file__).resolve().parents[2] / "docs"
SHIPPED = tomllib.loads((DOCS.parent / "tests" / "shipped.toml").read_text(encoding="utf-8"))[
    "effects"
]
_spec = importlib.util.spec_from_file_location("gallery", DOCS / "gallery.py")
assert _spec is not None
assert _spec.loader is not None
gallery = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(gallery)


def test_every_shipped_effect_has_a_picture():
    page = (DOCS / "gallery.md").read_text(encoding="utf-8")
    for name in SHIPPED:
        assert (DOCS / "images" / "effects" / f"{name}.png").stat().st_size > 2000
        assert f"](images/effects/{name}.png)" in page


def test_the_residual_torque_is_that_of_the_effect():
    _, u = gallery.excitation(2.0)
    [torque] = [p.default for p in effect("bias").parameters]
    _, v = gallery.simulate(u, "bias")
    np.testing.assert_allclose(np.nanmedian(gallery.residual_torque(u, v)), torque, rtol=0.05)
    _, v = gallery.simulate(u, None)
    assert abs(np.nanmedian(gallery.residual_torque(u, v))) < 0.01 * torque
