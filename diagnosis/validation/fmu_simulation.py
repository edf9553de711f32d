"""A plant FMU over long stretches of records, up to whole ones."""

from __future__ import annotations

import numpy as np

from bristle.common.errors import RestartError
from bristle.common.table import Array
from bristle.diagnosis.answer import Finding, Line, Reason, finding
from bristle.diagnosis.estimation.dataset import Segments
from bristle.diagnosis.validation.long_simulation import OpenLoop, Records, split
from bristle.fmus.host import Fmu
from bristle.fmus.playback import (
    Replay,
    ReplaySegment,
    replay_records,
    replay_segments,
    start_variable,
)


class FmuSimulator:
    """Simulates an FMU over records, from the measured state at each start if it can be started
    from one.

    `timeout`: seconds that a simulation may take. `why_whole`: why whole records are simulated from
    its own start, or empty.
    """

    def __init__(self, fmu: Fmu, velocity: bool, timeout: float | None = None) -> None:
        self.fmu, self.timeout = fmu, timeout
        self.why_whole: Line | None = None
        self._output = "v" if velocity else "theta"
        wanted = ("v",) if velocity else ("theta", "v")
        self._begins = {
            name: variable for name in wanted if (variable := start_variable(fmu, name)) is not None
        }
        if missing := [name for name in wanted if name not in self._begins]:
            self.why_whole = finding(Reason.NO_START_VARIABLE, variable=missing[0])

    def open_loop(self, records: Records, seconds: float) -> OpenLoop | None:
        """Return the outputs of the FMU that begins anew after so many seconds, positions at the
        starts fitted.

        An FMU that cannot be started from a given state gives whole records alone (else None),
        moved onto what was measured.
        """
        if self.why_whole is None:
            try:
                return split(records, self._restarted(records.stretches(seconds, records.samples)))
            except RestartError as error:
                self.why_whole = str(error)
        if seconds < records.seconds:
            return None
        runs = tuple(ReplaySegment(float(r.time[0]), r.u, {}) for r in records.all)
        played = replay_records(
            Replay(self.fmu, records.all[0].h, runs, (self._output,), {}), self.timeout
        ).outputs
        simulated = [out[:, 0] for out in played]
        if self._output == "theta":
            simulated = [
                seen + np.mean(r.y - seen) for r, seen in zip(records.all, simulated, strict=True)
            ]
        return OpenLoop(tuple(r.y for r in records.all), tuple(simulated))

    def open_loop_after(self, records: Records, samples: int) -> OpenLoop | None:
        """Return the outputs of the FMU over whole records, begun in the state that their first
        `samples` show; None if it cannot be started from a given state.
        """
        if self.why_whole is not None:
            return None
        head = records.head(samples)
        starts = head.stretches(head.seconds, samples).initial
        try:
            return split(
                records, self._run(records.stretches(records.seconds, records.samples), starts)
            )
        except RestartError as error:
            self.why_whole = str(error)
            return None

    def _restarted(self, s: Segments) -> Array:
        """Return the outputs (stretches, samples), each begun where it fits best: a position moves
        by what its output lacks.
        """
        begun = self._run(s, s.initial)
        if s.velocity:
            return begun
        lacking = s.measured - begun
        moved = s.initial + np.column_stack([np.nanmean(lacking, axis=1), np.zeros(len(begun))])
        again = self._run(s, moved)
        better = np.nanmean(np.square(s.measured - again), axis=1) < np.nanmean(
            np.square(lacking), axis=1
        )
        return np.where(better[:, None], again, begun)

    def _run(self, s: Segments, starts: Array) -> Array:
        first, runs = 0, []
        for piece in s.pieces:
            for k, u in enumerate(piece.u.reshape(len(piece.measured), -1)):
                state = dict(zip(("theta", "v"), starts[first + k].tolist(), strict=True))
                start = {variable: state[name] for name, variable in self._begins.items()}
                runs.append(ReplaySegment(piece.time + k * s.seconds, u, start))
            first += len(piece.measured)
        known = {name: variable for name, variable in self._begins.items() if name == self._output}
        played = replay_segments(
            Replay(self.fmu, s.h, tuple(runs), (self._output,), known), timeout=self.timeout
        )
        return np.array([out[:, 0] for out in played.outputs])

    def notes(self) -> list[Finding]:
        """Return how the FMU was run, where that matters."""
        if self.why_whole is None:
            return []
        moved = self._output == "theta"
        why = self.why_whole
        return [finding(Reason.FMU_OWN_START, fmu=self.fmu.path.name, why=why, moved=moved)]
