"""Points of steps: their sizes and splits, times, and values that no model expects."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from bristle.fmus.conformance.instance import Ended, Options, Subject
from bristle.fmus.conformance.registry import Severity
from bristle.fmus.conformance.running import (
    STEPS,
    Array,
    NotApplicable,
    Run,
    ask,
    behaviour,
    refused,
    times,
    within,
)

MOST_STEPS = 2000  # of the default experiment that are run
LONG_STEPS = 10  # long steps, for step sizes and splits
# usual step sizes that a long step has, where it is halved twice, and where it is split unevenly
MULTIPLE, SPLIT = 4, 2
DIVERGENCE = 1.5  # by which differences may grow where steps become half as long
SMALL_SHARE = 1e-3  # differences, as share of an output's range, that are not judged
LARGE = 1e30  # an input that no model expects
LARGE_TIMES = 1000.0  # default experiments that a huge step lasts
LONGEST_STEP = 2.0  # s that a step of an odd or huge size may take
JUMP = 5  # steps by which a communication point is wrong
LATER = 3.0  # s, a start time that is not zero
VARIABLE = "canHandleVariableCommunicationStepSize"


@behaviour("run-experiment", "the default experiment runs to its end, with finite outputs")
def _experiment(subject: Subject) -> Iterator[str]:
    start, stop = times(subject)
    if stop is None:
        raise NotApplicable("it states no default experiment with a stop time")
    with Run(subject, moved=False) as run:
        run.begin()
        for k in range(min(MOST_STEPS, max(1, round((stop - start) / run.h)))):
            try:
                values = run.step()
            except Ended:
                return
            for name, value in zip(run.columns, values, strict=True):
                if not math.isfinite(value):
                    yield f"{name} is {value} after {k + 1} steps"
                    return


def _sampled(subject: Subject, parts: Sequence[float], multiple: int) -> tuple[list[str], Array]:
    """Return the names and outputs, shape (LONG_STEPS, outputs), with steps of some usual sizes
    that are split in parts.
    """
    with Run(subject) as run:
        run.begin()
        h = multiple * run.h
        return run.columns, np.array([run.step(h, parts) for _ in range(LONG_STEPS)], dtype=float)


def _scale(*tables: Array) -> Array:
    together = np.concatenate(tables)
    scale: Array = np.maximum(np.ptp(together, axis=0), np.finfo(float).tiny)
    return scale


@behaviour("run-convergence", "the shorter the steps, the closer the outputs", Severity.warning)
def _convergence(subject: Subject) -> Iterator[str]:
    tables = []
    for parts in (1, 2, 4):
        names, table = _sampled(subject, [1 / parts] * parts, MULTIPLE)
        tables.append(table)
    scale = _scale(*tables)
    first, second = (np.mean(np.abs(b - a), axis=0) / scale for a, b in itertools.pairwise(tables))
    for k in np.flatnonzero((second > DIVERGENCE * first) & (second > SMALL_SHARE)):
        yield (
            f"{names[k]}: half as long steps change it by {first[k]:.2g} of its range, a quarter as"
            f" long ones by {second[k]:.2g}"
        )


@behaviour(
    "run-split", "steps of varying size lead to the same outputs as equal ones", Severity.warning
)
def _split(subject: Subject) -> Iterator[str]:
    ask(subject, VARIABLE)
    (names, whole), (_, even), (_, odd) = (
        _sampled(subject, parts, SPLIT) for parts in ([1.0], [0.5, 0.5], [0.25, 0.75])
    )
    scale = _scale(whole, even, odd)
    allowed = 2 * np.max(np.abs(even - whole), axis=0) / scale + SMALL_SHARE
    off = np.max(np.abs(odd - even), axis=0) / scale
    for k in np.flatnonzero(off > allowed):
        yield f"{names[k]}: {off[k]:.2g} of its range apart"


@behaviour("run-noise", "times that differ in their last bits are taken", Severity.warning)
def _noise(subject: Subject) -> Iterator[str]:
    with Run(subject) as run:
        run.begin()
        for k in range(STEPS):
            noisy = run.t * (1 + (-1) ** k * 4e-16)
            status = run.instance.step_status(noisy, run.h)
            if refused(status):
                yield (
                    f"the step from {noisy:.17g} s in place of {run.t:.17g} s has status"
                    f" {status}{run.instance.last_message()}"
                )
                return
            run.t += run.h


@behaviour("run-jump", "a step from another time than where it is, is refused", Severity.note)
def _jump(subject: Subject) -> Iterator[str]:
    with Run(subject) as run:
        run.begin()
        run.steps(2)
        if not refused(run.instance.step_status(run.t + JUMP * run.h, run.h)):
            yield f"a step from {run.t + JUMP * run.h:g} s in place of {run.t:g} s has status OK"


@behaviour("run-later", "it starts at another time than zero", Severity.warning)
def _later(subject: Subject) -> Iterator[str]:
    with Run(subject) as run:
        run.begin(times(subject)[0] + LATER)
        values = run.steps(3)
    yield from (
        f"{name} is not finite"
        for name, row in zip(run.columns, values.T, strict=True)
        if not np.all(np.isfinite(row))
    )


def _told(run: Run, h: float) -> Iterator[str]:
    """Give what is wrong where a step that makes no sense is taken, with status OK."""
    run.begin()
    run.steps(2)
    if not refused(run.instance.step_status(run.t, h)):
        bad = [
            name
            for name, value in zip(run.columns, run.outputs(), strict=True)
            if not math.isfinite(value)
        ]
        yield from (f"a step of {h:g} s has status OK and {name} is not finite" for name in bad)


@behaviour("run-back", "a step back in time is refused", Severity.warning)
def _back(subject: Subject) -> Iterator[str]:
    with Run(subject) as run:
        run.begin()
        run.steps(2)
        if not refused(run.instance.step_status(run.t, -run.h)):
            yield f"a step of {-run.h:g} s has status OK"


@behaviour("run-zero", "a step of no length is refused, or changes nothing", Severity.warning)
def _zero(subject: Subject) -> Iterator[str]:
    with Run(subject) as run:
        run.begin()
        before = run.steps(2)[-1].tolist()
        if not refused(run.instance.step_status(run.t, 0.0)):
            for name, a, b in zip(run.columns, before, run.outputs(), strict=True):
                if a != b:
                    yield f"{name} goes from {a:.17g} to {b:.17g}"


@behaviour(
    "run-odd",
    "a step size that is no finite number is refused, or does no harm",
    Severity.note,
    step_seconds=LONGEST_STEP,
)
def _odd(subject: Subject) -> Iterator[str]:
    for h in (math.nan, math.inf):
        with Run(subject) as run:
            yield from _told(run, h)


@behaviour(
    "run-huge",
    f"a step of {LARGE_TIMES:g} default experiments ends, refused or with finite outputs",
    Severity.note,
    step_seconds=LONGEST_STEP,
)
def _huge(subject: Subject) -> Iterator[str]:
    start, stop = times(subject)
    with Run(subject) as run:
        yield from _told(run, LARGE_TIMES * (1.0 if stop is None else stop - start))


def _inputs(subject: Subject) -> list[str]:
    found = subject.scalars("input")
    if not found:
        raise NotApplicable("it has no real input")
    return found


@behaviour(
    "run-large",
    "with huge inputs, a step is refused or the outputs are finite",
    Severity.note,
    step_seconds=LONGEST_STEP,
)
def _large(subject: Subject) -> Iterator[str]:
    for sign in (1.0, -1.0):
        with Run(subject, moved=False) as run:
            run.begin()
            for name in _inputs(subject):
                run.instance.write(name, [within(subject, name, sign * LARGE)])
            for k in range(STEPS):
                if refused(run.instance.step_status(run.t, run.h)):
                    break
                run.t += run.h
                bad = [
                    name
                    for name, value in zip(run.columns, run.outputs(), strict=True)
                    if not math.isfinite(value)
                ]
                yield from (
                    f"{name} is not finite after {k + 1} steps with inputs of {sign * LARGE:g},"
                    " with status OK"
                    for name in bad
                )
                if bad:
                    return


@behaviour(
    "run-nan",
    "an input that is no number is refused, or leaves the outputs finite once it is a number again",
    Severity.warning,
    step_seconds=LONGEST_STEP,
)
def _nan(subject: Subject) -> Iterator[str]:
    for name in _inputs(subject):
        with Run(subject, moved=False) as run:
            run.begin()
            kept = run.instance.get(name)
            if refused(run.instance.write(name, [math.nan])) or refused(
                run.instance.step_status(run.t, run.h)
            ):
                continue
            run.t += run.h
            run.instance.write(name, kept)
            values = run.steps(2)[-1]
            for output, value in zip(run.columns, values, strict=True):
                if not math.isfinite(value):
                    yield f"{name} = NaN is taken, with status OK, and later {output} is {value}"


@behaviour("run-last-time", "without early return, a step ends at its end")
def _last_time(subject: Subject) -> Iterator[str]:
    if subject.fmi == 2:
        raise NotApplicable("FMI 2 has no early return")
    with Run(subject, moved=False) as run:
        run.begin()
        for _ in range(STEPS):
            run.step()
            early, last = bool(run.instance.flags[2]), run.instance.last.value
            if early or abs(last - run.t) > 1e-6 * run.h:
                yield f"a step to {run.t:.17g} s ends at {last:.17g} s{', early' if early else ''}"
                return


@behaviour("run-events", "with event mode, steps and events come to an end, and outputs are finite")
def _events(subject: Subject) -> Iterator[str]:
    ask(subject, "hasEventMode")
    with Run(subject, Options(event_mode=True)) as run:
        run.instance.enter(times(subject)[0])
        run.t = times(subject)[0]
        run.instance.leave()
        _through_events(run)
        for _ in range(STEPS):
            run.advance(run.h)
            if run.instance.flags[0]:
                run.instance.do("EnterEventMode")
                _through_events(run)
        bad = [
            name
            for name, value in zip(run.columns, run.outputs(), strict=True)
            if not math.isfinite(value)
        ]
        yield from (f"{name} is not finite" for name in bad)


def _through_events(run: Run) -> None:
    from bristle.fmus.conformance.exchange import settle

    settle(run.instance)
    run.instance.do("EnterStepMode")
