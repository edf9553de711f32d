"""Approach I, filtered: recursive least squares of all parameters at once from the velocity,
without a start.
"""

from __future__ import annotations

from collections.abc import Iterable

from bristle.model.variables import Parameter, State
from bristle.observer import filtered, swapping
from bristle.observer.method import EquationContext, Method, Sample, Update


def update(
    context: EquationContext, s: Sample, names: Iterable[str], prior: swapping.Prior | None = None
) -> Update:
    """Run the filters on the velocity, linear between samples, and on the held input.

    Source: dixit2008 eq. (20)-(22).
    """
    p = context.p
    change = s.u - p.u_before
    ends = (
        swapping.signals(s.u, change, s.y0, p.width),
        swapping.signals(s.u, change, s.y1, p.width),
    )
    given = swapping.Settings(p.cutoff, p.memory, p.noise**2, s.period)
    fit = swapping.observe(context, s, ends, given, swapping.OWN, prior)
    return Update(next=fit | {"u_before": s.u}, **swapping.published(p, swapping.OWN, given, names))


def _equations(context: EquationContext, s: Sample) -> Update:
    return update(context, s, swapping.ESTIMATES)


def parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare filter, memory, width and noise of the sensor under a method's name."""
    return (*swapping.parameters(prefix, 20.0), filtered.noise_parameter(prefix))


STATES = (
    *swapping.FILTER_STATES,
    *swapping.OWN.states,
    State("u_before", "V", "input before the last one"),
)

METHOD = Method(
    "swapped",
    "filtered Approach I: least squares of eleven entries, eight of them free, without"
    " differentiation",
    "dixit2008 eq. (20)-(22)",
    "y_v",
    parameters("swapped"),
    STATES,
    _equations,
)
