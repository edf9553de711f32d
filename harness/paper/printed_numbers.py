"""The numbers that the paper prints, each with its place: data, which `reproduce` sets beside what
a run gives.

What is known of the paper here is its text, and what set S was once read from its figures 4 and 5.
Axes are the first and the last number that the text has for an axis. No curve was digitised.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

PAPER = (
    "Dixit and Suryanarayanan, Adaptive observers for servo systems with friction, IEEE CCA 2008"
)


@dataclass(frozen=True)
class Printed:
    """A number of the paper, or several that belong together, in the unit that is printed.

    `origin` says how it is known: from the text, from the numbers at an axis, or as the level at
    which a curve ends, read by eye.
    """

    key: str
    meaning: str
    values: tuple[float, ...]
    unit: str
    place: str
    origin: Literal["text", "axis", "curve"]
    note: str = ""


_NUMBERS = (
    Printed(
        "inertia",
        "inertia of the disc",
        (0.001,),
        "kg.m2",
        "section IV-A",
        "text",
        "of the order of",
    ),
    Printed("diameter", "diameter of the disc", (75.0,), "mm", "section IV-A", "text"),
    Printed(
        "torque_constant",
        "torque constant of the motor",
        (40.0,),
        "mN.m/A",
        "section IV-A",
        "text",
        "the text has 40mN/A, which is no torque constant",
    ),
    Printed(
        "pulses", "pulses of the encoder per revolution", (10000.0,), "1", "section IV-A", "text"
    ),
    Printed(
        "resolution",
        "resolution after quadrature decoding",
        (0.009,),
        "deg",
        "section IV-A",
        "text",
    ),
    Printed(
        "vc",
        "gate of step 1",
        (50.0,),
        "deg/s",
        "section IV-B",
        "text",
        "the text has 500/sec, a degree sign read as 0",
    ),
    Printed(
        "cutoff",
        "cut-off of the low-pass that makes the reference",
        (5.0,),
        "rad/s",
        "section IV-C",
        "text",
    ),
    Printed("period", "sampling period", (1.0,), "ms", "section IV-C", "text"),
    Printed("reference_window", "time shown", (224.0, 236.0), "s", "Fig. 3", "axis"),
    Printed("reference_range", "velocity axis", (-300.0, 300.0), "deg/s", "Fig. 3", "axis"),
    Printed("centres", "centres of the basis functions", (0.0, 20.0), "deg/s", "eq. (24)", "text"),
    Printed("widths", "widths of the basis functions", (10.0, 20.0), "deg/s", "eq. (24)", "text"),
    Printed(
        "c1",
        "output-error gain of step 1",
        (100.0,),
        "1/s",
        "section IV-E",
        "text",
        "no unit is printed",
    ),
    Printed(
        "gamma",
        "diagonal of Gamma of step 1",
        (0.001, 0.001, 0.0001),
        "1",
        "section IV-E",
        "text",
        "for alpha2, b, Fc; no unit is printed",
    ),
    Printed("k0", "K0 of step 2", (100.0, 1000.0), "1", "section IV-E", "text"),
    Printed(
        "lambda", "lambda of step 2", (50.0,), "1/s", "section IV-E", "text", "no unit is printed"
    ),
    Printed("step1_window", "time shown", (0.0, 200.0), "s", "Fig. 4", "axis"),
    Printed(
        "step1_range",
        "axis of the estimates",
        (-2.0, 8.0),
        "1",
        "Fig. 4",
        "axis",
        "no unit is printed",
    ),
    Printed("alpha2", "alpha2 at the end", (2.0,), "1/s", "Fig. 4", "curve"),
    Printed("b", "b at the end", (6.5,), "1", "Fig. 4", "curve", "no unit is printed"),
    Printed("step2_window", "time shown", (0.0, 100.0), "s", "Fig. 5", "axis"),
    Printed(
        "step2_range",
        "axis of the estimates",
        (0.0, 9.0),
        "1",
        "Fig. 5",
        "axis",
        "no unit is printed",
    ),
    Printed("sigma0", "sigma0 at the end", (6.0,), "1/s2", "Fig. 5", "curve"),
    Printed("sigma1", "sigma1 at the end", (8.0,), "1/s2", "Fig. 5", "curve"),
    Printed("sigma2", "sigma2 at the end", (3.0,), "1/s2", "Fig. 5", "curve"),
    Printed("c", "c at the end", (1.5,), "1", "Fig. 5", "curve", "no unit is printed"),
    Printed(
        "converged",
        "when all parameters of step 2 have converged",
        (50.0, 60.0),
        "s",
        "section IV-E",
        "text",
    ),
    Printed("validation_window", "time shown", (85.0, 100.0), "s", "Fig. 6", "axis"),
    Printed("validation_range", "velocity axis", (-500.0, 400.0), "deg/s", "Fig. 6", "axis"),
    Printed(
        "mse",
        "eq. (25) on records that were not used to identify",
        (4.0, 6.0),
        "%",
        "section IV-F",
        "text",
    ),
)
PRINTED = {each.key: each for each in _NUMBERS}


@dataclass(frozen=True)
class PrintedFigure:
    """A figure of the paper: what it shows, what is known of it and how, what is left open."""

    number: int
    title: str
    shows: str
    known: str
    unknown: str


FIGURES: Sequence[PrintedFigure] = (
    PrintedFigure(
        1,
        "the Stribeck curve s(v)",
        "A sketch of s(v) against v, which falls from a0 + a1 at rest to a0 at higher sliding"
        " velocities; V0 on the axis between.",
        'The labels a0 + a1, a0, V0, "higher sliding velocities". It has no scale.',
        "Everything in numbers.",
    ),
    PrintedFigure(
        3,
        "the reference velocity",
        "A sample of the reference: a random signal through a low-pass filter with a cut-off of 5"
        " rad/s.",
        "Axes: 224 to 236 s, −300 to 300 deg/s. Cut-off and use from the text.",
        "The random signal and its seed, the order of the filter, the rms, whether it is clipped,"
        " the gains of the PI controller.",
    ),
    PrintedFigure(
        4,
        "step 1: alpha2 and b",
        "The estimates of step 1 on the experimental record, from zero.",
        "Axes: 0 to 200 s, −2 to 8. The levels at the end, alpha2 = 2 and b = 6.5, read by eye.",
        "The record, the unit of b (that of the velocity over that of u), the estimate of Fc, how"
        " the velocity was made from the encoder, and how the observer was integrated.",
    ),
    PrintedFigure(
        5,
        "step 2: sigma0, sigma1, sigma2 and c",
        "The estimates of step 2, from zero, with alpha2 and b of step 1.",
        "Axes: 0 to 100 s, 0 to 9. The levels at the end, 6, 8, 3 and 1.5, read by eye. From the"
        " text: all converge at 50 to 60 s.",
        "Whether its record is that of step 1, the unit of c. Read in rad, these figures have a"
        " presliding distance of 38 degrees; set S therefore takes sigma_i and c a hundred times"
        " larger, which leaves the friction level sigma0/c as it is.",
    ),
    PrintedFigure(
        6,
        "validation: measured and predicted velocity",
        "The velocity that the identified model predicts from the input alone, beside the measured"
        " one, on another record.",
        "Axes: 85 to 100 s, −500 to 400 deg/s. From the text: eq. (25) is between 4 % and 6 % over"
        " several validations.",
        "The records, their number, how the velocity was measured (one count of the encoder in 1 ms"
        " is 9 deg/s), and what any other model reaches on them.",
    ),
)
