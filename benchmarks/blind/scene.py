"""What is around an effect: the servo without it, its controller, what it is asked to do, and the
noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from truth import PERIOD, Array, Record, base_friction, disturbance, run

SECONDS = 20.0
SAMPLES = round(SECONDS / PERIOD)
STARTS = (0.0, 25.0)  # s, session time of the two records
LIMIT = 1.2  # N.m, of the controller
NOISE = 0.03  # rms of the disturbance over Fc
RANGE = 12.0  # rad, either side, that a rich reference keeps to
TOP_ACCELERATION = 75.0  # rad/s2
Generator = np.random.Generator


@dataclass(frozen=True)
class Scene:
    """A servo without effect and all that acts on it, the same however strong the effect is
    made.
    """

    base: dict[str, float]  # J, a2, Fc
    friction: dict[str, float]  # formulation of the base friction
    loop: dict[str, float]
    references: tuple[Array, Array]
    noises: tuple[Array, Array]

    def plant(self, effects: dict[str, float] | None = None) -> dict[str, float]:
        """Return the fields of the plant, effects included."""
        return {**self.base, **self.friction, **(effects or {})}

    def records(self, effects: dict[str, float] | None = None) -> list[Record]:
        """Simulate both records."""
        parts = zip(STARTS, self.references, self.noises, strict=True)
        return [run(self.plant(effects), self.loop, start, r, w) for start, r, w in parts]


def log_uniform(rng: Generator, low: float, high: float) -> float:
    """Return a number whose logarithm is uniform."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def draw_scene(rng: Generator, style: str, noise: float = NOISE) -> Scene:
    """Draw a scene; style: rich, sine or slow."""
    base = {
        name: value * log_uniform(rng, 0.7, 1.3)
        for name, value in (("J", 0.01), ("a2", 0.02), ("Fc", 0.12))
    }
    first = rich(rng) if style == "rich" else sine(rng) if style == "sine" else slow(rng)
    second = rich(rng) if style == "rich" else sine(rng) if style == "sine" else slow(rng)
    noises = [disturbance(rng, SAMPLES + 1, noise * base["Fc"]) for _ in STARTS]
    return Scene(
        base,
        base_friction(base["J"], base["Fc"]),
        draw_loop(rng, base),
        (first, second),
        (noises[0], noises[1]),
    )


def draw_loop(rng: Generator, base: dict[str, float]) -> dict[str, float]:
    """Draw a PD or PID position controller of 2 to 4 Hz, with a feedforward that is up to 20 %
    off.
    """
    omega, zeta = rng.uniform(14, 26), rng.uniform(0.7, 1.1)
    guess = {name: value * log_uniform(rng, 0.8, 1.25) for name, value in base.items()}
    kp = guess["J"] * omega**2
    forward = 1.0 if rng.random() < 0.7 else 0.0
    return {
        "kp": kp,
        "ki": kp * rng.uniform(0.5, 3.0) if rng.random() < 0.5 else 0.0,
        "kd": 2 * zeta * guess["J"] * omega,
        "filter": rng.uniform(0.002, 0.004),
        "limit": LIMIT,
        "forward_J": guess["J"] * rng.uniform(0.7, 1.0),
        "forward_a2": guess["a2"] * forward,
        "forward_Fc": guess["Fc"] * forward * rng.uniform(0.5, 1.0),
    }


def move(distance: float, speed: float, acceleration: float) -> Array:
    """Return a smooth step (samples x position, velocity, acceleration) within limits of speed and
    acceleration.

    Source: flash1985 (minimum-jerk profile: top speed 15/8 D/T, top acceleration 5.7735 D/T^2).
    """
    size = abs(distance)
    time = max(1.875 * size / speed, math.sqrt(5.7735 * size / acceleration), 0.03)
    s = np.arange(1, max(2, round(time / PERIOD)) + 1) / max(2, round(time / PERIOD))
    x = distance * (10 * s**3 - 15 * s**4 + 6 * s**5)
    v = distance / time * (30 * s**2 - 60 * s**3 + 30 * s**4)
    a = distance / time**2 * (60 * s - 180 * s**2 + 120 * s**3)
    return np.column_stack([x, v, a])


def rest(seconds: float) -> Array:
    """Return a rest at zero."""
    return np.zeros((round(seconds / PERIOD), 3))


def glide(rng: Generator, speed: float, seconds: float) -> Array:
    """Return slow motion there and back at about constant speed, smooth at its ends."""
    n = round(seconds / PERIOD)
    wanted = np.zeros(n)
    at, direction = 0, 1.0 if rng.random() < 0.5 else -1.0
    while at < n:
        leg = round(rng.uniform(0.25, 0.9) * seconds / PERIOD) + 1
        wanted[at : at + leg] = direction * speed * rng.uniform(0.5, 1.5)
        at, direction = at + leg, -direction if rng.random() < 0.8 else direction
    window = np.hanning(82)[1:-1]
    padded = np.concatenate([np.zeros(80), wanted, np.zeros(160)])
    v = np.convolve(padded, window / window.sum(), mode="valid")
    return np.column_stack([np.cumsum(v) * PERIOD, v, np.gradient(v, PERIOD)])


