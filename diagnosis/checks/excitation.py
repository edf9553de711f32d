"""What a set of records excites, in numbers, and what it therefore cannot show, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.signal import savgol_filter, welch

from bristle.common.table import Array
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
VELOCITY_CAVEAT = (
    "velocities only: position 0 is assumed at the beginning of each record; effects that depend on"
    " the position are found, with the right phase, only if all records begin at the same position"
)


def excitation(model: Model, records: Sequence[Record]) -> dict[str, Any]:
    """Return what the records excite: plain numbers, and ``{"value", "unit"}`` for what has a unit.

    ``narrow`` says why effects cannot be distinguished by their form, ``lacks`` what of `NEEDS` the
    records do not contain, and ``caveats`` what else they cannot show.
    """
    length = "m" if model.linear else "rad"
    positions, velocities = zip(*(_motion(model, r) for r in records), strict=True)
    v = np.concatenate(velocities)
    u = np.concatenate([r.u for r in records])
    top = float(np.quantile(np.abs(v), 0.999))
    rest = max(REST_SPEED * float(np.sqrt(np.mean(v**2))), _least_speed(model, records))
    still = np.abs(v) < rest
    reversals = sum(
        _reversals(each, rest, r.h) for each, r in zip(velocities, records, strict=True)
    )
    band = max(_spectrum(r.u, r.h)[0] for r in records)
    tone = min(_spectrum(each, r.h)[1] for each, r in zip(velocities, records, strict=True))
    span = max(float(np.ptp(x)) for x in positions)
    slow = float(np.mean((np.abs(v) < SLOW_SPEED * top) & ~still))
    seconds = sum(len(r) * r.h for r in records)
    numbers: dict[str, Any] = {
        "records": len(records),
        "samples": int(sum(len(r) for r in records)),
        "duration": _with("s", seconds),
        "sampling_period": _with("s", records[0].h),
        "input_range": {
            "lowest": float(np.min(u)),
            "highest": float(np.max(u)),
            "unit": model.input_unit,
        },
        "input_rms": _with(model.input_unit, float(np.sqrt(np.mean(u**2)))),
        "input_bandwidth": _with("Hz", band),
        "input_between_samples": "changing" if any(record.ahead for record in records) else "held",
        "speed_range": {
            "lowest": float(np.min(v)),
            "highest": float(np.max(v)),
            "unit": f"{length}/s",
        },
        "speed_dominant_tone_share": tone,
        "speed_rms": _with(f"{length}/s", float(np.sqrt(np.mean(v**2)))),
        "range_travelled": _with(length, span),
        "path_travelled": _with(length, float(sum(np.sum(np.abs(np.diff(x))) for x in positions))),
        "reversals": reversals,
        "rest_share": float(np.mean(still)),
        "slow_share": slow,
        "forward_share": float(np.mean(v > rest)),
        "backward_share": float(np.mean(v < -rest)),
    }
    if not model.linear:
        numbers["turns_travelled"] = span / (2 * np.pi)
    if model.input_kind in ("voltage", "current"):
        gain = model.parameters["b"]
        ends = sorted((gain * float(np.min(u)), gain * float(np.max(u))))
        numbers["torque_range"] = {
            "lowest": ends[0],
            "highest": ends[1],
            "unit": "N" if model.linear else "N.m",
        }
    numbers["inertia_share"] = max(
        _inertia_share(model, each, r) for each, r in zip(velocities, records, strict=True)
    )
    numbers["lacks"] = _lacks(numbers)
    numbers["narrow"] = _poor_excitation(model, records, numbers)
    numbers["caveats"] = [*_caveats(model, numbers), *_caveats_of_several(model, records)]
    return numbers


def _lacks(numbers: dict[str, Any]) -> list[str]:
    """Return what of `NEEDS` the records do not contain."""
    ahead, back, ends = numbers["forward_share"], numbers["backward_share"], numbers["input_range"]
    found = {
        BOTH_DIRECTIONS: min(ahead, back) < LEAST_SHARE_BACK * (ahead + back),
        REVERSALS: numbers["reversals"] < FEWEST_REVERSALS,
        BOTH_SIGNS: ends["lowest"] >= 0.0 or ends["highest"] <= 0.0,
    }
    return [need for need, missing in found.items() if missing]


def _poor_excitation(model: Model, records: Sequence[Record], numbers: dict[str, Any]) -> str:
    """Return why effects cannot be distinguished by their form on such records, or an empty text.

    Where the servo repeats one motion or hardly turns, speed, position and torque vary together:
    nearly any effect can replace another whose form differs a little from that of the catalogue.
    The same holds for short records.
    """
    if numbers["speed_dominant_tone_share"] > TONE_POWER:
        return (
            "the servo repeats one oscillation; record steps of several sizes, slow motion over"
            " several turns and a chirp"
        )
    period = numbers["sampling_period"]["value"]
    if period > COARSE_PERIOD and any(record.ahead for record in records):
        return (
            f"the input changes between samples that are {1e3 * period:.3g} ms apart; log it at the"
            " rate of the drive"
        )
    if numbers["duration"]["value"] < SHORT_DURATION:
        return f"the records last {numbers['duration']['value']:.3g} s in all; record 20 s or more"
    slow = numbers["inertia_share"] < LEAST_INERTIA
    if slow and not model.linear and numbers["range_travelled"]["value"] < SINE_RANGE:
        return (
            "the servo moves less than a quarter turn, and slowly; record fast and slow motion over"
            " several turns"
        )
    return ""


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


def _caveats_of_several(model: Model, records: Sequence[Record]) -> list[str]:
    """Return what several records cannot show because their relation in time or position is
    unknown.
    """
    found = []
    if overlap((float(r.time[0]), float(r.time[-1])) for r in records):
        found.append(
            "times of the records overlap: a clock of its own is assumed for each, so that a step"
            " in time is searched with each record as the last one, and a drift anew in each or"
            " from one to the next; log one time for all records if you can"
        )
    if model.output_kind == "velocity" and len(records) > 1:
        found.append(VELOCITY_CAVEAT)
    return found


def _caveats(model: Model, numbers: dict[str, Any]) -> list[str]:
    """Return which effects the numbers show to be indistinguishable or invisible."""
    found = []
    moving = numbers["forward_share"] + numbers["backward_share"]
    less = min(numbers["forward_share"], numbers["backward_share"])
    if less < 0.05 * moving:
        found.append(
            "nearly always in one direction: friction, bias and the mean of gravity cannot be"
            " distinguished"
        )
    elif numbers["rest_share"] < 0.02:
        found.append(
            "hardly ever at rest: bias and asymmetric friction cannot be distinguished; add a rest"
            " phase"
        )
    if numbers["rest_share"] > 0.5:
        found.append(
            f"at rest for {numbers['rest_share']:.0%} of the time: effects that need motion hardly"
            " show"
        )
    if numbers["reversals"] < 5:
        found.append(
            f"only {numbers['reversals']} reversals: presliding, backlash and dead zone hardly show"
        )
    if numbers["slow_share"] < 0.03:
        found.append("hardly ever slow: Stribeck friction and cogging hardly show; add slow motion")
    highest, rms = (
        max(abs(numbers["speed_range"][end]) for end in ("lowest", "highest")),
        numbers["speed_rms"]["value"],
    )
    if rms > 0.8 * highest:
        found.append(
            "speed hardly varies: viscous friction, drag and Coulomb friction cannot be"
            " distinguished"
        )
    if not model.linear and numbers["range_travelled"]["value"] < HALF_TURN:
        found.append(
            "less than half a turn: gravity is similar to a spring or a bias, an eccentric encoder"
            " to a gain"
        )
    if not model.linear and numbers["range_travelled"]["value"] < 4 * np.pi:
        found.append("less than two turns: effects that repeat every turn may be taken for others")
    band = numbers["input_bandwidth"]["value"]
    if band > 0.0:
        alike = 1.0 / (5 * 2 * np.pi * band)  # s: their phases differ by a few thousandths
        if alike > numbers["sampling_period"]["value"]:
            found.append(
                f"input bandwidth {band:.2g} Hz: a delay and an electrical pole below {alike:.2g} s"
                " are indistinguishable"
            )
        if band < 5.0:
            found.append("input stays below 5 Hz: compliance does not show; add a chirp")
    if numbers["speed_dominant_tone_share"] > TONE_POWER:
        found.append("one dominant frequency: effects of speed, position and time vary together")
    if BOTH_SIGNS in numbers["lacks"]:
        found.append("input of one sign: a gain that differs between the signs does not show")
    if numbers["duration"]["value"] < 20.0:
        found.append(f"{numbers['duration']['value']:.3g} s in all: slow drift does not show")
    return found
