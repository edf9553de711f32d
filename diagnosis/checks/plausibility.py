"""Plausibility before anything is named: sign, unit factors, swapped columns, order of differentiation.

A regression of the torque on acceleration, velocity and direction, all low-passed alike, gives J, a2 and Fc without a
simulation. It is biased by whatever effect is missing; it is good enough to see a wrong sign or a factor of ten.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import nnls
from scipy.signal import butter, sosfiltfilt

from bristle.common.table import Array
from bristle.diagnosis.modelfile import Model
from bristle.records.record import Record

LOWPASS_CUTOFF = 25.0  # Hz of the low-pass, where the sampling allows it: servo motion is slower, quantisation is not
CUTOFF_SAMPLES = 8.0  # samples in a period of the cutoff at least
ACCELERATION_NOISE = 0.2  # largest share of the acceleration that may come from the resolution; else the cutoff is lowered
JACKKNIFE_BLOCKS = 20  # left out in turn for the standard errors, because neighbouring samples share their errors
LEAST_ROWS = 100  # rows of the regression; with fewer in motion nothing is said
FAR_FACTOR = 5.0  # a factor beyond this is no inaccuracy of a nominal value
CAUSE_TOLERANCE = (3.0, 8.0, 3.0)  # one cause moves J, a2, Fc by factors that agree within this; many effects look viscous
ABSURD_FACTOR = 30.0  # a factor beyond this needs no second estimate beside it
SURE_ERRORS = 5.0  # standard errors that make an estimate's sign sure
READING_RATIO = 3.0  # unexplained torque must drop by this factor for another reading of the columns to be proposed
CLEARER_RATIO = 1.5  # or by this one, if the other reading gives nearly the nominal inertia and the given one does not
NOMINAL_RATIO = 0.7  # or this, if it also gives nominal values that the given reading is far from
EXPLAINED_SHARE = 0.8  # and that reading must explain this share
BEYOND_BOUNDS = 1.5  # an estimate this factor beyond its bounds is worth a line
CAUSES = {  # log-factors that (J, a2, Fc) get from a column that is too large by e
    "input": (1.0, 1.0, 1.0),
    "output": (-1.0, -1.0, 0.0),
    "time": (2.0, 1.0, 0.0),
}
KNOWN_FACTORS = {  # what a factor may come from: the column is too large by it
    "input": {1e3: "a unit of milli", 1e6: "a unit of micro", 100.0: "N.cm", 9.80665: "kgf", 98.0665: "kgf.cm"},
    "output": {180 / math.pi: "deg", 0.5 / math.pi: "rev", 30 / math.pi: "rpm", 1e3: "a unit of milli", 1e6: "a unit of micro"},
    "time": {1e3: "ms", 1e6: "us", 1.0 / 60.0: "min"},
}


@dataclass(frozen=True)
class Plausibility:
    """What a regression says of the data.

    Attributes
    ----------
    proposals : tuple of str
        Mistakes that should be mended before anything is named: one line each, empty for plausible data.
    findings : tuple of str
        What is odd, but may be true.
    fit : dict
        ``value`` and ``se`` of J, a2 and Fc (SI), and ``explained``, the share of the torque that the regression explains.
    """

    proposals: tuple[str, ...]
    findings: tuple[str, ...]
    fit: dict[str, dict[str, float] | float] = field(default_factory=dict)


@dataclass(frozen=True)
class _Rows:
    """Rows of the regression: torque (n,), core terms (n, 3), free terms (n, k), block of each row (n,)."""

    torque: Array
    core: Array
    free: Array
    block: Array


def check(model: Model, records: Sequence[Record]) -> Plausibility:
    """Compare what a regression on the records gives with the model's nominal values.

    Parameters
    ----------
    model : Model
        Nominal values, bounds, and what the columns are.
    records : sequence of Record
        As `bristle.diagnosis.intake` gives them.
    """
    velocity = model.output_kind == "velocity"
    gain = model.parameters.get("b", 1.0)
    rows = _rows([(r.u * gain, r.y) for r in records], records, velocity)
    if rows is None:
        return Plausibility((), ("too little motion to check signs and units",))
    value, error, explained = _regress(rows)
    fit: dict[str, dict[str, float] | float] = {
        name: {"value": float(value[i]), "se": float(error[i])} for i, name in enumerate(("J", "a2", "Fc"))
    }
    fit["explained"] = explained
    nominal = _nominal(model)
    findings = _outside(model, nominal, value, error)
    single = tuple(_single(model, records, gain, nominal)) if len(records) > 1 else ()
    whole = _structure(model, records, rows, gain, nominal, value, error) or _factor(model, nominal, value, error)
    if whole and (not single or len(single) > len(records) / 2):
        return Plausibility((whole,), tuple(findings), fit)
    return Plausibility(single, tuple(findings), fit)  # a mistake in a few of them hides in what all give, or blurs it


def _single(model: Model, records: Sequence[Record], gain: float, nominal: Array) -> Iterator[str]:
    """Give proposals for records one by one; a factor must set a record apart from the others, too."""
    velocity = model.output_kind == "velocity"
    rows = [_rows([(r.u * gain, r.y)], [r], velocity) for r in records]
    found = [_regress(each) if each else None for each in rows]
    for k, (r, own, estimate) in enumerate(zip(records, rows, found, strict=True)):
        if own is None or estimate is None:
            continue
        value, error, _ = estimate
        line = _structure(model, [r], own, gain, nominal, value, error, alone=True)
        others = [np.where(v > 3.0 * e, v, np.nan) for v, e, _ in (each for each in found[:k] + found[k + 1 :] if each)]
        if line is None and all(_factor(model, other, value, error) for other in others if np.isfinite(other[0])):
            line = _factor(model, nominal, value, error, alone=True)
        if line:
            yield f"record {r.name}: {line}"


def _nominal(model: Model) -> Array:
    """Return nominal J, a2 and Coulomb level; NaN where the law has none or it is 0."""
    own = {name.removeprefix(f"{model.friction}."): x for name, x in model.parameters.items()}
    level = own.get("Fc", own["J"] * own["sigma0"] / own["c"] if "c" in own else 0.0)
    given = np.array([own["J"], own["a2"], level])
    return np.where(given > 0.0, given, np.nan)


# -- regression ----------------------------------------------------------------------------------------------------------
def _slope(x: Array, h: float) -> Array:
    """Return the derivative by central differences of fourth order; the two values at either end repeat their neighbour."""
    d = np.empty_like(x)
    d[2:-2] = (8.0 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) / (12.0 * h)
    d[:2], d[-2:] = d[2], d[-3]
    return d


def _motion(y: Array, h: float, step: float, velocity: bool) -> tuple[Array, Array, Array, Array, float]:
    """Return (low-pass, position, velocity, acceleration, noise of the velocity) of one record.

    The cutoff is lowered until the steps of the output no longer make much of the acceleration.
    """
    cutoff = min(LOWPASS_CUTOFF, 1.0 / (CUTOFF_SAMPLES * h))
    order = 1 if velocity else 2
    while True:
        low = butter(2, cutoff, fs=1.0 / h, output="sos")
        smooth = sosfiltfilt(low, y)
        v = smooth if velocity else _slope(smooth, h)
        a = _slope(v, h)
        # white noise of step^2/12 behind the low-pass and `order` differentiations
        density = step**2 / 12.0 * 2.0 * h
        shaken = [math.sqrt(density * (2 * math.pi) ** (2 * n) * cutoff ** (2 * n + 1) / (2 * n + 1)) for n in (order - 1, order)]
        if shaken[1] < ACCELERATION_NOISE * float(np.std(a)) or cutoff < 2.0:
            break
        cutoff *= 0.7
    theta = np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) * h / 2)]) if velocity else smooth
    return low, theta, v, a, shaken[0]


def _rows(columns: Sequence[tuple[Array, Array]], records: Sequence[Record], velocity: bool, steps: bool = True) -> _Rows | None:
    """Return the rows of all records while they move; `steps` tells whether the output has the records' resolution."""
    torque, core, free, block = [], [], [], []
    moved = [_motion(y, r.h, (r.resolution or 0.0) * steps, velocity) for (_, y), r in zip(columns, records, strict=True)]
    scale = float(np.sqrt(np.mean(np.concatenate([v**2 for _, _, v, _, _ in moved]))))
    for number, ((u, _), record, (low, theta, v, a, noise)) in enumerate(zip(columns, records, moved, strict=True)):
        rest = max(3.0 * noise, 0.02 * scale)
        sense = sosfiltfilt(low, np.where(np.abs(v) > rest, np.sign(v), 0.0))
        # around a reversal friction is not what the sign says; the filter's ends are not what they should be
        use = np.abs(sense) > 0.9
        use[:10] = use[-10:] = False
        chosen = np.flatnonzero(use)[:: max(1, round(0.01 / record.h))]
        torque.append(sosfiltfilt(low, u)[chosen])
        core.append(np.column_stack([sosfiltfilt(low, a), sosfiltfilt(low, v), sense])[chosen])
        free.append(np.column_stack([np.ones_like(v), theta, np.sin(theta), np.cos(theta)])[chosen])
        block.append(number * JACKKNIFE_BLOCKS + (chosen * JACKKNIFE_BLOCKS) // len(v))
    found = _Rows(np.concatenate(torque), np.concatenate(core), np.concatenate(free), np.concatenate(block))
    if len(found.torque) < LEAST_ROWS or float(np.ptp(found.torque)) == 0.0:
        return None
    size = np.max(np.abs(found.free), axis=0)
    return _Rows(found.torque, found.core, found.free / np.where(size > 0.0, size, 1.0), found.block)


def _regress(rows: _Rows) -> tuple[Array, Array, float]:
    """Return J, a2, Fc of either sign with standard errors, and the share of the torque that is explained."""
    size = np.maximum(np.sqrt(np.mean(rows.core**2, axis=0)), 1e-300)
    x = np.column_stack([rows.core / size, rows.free])
    ridge = 1e-9 * len(x) * np.eye(x.shape[1])  # theta, sin and cos are alike on a small range
    weight = np.ones(len(x))
    for _ in range(8):  # Huber's weights
        b = np.linalg.solve((x * weight[:, None]).T @ x + ridge, (x * weight[:, None]).T @ rows.torque)
        r = rows.torque - x @ b
        spread = 1.4826 * float(np.median(np.abs(r))) + 1e-12 * float(np.max(np.abs(rows.torque)))
        weight = np.minimum(1.0, 1.5 * spread / np.maximum(np.abs(r), 1e-300))
    blocks = np.unique(rows.block)
    parts = []
    for part in np.array_split(blocks, min(JACKKNIFE_BLOCKS, len(blocks))):
        keep = ~np.isin(rows.block, part)
        z, w = x[keep], weight[keep, None]
        parts.append(np.linalg.solve((z * w).T @ z + ridge, (z * w).T @ rows.torque[keep]))
    n = len(parts)
    error = np.sqrt((n - 1) / n * np.sum((np.array(parts) - np.mean(parts, axis=0)) ** 2, axis=0))
    return b[:3] / size, error[:3] / size, _share(r, rows.torque)


def _share(residual: Array, torque: Array) -> float:
    return 1.0 - float(np.sum(residual**2) / np.sum((torque - np.mean(torque)) ** 2))


def _explained(rows: _Rows | None, sign: float = 1.0) -> tuple[float, Array]:
    """Return (share explained, J, a2, Fc) with none of the three below 0; free terms are not explanations of motion."""
    if rows is None:
        return 0.0, np.zeros(3)
    size = np.maximum(np.sqrt(np.mean(rows.core**2, axis=0)), 1e-300)
    x = np.column_stack([rows.core / size, rows.free, -rows.free])
    b, _ = nnls(x, sign * rows.torque, maxiter=1000)
    return _share(sign * rows.torque - x @ b, sign * rows.torque), b[:3] / size


# -- what it says --------------------------------------------------------------------------------------------------------
def _structure(
    model: Model,
    records: Sequence[Record],
    rows: _Rows,
    gain: float,
    nominal: Array,
    value: Array,
    error: Array,
    alone: bool = False,
) -> str | None:
    """Return a proposal to flip the input, to swap the columns or to differentiate once more or less."""
    given, found = _explained(rows)
    off = _distance(found, nominal)
    plausible = value[0] > SURE_ERRORS * error[0] and 1.0 / FAR_FACTOR < value[0] / nominal[0] < FAR_FACTOR
    if plausible and given > 0.5:
        return None
    sure = value / np.maximum(error, 1e-300)
    flipped, _ = _explained(rows, -1.0)
    core = sure[[0, 2]] if np.isfinite(nominal[2]) else sure[[0]]
    if (
        np.min(core) < -SURE_ERRORS
        and np.max(core) < SURE_ERRORS
        and 1.0 - given > CLEARER_RATIO * (1.0 - flipped)
        and flipped > 0.2
    ):
        return (
            f"input sign looks flipped: with -u the model explains {flipped:.0%} of the torque, as given {given:.0%} "
            f"(J {value[0]:.3g}, Fc {value[2]:.3g}); "
            + _mend('turn it: scale = "-1" beside the unit in [input], or in [output] if that is what is turned', alone)
        )
    velocity = model.output_kind == "velocity"
    other = "position" if velocity else "velocity"
    readings = {
        "order": ([(r.u * gain, r.y) for r in records], not velocity),
        "swapped": ([(r.y, r.u) for r in records], velocity),
    }
    best: tuple[float, str] | None = None
    for reading, (columns, as_velocity) in readings.items():
        share, constants = _explained(_rows(columns, records, as_velocity, steps=reading == "order"))
        need = READING_RATIO
        if reading == "order" and 1.0 / FAR_FACTOR < constants[0] / nominal[0] < FAR_FACTOR:
            # the nominal values speak as well: a derivative taken for its integral turns J into a2 and leaves J next to 0
            need = NOMINAL_RATIO if off - _distance(constants, nominal) > math.log(ABSURD_FACTOR) else CLEARER_RATIO
        if share > EXPLAINED_SHARE and 1.0 - given > need * (1.0 - share) and constants[0] > 0.0:
            best = max(best or (0.0, ""), (share, reading))
    if best is None:
        return None
    seen = f"explains {best[0]:.0%} of the torque, as given {given:.0%}"
    if best[1] == "order":
        advice = _mend("correct [output] kind and unit", alone)
        return f"output looks like a {other}, not a {model.output_kind}: that {seen}; {advice}"
    names = f"'{model.input.column}' and '{model.output.column}'"
    advice = _mend("swap them in the model file", alone)
    return f"columns of input and output look swapped: {names} the other way round {seen}; {advice}"


def _distance(found: Array, nominal: Array) -> float:
    """Return how far estimates are from nominal values: sum of the log-ratios, each at most log 100."""
    ratio = np.clip(np.where(np.isfinite(nominal), found / nominal, 1.0), 0.01, 100.0)
    return float(np.sum(np.abs(np.log(ratio))))


def _mend(advice: str, alone: bool) -> str:
    """Return what to do; where one record stands `alone` with a mistake, the model file is right for the others."""
    return "mend this record, not the model file, which is right for the others" if alone else advice


def _factor(model: Model, nominal: Array, value: Array, error: Array, alone: bool = False) -> str | None:
    """Return a proposal if one factor on one column explains what all estimates are off by."""
    use = np.isfinite(nominal) & (value > 3.0 * error) & (value > 0.0)
    if not use[0]:
        return None
    off = np.log(np.where(use, value / np.where(use, nominal, 1.0), 1.0))
    names = [name for name, used in zip(("J", "a2", "Fc"), use, strict=True) if used]
    ratios = ", ".join(f"{name} x{ratio:.3g}" for name, ratio in zip(names, np.exp(off[use]), strict=True))
    if use.sum() < 2:
        if abs(off[0]) < math.log(ABSURD_FACTOR):
            return None
        return f"J comes out at x{math.exp(off[0]):.3g} of its nominal value; check the units of input, output and time"
    fits = []
    for cause, shape in CAUSES.items():
        d = np.array(shape)
        size = float(np.sum(d[use] * off[use]) / np.sum(d[use] ** 2))
        left = float(np.max((np.abs(off - d * size) / np.log(CAUSE_TOLERANCE))[use]))
        if left < 1.0:
            fits.append((left, cause, size))
    if not fits or abs(min(fits)[2]) < math.log(FAR_FACTOR):
        return None
    (_, cause, size), *others = sorted(fits)
    column = {"input": model.input, "output": model.output, "time": model.time}[cause]
    known = {f: text for f, text in KNOWN_FACTORS[cause].items() if not (model.linear and text in ("deg", "rev", "rpm"))}
    near, text = min((abs(size - s * math.log(f)), text) for f, text in known.items() for s in (1, -1))
    missing = "a scale" if cause == "time" else "a gear ratio"
    hint = f"has it to do with {text}, or is {missing} missing" if near < math.log(2.0) else f"is {missing} or a unit missing"
    other = "".join(f", or {_size(model, cause, size)}" for _, cause, size in others if abs(size) > math.log(CAUSE_TOLERANCE[0]))
    where = _mend(f"check the unit '{column.unit}' of column '{column.column}'", alone)
    if cause == "input" and "b" in model.parameters:
        hint += f", or b, the {'force' if model.linear else 'torque'} per {model.input_unit}, wrong in [parameters]"
    rotor = ""
    if cause == "output" and "a2" not in names:  # the inertia alone: whoever fitted the friction to such data has its unit in it
        rotor = f"; or is the {model.input_kind} that of a rotor ahead of a gear, and J that of the load behind it?"
    return f"{_size(model, cause, size)}{other}: against the nominal values {ratios}; {where}: {hint}?{rotor}"


def _size(model: Model, cause: str, size: float) -> str:
    what = {"input": model.input_kind, "output": model.output_kind, "time": "time"}[cause]
    return f"{what} looks a factor {math.exp(abs(size)):.3g} too {'large' if size > 0 else 'small'}"


def _outside(model: Model, nominal: Array, value: Array, error: Array) -> list[str]:
    """Return lines on estimates that lie well outside their bounds, and on the factor that they share."""
    names = ("J", "a2", next((n for n in model.parameters if n.endswith(".Fc")), ""))
    found = []
    for name, estimate, spread, usual in zip(names, value, error, nominal, strict=True):
        low, high = model.bounds.get(name, (-math.inf, math.inf))
        above = high > 0 and estimate - 3 * spread > BEYOND_BOUNDS * high
        below = low > 0 and 0.0 < estimate + 3 * spread < low / BEYOND_BOUNDS
        if (above or below) and math.isfinite(usual) and estimate > 0:
            found.append((name, estimate, low, high, estimate / usual))
    lines = [
        f"{name} comes out near {estimate:.3g} {model.unit(name)} before any effect is added, its bounds are "
        f"[{low:.3g}, {high:.3g}]; if that is true, widen them"
        for name, estimate, low, high, _ in found
    ]
    ratios = [ratio for *_, ratio in found]
    if len(found) > 1 and max(ratios) < BEYOND_BOUNDS * min(ratios):
        common = math.exp(sum(map(math.log, ratios)) / len(ratios))
        shown = f"{common:.3g}" if common > 1 else f"1/{1 / common:.3g}"
        lines.append(
            f"{' and '.join(name for name, *_ in found)} come out at {shown} of nominal alike: "
            "is the input a torque on the other side of a gear?"
        )
    return lines
