"""What a set of records excites, in numbers, and what it therefore cannot show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.signal import savgol_filter, welch

from bristle.common.table import Array
from bristle.diagnosis.answer import Excitation, Finding, Reason, finding
from bristle.diagnosis.modelfile import Model
from bristle.plant.effect import BOTH_DIRECTIONS, BOTH_SIGNS, REVERSALS
from bristle.records.clock import overlap
from bristle.records.record import Record

VELOCITY_SMOOTHING = 0.02  # s: half-width of the parabola that gives the velocity
REST_SPEED = 0.02  # of the rms speed: below it the servo is at rest
SLOW_SPEED = 0.1  # of the largest speed: below it the servo is slow
BANDWIDTH_POWER = 0.95  # of the input's power: share below its bandwidth
# of the speed's power: share of one tone from which on the motion is one oscillation
TONE_POWER = 0.9
# periods within a record from which on a tone is distinguished from slow motion
RESOLVED_PERIODS = 5
REVERSAL_DWELL = 0.05  # s: least motion in one direction before and after a reversal
# of the motion: less of it in one of the directions is too little to show what differs between them
LEAST_SHARE_BACK = 0.02
FEWEST_REVERSALS = 2  # fewer do not show what happens after a reversal
HALF_TURN = float(np.pi)  # rad
# s: sampling period above which an input that changes between samples is poorly known
COARSE_PERIOD = 0.02
SHORT_DURATION = 5.0  # s: duration of all records below which too few segments can be held out
# rad: range below which a sine of the position is nearly a straight line
SINE_RANGE = float(np.pi / 2)
# of the input: mean torque of the inertia below which a motion in so small a range shows little but
# friction
LEAST_INERTIA = 0.3
# of the motion: less of it in one of the directions hardly tells friction from what is constant
LITTLE_BACK = 0.05
LITTLE_REST, MUCH_REST = 0.02, 0.5  # of the time
LITTLE_SLOW = 0.03  # of the time
FEW_REVERSALS = 5  # fewer hardly show what acts at a reversal
EVEN_SPEED = 0.8  # of the largest speed: rms from which on the speed hardly varies
TWO_TURNS = 4 * float(np.pi)  # rad
FAST_INPUT = 5.0  # Hz: least bandwidth that shows a compliance
LONG_DURATION = 20.0  # s: least that shows a slow drift


def excitation(model: Model, records: Sequence[Record]) -> Excitation:
    """Return what the records excite: plain numbers, and ``{"value", "unit"}`` for what has a
    unit; and what they therefore cannot show.
    """
    numbers = _of_input(model, records) | _of_motion(model, records)
    lacks = _lacks(numbers)
    caveats = (*_caveats(model, numbers, lacks), *_caveats_of_several(model, records))
    return Excitation(numbers, tuple(lacks), _uniform(model, records, numbers), caveats)


def _of_input(model: Model, records: Sequence[Record]) -> dict[str, Any]:
    """Return how much there is of the records, and numbers of their input."""
    u = np.concatenate([r.u for r in records])
    unit, ends = model.input_unit, (float(np.min(u)), float(np.max(u)))
    band = max(_spectrum(r.u, r.h)[0] for r in records)
    return {
        "records": len(records),
        "samples": int(sum(len(r) for r in records)),
        "duration": _with("s", sum(len(r) * r.h for r in records)),
        "sampling_period": _with("s", records[0].h),
        "input_range": _range(unit, ends),
        "input_rms": _with(unit, float(np.sqrt(np.mean(u**2)))),
        "input_bandwidth": _with("Hz", band),
        "input_between_samples": "changing" if any(record.ahead for record in records) else "held",
    }


def _of_motion(model: Model, records: Sequence[Record]) -> dict[str, Any]:
    """Return numbers of the motion, and of the torque that it takes."""
    length = "m" if model.linear else "rad"
    positions, velocities = zip(*(_motion(model, r) for r in records), strict=True)
    moved = list(zip(velocities, records, strict=True))
    v = np.concatenate(velocities)
    rms = float(np.sqrt(np.mean(v**2)))
    # the top speed, of which slow is a share, and the speed below which the servo rests
    top, rest = (
        float(np.quantile(np.abs(v), 0.999)),
        max(REST_SPEED * rms, _least_speed(model, records)),
    )
    still = np.abs(v) < rest
    span = max(float(np.ptp(x)) for x in positions)
    # of the motion alone
    numbers: dict[str, Any] = {
        "speed_range": _range(f"{length}/s", (float(np.min(v)), float(np.max(v)))),
        "speed_dominant_tone_share": min(_spectrum(each, r.h)[1] for each, r in moved),
        "speed_rms": _with(f"{length}/s", rms),
        "range_travelled": _with(length, span),
        "path_travelled": _with(length, float(sum(np.sum(np.abs(np.diff(x))) for x in positions))),
        "reversals": sum(_reversals(each, rest, r.h) for each, r in moved),
        "rest_share": float(np.mean(still)),
        "slow_share": float(np.mean((np.abs(v) < SLOW_SPEED * top) & ~still)),
        "forward_share": float(np.mean(v > rest)),
        "backward_share": float(np.mean(v < -rest)),
    }
    # what depends on the axis and the input
    if not model.linear:
        numbers["turns_travelled"] = span / (2 * np.pi)
    if model.input_kind in ("voltage", "current"):
        u, gain = np.concatenate([r.u for r in records]), model.parameters["b"]
        low, high = sorted((gain * float(np.min(u)), gain * float(np.max(u))))
        numbers["torque_range"] = _range("N" if model.linear else "N.m", (low, high))
    numbers["inertia_share"] = max(_inertia_share(model, each, r) for each, r in moved)
    return numbers


def _lacks(numbers: dict[str, Any]) -> list[str]:
    """Return what effects need, of `NEEDS`, and the records do not contain."""
    ahead, back, ends = numbers["forward_share"], numbers["backward_share"], numbers["input_range"]
    missing_by_need = {
        BOTH_DIRECTIONS: min(ahead, back) < LEAST_SHARE_BACK * (ahead + back),
        REVERSALS: numbers["reversals"] < FEWEST_REVERSALS,
        BOTH_SIGNS: ends["lowest"] >= 0.0 or ends["highest"] <= 0.0,
    }
    return [need for need, missing in missing_by_need.items() if missing]


def _uniform(model: Model, records: Sequence[Record], numbers: dict[str, Any]) -> Finding | None:
    """Return why effects cannot be distinguished by their form on such records.

    Where the servo repeats one motion or hardly turns, speed, position and torque vary together:
    nearly any effect can replace another whose form differs a little from that of the catalogue.
    The same holds for short records.
    """
    if numbers["speed_dominant_tone_share"] > TONE_POWER:
        return finding(Reason.ONE_OSCILLATION)
    period = numbers["sampling_period"]["value"]
    if period > COARSE_PERIOD and any(record.ahead for record in records):
        return finding(Reason.COARSE_INPUT, period=period)
    if numbers["duration"]["value"] < SHORT_DURATION:
        return finding(Reason.SHORT_RECORDS, seconds=numbers["duration"]["value"])
    slow = numbers["inertia_share"] < LEAST_INERTIA
    if slow and not model.linear and numbers["range_travelled"]["value"] < SINE_RANGE:
        return finding(Reason.SMALL_RANGE)
    return None


def _inertia_share(model: Model, v: Array, record: Record) -> float:
    """Return the mean torque that the model's inertia takes in a record, over that of the input; 0
    without an input.
    """
    drive = float(np.mean(np.abs(model.parameters.get("b", 1.0) * record.u)))
    return (
        model.parameters["J"] * float(np.mean(np.abs(np.gradient(v, record.h)))) / drive
        if drive > 0
        else 0.0
    )


def _with(unit: str, value: float) -> dict[str, Any]:
    return {"value": float(value), "unit": unit}


def _range(unit: str, ends: tuple[float, float]) -> dict[str, Any]:
    return {"lowest": ends[0], "highest": ends[1], "unit": unit}


def _motion(model: Model, record: Record) -> tuple[Array, Array]:
    """Return position and smoothed velocity of a record, each of shape (n,)."""
    width = min(
        2 * max(2, round(VELOCITY_SMOOTHING / record.h)) + 1, 2 * ((len(record) - 1) // 2) - 1
    )
    if model.output_kind == "velocity":
        v = savgol_filter(record.y, width, 2)
        return np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) * record.h / 2)]), v
    return record.y, savgol_filter(record.y, width, 2, deriv=1, delta=record.h)


def _least_speed(model: Model, records: Sequence[Record]) -> float:
    """Return the speed of one step of the output within the smoothing."""
    step = max((r.resolution or 0.0 for r in records), default=0.0)
    return step if model.output_kind == "velocity" else step / (2 * VELOCITY_SMOOTHING)


def _reversals(v: Array, rest: float, h: float) -> int:
    """Count changes of direction, each after and before some dwell; rest is ignored."""
    sense = np.sign(v) * (np.abs(v) > rest)
    sense = sense[sense != 0]
    edges = np.flatnonzero(np.diff(sense)) + 1
    runs = np.diff([0, *edges.tolist(), len(sense)])
    directions = (
        sense[np.concatenate([[0], edges])][runs * h >= REVERSAL_DWELL] if len(sense) else sense
    )
    return int(np.sum(np.diff(directions) != 0))


def _spectrum(signal: Array, h: float) -> tuple[float, float]:
    """Return the frequency [Hz] below which most of a signal's power lies, and the share of its
    strongest tone.
    """
    x = signal - np.mean(signal)
    if not np.any(x):
        return 0.0, 0.0
    window = min(len(x), max(256, round(10.0 / h)))
    f, power = welch(x, fs=1.0 / h, nperseg=window, detrend="constant")
    total = float(np.sum(power))
    if total <= 0.0:
        return 0.0, 0.0
    band = float(f[np.searchsorted(np.cumsum(power), BANDWIDTH_POWER * total)])
    if np.argmax(power) < RESOLVED_PERIODS:
        power = welch(x, fs=1.0 / h, nperseg=len(x), detrend="constant")[1]
    peak = int(np.argmax(power))
    if peak < RESOLVED_PERIODS:
        return band, 0.0
    return band, float(np.sum(power[peak - 2 : peak + 3]) / np.sum(power))


def _caveats_of_several(model: Model, records: Sequence[Record]) -> list[Finding]:
    """Return what several records cannot show: their relation in time or place is unknown."""
    caveats = []
    if overlap((float(r.time[0]), float(r.time[-1])) for r in records):
        caveats.append(finding(Reason.OVERLAPPING_TIMES))
    if model.output_kind == "velocity" and len(records) > 1:
        caveats.append(finding(Reason.UNKNOWN_POSITIONS))
    return caveats


def _caveats(model: Model, numbers: dict[str, Any], lacks: Sequence[str]) -> list[Finding]:
    """Return which effects the numbers show to be indistinguishable or invisible."""
    rest, reversals = numbers["rest_share"], numbers["reversals"]
    ahead, back = numbers["forward_share"], numbers["backward_share"]
    one_way = min(ahead, back) < LITTLE_BACK * (ahead + back)
    highest = max(abs(numbers["speed_range"][end]) for end in ("lowest", "highest"))
    span = math.inf if model.linear else numbers["range_travelled"]["value"]
    seconds = numbers["duration"]["value"]
    tone = numbers["speed_dominant_tone_share"]
    shown = (
        # directions, rest and reversals
        (one_way, finding(Reason.ONE_DIRECTION)),
        (not one_way and rest < LITTLE_REST, finding(Reason.NO_REST)),
        (rest > MUCH_REST, finding(Reason.MOSTLY_REST, share=rest)),
        (reversals < FEW_REVERSALS, finding(Reason.FEW_REVERSALS, reversals=reversals)),
        # speeds and range
        (numbers["slow_share"] < LITTLE_SLOW, finding(Reason.NO_SLOW_MOTION)),
        (numbers["speed_rms"]["value"] > EVEN_SPEED * highest, finding(Reason.EVEN_SPEED)),
        (span < HALF_TURN, finding(Reason.LESS_THAN_HALF_A_TURN)),
        (span < TWO_TURNS, finding(Reason.LESS_THAN_TWO_TURNS)),
        # the input and the time
        *_caveats_of_bandwidth(numbers),
        (tone > TONE_POWER, finding(Reason.ONE_FREQUENCY)),
        (BOTH_SIGNS in lacks, finding(Reason.ONE_SIGN)),
        (seconds < LONG_DURATION, finding(Reason.NO_LONG_TIME, seconds=seconds)),
    )
    return [said for holds, said in shown if holds]


def _caveats_of_bandwidth(numbers: dict[str, Any]) -> list[tuple[bool, Finding]]:
    """Return what the bandwidth of the input hides, each with whether it does."""
    band = numbers["input_bandwidth"]["value"]
    if not band > 0.0:
        return []
    alike = 1.0 / (5 * 2 * np.pi * band)  # s: their phases differ by a few thousandths
    return [
        (
            alike > numbers["sampling_period"]["value"],
            finding(Reason.NARROW_BAND, bandwidth=band, alike=alike),
        ),
        (band < FAST_INPUT, finding(Reason.NO_FAST_INPUT)),
    ]
