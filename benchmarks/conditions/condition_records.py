"""Records of a servo under many conditions, made by servo.c; nothing of the package's own plants,
sensors or controller is used.
"""

from __future__ import annotations

import ctypes
import json
import math
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from bristle.common.cache import cache_folder, cached, digest
from bristle.model.compiler import FLAGS, SUFFIX, compile_shared, compiler_identity

Array = NDArray[np.float64]

SOURCE = Path(__file__).with_name("servo.c").read_text(encoding="utf-8")
DEGREE = math.pi / 180
SECONDS = 60.0
# s; at the largest relaxation rate c |v| of the conditions, 15000 1/s, a third of the stability
# limit
LONGEST_SUBSTEP = 2.5e-5
CONTROLLER_GAINS = (4.0, 20.0)  # V s/rad and V/rad, for b = 6.5 rad/(s2.V)
STANDARD_B = 6.5  # rad/(s2.V)
CLIPPED_AT = 2.5  # of the rms of a noise reference
S = {"alpha2": 2.0, "b": STANDARD_B, "tau": 0.0, "s0": 600.0, "s1": 800.0, "s2": 300.0, "c": 150.0}
R = S | {"s0": 800.0, "s1": 1067.0, "s2": 400.0, "c": 200.0}
DAMPED = S | {"tau": 0.02}
LUGRE = {
    "law": 1.0,
    "alpha2": 2.0,
    "b": STANDARD_B,
    "tau": 0.0,
    "s0": 800.0,
    "a0": 0.005,
    "a1": 0.004,
    "v0": 25 * DEGREE,
}
PLANTS: dict[str, dict[str, float]] = {"S": S, "R": R, "damped": DAMPED, "LuGre": LUGRE}
WIDTHS = ("w1", "m2", "w2")  # of the basis functions, and the place of the second
SHAPES = {
    "law": 0.0,
    "w1": 10 * DEGREE,
    "m2": 20 * DEGREE,
    "w2": 20 * DEGREE,
    "a0": 1.0,
    "a1": 0.0,
    "v0": 1.0,
}


@dataclass(frozen=True)
class Condition:
    """What differs from the standard record: noise of 5 rad/s and 120 deg/s rms, 1 ms, 40000
    counts, nothing else acting.
    """

    name: str
    group: str
    plants: tuple[str, ...] = ("S", "R")
    factors: Mapping[str, float] = field(default_factory=dict)  # of parameters of the plant
    reference: str = "noise"
    corner: float = 5.0  # rad/s
    # low-pass sections of a noise reference, by turns over the seeds
    sections: tuple[int, ...] = (1, 2)
    rms: float = 120.0  # deg/s
    period: float = 1e-3  # s
    counts: float = 40000.0
    delay: float = 0.0  # samples
    input_noise: float = 0.0  # over the rms of the input
    load: str = "none"
    load_share: float = 0.0  # of Coulomb friction
    load_scale: float = 1.0  # normal load in the second half
    seconds: float = SECONDS

    @property
    def constant(self) -> bool:
        """Whether the servo and its load stay as they are throughout."""
        return self.load_scale == 1.0 and self.load != "step"


@dataclass(frozen=True)
class Record:
    """A record as an observer gets it (`y_theta` from the encoder, `y_v` the true velocity, as
    late), and the truth at the end.
    """

    u: Array
    y_theta: Array
    y_v: Array
    true: dict[str, float]


@cache
def _library() -> ctypes.CDLL:
    name = "conditions-" + digest(SOURCE, " ".join(FLAGS), compiler_identity())[:32] + SUFFIX
    return ctypes.CDLL(str(cached(name, lambda path: compile_shared({"servo.c": SOURCE}, path))))


def _servo(values: Mapping[str, float]) -> ctypes.Structure:
    body = re.search(r"typedef struct \{([^}]*)\} Servo;", SOURCE)
    assert body is not None
    bare = re.sub(r"/\*.*?\*/", "", body[1])
    names = [
        name.strip() for line in re.findall(r"double ([^;]*);", bare) for name in line.split(",")
    ]
    kind = type(
        "Servo", (ctypes.Structure,), {"_fields_": [(name, ctypes.c_double) for name in names]}
    )
    return kind(**values)  # type: ignore[no-any-return]  # a class made of the fields in servo.c


