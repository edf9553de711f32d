"""The FMU simulated over the records, segment by segment or, where it cannot be restarted, over
each whole record.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from bristle.common.errors import RestartError
from bristle.common.progress import Progress
from bristle.common.table import Array
from bristle.diagnosis.answer import Finding, Reason, finding
from bristle.diagnosis.estimation.dataset import (
    STATE_SMOOTHING,
    Dataset,
    Segments,
)
from bristle.diagnosis.sliding.stretches import smooth
from bristle.fmus.host import Fmu
from bristle.fmus.playback import (
    Replay,
    ReplayResult,
    ReplaySegment,
    replay_records,
    replay_segments,
    start_variable,
)

# s: time before a segment from which the FMU is simulated, so that its hidden states settle
FMU_LEAD = 0.04


def simulate_segments(
    fmu: Fmu, dataset: Dataset, tell: Progress, timeout: float | None = None
) -> tuple[Segments, Finding]:
    """Return the segments with outputs and initial states of the FMU in place of the measured ones,
    and how it ran.

    Simulating them may take `timeout` seconds.
    """
    tell("simulating the FMU", 0.0)
    s, name = dataset.segments, fmu.path.name
    wanted = ("v",) if s.velocity else ("theta", "v")
    shows_velocity = fmu.has("v", "output") and fmu.is_real("v")
    outputs = wanted if s.velocity or shows_velocity else ("theta",)
    try:
        begins = _start_variables(fmu, wanted)
        # segment by segment, each from a little before its start
        lead = round(FMU_LEAD / s.h)
        stretches = tuple(_stretches(dataset, lead, begins))
        known = {key: variable for key, variable in begins.items() if key in outputs}
        replay = Replay(fmu, s.h, stretches, outputs, known)
        played = replay_segments(
            replay, lambda n: tell("simulating the FMU", 0.05 * n / len(stretches)), timeout
        )
        how = {"way": played.way, "segments": len(stretches), "lead": lead * s.h}
        starts = tuple(begins.values())
        said = finding(Reason.FMU_BY_SEGMENT, fmu=name, variables=starts, **how)
        return _gathered(s, played, lead), said
    except RestartError as error:
        whole = tuple(ReplaySegment(piece.time, piece.u, {}) for piece in s.pieces)
        played = replay_records(Replay(fmu, s.h, whole, outputs, {}), timeout)
        return _cut(s, played), finding(Reason.FMU_BY_RECORD, fmu=name, why=str(error))


def _start_variables(fmu: Fmu, wanted: Sequence[str]) -> dict[str, str]:
    """Return what each state is started by; `RestartError` where there is none."""
    begins = {}
    for name in wanted:
        variable = start_variable(fmu, name)
        if variable is None:
            raise RestartError(f"no parameter {name}_start and no start value of {name}")
        begins[name] = variable
    return begins


def _stretches(dataset: Dataset, lead: int, begins: Mapping[str, str]) -> Iterator[ReplaySegment]:
    """Give the inputs of each segment with those of the lead before it, and the measured state
    where that begins.
    """
    s, m, offset = dataset.segments, dataset.motion, 0
    length = s.bins * s.width
    for piece in s.pieces:
        for first in range(0, len(piece.u), length):
            at = max(0, first - lead)
            state = {"theta": float(m.theta[offset + at]), "v": float(m.v[offset + at])}
            start = {variable: state[name] for name, variable in begins.items()}
            yield ReplaySegment(piece.time + s.h * at, piece.u[at : first + length], start)
        offset += len(piece.u)


def _gathered(s: Segments, played: ReplayResult, lead: int) -> Segments:
    """Return the segments as the FMU gives them, from one stretch each."""
    pieces, done, length = [], 0, s.bins * s.width
    for piece in s.pieces:
        n = len(piece.measured)
        parts = [_state(s, each) for each in played.outputs[done : done + n]]
        seen = np.array([_averages(s, y[len(y) - length :]) for y, _ in parts])
        starts = np.array([state[len(state) - length] for _, state in parts])
        pieces.append(replace(piece, measured=seen, initial=starts))
        done += n
    return replace(s, pieces=tuple(pieces))


def _cut(s: Segments, played: ReplayResult) -> Segments:
    """Return the segments as the FMU gives them, cut from whole records."""
    pieces = []
    for piece, outputs in zip(s.pieces, played.outputs, strict=True):
        y, state = _state(s, outputs)
        seen = np.array([_averages(s, part) for part in y.reshape(len(piece.measured), -1)])
        pieces.append(replace(piece, measured=seen, initial=state[:: s.bins * s.width]))
    return replace(s, pieces=tuple(pieces))


def _averages(s: Segments, y: Array) -> Array:
    return np.asarray(y.reshape(s.bins, s.width).mean(axis=1))


def _state(s: Segments, outputs: Array) -> tuple[Array, Array]:
    """Return the output (n,) and the state (n, 2) that an FMU shows; where it shows no velocity,
    from a parabola.
    """
    y = outputs[:, 0]
    if s.velocity:
        return y, np.column_stack([np.zeros_like(y), y])
    return y, np.column_stack(
        [y, outputs[:, 1] if outputs.shape[1] > 1 else smooth(y, s.h, STATE_SMOOTHING, 1)]
    )
