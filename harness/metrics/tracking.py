"""How well the velocity follows the reference with compensation, and without it in a second run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bristle.common.signals import Array
from bristle.harness.cosim.bus import BusTrace

TRACKING_SHARE = 0.25  # share of the run, at its end, over which the tracking error is taken


@dataclass(frozen=True)
class Tracking:
    """Tracking errors [rad/s] of one reference at the end of two runs, arrays (samples,)."""

    time: Array
    reference: Array
    compensated: Array
    alone: Array

    def as_dict(self) -> dict[str, float]:
        """Return the rms of both errors and their ratio, as result.json has them."""
        rms, without = (
            float(np.sqrt(np.mean(error**2))) for error in (self.compensated, self.alone)
        )
        return {
            "from_s": float(self.time[0]),
            "rms": rms,
            "rms_without": without,
            "ratio": rms / without if without else np.nan,
        }


def tracking(compensated: BusTrace, alone: BusTrace) -> Tracking:
    """Return the errors over the last part of both runs."""
    last = slice(-max(1, int(TRACKING_SHARE * compensated.steps)), None)
    references = [trace["controller", "reference"][last] for trace in (compensated, alone)]
    errors = [
        r - trace["plant", "v"][last]
        for r, trace in zip(references, (compensated, alone), strict=True)
    ]
    return Tracking(compensated.time[last], references[0], *errors)