def _pointer(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def _noise(
    random: np.random.Generator, n: int, period: float, corner: float, sections: int
) -> Array:
    """Return stationary low-pass noise of unit standard deviation."""
    warm = round(5 / corner / period)
    x, kept = random.standard_normal(n + warm), math.exp(-corner * period)
    for _ in range(sections):
        x = lfilter([1 - kept], [1, -kept], x)
    x = x[warm:]
    return np.asarray(x / np.std(x))


def _steps(random: np.random.Generator, n: int, period: float) -> Array:
    out, k = np.zeros(n), 0
    while k < n:
        length = round(random.uniform(0.5, 2.5) / period)
        out[k : k + length] = random.uniform(-math.sqrt(3), math.sqrt(3))
        k += length
    return out


def _multisine(random: np.random.Generator, t: Array) -> Array:
    return np.asarray(
        sum(
            math.sqrt(0.2) * np.sin(2 * math.pi * f * t + random.uniform(0, 2 * math.pi))
            for f in np.geomspace(0.05, 5, 10)
        )
    )


def _chirp(random: np.random.Generator, t: Array) -> Array:
    low, high, whole = 0.05, 5.0, t[-1]
    rate = math.log(high / low) / whole
    return np.asarray(
        math.sqrt(2)
        * np.sin(2 * math.pi * low * (np.exp(rate * t) - 1) / rate + random.uniform(0, 2 * math.pi))
    )


def _reference(c: Condition, random: np.random.Generator, seed: int, t: Array) -> Array:
    n, sections = len(t), c.sections[seed % len(c.sections)]

    def noise() -> Array:
        return np.clip(_noise(random, n, c.period, c.corner, sections), -CLIPPED_AT, CLIPPED_AT)

    shapes: dict[str, Callable[[], Array]] = {
        "noise": noise,
        "multisine": lambda: _multisine(random, t),
        "steps": lambda: _steps(random, n, c.period),
        "chirp": lambda: _chirp(random, t),
        "sine": lambda: math.sqrt(2) * np.sin(2 * math.pi * t + random.uniform(0, 2 * math.pi)),
        "one direction": lambda: np.clip(1 + 0.4 * noise(), 0.2, None),
        "rests": lambda: np.where((t % 15.0) < 9.0, 0.0, noise()),
        "idle": lambda: np.where((t > 20.0) & (t < t[-1] - 20.0), 0.0, noise()),
    }
    return np.ascontiguousarray(c.rms * DEGREE * shapes[c.reference](), dtype=float)


def _load(c: Condition, random: np.random.Generator, t: Array, level: float) -> Array:
    size = c.load_share * level * (1 if random.uniform() < 0.5 else -1)
    shapes: dict[str, Callable[[], Array]] = {
        "none": lambda: np.zeros(len(t)),
        "constant": lambda: np.full(len(t), size),
        "step": lambda: np.where(t < t[-1] / 2, 0.0, size),
        "sine": lambda: size * np.sin(2 * math.pi * 0.5 * t + random.uniform(0, 2 * math.pi)),
        "coloured": lambda: size * _noise(random, len(t), c.period, 2 * math.pi, 1),
    }
    return np.ascontiguousarray(shapes[c.load](), dtype=float)


def _true(values: Mapping[str, float], scale: float) -> dict[str, float]:
    """Return the normalised parameters; of the modified model's own ones, only where this is the
    law.
    """
    friction = values["s0"] / values["c"] if values["law"] == 0 else values["s0"] * values["a0"]
    out = {"alpha2": values["alpha2"], "b": values["b"], "Fc": friction * scale}
    widths = [values[name] / SHAPES[name] for name in WIDTHS]
    if values["law"] == 0 and np.allclose(widths, widths[0]):
        out |= (
            {f"sigma{i}": values[f"s{i}"] * scale for i in range(3)}
            | {"c": values["c"]}
            | ({"tau": values["tau"]} if values["tau"] else {})
        )
    return out


def record(condition: Condition, plant: str, seed: int) -> Record:
    """Return a record; simulated once, then taken from the cache."""
    c = condition
    values = SHAPES | PLANTS[plant]
    values = values | {
        name: values[name] * factor for name, factor in c.factors.items() if name != "J"
    }
    if "J" in c.factors:
        values |= {
            name: values[name] / c.factors["J"]
            for name in ("alpha2", "b", "s0", "s1", "s2")
            if name in values
        }
    gain = STANDARD_B / values["b"]
    values |= {
        "kp": CONTROLLER_GAINS[0] * gain,
        "ki": CONTROLLER_GAINS[1] * gain,
        "limit": 24.0 * abs(gain),
    }
    random = np.random.default_rng([seed, int(digest(plant + c.reference)[:8], 16)])
    t: Array = c.period * np.arange(round(c.seconds / c.period), dtype=np.float64)
    reference = _reference(c, random, seed, t)
    load = _load(c, random, t, _true(values, 1.0)["Fc"])
    scale = np.where(t < c.seconds / 2, 1.0, c.load_scale)
    noise = np.zeros(len(t))
    u, theta, v = _simulated(values, c.period, reference, load, noise, scale)
    if c.input_noise:
        noise = c.input_noise * float(np.std(u)) * random.standard_normal(len(t))
        u, theta, v = _simulated(values, c.period, reference, load, noise, scale)
    step = 2 * math.pi / c.counts
    late_theta, late_v = (np.interp(t - c.delay * c.period, t, x) for x in (theta, v))
    true = _true(values, c.load_scale) | {
        "load": float(load[-1]) if c.load in ("none", "constant", "step") else math.nan,
        "delay": c.delay,
    }
    return Record(u, step * np.floor(late_theta / step), late_v, true)


def _simulated(
    values: Mapping[str, float],
    period: float,
    reference: Array,
    load: Array,
    noise: Array,
    scale: Array,
) -> tuple[Array, Array, Array]:
    key = digest(
        SOURCE,
        json.dumps(sorted(values.items())),
        repr(period),
        *(x.tobytes() for x in (reference, load, noise, scale)),
    )
    path = cache_folder() / "conditions" / f"{key[:40]}.npy"
    if path.exists():
        out = np.load(path)
    else:
        out = np.empty((3, len(reference)))
        parts = max(1, math.ceil(period / LONGEST_SUBSTEP))
        _library().servo_run(
            ctypes.byref(_servo(values)),
            ctypes.c_long(len(reference)),
            ctypes.c_long(parts),
            ctypes.c_double(period),
            *(
                _pointer(np.ascontiguousarray(x, dtype=float))
                for x in (reference, load, noise, scale)
            ),
            *(_pointer(x) for x in out),
        )
        path.parent.mkdir(exist_ok=True)
        draft = path.with_suffix(f".{os.getpid()}.part")
        with draft.open("wb") as file:
            np.save(file, out)
        draft.replace(path)
    return out[0].copy(), out[1].copy(), out[2].copy()


# what parameters of the plant are multiplied by
FACTORS = {
    "c": (0.05, 5.0, 20.0),
    "alpha2": (0.05, 20.0),
    "friction": (0.05, 20.0),
    "b": (0.2, 50.0, -1.0),
    "J": (0.1, 10.0),
}
SCALED_WITH = {"friction": ("s0", "s1", "s2"), "c": ("c", "s0", "s1", "s2")}


def _conditions() -> dict[str, Condition]:
    found: list[Condition] = [Condition("standard", "reference")]

    def add(group: str, name: str, **changes: object) -> None:
        # of the fields of a condition, each of its own type
        found.append(replace(Condition(name, group), **changes))  # type: ignore[arg-type]

    for corner in (2.0, 10.0):
        add("reference", f"noise {corner:g} rad/s", corner=corner)
    for shape in ("multisine", "steps", "chirp", "sine", "one direction", "rests"):
        add("reference", shape, reference=shape)
    add("reference", "idle for 10 min", reference="idle", seconds=640.0)
    for rms in (5.0, 20.0, 600.0, 1200.0):
        add("reference", f"{rms:g} deg/s rms", rms=rms)
    for period in (5e-4, 2e-3, 5e-3):
        add("sensor", f"{1e3 * period:g} ms", period=period)
    for counts in (4096.0, 1e6):
        add("sensor", f"{counts:g} counts", counts=counts)
    for delay in (0.5, 1.0, 2.0):
        add("sensor", f"delay {delay:g} samples", delay=delay)
    for noise in (0.01, 0.05):
        add("input", f"input noise {100 * noise:g} %", input_noise=noise)
    for share in (0.005, 0.02, 0.1, 0.25, 0.5):
        add("torque", f"constant torque {100 * share:g} %", load="constant", load_share=share)
    add("torque", "torque step 25 %", load="step", load_share=0.25)
    add("torque", "torque sine 5 %", load="sine", load_share=0.05)
    add("torque", "coloured torque 5 %", load="coloured", load_share=0.05)
    for v0 in (5.0, 60.0, 120.0):
        add("plant", f"LuGre v0 {v0:g} deg/s", plants=("LuGre",), factors={"v0": v0 / 25.0})
    for name, factors in FACTORS.items():
        for factor in factors:
            scaled = SCALED_WITH.get(name, (name,))
            add("plant", f"{name} x{factor:g}", factors=dict.fromkeys(scaled, factor))
    for factor in (0.3, 0.6, 2.0, 4.0):
        add("plant", f"basis width x{factor:g}", factors=dict.fromkeys(WIDTHS, factor))
    add("plant", "tau 0.02 s", plants=("damped",))
    add("change", "load doubled", load_scale=2.0)
    return {each.name: each for each in found}


CONDITIONS = _conditions()
