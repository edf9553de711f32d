"""An FMU that gives inputs over time: steps and sines, as outputs of the simulated time alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi as ca

from bristle.fmus.build import program_files
from bristle.fmus.pack import write_archive
from bristle.model.program import Program
from bristle.model.system import System
from bristle.model.variables import Variable

SX = ca.SX


@dataclass(frozen=True)
class Source:
    """One output over time.

    Attributes
    ----------
    name, unit : str
        Output and its SI unit.
    start : float
        Value before the first of the points.
    points : tuple of (float, float)
        Time [s] from which the output has a value, and the value.
    sine : (float, float, float), optional
        Amplitude, frequency [Hz] and phase [rad] of a sine that is added.
    """

    name: str
    unit: str
    start: float
    points: tuple[tuple[float, float], ...] = ()
    sine: tuple[float, float, float] | None = None


def source_program(sources: Sequence[Source], step: float) -> Program:
    """Return the program of these outputs, whose values begin within half a `step` [s] of their
    times.
    """
    system = System("stimuli", "inputs over time")
    for each in sources:
        value = SX(each.start)
        for time, held in each.points:
            value = ca.if_else(system.time >= time - 0.5 * step, held, value)
        if each.sine is not None:
            amplitude, frequency, phase = each.sine
            value += amplitude * ca.sin(2 * math.pi * frequency * system.time + phase)
        system.output(Variable(each.name, each.unit, f"{each.name} over time"), value)
    return Program("Stimuli", [system])


def build_source(
    sources: Sequence[Source], step: float, out: Path, *, fmi: int = 2, platforms: str = "host"
) -> Path:
    """Write the FMU; `fmi` and `platforms` as of `build`."""
    return write_archive(
        out, program_files(source_program(sources, step), fmi, "native", platforms)
    )
