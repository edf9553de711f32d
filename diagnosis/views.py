"""Where a residual lives: the share of it that a function of one view of the motion predicts, block by block."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom
from scipy.stats import f as f_ratio

from bristle.diagnosis.fit import FREEDOM
from bristle.diagnosis.lens import Lens, Motion
from bristle.diagnosis.null import chance

Array = NDArray[np.float64]

FOLDS = 5
FLIPS, OFTEN = 999, 20  # random signs of segments, for the significance; draws as high after which a line is an ordinary one
LEAST_P = 1 / (1 + FLIPS)  # no smaller p is told
RIDGE = 1e-3  # of a view's own power
KNOTS = 9
TONES = (0.2, 45.0)  # Hz
PADDED = 4  # times the length: so fine is the grid of their frequencies
DISTANT = 3.0  # times what they last in all: records of one clock that lie over a longer time lie far apart
PERIODS = 60  # in a turn
POINTS = 5000  # of the path, for them
MEASURED = ("du",)  # views that hold the sensor's own noise in a closed loop, which a residual follows whatever is missing
ONCE = ("gravity", "eccentric_encoder")  # effects that repeat with each turn of a shaft
FAR = 5.0  # times the usual squared error, whitened
STRETCHES = "some stretches"
SAME, HARMONICS = 0.03, (2, 3, 4)  # periods that count as equal; multiples that are the form of a wave
PHASES, SELDOM = 20, 0.1  # of one period that is drawn; share of the usual number of samples below which none is
STOPS = 5  # widths of elastic elements that make up a hysteresis


@dataclass(frozen=True)
class Share:
    """What a view predicts: share of the squared error that falls, its p over all views and alone, and a label.

    `periods`: of the wave along the position that was found in it [1/turn]; `frequency`: of one in time [Hz].
    """

    view: str
    share: float
    p: float
    label: str = ""
    alone: float = 1.0
    periods: float | None = None
    frequency: float | None = None

    def period(self, turn: float) -> float | None:
        """Return the length of the wave that was found in it, in the unit of `turn` or in seconds; None without a wave."""
        if self.frequency is not None:
            return 1 / self.frequency
        return None if self.periods is None else turn / self.periods


def periods_of(name: str, values: Mapping[str, float], turn: float) -> float | None:
    """Return how often an effect repeats along a path `turn` [rad]; None if it does not."""
    periods = 1.0 if name in ONCE else values.get(f"{name}.periods")
    return None if periods is None else periods * turn / (2 * math.pi)


def is_same(periods: float | None, wave: float) -> bool:
    """True if something repeats as a wave does, both along the same path."""
    return periods is not None and abs(periods / wave - 1) < SAME


def is_form(periods: float | None, wave: float) -> bool:
    """True if something repeats as a small multiple of a wave: what the wave's own form may have beside a sine."""
    return periods is not None and any(is_same(periods, k * wave) for k in HARMONICS)


def hats(x: Array, knots: int = KNOTS) -> Array:
    """Return piecewise linear functions (n, knots) that add up to one, with knots where the data are."""
    at = np.unique(np.quantile(x, np.linspace(0.005, 0.995, knots)))
    if len(at) < 2:
        return np.ones((len(x), 1))
    inside = np.clip(x, at[0], at[-1])
    return np.column_stack([np.interp(inside, at, np.eye(len(at))[i]) for i in range(len(at))])


