"""Parameters from a whole record at once, beside those of an observer, which takes it sample by
sample.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from bristle.common.metrics import NORMAL_95
from bristle.common.table import Array
from bristle.fmus.host import Fmu
from bristle.harness.scenario.rig import ANGLE
from bristle.harness.scenario.samples import Samples

# of input, output, sampling period, whether that is a velocity, sensor step, whether the axis
# turns: parameters with standard deviations
Batch = Callable[[Array, Array, float, bool, float | None, bool], Mapping[str, tuple[float, float]]]
VALID_SHARE = 0.15  # half-width of a 95 % interval over the value, up to which it is valid


def batch_result(samples: Samples, observer: Fmu, estimate: Batch) -> dict[str, dict[str, Any]]:
    """Return what an estimate from the whole record gives of what an observer could: each parameter
    with its unit, standard deviation, and whether it is known closely enough to be valid.
    """
    velocity = "theta" not in samples.measured
    y = samples.v if velocity else samples.theta
    rotary = samples.rig.position == ANGLE
    found = estimate(samples.u, y, samples.h, velocity, samples.resolution, rotary)
    return {
        name: {
            "unit": samples.rig.unit(observer.unit(f"{name}_hat")),
            "value": value,
            "sd": sd,
            "valid": bool(NORMAL_95 * sd <= VALID_SHARE * abs(value)),
        }
        for name, (value, sd) in found.items()
        if observer.has(f"{name}_hat", "output")
    }


def known_at_once(result: Mapping[str, Any]) -> list[str]:
    """Return a line on what the whole record shows and the observer does not."""
    known = {name: e for name, e in result.get("batch", {}).items() if e["valid"]}
    if all(result["estimates"].get(name, {}).get("valid") for name in known):
        return []
    values = ", ".join(f"{name} {e['value']:.4g} {e['unit']}" for name, e in known.items())
    return [f"The whole record at once gives {values}; the verdict does not depend on it."]
