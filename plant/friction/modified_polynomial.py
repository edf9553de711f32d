"""The modified LuGre law with powers of |v| as basis functions."""

from __future__ import annotations

from bristle.model.basis import polynomial
from bristle.plant.friction.modified import modified

LAW = modified("modified_polynomial", "polynomial", polynomial)
