"""Compensation of friction and inertia along the reference, from the estimates of an observer."""

from __future__ import annotations

import casadi as ca

from bristle.model.basis import BASIS_COUNT, gaussian
from bristle.model.normalised import OBSERVED
from bristle.model.system import System
from bristle.model.variables import Namespace, Parameter, State, Variable

SX = ca.SX

CITATION = "olsson1998 (compensation by a friction model)"
COMPENSATED = (
    "alpha2",
    "b",
    "Fc",
    *(f"sigma{i}" for i in range(BASIS_COUNT + 1)),
    "c",
    "tau",
    "width",
    "load",
)
TEST_TIME = Parameter(
    "test_time",
    "T_t",
    "s",
    2.0,
    1e-2,
    1e4,
    "time over which the compensation is tested",
    "widrow1985 chapter 11",
)
FADE_TIME = Parameter(
    "fade",
    "T_f",
    "s",
    1.0,
    1e-3,
    1e3,
    "time constant with which an estimate takes effect or loses it",
    CITATION,
)
ASSUMED_C = Parameter(
    "assumed_c",
    "c",
    "1/rad",
    100.0,
    1e-6,
    1e9,
    "inverse presliding distance while none is estimated",
    "dixit2008 eq. (17)",
)
# of a part: friction at low speed may be twice the Coulomb friction that was found at high speed
LARGEST_SHARE = 2.0
# mean relative distance of a gain from its lagged value up to which its part is applied in full; at
# twice that, not
STEADY = 0.1
# of each gain, in its unit; keeps what follows from an estimate near zero finite
LARGEST_GAIN = 1e6
# from the estimates, in volts; each follows its present value with the time constant FADE_TIME
COMPENSATION_GAINS = {
    "inertia": ("V.s2/rad", "voltage over acceleration"),
    "viscous": ("V.s/rad", "voltage over velocity"),
    **{
        f"level{i}": ("V", f"voltage that friction takes: part {i} of its level")
        for i in range(BASIS_COUNT + 1)
    },
    "load": ("V", "voltage that the load torque gives"),
}
LEVELS = tuple(f"level{i}" for i in range(BASIS_COUNT + 1))
# whose steadiness decides about a part
JUDGED_GAINS = {"motion": ("inertia",), "friction": LEVELS, "load": ("inertia",)}


def _over(dividend: SX, divisor: SX) -> SX:
    """Return the quotient, 0 where the divisor is not positive."""
    positive = divisor > 0
    return SX(ca.if_else(positive, dividend / ca.if_else(positive, divisor, 1), 0))


def _gain_targets(given: Namespace) -> dict[str, SX]:
    """Return the gains that the estimates make now; one that is not valid contributes nothing."""

    def where(condition: SX, value: SX) -> SX:
        return SX(ca.if_else(condition, value, 0))

    per_volt = where(given.b_valid, ca.fmin(_over(SX(1), given.b_hat), LARGEST_GAIN))
    whole = ca.logic_and(given.c_valid, given.c_hat > 0)
    for i in range(BASIS_COUNT + 1):
        whole = ca.logic_and(whole, given[f"sigma{i}_valid"])
    levels = {
        f"level{i}": where(whole, _over(given[f"sigma{i}_hat"], given.c_hat))
        for i in range(BASIS_COUNT + 1)
    }
    levels["level0"] = ca.if_else(whole, levels["level0"], where(given.Fc_valid, given.Fc_hat))
    others = {
        "viscous": where(given.alpha2_valid, given.alpha2_hat),
        "load": where(given.load_valid, given.load_hat),
    }
    targets = {"inertia": per_volt} | {
        name: SX(value * per_volt) for name, value in {**others, **levels}.items()
    }
    return {
        name: SX(ca.fmin(ca.fmax(target, -LARGEST_GAIN), LARGEST_GAIN))
        for name, target in targets.items()
    }


def gains(system: System, p: Namespace, given: Namespace) -> tuple[Namespace, dict[str, SX]]:
    """Declare the gains, each a first-order lag behind what the estimates make now.

    Return them and, for each part of the compensation, 1 while its gains are steady, 0 while they
    are not.

    Estimates that wander say nothing about the next second, even where they have compensated the
    last one well.
    """
    targets, faded, averaged = (
        _gain_targets(given),
        1 - ca.exp(-p.sample_time / p.fade),
        1 - ca.exp(-p.sample_time / p.test_time),
    )
    gain = Namespace(
        {
            name: system.sampled(State(f"gain_{name}", unit, meaning))
            for name, (unit, meaning) in COMPENSATION_GAINS.items()
        }
    )
    for name in COMPENSATION_GAINS:
        system.update(f"gain_{name}", gain[name] + faded * (targets[name] - gain[name]))
    steady = {}
    for part, names in JUDGED_GAINS.items():
        wander = system.sampled(
            State(
                f"wander_{part}",
                "1",
                f"mean relative distance of its gains from the lagged ones: {part}",
                initial=1.0,
            )
        )
        away, size = (
            sum(ca.fabs(x) for x in each)
            for each in ([targets[n] - gain[n] for n in names], [gain[n] for n in names])
        )
        now = ca.if_else(size > 0, ca.fmin(_over(away, size), 1), 1)
        system.update(f"wander_{part}", wander + averaged * (now - wander))
        steady[part] = SX(ca.fmin(ca.fmax(2 - wander / STEADY, 0), 1))
    return gain, steady


