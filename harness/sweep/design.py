"""The runs of a sweep: values of the keys that vary, listed, in a grid or drawn from distributions,
each with every seed.

Distributions are those of scipy.stats, points in the unit cube those of scipy.stats.qmc.
"""

from __future__ import annotations

import ast
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bristle.common.errors import BristleError, suggest
from bristle.common.units import parse_unit
from bristle.harness.scenario.reading import keys_of
from bristle.harness.scenario.vary import SPECS, values_of

Sampling = Literal["lhs", "sobol", "random"]
# Latin hypercube, Sobol' points (scrambled), independent points
SAMPLINGS: tuple[Sampling, ...] = get_args(Sampling)
MOST_RUNS = 10_000_000
DISTRIBUTION = re.compile(r"([A-Za-z_]\w*)\s*(\(.*\))(?:\s+(\S+))?", re.DOTALL)
WRITTEN = f"{SPECS}, or a distribution such as uniform(a, b)"


@dataclass(frozen=True)
class VariedKey:
    """A key of the scenario that varies: its path without quotes; values as overrides, or a
    distribution and its unit.
    """

    path: str
    overrides: tuple[str, ...] = ()
    distribution: Any = None
    unit: str = ""

    def drawn(self, shares: ArrayLike) -> list[str]:
        """Return the overrides whose values have these cumulative probabilities."""
        unit = f" {self.unit}" if self.unit else ""
        return [
            f"{self.path}={value!r}{unit}"
            for value in np.asarray(self.distribution.ppf(shares), dtype=float).tolist()
        ]

    @cached_property
    def numeric(self) -> bool:
        """Whether its values are numbers of one dimension."""
        dimensions = {_dimension(each) for each in self.overrides}
        return not self.overrides or (len(dimensions) == 1 and None not in dimensions)

    def value(self, override: str) -> float | str:
        """Return the value of one of its overrides for a table: a number in SI units, or text."""
        if not self.numeric:
            return override.partition("=")[2].strip()
        number, unit = _number_and_unit(override)
        return float(number) * (parse_unit(unit).factor if unit else 1.0)

    @property
    def meaning(self) -> str:
        """What its values in a table are: text, numbers in SI, or numbers in one of these units."""
        if not self.numeric:
            return "text"
        units = {_number_and_unit(each)[1] for each in self.overrides} or {self.unit}
        [unit] = units if len(units) == 1 else [""]
        return unit if unit and parse_unit(unit).factor == 1.0 else "numbers in SI units"

    def ends(self) -> tuple[str, ...]:
        """Return the overrides that are tried before anything runs: all that are listed, or far out
        and in the middle.
        """
        return self.overrides or tuple(self.drawn((0.001, 0.5, 0.999)))


@dataclass(frozen=True)
class SweepPoint:
    """One run of a sweep: its place, its seed if given, what differs from the scenario's file."""

    index: int
    overrides: tuple[str, ...]
    seed: int | None = None


