"""What is reproduced: schemes, plants and gains of the paper, and what is kept of their runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from bristle.common.signals import Array
from bristle.harness.metrics.fit import Data
from bristle.harness.paper.printed_numbers import PRINTED

SCHEMES = {"printed": "as printed", "repaired": "as repaired", "best": "best observer"}
LETTERS = {
    scheme: f"({letter}) {title}"
    for letter, (scheme, title) in zip("abc", SCHEMES.items(), strict=True)
}
TEST_PLANTS = {"S": "", "L0": "_lugre"}  # set: suffix of the scenario files
# sections of the low-pass that makes the reference: the paper leaves open how many
FILTER_ORDERS = (1, 2)
BASELINE_SCHEME = "repaired"  # whose scenarios fit the baselines: all schemes have the same records
GAINS = {
    "vc": ("vc",),
    "c1": ("c1",),
    "gamma": ("gamma1", "gamma2", "gamma3"),
    "k0": ("k1", "k2"),
    "lambda": ("lam",),
}
# columns of the table of eq. (25)
COMPARED = ("printed", "repaired", "best", "linear", "coulomb", "floor")


@dataclass(frozen=True)
class Remark:
    """What has to be known of a score: step1 (only its estimates are scored), invalid (so the
    observer says), none (no score).
    """

    kind: str
    text: str


@dataclass(frozen=True)
class Prediction:
    """The model that the last published estimates make, on the second record."""

    law: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    mse_percent: float | None = None
    velocity: Array | None = None
    remark: Remark | None = None


class Key(NamedTuple):
    """Which scheme on which record."""

    scheme: str
    plant: str
    order: int


@dataclass
class SchemeCase:
    """A scheme on a record: what of it the page shows. Arrays have shape (n,), in SI units."""

    key: Key
    result: dict[str, Any]
    source: Path
    method: str
    values: Mapping[str, Any]  # start values of the plant
    begin: float  # s: when step 2 starts, 0 if all parameters are estimated at once
    time: Array
    hats: Mapping[str, Array]
    last: Mapping[str, float]  # the estimates published last
    sample_time: Array  # of the reference, in the window of Fig. 3
    reference: Array
    second: Data | None  # the second record
    validation_time: Array  # in the window of Fig. 6
    measured: Array
    predictions: Mapping[str, Array]
    model: Prediction
    gains: Mapping[str, list[float] | None] = field(default_factory=dict)


@dataclass
class PaperComparison:
    """Everything on the page."""

    cases: dict[Key, SchemeCase]
    # velocity and level of friction over inertia of L0: the plant's and the schemes'
    curves: dict[str, tuple[Array, Array]]
    content: dict[str, Any]  # reproduce.json
    share: float = 1.0

    def window(self, key: str) -> tuple[float, float]:
        """Return a time window of the paper, shortened as the runs are."""
        first, last = PRINTED[key].values
        return first * self.share, last * self.share