def parts(
    system: System, p: Namespace, given: Namespace, gain: Namespace, reference: tuple[SX, SX]
) -> dict[str, SX]:
    """Declare the bristle of the model at the reference; return the voltages that the model needs,
    by what they are for.

    b u = (r' + alpha2 r) + (W + tau W') - load with W' = c (G(r) r - |r| W), where `reference`
    [rad/s] is that before and after a sample. G is the level of friction: sigma_i / c and the basis
    functions, or Fc alone where these are not valid. No part is more than the controller may ask
    for.

    Source: olsson1998 (compensation by a friction model); dixit2008 eq. (15) and (17).
    """
    bristle = system.sampled(State("bristle", "V", "friction of the model at the reference"))
    before, after = reference
    speed = (before + after) / 2
    c = ca.if_else(ca.logic_and(given.c_valid, given.c_hat > 0), given.c_hat, p.assumed_c)
    width = ca.if_else(ca.logic_and(given.width_valid, given.width_hat > 0), given.width_hat, 1)
    tau = ca.if_else(given.tau_valid, given.tau_hat, 0)
    level = gain.level0 + sum(
        gain[f"level{i}"] * phi for i, phi in enumerate(gaussian(speed / width), start=1)
    )
    kept = ca.exp(-c * ca.fabs(speed) * p.sample_time)
    following = kept * bristle + (1 - kept) * ca.sign(speed) * level
    system.update("bristle", following)
    voltages = {
        "motion": gain.inertia * (after - before) / p.sample_time + gain.viscous * speed,
        "friction": (bristle + following) / 2 + tau * (following - bristle) / p.sample_time,
        "load": -gain.load,
    }
    return {
        name: SX(ca.fmin(ca.fmax(voltage, -p.u_max), p.u_max)) for name, voltage in voltages.items()
    }


def tested(
    system: System,
    p: Namespace,
    gain: Namespace,
    error: SX,
    voltages: dict[str, SX],
    steady: dict[str, SX],
) -> dict[str, SX]:
    """Return of each part the share that is applied: what has made tracking best recently, while
    the part is steady.

    x_i is how far part i would have moved the velocity, in a closed loop of the estimated b and
    alpha2. Without compensation the error would have been e_0 = e + sum k_i x_i with the shares k_i
    that were applied; the new ones minimise the mean of (e_0 - sum k_i x_i)^2 with exponential
    forgetting, each from 0 to `LARGEST_SHARE`. All 0 is the controller alone.

    Source: widrow1985 chapter 11 (filtered-x algorithm), by least squares with forgetting
    (ljung1999 section 11.2), whose bounded minimum is followed by one sweep over the shares a
    sample (bertsekas1999 section 2.7, coordinate descent).
    """

    def state(name: str, unit: str, meaning: str) -> SX:
        return system.sampled(State(f"test_{name}", unit, meaning))

    def update(name: str, value: SX) -> SX:
        system.update(f"test_{name}", value)
        return value

    h, names, forgetting = p.sample_time, list(voltages), 1 - ca.exp(-p.sample_time / p.test_time)
    whole = gain.inertia + h * (ca.fmax(gain.viscous, 0) + p.kp) + h**2 * p.ki  # all over b
    share, moved = {}, {}
    for name in names:
        share[name] = state(f"share_{name}", "1", f"share of the {name} voltage that is applied")
        meaning = f"velocity that comes from the {name} voltage"
        moved[name] = state(f"moved_{name}", "rad/s", meaning)
        turned = state(f"turned_{name}", "rad", "its integral")
        acting = state(f"acting_{name}", "V", f"the whole {name} voltage")
        momentum = gain.inertia * moved[name] + h * (acting - p.ki * turned)
        new = update(f"moved_{name}", _over(momentum, whole))
        update(f"turned_{name}", turned + h * new)
        update(f"acting_{name}", voltages[name])
    alone = error + sum(share[name] * moved[name] for name in names)

    def averaged(name: str, now: SX) -> SX:
        mean = state(name, "rad2/s2", "recent mean product of velocities")
        return update(name, mean + forgetting * (now - mean))

    with_error = {name: averaged(f"error_{name}", alone * moved[name]) for name in names}
    pairs = [(one, other) for one in names for other in names if one <= other]
    products = {
        (one, other): averaged(f"{one}_{other}", moved[one] * moved[other]) for one, other in pairs
    }
    for name in names:
        others = [other for other in names if other != name]
        rest = sum(share[x] * products[min(name, x), max(name, x)] for x in others)
        unbounded = _over(with_error[name] - rest, products[name, name])
        best = ca.fmin(ca.fmax(unbounded, 0), LARGEST_SHARE)
        share[name] = update(f"share_{name}", steady[name] * best)
    return share


def compensation(
    system: System, p: Namespace, given: Namespace, error: SX, reference: tuple[SX, SX]
) -> SX:
    """Declare the compensation; return its voltage: of each part the share that has proved right,
    while its gain is steady.
    """
    gain, steady = gains(system, p, given)
    voltages = parts(system, p, given, gain, reference)
    share = tested(system, p, gain, error, voltages, steady)
    return SX(sum(share[name] * voltages[name] for name in voltages))


def estimates(system: System) -> Namespace:
    """Declare an estimate and its validity as inputs, by the names of the observer's outputs."""
    symbols = {}
    for name in COMPENSATED:
        unit, meaning = OBSERVED[name]
        hat, valid = f"{name}_hat", f"{name}_valid"
        symbols[hat] = system.input(Variable(hat, unit, f"estimate of {meaning}"))
        symbols[valid] = system.input(
            Variable(valid, "1", f"{hat} counts; otherwise it contributes nothing", boolean=True)
        )
    return Namespace(symbols)
