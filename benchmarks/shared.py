"""What several benchmarks share: how sure a count is, and results written in one piece."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from scipy.stats import beta

CONFIDENCE = 0.95


def upper_bound(count: int, n: int) -> float:
    """Return the one-sided 95 % upper bound of a share.

    Source: clopper1934 (exact binomial limits).
    """
    return 1.0 if count >= n else float(beta.ppf(CONFIDENCE, count + 1, n - count))


def write_json(path: Path, content: Any, indent: int | None = None) -> None:
    """Write a file whose presence means that it is whole; its folder is made if it is missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(".part")
    draft.write_text(json.dumps(content, indent=indent), encoding="utf-8")
    draft.replace(path)
