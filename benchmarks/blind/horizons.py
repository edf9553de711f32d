"""Do refits to longer horizons generalise where the model is right? The cases of scenarios/hidden,
each with its true structure.

    python benchmarks/blind/horizons.py [CASE ...]

Prints, for each half of the records and each horizon, by what factor a refit to that half lowers
the squared error in the other half. Where the structure is the true one, only chance can lower it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hidden import HIDDEN_CASES, open_answers

from bristle.diagnosis import load_model, load_records
from bristle.diagnosis.checks.preparation import base_servo_of, dataset_of
from bristle.diagnosis.estimation.fitted_model import fit_with_noise
from bristle.diagnosis.estimation.optimiser import resume
from bristle.diagnosis.estimation.simulator import (
    BRISTLE_EFFECTS,
    OWN_BRISTLES,
    Servo,
)
from bristle.diagnosis.free_parameter import free_parameters
from bristle.diagnosis.validation.long_simulation import (
    Records,
    fitted_error,
    open_loop_servo,
    refit_horizon,
    with_fitted_starts,
)


def with_effect(servo: Servo, name: str, start: Mapping[str, float]) -> Servo:
    """Return a servo with an effect, its parameters free; an effect of bristles takes the place of
    the servo's own.
    """
    free = [
        f
        for f in servo.free
        if name not in BRISTLE_EFFECTS or not f.name.startswith(f"{OWN_BRISTLES}.")
    ]
    free += free_parameters(name, start, servo.limits)
    return replace(
        servo,
        effects=(*servo.effects, name),
        free=tuple(free),
        rigid=servo.rigid and name not in BRISTLE_EFFECTS,
    )


def falls(folder: Path, answer: Mapping[str, Any]) -> Iterator[str]:
    """Give for each half the factors by which the squared error falls in the other one."""
    model = load_model(folder / "model.toml")
    records = load_records(model, [folder / "a.npz", folder / "b.npz"])
    dataset = dataset_of(model, records)
    servo, values = base_servo_of(model, dataset)
    for effect in answer["effects"]:
        servo = with_effect(servo, effect["name"], effect["parameters"])
        values |= {f"{effect['name']}.{key}": value for key, value in effect["parameters"].items()}
    fitted = fit_with_noise(dataset, servo, values)
    own = resume(fitted.problem.only(dataset.segments.counted), fitted.fit).values
    plain, whole = open_loop_servo(servo), Records.of(dataset, records, dataset.segments.times)
    for one, other in (whole.halves(), whole.halves()[::-1]):
        now, found = own, []
        for seconds in one.horizons(dataset.segments.seconds):
            fit = refit_horizon(plain, now, one.stretches(seconds), one.least)
            if fit is None:
                break
            now, s = fit.values, other.stretches(seconds)
            before, after = (
                fitted_error(with_fitted_starts(plain, each, s, one.least)) for each in (own, now)
            )
            found.append(f"{seconds:.1f} s {(before / after) ** 2:.2f}")
        yield ", ".join(found) or "no refit stays with the records"


def main(names: list[str]) -> int:
    """Print the table."""
    with threadpool_limits(1, user_api="blas"):
        for case, answer in open_answers().items():
            absorbed = any(effect["name"] == "back_emf" for effect in answer["effects"])
            if answer["kind"] != "outside" and not absorbed and (not names or case in names):
                effects = " + ".join(effect["name"] for effect in answer["effects"]) or "none"
                print(
                    f"{case} {effects}: " + "; ".join(falls(HIDDEN_CASES / case, answer)),
                    flush=True,
                )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
