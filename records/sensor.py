"""What output and input show of sensor and drive: resolution, spikes, wraps, a frozen reading, a
limited input.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import fft, ndimage, stats

from bristle.common.table import Array
from bristle.records.layout import SETPOINT, Layout
from bristle.records.record import Raw, Record
from bristle.records.resolution import common_step

# share of all samples at the largest or smallest input above which that value may be a limit
LIMITED_SHARE = 0.01
LIMITED_SAMPLES = 10  # samples: least number of these
# a limit is held by this many times as many samples as each of the three values next to it
CREST_RATIO = 4.0
SWITCHED_LEVELS = 20  # values: an input of fewer distinct values is switched, not limited
MOTIONLESS_STEPS = 3.001  # steps of the resolution: an output with a smaller range does not move
PRINTED_DIGITS = 1e-7  # of the range: a finer step is that of the printed digits, not of the sensor
FINE_STEP = 1e-5  # of the range, or of a turn: a finer step of the sensor needs no mention
STEP_AGREEMENT = (0.8, 1.25)  # range of measured over declared resolution in which they agree
WHOLE_COUNTS = 0.05  # counts: deviation from a whole number of counts a turn that is ignored
NOISE_P = 0.01  # chance that pure noise passes for motion, in each test
MEDIAN_SAMPLES = 9  # samples of the running median in which a motion that lasts leaves the noise
MEDIAN_DEVIATIONS = 8.0  # standard deviations: largest range of that running median of pure noise
# differences between samples before and after a spike that it is compared with
SPIKE_NEIGHBOURS = 6
SPIKE_RATIO = 8.0  # a spike steps this many times farther than its neighbours
SPIKE_RETURN = 0.25  # of the step: largest difference between a spike's steps away and back
SPIKE_STEPS = 6.0  # steps of the resolution: a smaller jump is no spike
COUNTER_BITS = (8, 32)  # bits of a counter that wraps
FROZEN_SAMPLES = 5  # samples: least number of equal readings in a row that are looked at
# s: an output at rest for as long while the input covers most of its range is reported
FROZEN_DURATION = 0.2
FROZEN_INPUT_SHARE = 0.8  # of the input's range: what it must cover meanwhile


def compare_resolution(layout: Layout, raw: Raw) -> float | None:
    """Return the step in which the output was recorded, None if it shows none; report where the
    declared one differs.
    """
    found = common_step(raw.y)
    if found is not None and found < PRINTED_DIGITS * np.ptp(raw.y):
        found = None
    if layout.resolution is None:
        return found
    declared = f"[output] resolution is {layout.resolution:.4g} {layout.output_unit}"
    if found is None:
        raw.say(
            f"{declared}, but the output shows no such steps: was it filtered, interpolated or"
            " written with too few digits?"
        )
    elif not STEP_AGREEMENT[0] < found / layout.resolution < STEP_AGREEMENT[1]:
        seen = f"the output comes in steps of {found:.4g} {layout.output_unit}"
        raw.say(f"{declared}, but {seen}; correct the resolution or the unit")
    return found


def report_steps(layout: Layout, records: list[Record]) -> list[Record]:
    """Report once, with the first record, in what steps the output was recorded if the layout does
    not declare it.
    """
    step = max(record.resolution or 0.0 for record in records)
    span = max(float(np.ptp(record.y)) for record in records)
    turns = layout.output_kind == "position" and not layout.linear
    if layout.resolution is not None or step <= FINE_STEP * (
        min(span, 2.0 * np.pi) if turns else span
    ):
        return records
    counts = 2.0 * np.pi / step
    whole = turns and abs(counts - round(counts)) < WHOLE_COUNTS
    line = f"the output moves in steps of {step:.3g} {layout.output_unit}" + (
        f" ({counts:.0f} a turn)" if whole else ""
    )
    return [replace(records[0], findings=(*records[0].findings, line)), *records[1:]]


def must_move(layout: Layout, raw: Raw, resolution: float | None) -> None:
    """Refuse an output whose range is a few steps of its resolution, or that is noise only."""
    span, unit = float(np.ptp(raw.y)), layout.output_unit
    if span <= MOTIONLESS_STEPS * (resolution or 0.0) or span <= 1e-12 * float(
        np.max(np.abs(raw.y))
    ):
        seen = f"the output stays within {span:.3g} {unit}" + (
            f", its resolution is {resolution:.3g} {unit}" if resolution else ""
        )
    elif not _leaves_noise(raw.y) and _only_noise(raw.u, raw.y):
        seen = f"all that the output shows is noise of {np.std(raw.y):.3g} {unit} rms"
    else:
        return
    raise raw.error(f"nothing moves: {seen}; check [output] column, and give a record with motion")


def _leaves_noise(y: Array) -> bool:
    """True if a running median of the output leaves the noise: a servo may nearly always rest."""
    # a coarse reading that hardly changes has a median deviation of 0
    step = float(np.min(np.diff(np.unique(y)), initial=np.inf))
    usual = max(float(stats.median_abs_deviation(y, scale="normal")), step)
    return bool(
        np.ptp(ndimage.median_filter(y, MEDIAN_SAMPLES, mode="nearest")) > MEDIAN_DEVIATIONS * usual
    )


def _only_noise(u: Array, y: Array) -> bool:
    """True if the output is white and not correlated with the input; the motion of a servo, which
    is a low-pass, is not white.

    Three tests, of which a motion far smaller than the noise fails one: the largest ordinate of the
    periodogram, the Kolmogorov-Smirnov test of the cumulative periodogram, and the largest
    correlation with the input over all lags. Ranks take the place of the values, because a lone
    outlier, whose spectrum is flat as well, would hide a motion.
    """
    u, y = stats.rankdata(u), stats.rankdata(y)
    n = len(y)
    spectrum = np.asarray(fft.rfft(y))
    spectrum[0] = 0.0  # the mean
    share = np.abs(spectrum[1 : (n + 1) // 2]) ** 2
    share /= np.sum(share)
    m = len(share)
    if (
        m * np.exp(-m * np.max(share)) < NOISE_P
        or stats.kstest(np.cumsum(share)[:-1], "uniform").pvalue < NOISE_P
    ):
        return False
    correlation = fft.irfft(spectrum * np.conj(fft.rfft(u)), n) / (n * np.std(u) * np.std(y) or 1.0)
    return bool(n * np.exp(-n * np.max(correlation**2) / 2) > NOISE_P)


def repaired(layout: Layout, raw: Raw, resolution: float | None) -> bool:
    """Repair and report what output and input show of sensor and drive; return whether the position
    was wrapped.
    """
    declared = resolution or layout.resolution
    _repair_spikes(raw, declared)
    wrapped = layout.output_kind == "position" and _unwrap(layout, raw, resolution)
    _report_frozen(raw, declared, layout.input_kind != SETPOINT)
    if layout.input_kind != SETPOINT:  # a goal rests
        _report_limits(raw)
    must_move(layout, raw, declared)
    return wrapped


def _repair_spikes(raw: Raw, resolution: float | None) -> None:
    """Replace up to three samples that jump away and back, as no servo does, by interpolation."""
    d, near = np.diff(raw.y), SPIKE_NEIGHBOURS
    size = np.abs(d)
    floor = max(SPIKE_STEPS * (resolution or 0.0), 1e-9 * float(np.max(np.abs(raw.y), initial=0.0)))
    spikes: list[int] = []
    y = raw.y.copy()
    # of the steps before step 6, 7, ...
    before = np.max(np.lib.stride_tricks.sliding_window_view(size, near), axis=1)[:-1]
    for k in (
        near + np.flatnonzero((size[near:] > floor) & (size[near:] > SPIKE_RATIO * before))
    ).tolist():
        for width in (1, 2, 3):
            back = k + width
            if back + near >= len(d) or (spikes and spikes[-1] > k - near):
                continue
            around = max(float(before[k - near]), float(np.max(size[back + 1 : back + near + 1])))
            inside = float(np.max(size[k + 1 : back], initial=0.0))
            returns = d[k] * d[back] < 0 and abs(d[k] + d[back]) < SPIKE_RETURN * size[k]
            if returns and size[back] > SPIKE_RATIO * around and inside < SPIKE_RETURN * size[k]:
                y[k + 1 : back + 1] = np.interp(
                    np.arange(k + 1, back + 1), [k, back + 1], raw.y[[k, back + 1]]
                )
                spikes.append(k + 1)
                break
    if spikes:
        worst = max(float(size[i - 1]) for i in spikes)
        where = f"first at sample {spikes[0]}, {raw.time[spikes[0]]:.6g} s; up to {worst:.3g}"
        raw.say(f"output jumps away and back at {len(spikes)} places ({where}); interpolated over")
        raw.y = y


def _unwrap(layout: Layout, raw: Raw, resolution: float | None) -> bool:
    """Unwrap a position that jumps by one amount and never leaves a range of that size."""
    d = np.diff(raw.y)
    span = float(np.ptp(raw.y))
    jumps = np.flatnonzero(np.abs(d) > 0.5 * span)
    if not len(jumps) or span == 0.0:
        return False
    rest = np.abs(np.delete(d, jumps))
    if np.max(rest, initial=0.0) > 0.25 * span:
        return False
    before, after = np.maximum(jumps - 1, 0), np.minimum(jumps + 1, len(d) - 1)
    sizes = np.abs(d[jumps] - 0.5 * (d[before] + d[after]))
    full = 2.0 * np.pi
    turn, sure = _turn(float(np.median(sizes)), layout.linear, resolution)
    fits = span <= 1.02 * turn and np.max(np.abs(sizes - turn)) <= 0.1 * turn
    # a single jump of another size may be a lost reading
    if len(jumps) < 2 and not (fits and sure):
        where = f"after {raw.time[jumps[0]]:.6g} s"
        raw.say(
            f"position jumps once by {turn:.4g} {layout.output_unit} {where}: a lost reading or a"
            " wrap? cut the record there"
        )
        return False
    if not fits:
        return False
    turns = np.where(np.abs(d) > 0.5 * span, -np.sign(d) * turn, 0.0)
    raw.y = raw.y + np.concatenate([[0.0], np.cumsum(turns)])
    first = f"{len(jumps)} times (first at {raw.time[jumps[0]]:.6g} s)"
    said = f"position wraps by {turn:.6g} {layout.output_unit} {first}; unwrapped"
    if not (layout.linear or sure):
        unit = layout.output.unit
        said += f", but a turn has {full:.4g} rad: check [output] unit ('{unit}') and scale"
    raw.say(said)
    return True


def _turn(jump: float, linear: bool, resolution: float | None) -> tuple[float, bool]:
    """Return the range that a jump is nearest to, and whether it is one that sensors have."""
    known = () if linear else ((2.0 * np.pi, True), (360.0, False), (1.0, False))
    for size, sure in known:
        if abs(jump - size) < 0.02 * size:
            return size, sure
    if (counter := _counter(jump, resolution)) is not None:
        return counter, True
    return resolution * round(jump / resolution) if resolution else jump, False


def _counter(turn: float, resolution: float | None) -> float | None:
    """Return the range of a counter with a whole number of bits, if a jump is of that size."""
    if not resolution or turn <= 0.0:
        return None
    bits = round(float(np.log2(turn / resolution)))
    size = float(resolution * 2.0**bits)
    return (
        size
        if min(COUNTER_BITS) <= bits <= max(COUNTER_BITS) and abs(turn - size) < 0.005 * size
        else None
    )


def _report_frozen(raw: Raw, resolution: float | None, driven: bool) -> None:
    """Report an output that freezes in motion and then catches up or, where the input is what
    drives it, stays at rest while that covers most of its range.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], np.diff(raw.y) == 0, [False]])))
    runs = edges.reshape(-1, 2)  # differences start..end-1 are zero
    d = np.abs(np.diff(raw.y))
    span = float(np.ptp(raw.u))
    caught, still = [], []
    for start, end in runs[runs[:, 1] - runs[:, 0] >= FROZEN_SAMPLES].tolist():
        if start >= 4 and end + 4 < len(d):
            speed = float(np.mean(d[start - 3 : start]))
            leap = float(d[end])
            after = float(np.max(d[end + 1 : end + 4]))
            if (
                speed > 3 * (resolution or 0.0)
                and leap > 0.5 * speed * (end - start)
                and leap > 2.5 * max(after, speed)
            ):
                caught.append((start, end))
                continue
        if (
            raw.time[end] - raw.time[start] >= FROZEN_DURATION
            and np.ptp(raw.u[start : end + 1]) > FROZEN_INPUT_SHARE * span > 0.0
        ):
            still.append((start, end))
    lost = "the output freezes in motion and then catches up: samples were lost; cut these parts"
    stuck = (
        "the output stands still while the input covers most of its range: a stop, a drive that is"
        " off, a stuck sensor?"
    )
    for runs_found, what in ((caught, lost), (still if driven else [], stuck)):
        if runs_found:
            start, end = runs_found[0]
            where = (
                f"{len(runs_found)} such parts, the first from {raw.time[start]:.6g} to"
                f" {raw.time[end]:.6g} s"
            )
            raw.say(f"{what} ({where})")


def _report_limits(raw: Raw) -> None:
    """Report an input that rests at its largest or smallest value."""
    values, counts = np.unique(raw.u, return_counts=True)
    if len(values) < SWITCHED_LEVELS:
        return
    largest = "largest", values[-1], counts[-1], np.max(counts[-4:-1])
    smallest = "smallest", values[0], counts[0], np.max(counts[1:4])
    for which, value, count, beside in (largest, smallest):
        # the crest of a signal in steps also dwells on its last value, but not so much longer than
        # on those before
        if (
            count > max(LIMITED_SHARE * len(raw.u), LIMITED_SAMPLES)
            and count > CREST_RATIO * beside
            and value != 0.0
        ):
            line = (
                f"input is at its {which} value {value:.6g} for {count / len(raw.u):.1%} of the"
                " time"
            )
            raw.say(
                f"{line}: a limit, and what is logged must be behind it; or a step of the command"
            )
