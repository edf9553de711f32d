"""What a method's estimates are worth: a least-squares fit beside it, on the same filtered signals.

Each method is, for its own filtered signals, a linear regression z = h' theta + e. A companion
keeps the information of [h, x, z], where x are columns of what the method does not model but a rig
may have: a load torque, a delay, friction that still falls with speed. From it follow the least
squares of theta beside x, how well these are known, and so

- the standard deviation of an estimate: that of the least squares, enlarged as much as they move
  more than they claim (consistency.py), and the distance of the estimate from them. What a gradient
  law lags behind, and what a load or a delay does to a method that knows of none, is in that
  distance;
- `adapted`: more independent samples have counted than there are columns;
- `innovation`: the mean squared residual of late over what the sensor alone explains;
- `valid`: adapted, a standard deviation that is a small share of the estimate, and nothing known
  for sure that is impossible.

Use, in a method with estimates alpha2, b and Fc::

    COMPANION = Companion(("alpha2", "b", "Fc"), extra=2)       # h has three entries, x has two
    states:     (*own, *COMPANION.states)
    next:       own | COMPANION.advance(p, Row(z, h, x, counts, noise, alike), kept, period)
    sd:         COMPANION.deviations(p, estimates)
    published:  Update(next, estimates, **COMPANION.judge(p, sd, limits, possible))

The estimates may be the method's own, or the least squares themselves (`fit`). A second companion
in one method needs a `prefix` of its own. Source: ljung1999 sections 9.6 and 11.2; hausman1978 (an
estimate against one that is right under wider assumptions).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from bristle.model.variables import Namespace, State
from bristle.observer import consistency, excitation, information
from bristle.observer.method import LARGEST_SD, stack, unstack, vector_states

SX = ca.SX
# share of a column that the others must leave unexplained, else its estimate is not known at all
LEAST_DISTINCT = 1e-6
# of each diagonal entry: shares out among equal columns what they explain together
RIDGE_SHARE = 1e-9
# of the squared movement over the variance lost: errors of a differentiated signal average out
# faster
LEAST_EXCESS = 1e-3
BLOCKS_OF_CLAIM = 0.05  # blocks that the claimed variance counts for at the start
LATE_TIME = 20.0  # s, over which the innovations of late are averaged
LARGEST_SQUARE = 1e6  # most that one squared innovation counts over the variance of the sensor
# standard deviations of a sum of squares beyond which there is more than the sensor's noise
SURE_BY = 2.0
# of what is missed, how much of it lies along a regressor: one standard deviation
ALONG_SHARE = 0.5
LARGEST_WALK = 1e60  # most that the variance of a random walk counts over what a sample says
LEAST_KEPT = 1e-100  # keeps a division defined where nothing is kept
LEAST_NOISE = 1e-300  # keeps a division defined where the sensor has none


@dataclass(frozen=True)
class Rest:
    """Whether the servo `moves`; while it does not, the load may change unseen.

    `column`: the entry that changes with it; `friction`: the quantity of the companion by which its
    drift is counted.
    """

    moves: SX
    column: int
    friction: str = "Fc"


@dataclass(frozen=True)
class Row:
    """A sample of z = h' theta + x' eta + e, and whether it counts.

    `noise`: variance of e by the sensor alone; `alike`: how many samples in a row share an error
    (of a filter with corner a: 2 / (a Ts)); `rest`: where it is given, nothing counts and nothing
    is forgotten in rest.
    """

    z: SX
    h: SX
    x: SX
    counts: SX
    noise: SX
    alike: SX
    rest: Rest | None = None


@dataclass(frozen=True)
class View:
    """A regression in entries that are functions of fewer: h' g(theta), near some theta h' (slope
    theta + rest).

    `origin`: values about which something is known beforehand; `certainty`: with which information,
    `exact`: the same in multiples of what the samples say. `derived`: returns values and slopes of
    what follows from theta.
    """

    slope: SX
    rest: SX
    origin: SX
    certainty: SX
    exact: SX
    derived: Callable[[SX], tuple[SX, SX]]

    def of(self, information: SX, line: SX) -> tuple[SX, SX]:
        """Return (information, line) of theta - origin and of z."""
        n, entries = self.slope.shape[1], self.slope.shape[0]
        turn = SX(entries + 1, n + 1)
        turn[:entries, :n], turn[:entries, n], turn[entries, n] = (
            self.slope,
            -self.rest - self.slope @ self.origin,
            1,
        )
        seen = turn.T @ information @ turn
        own = ca.diag(seen)[:n]
        return seen + ca.diag(ca.vertcat(self.certainty + self.exact * own, 0)), turn.T @ line


@dataclass(frozen=True)
class _Solved:
    """Least squares, with the states of a companion that follow from them.

    `everything`: of all columns; `found`, `narrow`, `unit`, `distinct`: of what has a name; `left`:
    the sum of squares that they leave.
    """

    everything: SX
    found: SX
    narrow: SX
    unit: SX
    distinct: SX
    left: SX


class Companion:
    """The least squares of the entries of theta called `names`, beside `extra` further columns.

    Through a `View` the samples may have `entries` columns of which theta are fewer functions, and
    further quantities, called `derived`, may follow from theta.
    """

    def __init__(
        self,
        names: Sequence[str],
        extra: int = 0,
        prefix: str = "",
        entries: int = 0,
        derived: Sequence[str] = (),
    ) -> None:
        self.names, self.prefix, self.fitted = (*names, *derived), prefix, len(names)
        self.count, self.columns = len(self.names), len(names) + extra
        self.entries = entries or self.columns

    @property
    def states(self) -> tuple[State, ...]:
        """What the companion remembers."""
        pre = self.prefix
        return (
            *information.states(self.entries + 1, f"{pre}information"),
            *vector_states(
                f"{pre}fit", "1", f"least squares of {', '.join(self.names)}", self.count
            ),
            *vector_states(f"{pre}narrow", "1", "the same without the further columns", self.count),
            *vector_states(
                f"{pre}unit", "1", "their variance for unit variance of the residual", self.count
            ),
            *vector_states(
                f"{pre}distinct",
                "1",
                "1 where the other columns do not explain its own",
                self.count,
            ),
            State(f"{pre}rows", "1", "samples remembered"),
            State(f"{pre}counted", "s", "time that has counted"),
            State(
                f"{pre}residual",
                "1",
                "variance of the residual that independent samples would have",
            ),
            State(f"{pre}left", "1", "sum of squares left unexplained"),
            State(f"{pre}missed", "1", "what of it the sensor does not explain either"),
            State(
                f"{pre}adapted",
                "1",
                "1 when more independent samples have counted than there are columns",
            ),
            State(f"{pre}late", "1", "mean squared residual of late over what the sensor explains"),
            excitation.rest_state(f"{pre}rest"),
            *consistency.states(self.count, pre),
        )

    def advance(
        self, p: Namespace, row: Row, kept: SX, period: SX, look: Callable[[SX], View] | None = None
    ) -> dict[str, SX]:
        """Return the next states after a sample that, if it counts, leaves the share `kept` of what
        was known.

        Source: ljung1999 section 11.2 (information form); flyvbjerg1989 (samples that share an
        error).
        """
        pre = self.prefix
        line = ca.vertcat(row.h, row.x, row.z)
        moves = row.rest.moves if row.rest else SX(1)
        since, rests = excitation.rest(p[f"{pre}rest"], moves, period)
        counts = ca.logic_and(row.counts, ca.logic_not(rests))
        # what the samples say so far
        before, rows = information.read(p, self.entries + 1, f"{pre}information"), p[f"{pre}rows"]
        r = ca.if_else(counts, kept * before + line @ line.T, before)
        r = ca.if_else(rests, self._drifted(p, r, row.rest, period), r) if row.rest else r
        rows = ca.if_else(counts, kept * rows + 1, rows)
        # their least squares
        view = look(r) if look else None
        seen, looked = view.of(r, line) if view else (r, line)
        solved = self._solved(seen, view)
        free = rows / row.alike - self.columns  # independent samples beyond the unknowns
        adapted = free > 0
        residual = solved.left / ca.fmax(free, 1)
        known = stack(p, f"{pre}unit", self.count) / ca.fmax(kept, LEAST_KEPT)
        lost = ca.if_else(counts, ca.fmax(known - solved.unit, 0), 0)
        fit = ca.if_else(adapted, solved.found, 0)
        # how well they explain the sample, and how much they move
        time, age = ca.if_else(counts, period, 0), p[f"{pre}counted"]
        error = looked[-1] - ca.dot(looked[:-1], solved.everything)
        square = ca.fmin(error**2 / ca.fmax(row.noise, LEAST_NOISE), LARGEST_SQUARE)
        late = p[f"{pre}late"]
        share = time / ca.fmin(age + period, LATE_TIME)
        sensor = row.noise * (rows + SURE_BY * ca.sqrt(2 * rows * row.alike))
        moved = (age, time, p[f"{pre}adapted"] > 0)
        return {
            **information.write(r, f"{pre}information"),
            **unstack(f"{pre}fit", fit),
            **unstack(f"{pre}narrow", ca.if_else(adapted, solved.narrow, 0)),
            **unstack(f"{pre}unit", solved.unit),
            **unstack(f"{pre}distinct", solved.distinct),
            f"{pre}rows": rows,
            f"{pre}counted": age + time,
            f"{pre}residual": residual,
            f"{pre}left": solved.left,
            f"{pre}missed": ca.fmax(solved.left - sensor, 0),
            f"{pre}adapted": adapted,
            f"{pre}late": late + share * (square - late),
            f"{pre}rest": since,
            **consistency.blocks(p, fit, residual * lost, moved, BLOCKS_OF_CLAIM, pre),
        }

    def _solved(self, seen: SX, view: View | None) -> _Solved:
        """Return the least squares of the information, and of what follows from them."""
        n = self.fitted
        factors = information.Factors(seen + RIDGE_SHARE * ca.diag(ca.diag(seen)))
        everything, unit = factors.regression(), factors.inverse_diagonal(self.columns)[:n]
        # 1 over its product with `unit` is the share that the others do not explain
        own = ca.diag(seen)[:n]
        distinct = ca.logic_and(unit * own * LEAST_DISTINCT < 1, own > information.ZERO_ENTRY)
        found, narrow = everything[:n], factors.regression(n)
        if view:
            found, narrow = found + view.origin[:n], narrow + view.origin[:n]
            values, slopes = view.derived(found)
            spread = [factors.inverse_along(slopes[i, :].T) for i in range(values.numel())]
            narrow = ca.vertcat(narrow, view.derived(narrow)[0])
            found = ca.vertcat(found, values)
            unit = ca.vertcat(unit, *spread)
            distinct = ca.vertcat(distinct, *([ca.mmin(distinct)] * len(spread)))
        # rounding may have cost these their sign
        left, unit = ca.fabs(factors.d[-1]), ca.fabs(unit)
        return _Solved(everything, found, narrow, unit, distinct, left)

    def _drifted(self, p: Namespace, matrix: SX, rest: Rest, period: SX) -> SX:
        """Return the information after a time in which the load's entry has done a random walk.

        The quadratic form least over the change of that entry: R - R e e' R / (1 / q + e' R e).
        Source: jazwinski1970 chapter 7 (process noise), in information form.
        """
        excess = (
            consistency.inflation(p, self.count, self.prefix, LEAST_EXCESS)[
                self.names.index("load")
            ]
            ** 2
        )
        claimed = excess * p[f"{self.prefix}residual"]  # variance for unit information
        rate = excitation.LOAD_DRIFT * self.fit(p)[rest.friction] ** 2
        walk = ca.fmin(rate * period / ca.fmax(claimed, LEAST_NOISE), LARGEST_WALK)
        column = matrix[:, rest.column]
        return SX(matrix - walk * column @ column.T / (1 + walk * column[rest.column]))

    def fit(self, p: Namespace) -> dict[str, SX]:
        """Return the least squares beside the further columns; 0 before samples suffice."""
        return {name: p[f"{self.prefix}fit{i}"] for i, name in enumerate(self.names)}

    def narrow(self, p: Namespace) -> dict[str, SX]:
        """Return the least squares without the further columns."""
        return {name: p[f"{self.prefix}narrow{i}"] for i, name in enumerate(self.names)}

    def deviations(self, p: Namespace, estimates: Mapping[str, SX]) -> dict[str, SX]:
        """Return the standard deviations of estimates of some of the entries.

        Source: ljung1999 section 9.6; hausman1978.
        """
        factors = consistency.inflation(p, self.count, self.prefix, LEAST_EXCESS)
        own = p[f"{self.prefix}residual"] * stack(p, f"{self.prefix}unit", self.count) * factors**2
        own = ca.if_else(stack(p, f"{self.prefix}distinct", self.count) > 0, own, LARGEST_SD**2)
        fit = self.fit(p)
        square = {
            name: own[self.names.index(name)] + (x - fit[name]) ** 2
            for name, x in estimates.items()
        }
        return {name: ca.sqrt(each) for name, each in square.items()}

    def dilution(self, p: Namespace, name: str, size: SX) -> SX:
        """Return by what share of its size noise in the regressor of an entry may have made it too
        small, at most.

        The true value lies between the least squares and those of the regressor on z, which are
        larger by this share. Source: frisch1934 (bounds by reverse regression).
        """
        unit = p[f"{self.prefix}unit{self.names.index(name)}"]
        return SX(ca.fmin(p[f"{self.prefix}left"] * unit / (size**2 + LEAST_NOISE), LARGEST_SD))

    def misfit(self, p: Namespace, name: str) -> SX:
        """Return the standard deviation of an entry by what the model misses.

        What is left beyond the sensor's noise need not be noise: a saturation, say, is a function
        of the regressors, and part of it lies along them, where it is not seen and does not average
        out. Were all of it along one, it would move the estimate by the root of (sum of squares
        times inverse information). Source: ljung1999 section 8.5 (bias by a model set without the
        true one), 16.6 (residuals against the noise).
        """
        return SX(
            ALONG_SHARE
            * ca.sqrt(p[f"{self.prefix}missed"] * p[f"{self.prefix}unit{self.names.index(name)}"])
        )

    def mean_square(self, p: Namespace, entry: int) -> SX:
        """Return the mean square of a column of the samples."""
        diagonal = p[f"{self.prefix}information{entry * (entry + 3) // 2}"]
        return SX(diagonal / ca.fmax(p[f"{self.prefix}rows"], 1))

    def judge(
        self, p: Namespace, sd: Mapping[str, SX], limits: Mapping[str, SX], possible: SX
    ) -> dict[str, Any]:
        """Return the fields of an `Update` for estimates with these standard deviations, each valid
        below its limit.

        `possible`: 0 where something is known that cannot be, so that the model is refuted.
        """
        adapted = p[f"{self.prefix}adapted"] > 0
        sound = ca.logic_and(adapted, possible)
        valid = {name: ca.logic_and(sound, sd[name] < limit) for name, limit in limits.items()}
        return {
            "sd": dict(sd),
            "valid": valid,
            "adapted": adapted,
            "innovation": p[f"{self.prefix}late"],
        }
