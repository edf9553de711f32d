"""Interval arithmetic on symbols: bounds that hold for every value of what is uncertain."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

SX = ca.SX
TINY = 1e-300
LARGE_LOGARITHM = 1e9  # used for an infinite logarithm


@dataclass(frozen=True)
class Interval:
    """A quantity known to lie between two bounds."""

    lo: SX
    hi: SX

    @property
    def middle(self) -> SX:
        """Return the value whose largest error is smallest."""
        return (self.lo + self.hi) / 2

    def __add__(self, other: Interval) -> Interval:
        return Interval(self.lo + other.lo, self.hi + other.hi)

    def __sub__(self, other: Interval) -> Interval:
        return Interval(self.lo - other.hi, self.hi - other.lo)

    def times(self, factor: SX) -> Interval:
        """Return the interval times a number of either sign."""
        a, b = self.lo * factor, self.hi * factor
        return Interval(ca.fmin(a, b), ca.fmax(a, b))

    def over(self, other: Interval) -> Interval:
        """Return the quotient by an interval that does not contain zero."""
        ends = [a / b for a in (self.lo, self.hi) for b in (other.lo, other.hi)]
        return Interval(
            ca.fmin(ca.fmin(*ends[:2]), ca.fmin(*ends[2:])),
            ca.fmax(ca.fmax(*ends[:2]), ca.fmax(*ends[2:])),
        )

    def exp(self) -> Interval:
        """Return e to the power of the interval."""
        return Interval(ca.exp(self.lo), ca.exp(self.hi))

    def log(self) -> Interval:
        """Return the logarithm of what is positive in the interval."""
        return Interval(
            *(
                ca.if_else(x > TINY, ca.log(ca.fmax(x, TINY)), -LARGE_LOGARITHM)
                for x in (self.lo, self.hi)
            )
        )

    def meet(self, other: Interval) -> Interval:
        """Return the intersection, which is empty where lo > hi."""
        return Interval(ca.fmax(self.lo, other.lo), ca.fmin(self.hi, other.hi))