@dataclass(frozen=True)
class Design:
    """Which runs a sweep has: a grid of all listed values, each of the drawn ones, and each seed;
    `asked` is how it was written.
    """

    asked: tuple[str, ...] = ()
    axes: tuple[VariedKey, ...] = ()
    seeds: tuple[int, ...] = ()
    samples: int = 0
    sampling: Sampling = "lhs"
    sampling_seed: int = 0

    @property
    def runs(self) -> int:
        """How many runs that is."""
        listed = math.prod(len(axis.overrides) for axis in self.axes if axis.overrides)
        return listed * max(1, self.samples) * max(1, len(self.seeds))

    def points(self) -> Iterator[SweepPoint]:
        """Give the runs in their order: seeds change fastest, then the drawn values, then the last
        of the listed ones.
        """
        axes = [axis for axis in self.axes if not axis.overrides]
        columns = [axis.drawn(shares) for axis, shares in zip(axes, self._shares().T, strict=True)]
        drawn = list(zip(*columns, strict=True)) or [()]
        listed = [axis.overrides for axis in self.axes if axis.overrides]
        order = [
            place
            for wanted in (True, False)
            for place, axis in enumerate(self.axes)
            if bool(axis.overrides) is wanted
        ]
        count = itertools.count()
        for chosen in itertools.product(*listed):
            for row in drawn:
                values = tuple(
                    value for _, value in sorted(zip(order, (*chosen, *row), strict=True))
                )
                for seed in self.seeds or (None,):
                    yield SweepPoint(next(count), values, seed)

    def trials(self) -> Iterator[tuple[str, ...]]:
        """Give the overrides that are checked before anything runs: each value of each axis, with
        the others at their first.
        """
        first = [axis.ends()[0] for axis in self.axes]
        yield tuple(first)
        for place, axis in enumerate(self.axes):
            for value in axis.ends()[1:]:
                yield (*first[:place], value, *first[place + 1 :])

    def _shares(self) -> NDArray[np.float64]:
        """Return cumulative probabilities, (samples, drawn axes), in the open interval 0 to 1."""
        from scipy.stats import qmc

        dimensions = sum(not axis.overrides for axis in self.axes)
        if not dimensions:
            return np.empty((1, 0))
        if self.sampling == "random":
            shares = np.random.default_rng(self.sampling_seed).random((self.samples, dimensions))
        else:
            kind = qmc.LatinHypercube if self.sampling == "lhs" else qmc.Sobol
            shares = kind(dimensions, seed=self.sampling_seed).random(self.samples)
        tiny = np.finfo(float).eps
        return np.clip(shares, tiny, 1 - tiny)


def design(
    vary: Sequence[str],
    seeds: Sequence[int] = (),
    samples: int | None = None,
    sampling: Sampling = "lhs",
    sampling_seed: int = 0,
) -> Design:
    """Read which runs are asked for.

    Parameters
    ----------
    vary : sequence of str
        Each ``PATH=SPEC``; a SPEC is ``a:b:n``, a list ``[v1, v2]``, or a distribution by its name
        in scipy.stats: its shape parameters, then scale, or location and scale; ``uniform(a, b)``
        lies between a and b. A unit may follow.
    seeds : sequence of int
        Seeds of the controller's reference; none: that of the file.
    samples : int, optional
        How many values are drawn from the distributions; required with them.
    sampling : {"lhs", "sobol", "random"}
        How they are drawn together.
    sampling_seed : int
        Seed of that.

    Raises
    ------
    BristleError
        If that is no design, or has more than `MOST_RUNS` runs.
    """
    axes = tuple(map(axis_of, vary))
    if sampling_seed < 0:
        raise BristleError(f"sampling_seed {sampling_seed}: must be 0 or more")
    _check_samples(samples, sampling, [axis.path for axis in axes if not axis.overrides])
    asked = Design(tuple(vary), axes, tuple(seeds), samples or 0, sampling, sampling_seed)
    if asked.runs > MOST_RUNS:
        raise BristleError(
            f"vary: {asked.runs} runs; at most {MOST_RUNS} go into one sweep: take fewer values"
        )
    return asked


def _check_samples(samples: int | None, sampling: Sampling, drawn: Sequence[str]) -> None:
    """Refuse a number of samples that does not go with the keys that are `drawn`."""
    if samples is None:
        if drawn:
            raise BristleError(
                f"vary '{drawn[0]}': a distribution; give samples, the number of values that are"
                " drawn"
            )
        return
    if samples < 1:
        raise BristleError(f"samples {samples}: draw at least 1")
    if not drawn:
        raise BristleError(
            f"samples {samples}: no distribution to draw from; leave it out, or vary by one such as"
            " uniform(a, b)"
        )
    if sampling == "sobol" and samples & (samples - 1):
        near = 1 << samples.bit_length()
        raise BristleError(
            f"samples {samples}: Sobol' points come in powers of two; write {near // 2} or {near}"
        )


def _number_and_unit(override: str) -> tuple[str, str]:
    """Return the number of an override and its unit, which may be empty, as texts."""
    number, _, unit = override.partition("=")[2].strip().partition(" ")
    return number, unit


def _dimension(override: str) -> tuple[int, ...] | None:
    """Return the exponents of the unit of an override, None if it is no number with a unit."""
    number, unit = _number_and_unit(override)
    try:
        float(number)
        return parse_unit(unit or "1").exponents
    except ValueError:  # of either
        return None


