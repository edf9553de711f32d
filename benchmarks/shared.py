"""Shared by several benchmarks: confidence bounds of counts, limits of the blind test, results
written in one piece.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from scipy.stats import beta

CONFIDENCE = 0.95  # of one-sided bounds
BLIND_TEST_LIMITS = """### What these figures do not say

- Every model file of the test has Coulomb friction as its law. Models with another law are not
  tested; only some records (controls with other friction, effects in another form) come from
  another law.
- The disturbance torque is first-order low-pass noise with a corner frequency of 10 Hz. That is the
  kind of disturbance which the estimator assumes, and 10 Hz is one of the five corner frequencies
  that it tries (1, 3, 10, 30 and 100 Hz). Other disturbances occur only as effects from outside the
  catalogue.
- All records are 20 s of position from one encoder (16384 counts a turn), sampled at 1 kHz together
  with the input.
- The gap ratio, by which the cases are grouped, compares segments of 0.4 s, the length that the
  method itself uses. An effect that acts over longer times looks small to both.
- A commit is tested on its own cases once. Afterwards these cases were used in development: rules
  that are younger were made with the answers at hand, and results on the same cases are no longer
  blind.
- The table holds for the commit that it names. Later rules are not part of it.
"""


def upper_bound(count: int, n: int) -> float:
    """Return the one-sided 95 % upper bound of a share.

    Source: clopper1934 (exact binomial limits).
    """
    return 1.0 if count >= n else float(beta.ppf(CONFIDENCE, count + 1, n - count))


def write_json(path: Path, content: Any, indent: int | None = None) -> None:
    """Write a file in one piece, so that an existing file is complete; create its folder if it is
    missing.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(".part")
    draft.write_text(json.dumps(content, indent=indent), encoding="utf-8")
    draft.replace(path)