def chirp(rng: Generator, seconds: float) -> Array:
    """Return a sweep from 1 to about 40 Hz, its acceleration about even above 3 Hz."""
    n = round(seconds / PERIOD)
    t = np.arange(1, n + 1) * PERIOD
    rate = math.log(rng.uniform(30, 45)) / seconds
    frequency = np.exp(rate * t)
    amplitude = np.minimum(
        rng.uniform(0.05, 0.2), rng.uniform(25, 50) / (2 * math.pi * frequency) ** 2
    )
    fade = np.minimum(1, np.minimum(t, seconds - t) / 0.3)
    x = (
        amplitude
        * fade**3
        * (10 - 15 * fade + 6 * fade**2)
        * np.sin(2 * math.pi * (frequency - 1) / rate)
    )
    v = np.gradient(x, PERIOD)
    return np.column_stack([x, v, np.gradient(v, PERIOD)])


def leg(rng: Generator, position: float, fast: bool) -> Array:
    """Return one smooth step within the range, of a second or two at most."""
    size = log_uniform(rng, 1.0, 8.0) if fast else log_uniform(rng, 0.01, 5.0)
    distance = size if rng.random() < 0.5 else -size
    if abs(position + distance) > RANGE:
        distance = -distance
    speed = rng.uniform(6, 10) if fast else max(log_uniform(rng, 0.5, 10), 1.6 * size)
    return move(distance, speed, log_uniform(rng, 30 if fast else 20, TOP_ACCELERATION))


def steps(rng: Generator, start: float, seconds: float, fast: bool) -> Array:
    """Return random smooth steps of all sizes with rests in between, from `start` within the range,
    of a given duration.
    """
    parts: list[Array] = []
    position, left = start, round(seconds / PERIOD)
    while left > 0:
        part = leg(rng, position, fast)
        if len(part) > left:  # no room for this one: a smaller one, or rest
            part = move(log_uniform(rng, 0.01, 0.3) * (1 if rng.random() < 0.5 else -1), 4.0, 40.0)
            part = part if len(part) <= left else rest(left * PERIOD)
        pause = rest(
            min(rng.uniform(0.1, 0.5), (left - len(part)) * PERIOD) if rng.random() < 0.4 else 0.0
        )
        parts += [part, pause]
        position += float(part[-1, 0])
        left -= len(part) + len(pause)
    return chain(parts, start)


def chain(parts: list[Array], start: float = 0.0) -> Array:
    """Put motions behind each other, each beginning where the last one ended."""
    done, at = [], start
    for part in parts:
        done.append(part + np.array([at, 0, 0]))
        at = float(done[-1][-1, 0]) if len(part) else at
    return np.concatenate(done)


def rich(rng: Generator) -> Array:
    """Return a record's reference: steps with rests, creep both ways, fast turns, a sweep, in any
    order.
    """
    kinds = ["steps", "creep", "fast", "chirp", "steps", "creep", "steps"]
    share = rng.uniform(0.8, 1.2, len(kinds)) * [3.2, 2.4, 4.0, 3.4, 3.2, 1.8, 2.0]
    share *= (SECONDS - 0.3) / share.sum()
    parts, position = [rest(0.3)], rng.uniform(-3, 3)
    start = position
    for i in rng.permutation(len(kinds)):
        kind, seconds = kinds[i], float(share[i])
        if kind == "creep":
            part = glide(rng, log_uniform(rng, 0.05, 0.8), seconds)
        elif kind == "chirp":
            part = chirp(rng, seconds)
        else:
            part = steps(rng, position, seconds, kind == "fast")
            part -= np.array([position, 0, 0])
        parts.append(part)
        position += float(part[-1, 0])
    missing = max(0, SAMPLES - sum(map(len, parts)))
    whole = chain([*parts, rest(missing * PERIOD)], start)
    return np.ascontiguousarray(whole[:SAMPLES])


def sine(rng: Generator) -> Array:
    """Return one sine of about 1 Hz."""
    t = np.arange(SAMPLES) * PERIOD
    omega, amplitude, centre = (
        2 * math.pi * rng.uniform(0.8, 1.2),
        rng.uniform(0.5, 1.0),
        rng.uniform(-3, 3),
    )
    fade = np.minimum(1, t / 0.7)
    x = centre + amplitude * fade**3 * (10 - 15 * fade + 6 * fade**2) * np.sin(omega * t)
    v = np.gradient(x, PERIOD)
    return np.column_stack([x, v, np.gradient(v, PERIOD)])


def slow(rng: Generator) -> Array:
    """Return slow motion within 0.3 rad of some place."""
    parts, position, total, centre = [rest(0.2)], 0.0, 0, rng.uniform(-3, 3)
    while total < SAMPLES:
        goal = rng.uniform(-0.28, 0.28)
        parts.append(move(goal - position, log_uniform(rng, 0.1, 0.6), 10.0))
        position = goal
        total += len(parts[-1])
        if rng.random() < 0.3:
            parts.append(rest(rng.uniform(0.1, 0.5)))
    return np.ascontiguousarray(chain(parts, centre)[:SAMPLES])


def with_friction(scene: Scene, friction: dict[str, float]) -> Scene:
    """Return the scene with another formulation of the base friction."""
    return replace(scene, friction=friction)