def axis_of(given: str) -> VariedKey:
    """Return the axis that a ``PATH=SPEC`` stands for."""
    path, separator, spec = (part.strip() for part in given.partition("="))
    match = DISTRIBUTION.fullmatch(spec)
    if not separator or not path or match is None:
        overrides = tuple(values_of(given, WRITTEN))
        return VariedKey(".".join(keys_of(overrides[0].partition("=")[0])), overrides)
    return VariedKey(
        ".".join(keys_of(path)), (), _distribution(given, match[1], match[2]), match[3] or ""
    )


def _distribution(given: str, name: str, arguments: str) -> Any:
    """Return a distribution of scipy.stats with fixed parameters."""
    from scipy import stats

    known = getattr(stats, name, None)
    if not isinstance(known, stats.rv_continuous | stats.rv_discrete):
        names = sorted(
            each
            for each in dir(stats)
            if isinstance(getattr(stats, each), stats.rv_continuous | stats.rv_discrete)
        )
        raise BristleError(
            f"vary '{given}': scipy.stats has no distribution '{name}'{suggest(name, names)}"
        )
    positional, named = _arguments(given, name, arguments)
    if name == "uniform":
        positional = _uniform(given, positional, named)
    frozen = known(**_parameters(given, name, known, positional, named))
    with np.errstate(all="ignore"):
        middle = frozen.ppf(0.5)
    if not np.isfinite(middle):
        raise BristleError(
            f"vary '{given}': scipy.stats.{name} has no values for these parameters; see its"
            " documentation"
        )
    return frozen


def _uniform(given: str, positional: list[float], named: Mapping[str, float]) -> list[float]:
    """Return the parameters of a uniform distribution: people write its ends."""
    if len(positional) == 2:
        return [positional[0], positional[1] - positional[0]]
    if set(named) != {"loc", "scale"}:
        raise BristleError(f"vary '{given}': uniform needs both its ends; write uniform(a, b)")
    return positional


def _parameters(
    given: str, name: str, known: Any, positional: Sequence[float], named: Mapping[str, float]
) -> dict[str, float]:
    """Return the parameters of a distribution by name: shapes, scale, or location and scale."""
    shapes = [] if known.shapes is None else [each.strip() for each in known.shapes.split(",")]
    # what may follow the shapes, by how many numbers do
    discrete = hasattr(known, "pmf")
    more = len(positional) - len(shapes)
    follow: dict[int, tuple[str, ...]] = {1: ("scale",), 2: ("loc", "scale")}
    rest = ({1: ("loc",)} if discrete else follow).get(more, ())
    allowed = [*shapes, "loc", *([] if discrete else ["scale"])]
    order = f"{name}({', '.join([*shapes, *rest]) or ', '.join(allowed)})"
    if more > len(rest) or set(named) - set(allowed):
        raise BristleError(
            f"vary '{given}': its parameters are {', '.join(allowed)}; write for example {order}"
        )
    values = dict(zip([*shapes, *rest], positional, strict=False)) | dict(named)
    missing = [shape for shape in shapes if shape not in values]
    if missing:
        raise BristleError(
            f"vary '{given}': parameter {missing[0]} of {name} is missing; write {order}"
        )
    return values


def _arguments(given: str, name: str, arguments: str) -> tuple[list[float], dict[str, float]]:
    """Return the numbers in brackets, those with names apart."""
    try:
        call = ast.parse(f"f{arguments}", mode="eval").body
        if not isinstance(call, ast.Call):
            raise ValueError
        positional = [float(ast.literal_eval(each)) for each in call.args]
        named = {str(each.arg): float(ast.literal_eval(each.value)) for each in call.keywords}
    except (SyntaxError, ValueError, TypeError, RecursionError, MemoryError):
        raise BristleError(
            f"vary '{given}': its parameters must be plain numbers; write for example {name}(1.0,"
            " 2.0)"
        ) from None
    if not all(map(math.isfinite, [*positional, *named.values()])):
        raise BristleError(f"vary '{given}': its parameters must be finite")
    return positional, named
