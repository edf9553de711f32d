"""What extensions and effects are: something a servo may have beside its friction law, as slots
that `servo` composes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from bristle.common.errors import BristleError
from bristle.model.system import System
from bristle.model.variables import Namespace, Parameter, State, Variable
from bristle.plant.law import Friction, FrictionLaw
from bristle.plant.wording import Wording

__all__ = [
    "BOTH_DIRECTIONS",
    "BOTH_SIGNS",
    "DRY_FRICTION",
    "NEEDS",
    "OVER_INERTIA",
    "REVERSALS",
    "Context",
    "Coupling",
    "Effect",
    "Evidence",
    "Extension",
    "Limits",
    "RecordedMotion",
    "power",
]

SX = ca.SX
Array = NDArray[np.float64]
T = TypeVar("T")

VIEWS = {  # quantities that a residual torque may be a function of
    "all": "everywhere, at rest too",
    "v": "velocity",
    "a": "acceleration",
    "u": "input",
    "du": "rate of the input",
    "t": "time",
    "theta": "position",
    "direction": "sign of the velocity",
    "history": "travel since the last reversal",
    "frequency": "frequency, near the resonance",
    "theta x direction": "position, with the sign of the velocity",
    "t x direction": "time, with the sign of the velocity",
    "u x direction": "input, with the sign of the velocity",
}


BOTH_DIRECTIONS, REVERSALS, BOTH_SIGNS = (
    "motion in both directions",
    "reversals",
    "an input of both signs",
)
# what records may lack so that an effect is indistinguishable from others
NEEDS = (BOTH_DIRECTIONS, REVERSALS, BOTH_SIGNS)

# normalised parameters that grow with the dry friction
DRY_FRICTION = ("Fc", "sigma0", "sigma1", "sigma2")
# normalised parameters that have the inertia below them
OVER_INERTIA = ("alpha2", "b", "load", *DRY_FRICTION)
LONGEST_DELAY = 40  # sampling periods kept by what delays a measurement (1)

LARGEST_SPEED_SHARE = 0.25  # largest Stribeck velocity over the top speed (1)
COMMON_SPEEDS = 1 - 0.05  # share of the samples whose speed is below the top speed (1)
RESONANCE_WINDOW = 4.0  # s: length of the windows over which a spectrum is averaged
PEAK_PROMINENCE = 1.0  # of the logarithm of the power: least of a peak above what surrounds it
FLAT = 1e-9  # smallest value whose logarithm is taken (1)


def power(x: SX, exponent: SX) -> SX:
    """Return |x|^exponent, whose derivative by the exponent exists at x = 0 too."""
    return ca.exp(exponent * ca.log(ca.fmax(ca.fabs(x), FLAT)))


@dataclass(frozen=True)
class Context:
    """What a slot sees: its own parameters and states as p.amplitude, the servo's as p.J; position
    and velocity of the side it acts on, the input as it arrives at the slot, time, and the motor
    torque."""

    p: Namespace
    theta: SX
    v: SX
    u: SX
    time: SX
    torque: SX


@dataclass(frozen=True)
class Coupling:
    """A second inertia: its share of the servo's J, the torque [N.m] of the motor side, and the
    share of the servo's friction that acts on it.
    """

    share: SX
    torque: SX
    friction: SX | None = None


@dataclass(frozen=True)
class Evidence:
    """A measured motion and what a model without the effect leaves of it, for starting values.

    Attributes
    ----------
    theta, v, a, u, time : ndarray, shape (n,)
        Position, velocity, acceleration (smoothed) and input of all records, one after the other.
    h, resolution : float
        Sampling period [s]; step of the position [rad].
    inertia, level, gain : float
        Fitted inertia [kg.m2], dry friction [N.m] and torque over input.
    regress : function
        Coefficients (k,) of torques (n, k) [N.m] in what the model leaves, and the log-likelihood
        they gain [nats].
    turn : float
        Path after which a motion begins anew: one turn or, on a linear axis, the range that was
        travelled.
    """

    theta: Array
    v: Array
    a: Array
    u: Array
    time: Array
    h: float
    resolution: float
    inertia: float
    level: float
    gain: float
    regress: Callable[[Array], tuple[Array, float]]
    turn: float = 2 * np.pi

    def coefficient(self, torque: Array) -> float:
        """Return the coefficient of a torque (n,) [N.m] in what the model leaves."""
        return float(self.regress(torque[:, None])[0][0])

    def resonances(self, count: int) -> list[float]:
        """Return the frequencies [Hz] at which the torque that an inertia with dry friction lacks
        has its highest peaks.

        At most `count`, the highest first; from four periods in a window upwards. Source: welch1967
        (averaged spectrum).
        """
        # only where it is needed: its import takes half a second
        from scipy.signal import find_peaks, welch

        lacking = self.inertia * self.a + self.level * np.sign(self.v) - self.gain * self.u
        window = min(len(lacking), round(RESONANCE_WINDOW / self.h))
        frequency, power = welch(lacking, fs=1 / self.h, nperseg=window)
        peaks, _ = find_peaks(np.log(power[4:] + 1e-300), prominence=PEAK_PROMINENCE)
        highest = 4 + peaks[np.argsort(-power[4:][peaks], kind="stable")[:count]]
        return [float(x) for x in frequency[highest]]

    def waves(self, least: int, most: int) -> list[float]:
        """Return the numbers of periods [1/rad] of which so many fit into a turn."""
        return [2 * np.pi / self.turn * n for n in range(least, most + 1)]

    def best(
        self, options: Sequence[float], columns: Callable[[float], Array], count: int
    ) -> list[tuple[float, Array]]:
        """Return the options whose torques gain most, with their coefficients; the best first."""
        found = [(*self.regress(columns(option)), option) for option in options]
        found.sort(key=lambda each: -each[1])
        return [(option, coefficients) for coefficients, _, option in found[:count]]


@dataclass(frozen=True)
class RecordedMotion:
    """What the records of a diagnosis contain, for limits of parameters.

    Attributes
    ----------
    theta, v, u, time : ndarray, shape (n,)
        Position [rad], velocity [rad/s], input [V] and time [s] of all records, one after the
        other.
    turn : float
        Path after which a motion begins anew [rad]: one turn or, on a linear axis, the range
        travelled.
    segment : float
        Length of the segments that are simulated [s].
    linear : bool
        True for a linear axis.
    """

    theta: Array
    v: Array
    u: Array
    time: Array
    turn: float
    segment: float
    linear: bool

    @property
    def slow(self) -> tuple[float, float]:
        """The interval of speeds at which what falls with the speed has fallen by the top speed."""
        return 0.0, LARGEST_SPEED_SHARE * float(np.quantile(np.abs(self.v), COMMON_SPEEDS))

    @property
    def two_periods(self) -> float:
        """The number of periods [1/rad] of which two fit into a turn or the range travelled."""
        return 2 * 2 * np.pi / self.turn


Limits = dict[str, tuple[float, float]]  # intervals by short names of parameters


@dataclass(frozen=True)
class Extension:
    """What a servo may have beside its friction law; each slot is a function of a `Context`, and
    what is None is not touched.

    Attributes
    ----------
    description : str
        What it is, in a sentence's part.
    source : str
        Where its equation comes from: a key of references.bib.
    parameters : tuple of Parameter
        Its parameters, called ``name.parameter``.
    order : int
        Extensions act in the order of (order, name), whatever the order they are given in.
    load_side : bool
        With a second inertia, `torque` acts on the load and sees its motion, otherwise the motor's.
    without_truth : tuple of str
        Normalised parameters that have no true value beside it: it makes them vary, or changes what
        an observer should find.
    states, rates : tuple of State, function
        Own continuous states and their derivatives; the context is that of its input map.
    follow : function
        Values of own continuous states without rates at the end of an internal step; arguments the
        context at its start, the position and the velocity at its end.
    recorded : function
        Values of all own states from a recorded motion: its context also has the acceleration
        as ``p.a``, the inputs of the sample before and of the record's first one as ``p.u_before``
        and ``p.u_first``, and the integral of u - theta [rad.s] as ``p.error_sum``.
    inputs : tuple of Variable
        Own inputs, which its functions see as ``p.name``.
    inertia : function
        Factor on the inertia of the servo.
    sampled, updates : tuple of State, function
        Own sampled states, updated before an interval is integrated. The `initial` of a state may
        be a function of the parameters.
    command : function
        Map of the input before the drive's limit u_max.
    drive : function
        Map of the input after the limit.
    torque : function
        Torque added [N.m].
    load : function
        Constant torque within `torque` [N.m], which an observer is to find as the load.
    factor : function
        Factors (for forward, for backward motion) on the dry friction of the law. A set-valued law
        gets two bounds; a smooth law chooses by the sign of its friction force, so that the product
        stays continuous.
    bound : function
        Dry-friction torque added [N.m], against forward and backward motion. A smooth law grows by
        it in proportion to its Fc.
    output : function
        Position and velocity that are measured.
    delay : function
        Delay of what is measured, in sampling periods.
    coupling : function
        Second inertia behind the motor; arguments context, twist (motor - load) and its rate.
    bristles : function
        Stiffness [N.m/rad] and damping [N.m.s/rad] of bristles that stand in for set-valued
        friction.
    file : str
        File of a plug-in, for errors in its equations.
    """

    name: str
    description: str
    source: str
    parameters: tuple[Parameter, ...] = ()
    order: int = 0
    load_side: bool = False
    without_truth: tuple[str, ...] = ()
    states: tuple[State, ...] = ()
    rates: Callable[[Context], dict[str, SX]] | None = None
    follow: Callable[[Context, SX, SX], dict[str, SX]] | None = None
    recorded: Callable[[Context], dict[str, SX]] | None = None
    inputs: tuple[Variable, ...] = ()
    inertia: Callable[[Context], SX] | None = None
    sampled: tuple[State, ...] = ()
    updates: Callable[[Context], dict[str, SX]] | None = None
    command: Callable[[Context], SX] | None = None
    drive: Callable[[Context], SX] | None = None
    torque: Callable[[Context], SX] | None = None
    load: Callable[[Context], SX] | None = None
    factor: Callable[[Context], tuple[SX, SX]] | None = None
    bound: Callable[[Context], tuple[SX, SX]] | None = None
    output: Callable[[Context], tuple[SX, SX]] | None = None
    delay: Callable[[Context], SX] | None = None
    coupling: Callable[[Context, SX, SX], Coupling] | None = None
    bristles: Callable[[Context], tuple[SX, SX]] | None = None
    file: str = field(default="", compare=False)


@dataclass(frozen=True, kw_only=True)
class Effect(Extension):
    """An extension that a diagnosis can find missing: what it looks like in records, and how a
    diagnosis searches for it.

    Attributes
    ----------
    title : str
        What it is, in two to five words; this, `description`, `excitation`, `separation` and the
        descriptions of the parameters may have the placeholders of a `Wording`.
    group : str
        Name of its class: the effects that data may not distinguish, joined by a slash.
    equation : str
        The equation in one line of text.
    residual : tuple of str
        What the residual torque of a model without the effect is a function of: keys of `VIEWS`.
    excitation : str
        What a record must contain to show the effect.
    needs : tuple of str
        What of `NEEDS` the records must contain: without it they cannot show the effect, or only as
        another one.
    confounded : tuple of str
        Names of the effects it is easily taken for.
    timing : str
        How it depends on time: "event" if it happens once, "course" if it goes on, empty if it does
        not.
    sparse : bool
        True if it only acts beyond a limit, so that it may show in a few segments of a record.
    nonsmooth : bool
        True if it switches, so that a fit along derivatives ends at one of many small maxima.
    free_play : str
        Of a coupling: its parameter, by a short name, that says how far the load can move by
        itself.
    shape_starts : tuple of mapping
        Parameters, by short names, of its shape, which do nothing at their defaults: a fit frees
        them last, from each of these start values.
    second_term : tuple of str
        Parameters, by short names, of a second term, which is zero while the first of them is at
        its default.
    off : mapping
        Values, by short names, of parameters at which the whole effect does nothing; empty if there
        are none.
    unused : mapping
        Values, by short names, at which an optional part does nothing, such as a stop that is never
        reached.
    search_interval : mapping
        Intervals, by short names, in which a fit looks for parameters where that is narrower than
        what can be simulated.
    limits, credible : function
        Intervals of parameters, by short names, from a `RecordedMotion`: how far they may move, and
        beyond which values the effect is named only with a stronger likelihood gain.
    hardware : mapping
        Intervals, by short names, beyond which no hardware is known: an effect of such a size is
        suspected, and not named.
    once_per_turn : bool
        True if it repeats with each turn of a shaft, so that a linear axis does not have it.
    periods : str
        Its parameter, by a short name, that gives the periods in a turn [1/rad], if it repeats
        along the position.
    excluded : function
        Why the servo cannot lack it beside a friction law that has it already, as a text; empty
        where it can.
    separation : str
        What to measure to distinguish the effects of its class (stated by one effect of the class).
    rigid_friction : bool
        True for the one effect whose bristles, too stiff for the sensor to see, are part of each
        simulation of set-valued friction in a diagnosis: without them each effect would be fitted
        to the last digits of sticking.
    starts : function
        Starting values from data: for each start the parameters that a fit may move, by their short
        names.
    """

    title: str
    group: str
    equation: str
    residual: tuple[str, ...]
    excitation: str
    confounded: tuple[str, ...]
    needs: tuple[str, ...] = ()
    timing: str = ""
    sparse: bool = False
    nonsmooth: bool = False
    free_play: str = ""
    shape_starts: tuple[Mapping[str, float], ...] = ()
    second_term: tuple[str, ...] = ()
    off: Mapping[str, float] = field(default_factory=dict)
    unused: Mapping[str, float] = field(default_factory=dict)
    search_interval: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    limits: Callable[[RecordedMotion], Limits] | None = None
    credible: Callable[[RecordedMotion], Limits] | None = None
    hardware: Limits = field(default_factory=dict)
    once_per_turn: bool = False
    periods: str = ""
    excluded: Callable[[FrictionLaw], str] | None = None
    separation: str = ""
    rigid_friction: bool = False
    starts: Callable[[Evidence], list[dict[str, float]]] | None = None

    def worded(self, wording: Wording) -> Effect:
        """Return the effect with the words for an axis in its texts."""
        parameters = tuple(
            replace(p, description=wording.fill(p.description)) for p in self.parameters
        )
        return replace(
            self,
            description=wording.fill(self.description),
            title=wording.fill(self.title),
            excitation=wording.fill(self.excitation),
            separation=wording.fill(self.separation),
            parameters=parameters,
        )

    @property
    def strength(self) -> Parameter:
        """Its first parameter, which says how strong it is."""
        return self.parameters[0]

    @property
    def decisive(self) -> Parameter:
        """What must be known for it to be told from others: its strength, or the free play, without
        which it is a shaft.
        """
        return next(
            (p for p in self.parameters if p.name == f"{self.name}.{self.free_play}"), self.strength
        )

    @property
    def strengths(self) -> tuple[str, ...]:
        """Full names of all parameters that must vanish for it to do nothing, or of the `decisive`
        one.
        """
        return tuple(self.by_full_name(self.off)) if len(self.off) > 1 else (self.decisive.name,)

    @property
    def shape_parameters(self) -> frozenset[str]:
        """Short names of the parameters of its shape."""
        return frozenset(short for start in self.shape_starts for short in start)

    @property
    def optional_parameters(self) -> frozenset[str]:
        """Short names of the parameters of a second term and of its shape."""
        return self.shape_parameters.union(self.second_term)

    @property
    def position_dependent(self) -> bool:
        """Whether its residual is a function of the position."""
        return any("theta" in view for view in self.residual)

    @property
    def inactive_values(self) -> dict[str, float]:
        """Values, by full names, at which its optional parameters do nothing."""
        defaults = {
            p.name: p.default
            for p in self.parameters
            if p.name.removeprefix(f"{self.name}.") in self.optional_parameters
        }
        return defaults | self.by_full_name(self.unused)

    def by_full_name(self, values: Mapping[str, T]) -> dict[str, T]:
        """Return values given by short names of parameters by their full names."""
        return {f"{self.name}.{short}": value for short, value in values.items()}


E = TypeVar("E", bound=Extension)


def arrange(effects: Sequence[E]) -> list[E]:
    """Return the effects in the order in which they act; raise `BristleError` for those that
    exclude each other.
    """
    names = [effect.name for effect in effects]
    for name in names:
        if names.count(name) > 1:
            raise BristleError(f"effect '{name}' is given twice; give it once")
    for slot, what in (
        ("coupling", "put a second inertia behind the motor"),
        ("bristles", "put bristles under the friction"),
    ):
        both = sorted(effect.name for effect in effects if getattr(effect, slot) is not None)
        if len(both) > 1:
            raise BristleError(
                f"effects '{both[0]}' and '{both[1]}' both {what}; choose one of them"
            )
    return sorted(effects, key=lambda effect: (effect.order, effect.name))


@dataclass(frozen=True)
class _Ways:
    """What holds for forward and for backward motion; `even` where both are the same expression."""

    forward: SX
    backward: SX
    even: bool

    def joined(self, other: _Ways, join: Callable[[SX, SX], SX]) -> _Ways:
        """Return what a function makes of this and another, each way."""
        forward, even = join(self.forward, other.forward), self.even and other.even
        return _Ways(forward, forward if even else join(self.backward, other.backward), even)


class Effects:
    """The effects of one servo at work: its slots in turn, each with what is computed so far."""

    def __init__(self, system: System, effects: Sequence[Extension], theta: SX, v: SX) -> None:
        self._system, self._effects = system, effects
        self._seen = Context(system.namespace(), theta, v, SX(0), system.time, SX(0))

    def having(self, slot: str, **seen: SX) -> Iterator[tuple[Extension, Context]]:
        """Yield the effects that fill a slot, with what they see."""
        for effect in self._effects:
            if getattr(effect, slot) is not None:
                yield (
                    effect,
                    replace(self._seen, p=self._system.namespace(f"{effect.name}."), **seen),
                )

    def input(self, slot: str, u: SX) -> SX:
        """Send the input through the maps of a slot, and give their states their equations."""
        for effect, c in self.having(slot):
            here = replace(c, u=u)
            for name, rate in (effect.rates(here) if effect.rates else {}).items():
                self._system.rate(f"{effect.name}.{name}", rate)
            for name, value in (effect.updates(here) if effect.updates else {}).items():
                self._system.update(f"{effect.name}.{name}", value)
            u = getattr(effect, slot)(here)
        return u

    def torque(self, start: SX, load_side: bool, theta: SX, v: SX) -> SX:
        """Add the torques of one side, which moves with theta and v."""
        for effect, c in self.having("torque", theta=theta, v=v):
            if effect.torque is not None and effect.load_side is load_side:
                start = start + effect.torque(c)
        return start

    def inertia(self, j: SX) -> SX:
        """Return the inertia of the servo."""
        for effect, c in self.having("inertia"):
            assert effect.inertia is not None
            j = effect.inertia(c) * j
        return j

    def load(self) -> SX:
        """Return the constant torque that acts as a load."""
        return sum(
            (effect.load(c) for effect, c in self.having("load") if effect.load is not None), SX(0)
        )

    def friction(
        self, law: FrictionLaw, friction: Friction, scale: SX, motor: SX, inertia: SX
    ) -> tuple[SX, SX | None, SX | None]:
        """Return (friction torque, bound of set-valued friction, bound against backward motion
        where it differs).
        """
        smooth = friction.bound is None and not SX(friction.force).is_zero()
        if friction.bound is None and not smooth:
            self._refuse("factor", f"scales dry friction, which law '{law.name}' does not have")
        factor, added = self._factor(scale), self._added(motor)
        if smooth and added is not None:
            if "Fc" not in friction.true:
                self._refuse("bound", f"needs a law with a Coulomb level Fc, not '{law.name}'")
            level = friction.true["Fc"] * inertia
            factor = factor.joined(added, lambda own, more: own + more / level)
        if smooth:
            share = factor.forward
            if not factor.even:
                share = ca.if_else(friction.force > 0, factor.forward, factor.backward)
            return share * friction.force, None, None
        force = scale * friction.force
        if friction.bound is None and added is None:
            return force, None, None
        own = SX(0) if friction.bound is None else friction.bound
        more = added if added is not None else _Ways(SX(0), SX(0), even=True)
        bound = factor.joined(more, lambda share, extra: share * own + extra)
        return force, bound.forward, None if bound.even else bound.backward

    def _refuse(self, slot: str, why: str) -> None:
        """Raise `BristleError` if an effect fills a slot that the law has no use for."""
        for effect, _ in self.having(slot):
            raise BristleError(f"effect '{effect.name}' {why}; choose another law")

    def _factor(self, scale: SX) -> _Ways:
        """Return the factor of the friction."""
        found = _Ways(scale, scale, even=True)
        for effect, c in self.having("factor"):
            assert effect.factor is not None
            up, down = effect.factor(c)
            found = found.joined(_Ways(up, down, up is down), lambda own, more: own * more)
        return found

    def _added(self, motor: SX) -> _Ways | None:
        """Return the friction that is added to the bound; None if no effect adds any."""
        found = [e.bound(c) for e, c in self.having("bound", torque=motor) if e.bound is not None]
        more, back = (sum((bounds[side] for bounds in found), SX(0)) for side in (0, 1))
        return _Ways(more, back, all(up is down for up, down in found)) if found else None

    def bristles(self, law: FrictionLaw, bound: SX | None) -> tuple[SX, SX] | None:
        """Return (stiffness, damping) of bristles where an effect puts them under the law's
        set-valued friction.
        """
        for effect, c in self.having("bristles"):
            if law.states:
                own = "which has bristles of its own; set its parameters"
                raise BristleError(f"effect '{effect.name}' cannot join law '{law.name}', {own}")
            if bound is None:
                raise BristleError(
                    f"effect '{effect.name}' needs dry friction, which law '{law.name}' does not"
                    " have; choose another law"
                )
            assert effect.bristles is not None
            return effect.bristles(c)
        return None

    @property
    def coupled(self) -> bool:
        """True if there is a second inertia."""
        return any(True for _ in self.having("coupling"))

    def couple(self, twist: SX, rate: SX) -> Coupling:
        """Return the second inertia, of which there must be one."""
        [(effect, c)] = self.having("coupling")
        assert effect.coupling is not None
        return effect.coupling(c, twist, rate)

    def follow(self, theta: SX, v: SX) -> None:
        """Give the states of the effects that follow the motion their values, from where it is at
        the end of a step.
        """
        for effect, c in self.having("follow"):
            assert effect.follow is not None
            for name, value in effect.follow(c, theta, v).items():
                self._system.follow(f"{effect.name}.{name}", value)

    def shown(self, theta: SX, v: SX) -> tuple[SX, SX]:
        """Return the position and velocity that are measured."""
        for effect, c in self.having("output"):
            assert effect.output is not None
            theta, v = effect.output(replace(c, theta=theta, v=v))
        return theta, v

    def delay(self) -> SX | None:
        """Return the delay of what is measured [sampling periods], None without one."""
        for effect, c in self.having("delay"):
            assert effect.delay is not None
            return effect.delay(c)
        return None