def stops(theta: Array, record: NDArray[np.int_], widths: Array) -> Array:
    """Return elastic elements (n, widths) that slide beyond a deflection, scaled to -1..1.

    Some thousand points of the path say enough; between them the elements stand still.

    Source: albender2005 (hysteresis as parallel elasto-slide elements).
    """
    skip = max(1, len(theta) // POINTS)
    some = theta[::skip]
    step = np.diff(some, prepend=some[0])
    step[np.flatnonzero(np.diff(record[::skip], prepend=record[0]))] = 0.0
    z, out = np.zeros(len(widths)), np.empty((len(some), len(widths)))
    for k, move in enumerate(step.tolist()):
        z = np.clip(z + move, -widths, widths)
        out[k] = z
    return np.repeat(out / widths, skip, axis=0)[: len(theta)]


def _waves(angle: Array, count: int) -> Array:
    return np.column_stack([wave(k * angle) for k in range(1, count + 1) for wave in (np.sin, np.cos)])


def bases(m: Motion, h: float, step: float) -> dict[str, Array]:
    """Return functions (n, k) of each view; `step` is the step of the sensor [rad]."""
    way = np.sign(m.v)[:, None]
    du = np.diff(m.u, prepend=m.u[0]) / h
    turn = np.column_stack([_waves(m.theta, 3), hats(m.theta)])
    widths = np.geomspace(4 * step, max(0.2 * np.ptp(m.theta), 40 * step), STOPS)
    span = np.column_stack([np.ones_like(m.u), m.u, np.abs(m.u)])
    return {
        "v": hats(m.v, 13),
        "u": hats(m.u, 13),
        "du": hats(du),
        "t": hats(m.time, 21),
        "theta": turn,
        "theta x direction": way * turn,
        "theta x u": m.u[:, None] * _waves(m.theta, 4),
        "t x direction": way * hats(m.time),
        "t x v": m.v[:, None] * hats(m.time),
        "u x direction": way * np.column_stack([span, hats(np.abs(m.u))]),
        "v x u": m.v[:, None] * np.column_stack([span, hats(np.abs(m.u), 5)]),
        "history": stops(m.theta, m.record, widths),
    }


def clocks(m: Motion) -> NDArray[np.int_]:
    """Return for each sample (n,) the number of its clock: 0 where the records share one, else that of its record.

    They do not if their times overlap, as those of files that each begin at 0 do; and how a tone goes on from one to the next
    nobody can tell where they lie far apart.
    """
    ends = sorted((float(t[0]), float(t[-1])) for t in (m.time[m.record == k] for k in range(int(m.record.max()) + 1)))
    apart = all(before[1] < after[0] for before, after in pairwise(ends))
    together = apart and ends[-1][1] - ends[0][0] < DISTANT * sum(last - first for first, last in ends)
    return np.zeros_like(m.record) if together else m.record


def spectrum(time: Array, clock: NDArray[np.int_], rough: Array) -> tuple[Array, Callable[[Array], Array]]:
    """Return frequencies (k,) [Hz] within `TONES` and what gives a torque's amplitudes (k,) there for signs (segments,).

    Parameters: time and rough torque (segments, bins), the clock of each segment. What has another clock has another phase:
    its power is added.
    """
    step = float(np.median(np.diff(time, axis=1)))
    which, row = np.unique(clock, return_inverse=True)
    first = np.array([time[row == k].min() for k in range(len(which))])
    place = np.rint((time - first[row, None]) / step).astype(int)
    length = int(place.max()) + 1
    frequency = np.fft.rfftfreq(PADDED * length, step)
    inside = (frequency >= TONES[0]) & (frequency <= TONES[1])

    def amplitudes(signs: Array) -> Array:
        even = np.zeros((len(which), length))
        even[row[:, None], place] = signs[:, None] * rough
        lines = np.abs(np.fft.rfft(even, PADDED * length, axis=1)[:, inside])
        return np.asarray(np.sqrt(np.square(lines).sum(axis=0)))

    return np.asarray(frequency[inside]), amplitudes


def _searched(lens: Lens, m: Motion, rough: Array) -> dict[str, tuple[Array, dict[str, Any]]]:
    """Return waves whose frequency is chosen by the residual: in time and along the position, and what a `Share` says of them."""
    middle = _middle(lens, rough)
    r, theta = rough.ravel(), m.theta[middle]
    clock = clocks(m)
    frequency, amplitudes = spectrum(m.time[middle].reshape(rough.shape), clock[middle].reshape(rough.shape)[:, 0], rough)
    tone = float(frequency[int(np.argmax(amplitudes(np.ones(len(rough)))))])
    own = [(clock == k)[:, None] * _waves(2 * np.pi * tone * m.time, 1) for k in np.unique(clock)]
    found: dict[str, tuple[Array, dict[str, Any]]] = {
        "tone": (np.column_stack(own), {"label": f"{tone:.3g} Hz", "frequency": tone})
    }
    turns = np.arange(1.0, PERIODS + 1)
    spin = np.exp(-1j * np.outer(turns, theta))
    one, way = np.ones_like(m.u), np.sign(m.v)
    for view, factors in (  # inertia that varies with position shows in both acceleration and speed squared
        ("theta", (one,)), ("theta x direction", (way,)), ("theta x u", (m.u,)), ("theta x a", (m.a, m.v**2)),
    ):  # fmt: skip
        power = np.sum([np.abs(spin @ (r * f[middle])) ** 2 / max(float(f @ f), 1e-300) for f in factors], axis=0)
        periods = float(turns[int(np.argmax(power))])
        waves = [f[:, None] * _waves(periods * m.theta, 1) for f in factors]
        found[view] = np.column_stack(waves), {"label": f"{periods:.3g} in a turn", "periods": periods}
    return found


def _middle(lens: Lens, rough: Array) -> NDArray[np.int_]:
    """Return the samples in the middle of each bin."""
    skip = lens.shape[1] // rough.shape[1]
    return np.arange(rough.size * skip).reshape(-1, skip)[:, skip // 2]


def shares(lens: Lens, m: Motion, h: float, step: float, rough: Array) -> list[Share]:
    """Return the views with their shares, the strongest first; stretches that stand out come last.

    A view's function is fitted on four fifths of the segments, and its p is how often the strongest of all views
    predicts the rest as well when segments get random signs. A tone must stand out as well among the highest lines of such
    spectra, for its frequency was chosen. The share is the power that a view has in the output.

    Source: liu1988 (wild bootstrap).
    """
    live = np.flatnonzero(lens.weight > 0)
    rng = np.random.default_rng(2)
    signs = np.concatenate([np.ones((1, len(live))), rng.choice([-1.0, 1.0], size=(FLIPS, len(live)))])
    told, tables = {}, bases(m, h, step)
    for view, (waves, facts) in _searched(lens, m, rough).items():
        tables[view] = np.column_stack([tables[view], waves]) if view in tables else waves
        told[view] = facts
    found = {view: _predicted(lens, basis, live, signs) for view, basis in tables.items()}
    strongest = np.max([draws[1:] for draws, _ in found.values()], axis=0)
    ps = {view: (chance(strongest, draws[0]), chance(draws[1:], draws[0])) for view, (draws, _) in found.items()}
    middle = _middle(lens, rough).reshape(rough.shape)[live]
    highest = line_p(m.time[middle], clocks(m)[middle[:, 0]], rough[live], signs)
    ps["tone"] = max(ps["tone"][0], highest), max(ps["tone"][1], highest)
    whole = float(np.square(lens.plain(lens.rest[live][:, :, None], live)).mean())
    result = []
    for view, (_, power) in found.items():
        result.append(
            Share(view, float(np.clip(power / whole, 0.0, 1.0)), ps[view][0], alone=ps[view][1], **told.get(view, {}))
        )
    return [*sorted(result, key=lambda each: -each.share), _outbreaks(lens, m, live)]


def line_p(time: Array, clock: NDArray[np.int_], rough: Array, signs: Array) -> float:
    """Return how often the highest line of a spectrum is as high when segments get random signs; the first are the true ones.

    Each draw finds its own frequency, as the data did. Where that is often it is known early, and the other draws are
    saved. Parameters as of `spectrum`; signs (draws, segments).

    Source: besag1991 (sequential Monte Carlo p-values).
    """
    _, amplitudes = spectrum(time, clock, rough)
    seen, higher = amplitudes(signs[0]).max(), 0
    for drawn, each in enumerate(signs[1:], 1):
        higher += bool(amplitudes(each).max() >= seen)
        if higher == OFTEN:
            return higher / drawn
    return (1 + higher) / len(signs)


def _outbreaks(lens: Lens, m: Motion, live: NDArray[np.int_]) -> Share:
    """Return the share of the squared error in stretches that are off by far more than the rest.

    Its p is the chance of so many of them, if the misfits of segments have the heavy tail that the fit allows them.
    """
    misfit = np.square(lens.rest[live]).mean(axis=1)
    far = misfit > FAR
    power = np.square(lens.plain(lens.rest[live][:, :, None], live)).mean(axis=(1, 2))
    p = float(binom.sf(np.count_nonzero(far) - 1, len(live), f_ratio.sf(FAR, lens.rest.shape[1] - 2, FREEDOM)))
    worst = m.time.reshape(lens.shape)[live[int(np.argmax(misfit))], 0]
    label = f"{np.count_nonzero(far)} of {len(live)} stretches, the worst at {worst:.3g} s"
    return Share(STRETCHES, float(power[far].sum() / power.sum()), p, label)


def _predicted(lens: Lens, basis: Array, live: NDArray[np.int_], signs: Array) -> tuple[Array, float]:
    """Return for each set of signs by how much the weighted square of held-out segments falls, and a power.

    The power is the mean square [output squared] of what the view's function does to the output, less what chance adds.
    """
    columns = lens.free_of_model(lens.through(basis))[live]
    weight, rest = lens.weight[live], lens.rest[live]
    grams = np.matmul(columns.transpose(0, 2, 1), columns) * weight[:, None, None]
    slopes = np.matmul(columns.transpose(0, 2, 1), rest[:, :, None])[:, :, 0] * weight[:, None]
    total = grams.sum(axis=0)
    k = len(total)
    ridge = RIDGE * np.trace(total) / k * np.eye(k) + 1e-300 * np.eye(k)
    fold, gain = np.arange(len(live)) % FOLDS, np.zeros(len(signs))
    for f in range(FOLDS):
        test = fold == f
        held = grams[test].sum(axis=0)
        learned = np.linalg.solve(total - held + ridge, ((signs[:, ~test]) @ slopes[~test]).T).T
        seen = signs[:, test] @ slopes[test]
        gain += 2 * np.einsum("rk,rk->r", learned, seen) - np.einsum("rk,kl,rl->r", learned, held, learned, optimize=True)
    inverse = np.linalg.inv(total + ridge)
    outer = inverse @ slopes.sum(axis=0)
    chance = inverse @ (slopes.T @ slopes) @ inverse
    seen = lens.plain(columns, live).reshape(-1, k)
    gram = seen.T @ seen / len(seen)
    return gain, float(outer @ gram @ outer - np.sum(chance * gram))


def residual_map(view: str, m: Motion, before: Array, after: Array, bins: int = 40) -> dict[str, Any]:
    """Return the residual torques (samples,) averaged in bins of a view: fields of `result.View`, none where it has no axis."""
    found = _axis(view, m)
    if found is None:
        return {}
    x, groups, names = found
    low, high = np.quantile(x, [0.002, 0.998]).tolist()
    edges = np.linspace(low, high, bins + 1)
    if not edges[-1] > edges[0]:
        return {}
    place = np.digitize(x, edges) - 1
    lines = [[_averages(place, r, g & m.moving, bins) for g in groups] for r in (before, after)]
    return {
        "centres": (edges[1:] + edges[:-1]) / 2, "before": np.array(lines[0]), "after": np.array(lines[1]), "lines": names
    }  # fmt: skip


def wave_map(view: str, m: Motion, before: Lens, after: Lens, period: float | None) -> dict[str, Any]:
    """Return the torque that repeats with a period [unit of the axis], over one of them: fields of `result.View`.

    None where it does not repeat, or where the torque along the whole axis explains more. It is fitted through the lens, for
    averages of the most likely torque are lower than what acts: a wave that is passed in a moment hardly shows in them.
    """
    found = _axis(view, m)
    if found is None or period is None or np.ptp(found[0]) <= period:
        return {}
    x, groups, names = found
    knots = np.linspace(0.0, period, PHASES + 1)
    table = np.column_stack([np.interp(x, knots[:-1], row, period=period) for row in np.eye(PHASES)])
    waves, whole = (np.column_stack([g[:, None] * each for g in groups]) for each in (table, hats(x, PHASES)))
    curves, gain = before.regress(waves)
    if view == "tone" and len(groups) > 1:  # of clocks of their own the one in which it is largest
        largest = int(np.argmax(np.ptp(curves.reshape(-1, PHASES), axis=1)))
        groups, names = [groups[largest]], names[largest : largest + 1]
        waves = groups[0][:, None] * table
        curves = before.regress(waves)[0]
    elif gain < before.regress(whole)[1]:
        return {}
    seen = m.moving @ waves
    lines = [np.where(seen > SELDOM * seen.mean(), c, np.nan).reshape(-1, PHASES) for c in (curves, after.regress(waves)[0])]
    first, second = (np.column_stack([each, each[:, 0]]) for each in lines)
    return {"centres": knots, "before": first, "after": second, "lines": names, "period": period}


def _axis(view: str, m: Motion) -> tuple[Array, list[NDArray[np.bool_]], tuple[str, ...]] | None:
    """Return along what a view is drawn, the samples of each line, and the names of the lines."""
    if view == "tone":
        clock = clocks(m)
        numbers = np.unique(clock)
        names = tuple(f"record {k + 1}" for k in numbers) if len(numbers) > 1 else ()
        return m.time, [clock == k for k in numbers], names
    along, _, side = view.partition(" x ")
    x = {"v": m.v, "a": m.a, "u": m.u, "t": m.time, "theta": m.theta}.get(along)
    if x is None:  # travel, rates and single stretches have no axis of their own here
        return None
    way = {"direction": m.v, "v": m.v, "u": m.u, "a": m.a}.get(side)
    if way is None:
        return x, [np.ones(len(x), dtype=bool)], ()
    return x, [way > 0, way < 0], ("forward", "backward") if side in ("direction", "v") else (f"{side} > 0", f"{side} < 0")


def _averages(place: NDArray[np.int_], values: Array, mask: NDArray[np.bool_], bins: int) -> Array:
    inside = mask & (place >= 0) & (place < bins)
    count = np.bincount(place[inside], minlength=bins)
    total = np.bincount(place[inside], weights=values[inside], minlength=bins)
    return np.where(count >= 5, total / np.maximum(count, 1), np.nan)
