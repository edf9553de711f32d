"""Records of the benchmark plants under the reference controller, made by the FMUs and kept for the
process.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from bristle.fmus import obtain
from bristle.fmus.host import Fmu
from bristle.harness.cosim.bus import Bus, BusUnit
from bristle.harness.cosim.loop import simulate
from bristle.model.native import Native
from bristle.observer import observer_program

RECORD_STEP = 1e-3
SERVO = {"J": 0.001, "b": 0.0065, "a2": 0.002}  # alpha2 = 2 1/s, b = 6.5 rad/(s2.V)
LUGRE_PLANT = {
    "lugre.sigma0": 0.8,
    "lugre.Fc": 0.004,
    "lugre.Fs": 0.0072,
    "lugre.vs": math.radians(25.0),
}

GMS_PLANT = {
    "gms.Fc": 0.004,
    "gms.Fs": 0.0072,
    "gms.vs": math.radians(25.0),
    "gms.C": 0.2,
    **{f"gms.k{i}": k for i, k in enumerate((0.4, 0.25, 0.15, 0.08), start=1)},
    **{f"gms.alpha{i}": share for i, share in enumerate((0.1, 0.2, 0.3, 0.4), start=1)},
}
# s: when the normal load doubles, and how long the record goes on
LOAD_CHANGE_TIME, TIME_AFTER_CHANGE = 60.0, 30.0


def modified(sigma0: float, sigma1: float, sigma2: float, c: float) -> dict[str, float]:
    """Return the parameters of a plant with the modified law."""
    values = {"sigma0": sigma0, "sigma1": sigma1, "sigma2": sigma2, "c": c}
    return {f"modified.{name}": value for name, value in values.items()}


RECORD_PLANTS = {
    "S": ("modified", SERVO | modified(600.0, 800.0, 300.0, 150.0)),
    "R": ("modified", SERVO | modified(800.0, 1067.0, 400.0, 200.0)),
    "L0": ("lugre", SERVO | LUGRE_PLANT | {"lugre.sigma1": 0.0}),
    "L1": ("lugre", SERVO | LUGRE_PLANT | {"lugre.sigma1": 0.02}),
    "GMS": ("gms", SERVO | GMS_PLANT),
}
TRUE_PARAMETERS = {
    "S": {
        "alpha2": 2.0,
        "b": 6.5,
        "Fc": 4.0,
        "sigma0": 600.0,
        "sigma1": 800.0,
        "sigma2": 300.0,
        "c": 150.0,
    },
    "R": {
        "alpha2": 2.0,
        "b": 6.5,
        "Fc": 4.0,
        "sigma0": 800.0,
        "sigma1": 1067.0,
        "sigma2": 400.0,
        "c": 200.0,
    },
}


@lru_cache(maxsize=200)
def record(plant: str, order: int, seed: int, seconds: float) -> dict[str, NDArray[np.float64]]:
    """Return u, y_theta, y_v and the encoder's position and velocity, one value a sample, of a run
    from rest.
    """
    return _run(plant, order, seed, seconds)


def changed(plant: str, order: int, seed: int) -> dict[str, NDArray[np.float64]]:
    """Return the same of a run in which the normal load doubles after `LOAD_CHANGE_TIME`
    seconds.
    """
    return _run(
        plant,
        order,
        seed,
        LOAD_CHANGE_TIME + TIME_AFTER_CHANGE,
        ((round(LOAD_CHANGE_TIME / RECORD_STEP), ("plant", "load_scale"), 2.0),),
    )


def _run(
    plant: str,
    order: int,
    seed: int,
    seconds: float,
    events: tuple[tuple[int, tuple[str, str], float], ...] = (),
) -> dict[str, NDArray[np.float64]]:
    law, parameters = RECORD_PLANTS[plant]
    servo = Fmu(obtain("plant"))
    instances = (
        BusUnit("plant", servo, {"law": servo.choices("law")[law], **parameters}),
        BusUnit(
            "controller", Fmu(obtain("controller")), {"seed": float(seed), "order": float(order)}
        ),
    )
    links = ((("controller", "u"), ("plant", "u")), (("plant", "v"), ("controller", "y_v")))
    taps = (
        ("controller", "u"),
        *(("plant", name) for name in ("theta", "v", "theta_enc", "v_enc")),
    )
    trace = simulate(
        Bus(instances, round(seconds / RECORD_STEP), RECORD_STEP, links, events, record=taps)
    )
    if trace.failure is not None:
        raise RuntimeError(trace.failure.message)
    names = ("u", "y_theta", "y_v", "encoder", "encoder_v")
    return {name: np.ascontiguousarray(trace.values[:, i]) for i, name in enumerate(names)}


def observe(
    method: str,
    names: Sequence[str],
    data: Mapping[str, NDArray[np.float64]],
    plant: str,
    given: Mapping[str, float],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (error at the end in %, last time the error exceeds 5 %) of each parameter of a method
    on a record.

    A parameter that is still outside at the end counts as settling after the record; `given` are
    parameters of the method, without its name.
    """
    instance = Native(
        observer_program(method), {f"{method}.{name}": value for name, value in given.items()}
    )
    inputs = {name: data[name] for name in ("u", "y_theta", "y_v")}
    out, _ = instance.run(RECORD_STEP, inputs, [f"{name}_hat" for name in names])
    # row k is the estimate for t_k
    error = 100.0 * (out[1:] / [TRUE_PARAMETERS[plant][name] for name in names] - 1.0)
    late = [np.flatnonzero(~(np.abs(column) <= 5.0)) for column in error.T]
    return error[-1], np.array(
        [(rows[-1] + 1) * RECORD_STEP if len(rows) else 0.0 for rows in late]
    )
