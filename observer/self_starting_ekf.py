"""A joint filter from position alone: it computes its own start, adapts its noise and restarts when
the servo changes.

What makes an extended Kalman filter converge here within seconds, without start values:

- coordinates: the friction levels G_i = sigma_i / c in the place of sigma_i, and ln c. The levels
  are identifiable while sliding, whatever c is, and the error of c then has one sign;
- a start by least squares on the data so far, for alpha2, b, Fc and the load torque, once the
  motion has reversed;
- noise and memory that follow what has been excited, not the clock (excitation.py): process noise
  that decays as reversals accumulate, and a memory that grows with them, so that data taken with a
  poor linearisation are forgotten;
- bounds that move all entries, as the covariance relates them (kalman.bounded).

Beside the friction parameters it estimates what else acts on a rig: a load torque, a delay of the
measurement, and how much wider the Stribeck curve is than the nominal basis functions. Where the
innovations are larger than their covariance predicts, the position gets less weight, as in a fit of
the whole record. The standard deviations are those of the filter, enlarged as much as the estimates
move more than it claims (consistency.py); an estimate is valid while its standard deviation is
small and the innovations are about what the sensor alone explains.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from bristle.model.normalised import units
from bristle.model.variables import Namespace, Parameter, State, declaring
from bristle.observer import consistency, excitation, information, kalman, rls
from bristle.observer.kalman import MOTION_STATES
from bristle.observer.method import (
    EquationContext,
    Method,
    Sample,
    Update,
    stack,
    unstack,
    vector_states,
)

SX = ca.SX
ESTIMATES = units(
    "alpha2", "b", "Fc", "sigma0", "sigma1", "sigma2", "c", "tau", "width", "load", "delay"
)
GROWING = "ljung1983 chapter 5 (forgetting that fades)"
ADAPTIVE = "mehra1970"
REGRESSION_CITATION = "ljung1999 section 11.2"
CHANGE_CITATION = "basseville1993 chapter 2"
# places in the vector
V, W, ALPHA2, DRIVE = 1, 2, 3, 4
LEVELS = (5, 6, 7)
LN_C, TAU, LOAD, DELAY, LN_WIDTH = 8, 9, 10, 11, 12
ORDER = LN_WIDTH + 1
PARAMETER_COUNT = ORDER - MOTION_STATES
INPUTS_KEPT = 4  # the longest delay is one sample less
START_COLUMNS = 5  # of the regression behind a start: -v, u, -sgn v, 1, v'
# Start: what must be known before it, and the uncertainty it is given.
MIN_DETERMINANT = 0.02  # determinant of the correlations of -v, u and -sgn v
LONGEST_START = 5.0  # s of motion after which the filter starts in any case
START_REVERSALS = 2.0  # of the motion before a start
START_GATE = 0.17  # of the rms speed, above which data count for a start
# share of the information added to its diagonal; shrinks what the start data do not determine
RIDGE = 1e-3
LEVEL = (0.1, 2.0)  # bounds of Fc over the rms drive acceleration b u
LEAST_VISCOUS = 0.05  # of alpha2: acceleration at the rms speed over that of the drive
# sd over rms speed, over b, over Fc at the rms speed, over Fc
START_SD = {"v": 0.5, "b": 0.2, "alpha2": 0.5, "load": 0.3}
SMALLEST_LEVEL = 0.01  # of Fc at the start
# the same, upper limits: of Coulomb friction, and of the weights of the basis functions (either
# sign)
LARGEST_LEVEL = (4.0, 10.0)
# samples in which the presliding distance of the start is passed at the rms speed, at least
PASSED_SAMPLES = 10.0
# factors by which c may differ from its start value; a far too large c is not corrected by data
C_REACH, EARLY_C_REACH = 1e3, 10.0
LONGEST_TAU = 1.0  # s
WIDTH_REACH = 2.5  # ln of the factor by which the basis functions may be wider or narrower
# Process noise as a function of the innovations.
# mean squared innovation over its variance up to which the model counts as right
CONSISTENT_RATIO = 1.05
FULL_MISFIT = 0.3  # excess over that ratio at which the misfit counts in full
RECENT_MEAN_LIMIT = 2.0  # recent mean up to which the model may be right; one more is full misfit
LEAST_NOISE_SHARE = 1e-5  # share of the process noise that stays when the model is right
# share of the process noise while the model is wrong, or not yet known to be right
DOUBT_NOISE_SHARE = 2e-3
EARLY_QUANTUM = 10.0  # how much less a position counts at a start
# 1/s, variance over Fc^2 by which the load torque may drift; the loads that are asked for are
# constant
LOAD_NOISE = 1e-8
MISFIT_LOAD_NOISE = 1e-3  # 1/s, the same where the model is wrong
JUDGED_AFTER = 5.0  # s after a start from which the innovations are evaluated
MEAN_AGE = 2.0  # s: recent innovations are compared with their mean of one to two such times before
# from, to [s] after a start, recent mean: above it throughout, the filter is lost
LOST_CRITERION = (2.0, 3.0, 100.0)
FIRST_MEMORY = 1.0  # s
SHARED_COUNT = 100.0  # samples with the same count, at most, that share one rounding error
FADING_POWER = 8  # power of time with which the early noise decays
UNTRUSTED_TIME = 10.0  # s after a start during which the model never counts as right
CHANGE_SEARCH_AFTER = 10.0  # s after a start from which changes of the servo are looked for
# s, over which the innovations are compared with the sensor: at a start, and late
SENSOR_MEAN_TIME = (0.3, 20.0)
# most that one squared innovation counts over the variance of the sensor
LARGEST_SENSOR_RATIO = 100.0
# standard deviation of a valid estimate, over the estimate; of sigma_i over c times the Coulomb
# level
VALID_ERROR = 0.07
SHAPE = ("sigma1", "sigma2", "width")  # what another Stribeck curve than the model's shows in first
# mean squared innovation over the variance of the sensor up to which these are valid
SHAPE_LIMIT = 1.35
# standard deviation of what may be zero: s, 1, samples
VALID_SHIFT = {"tau": 1e-3, "width": 0.1, "delay": 0.1}


@dataclass(frozen=True)
class _Start:
    """Where the filter starts from, once `ready`; `spread`: standard deviations, `drive`: rms
    acceleration by the input.
    """

    ready: SX
    joint: SX
    spread: SX
    level: SX
    drive: SX


@dataclass(frozen=True)
class _Step:
    """What a sample makes of the filter; `size`: squared innovation over its variance, `sensor`:
    over that of the sensor alone.
    """

    joint: SX
    covariance: SX
    size: SX
    sensor: SX
    lost: SX  # variance that the sample took from each parameter


@dataclass(frozen=True)
class _Observed:
    """The motion after a sample; `seen`: information of the samples that a start is taken from,
    `reversals`: how often the motion has reversed since one is looked for.
    """

    row: rls.RegressionSample
    seen: SX
    excited: excitation.SampleExcitation
    reversals: SX
    rest: SX
    rests: SX


def _servo(entries: SX) -> kalman.ServoParameters:
    """Read the parameters from (alpha2, b, G0, G1, G2, ln c, tau, load, delay, ln width)."""
    alpha2, b, *levels, ln_c, tau, load, delay, ln_width = ca.vertsplit(entries)
    c = ca.exp(ln_c)
    return kalman.ServoParameters(
        alpha2, b, [c * level for level in levels], c, tau, load, delay, ca.exp(ln_width)
    )


def _start(p: Namespace, s: Sample, r: rls.RegressionSample, seen: SX, reversals: SX) -> _Start:
    """Solve the least squares of L v' = -alpha2 L v + b L u - Fc L sgn v + L d, and return how far
    each entry may be off.

    Source: ljung1999 section 11.2; dixit2008 eq. (23), with the load torque d.
    """
    count = ca.fmax(p.moving + s.period, s.period)
    factors = information.Factors(seen + RIDGE * ca.diag(ca.diag(seen)))
    distinct = factors.d[1] * factors.d[2] / ca.fmax(seen[1, 1] * seen[2, 2], 1e-300)
    alpha2, b, friction, load = ca.vertsplit(factors.regression())
    speed = ca.fmax(ca.sqrt(seen[0, 0] * s.period / count), 1e-9)
    drive = ca.fabs(b) * ca.sqrt(seen[1, 1] * s.period / count)
    level = ca.fmax(ca.fmin(ca.fmax(friction, LEVEL[0] * drive), LEVEL[1] * drive), 1e-12)
    alpha2 = ca.fmax(alpha2, LEAST_VISCOUS * drive / speed)
    # a larger c would not be corrected by data
    ln_c = ca.log(ca.fmin(p.c_start, 1 / (PASSED_SAMPLES * speed * s.period)))
    ln_c = ca.if_else(p.resumes > 0, p[f"mean{LN_C - MOTION_STATES}"], ln_c)
    load = ca.fmax(ca.fmin(load, level), -level)
    moving = (s.y1 + p.resolution / 2, -r.h[0], 0)
    joint = ca.vertcat(*moving, alpha2, b, level, 0, 0, ln_c, 0, load, 0, ca.log(p.width_start))
    viscous = START_SD["alpha2"] * level / speed
    motion = (p.resolution, START_SD["v"] * speed, level)
    levels = (level, level, level)
    rest = (p.c_spread, p.tau_spread, START_SD["load"] * level, p.delay_spread, p.width_spread)
    spread = ca.vertcat(*motion, viscous, START_SD["b"] * ca.fabs(b), *levels, *rest)
    enough = ca.logic_or(distinct > MIN_DETERMINANT, count > LONGEST_START)
    ready = ca.logic_and(ca.logic_and(count > p.start_time, enough), reversals >= START_REVERSALS)
    return _Start(ready, joint, spread, level, drive)


def _remembered(p: Namespace, covariance: SX, time: SX) -> SX:
    """Return P after forgetting: it grows by k h / age, which weights the past by (age / now)^k.

    It does not grow beyond what a start would give, where nothing is learnt.
    Source: ljung1983 chapter 5.
    """
    prior = stack(p, "prior", ORDER)
    known = SX(1)
    for i in range(MOTION_STATES, LOAD):
        known = ca.logic_and(known, covariance[i, i] <= prior[i] ** 2)
    memory = ca.fmin(p.age, p.longest_memory) + FIRST_MEMORY
    return covariance * (1 + ca.if_else(known, p.memory * time / memory, 0))


def _filter(p: Namespace, s: Sample, time: SX) -> _Step:
    """Advance the filter by a sample, of which `time` counts as excited.

    Source: jazwinski1970 chapter 8; ljung1983 chapter 5; mehra1970 (noise from innovations).
    """
    h = s.period
    inputs = ca.vertcat(s.u, *(p[f"input{i}"] for i in range(1, INPUTS_KEPT)))
    z, covariance = kalman.predict(_servo, *kalman.read(p, ORDER), inputs, h)
    covariance = _remembered(p, covariance, time)
    of_mean = (p.innovation_mean - CONSISTENT_RATIO) / FULL_MISFIT
    of_late = p.innovation_late - RECENT_MEAN_LIMIT
    misfit = ca.fmin(ca.fmax(ca.fmax(of_mean, of_late), 0), 1)
    early = 1 / (1 + (p.age / p.early_time) ** FADING_POWER)
    doubt = 1 / (1 + (p.age / UNTRUSTED_TIME) ** FADING_POWER)
    noise = p.drive**2 * (
        ca.fmax(DOUBT_NOISE_SHARE * ca.fmax(misfit, doubt), LEAST_NOISE_SHARE)
        + p.early_noise * early
    )
    rates = [SX(0)] * ORDER
    rates[V], rates[W] = p.noise_v * noise, p.noise_w * noise
    rates[LOAD] = p.level**2 * (LOAD_NOISE + MISFIT_LOAD_NOISE * misfit)
    same = ca.fmin(ca.fmax(p.resolution / ca.fmax(ca.fabs(z[V]) * h, 1e-12), 1), SHARED_COUNT)
    quantum = kalman.rounding(p.resolution) * same
    variance = quantum * (1 + p.misfit_noise * misfit + EARLY_QUANTUM * early)
    error = s.y1 + p.resolution / 2 - z[0]
    ended = ca.if_else(p.rest < excitation.FRESH_TIME, p.drifted, 0)
    before = kalman.moved_again(kalman.noisy(covariance, rates, h), ended, LOAD)
    z, covariance, size = kalman.correct(z, before, error, variance, p.gate)
    lost = ca.diag(before - covariance)[MOTION_STATES:]
    return _Step(
        kalman.bounded(z, covariance, *_bounds(p)), covariance, size, error**2 / quantum, lost
    )


def _bounds(p: Namespace) -> tuple[dict[int, SX], dict[int, SX]]:
    """Return the lowest and the highest values of the entries that have some."""
    reach = ca.log(ca.if_else(p.age < JUDGED_AFTER, EARLY_C_REACH, C_REACH))
    low = {
        ALPHA2: SX(0),
        LEVELS[0]: SMALLEST_LEVEL * p.level,
        LN_C: p.ln_c - reach,
        TAU: SX(0),
        DELAY: SX(0),
        LN_WIDTH: ca.log(p.width_start) - WIDTH_REACH,
    }
    low |= {place: -LARGEST_LEVEL[1] * p.level for place in LEVELS[1:]}
    high = {place: LARGEST_LEVEL[min(i, 1)] * p.level for i, place in enumerate(LEVELS)}
    high |= {
        LN_C: p.ln_c + reach,
        TAU: SX(LONGEST_TAU),
        DELAY: SX(INPUTS_KEPT - 1),
        LN_WIDTH: ca.log(p.width_start) + WIDTH_REACH,
    }
    return low, high


def _judge(p: Namespace, h: SX, step: _Step) -> tuple[dict[str, SX], SX, SX]:
    """Return (the averages of the innovations, whether the servo has changed, whether the filter is
    lost).

    The innovations of late are compared with their mean as it was some seconds ago, which a change
    has not reached yet. Where that mean says that the model was right, they need not grow by much:
    a right model's never do. Source: basseville1993 chapter 2 (a mean of late against the mean
    before).
    """
    size = ca.fmin(step.size, 1e9)
    late = p.innovation_late + h / p.change_window * (size - p.innovation_late)
    judged = ca.fmax(p.age - JUDGED_AFTER, 0)
    share = ca.if_else(p.age > JUDGED_AFTER, h / (judged + FIRST_MEMORY), 0)
    mean = p.innovation_mean + share * (size - p.innovation_mean)
    kept = ca.floor(p.age / MEAN_AGE) != ca.floor((p.age + h) / MEAN_AGE)
    first, last = SENSOR_MEAN_TIME
    sensor_share = h / (first + ca.fmin(judged, last))
    averages = {
        "innovation_mean": mean,
        "innovation_late": late,
        "innovation_least": ca.if_else(
            p.age < LOST_CRITERION[0], late, ca.fmin(late, p.innovation_least)
        ),
        "innovation_kept": ca.if_else(kept, mean, p.innovation_kept),
        "innovation_before": ca.if_else(kept, p.innovation_kept, p.innovation_before),
        "innovation_sensor": (
            p.innovation_sensor
            + sensor_share * (ca.fmin(step.sensor, LARGEST_SENSOR_RATIO) - p.innovation_sensor)
        ),
    }
    most = ca.if_else(
        p.innovation_before < 1, p.surprise, p.change_ratio * ca.fmax(p.innovation_before, 1)
    )
    changed = ca.logic_and(p.age > CHANGE_SEARCH_AFTER, late > most)
    lost = ca.logic_and(
        ca.logic_and(p.age > LOST_CRITERION[1], p.age < CHANGE_SEARCH_AFTER),
        p.innovation_least > LOST_CRITERION[2],
    )
    return averages, changed, lost


def _observed(p: Namespace, s: Sample, runs: SX) -> _Observed:
    """Follow the motion by a sample, and collect the samples that a start is taken from."""
    gate = ca.fmax(START_GATE * excitation.rms_speed(p), excitation.noise_speed(p))
    r = rls.regression(p, s, gate)
    row = ca.vertcat(r.h, 1, r.z)
    seen = information.read(p, START_COLUMNS) + ca.if_else(r.counts, 1, 0) * (row @ row.T)
    excited = excitation.advance(p, -r.h[0], s.period)
    reversals = ca.if_else(runs, 0, p.start_reversals + excited.reverses)
    # what bends bristles is no motion
    clear = ca.fmax(excitation.CLEAR_SHARE * excitation.rms_speed(p), excitation.noise_speed(p))
    rest, rests = excitation.rest(p.rest, ca.fabs(r.h[0]) > clear, s.period)
    return _Observed(r, seen, excited, reversals, rest, rests)


def _equations(context: EquationContext, s: Sample) -> Update:
    p, h = context.p, s.period
    runs = p.runs > 0
    o = _observed(p, s, runs)
    friction = p[f"joint{LEVELS[0]}"] ** 2
    start = _start(p, s, o.row, o.seen, o.reversals)
    step = _filter(p, s, o.excited.time)
    averages, changed, lost = _judge(p, o.excited.time, step)
    go = ca.logic_and(ca.logic_not(runs), start.ready)
    joint, cov = kalman.read(p, ORDER)

    def choose(running: SX, starting: SX, otherwise: SX) -> SX:
        return SX(ca.if_else(runs, running, ca.if_else(go, starting, otherwise)))

    def at_start(name: str, value: SX) -> SX:
        return SX(ca.if_else(go, value, p[name]))

    prior, means = stack(p, "prior", ORDER), stack(p, "mean", PARAMETER_COUNT)
    vector = choose(step.joint, start.joint, ca.vertcat(s.y1, -o.row.h[0], joint[2:]))
    covariance = choose(step.covariance, ca.diag(start.spread**2), cov)
    mean = choose(_averaged(p, step.joint, h), start.joint[MOTION_STATES:], means)
    entries, time = step.joint[MOTION_STATES:], o.excited.time
    new = {
        **o.row.next,
        **o.excited.next,
        **information.write(ca.if_else(runs, 0, o.seen)),
        **kalman.write(vector, covariance),
        **consistency.advance(p, entries, step.lost, p.age, time, runs),
        **unstack("prior", ca.if_else(go, start.spread, prior)),
        **unstack("mean", mean),
        "input1": s.u,
        **{f"input{i}": p[f"input{i - 1}"] for i in range(2, INPUTS_KEPT)},
        "level": at_start("level", start.level),
        "drive": at_start("drive", start.drive),
        "ln_c": at_start("ln_c", start.joint[LN_C]),
        "runs": ca.if_else(runs, ca.logic_not(ca.logic_or(changed, lost)), go),
        "resumes": ca.if_else(runs, changed, p.resumes),
        "starts": p.starts + go,
        "start_reversals": o.reversals,
        "rest": o.rest,
        "drifted": ca.if_else(runs, excitation.drifted(p.drifted, o.rests, friction, h), 0),
        "moving": ca.if_else(runs, 0, p.moving + ca.if_else(o.row.counts, h, 0)),
        "age": ca.if_else(runs, p.age + time, 0),
        **{name: ca.if_else(runs, value, 1) for name, value in averages.items()},
    }
    signals = kalman.signals(joint, _servo(joint[MOTION_STATES:]))
    return Update(next=new, **_published(p), signals=signals, first={"joint0": s.y1})


def _published(p: Namespace) -> dict[str, Any]:
    """Return the fields of an `Update` that say what is estimated, and how well."""
    deviations, found = _deviations(p), _estimates(stack(p, "mean", PARAMETER_COUNT))
    return {
        "estimates": found | {"delay": found["delay"] + p.delay},
        "valid": _valid(p, deviations),
        "sd": deviations,
        "adapted": ca.logic_and(p.starts > 0, p.age > 0),
        "innovation": ca.if_else(p.runs > 0, p.innovation_sensor, 0),
    }


def _averaged(p: Namespace, z: SX, h: SX) -> SX:
    """Return the entries averaged: variations within some hundredths of a second are rounding
    noise.

    Source: polyak1992 (averages of estimates).
    """
    mean = stack(p, "mean", PARAMETER_COUNT)
    return mean + h / ca.fmax(p.averaging, h) * (z[MOTION_STATES:] - mean)


def _estimates(entries: SX) -> dict[str, SX]:
    """Return the parameters; Coulomb friction is the level at high speed, where no basis function
    is left.
    """
    servo = _servo(entries)
    sigma = {f"sigma{i}": each for i, each in enumerate(servo.sigma)}
    rest = {"tau": servo.tau, "width": servo.width, "load": servo.load, "delay": servo.delay}
    first = {"alpha2": servo.alpha2, "b": servo.b, "Fc": servo.sigma[0] / servo.c}
    return {**first, **sigma, "c": servo.c, **rest}


def _deviations(p: Namespace) -> dict[str, SX]:
    """Return the standard deviations of the estimates.

    Source: jazwinski1970 chapter 8; sigma_i = exp(ln c) G_i to first order.
    """
    z, covariance = kalman.read(p, ORDER)
    factors, place = ca.diag(consistency.inflation(p, PARAMETER_COUNT)), LOAD - MOTION_STATES
    covariance = factors @ covariance[MOTION_STATES:, MOTION_STATES:] @ factors
    covariance[place, place] = covariance[place, place] + p.drifted
    return kalman.deviations(_estimates, z[MOTION_STATES:], covariance)


def _valid(p: Namespace, deviations: dict[str, SX]) -> dict[str, SX]:
    """Return which estimates count: known well enough, while the filter runs and its innovations
    are about the sensor's own.

    What may be zero is known well enough in absolute terms, the load torque against the Coulomb
    friction. The shape of the Stribeck curve has to leave nothing unexplained: with narrow basis
    functions the filter may end at wide ones that do almost as well. Source: jazwinski1970 chapter
    8; mehra1970.
    """
    servo = _servo(kalman.read(p, ORDER)[0][MOTION_STATES:])
    level = servo.sigma[0] / servo.c
    sizes = {"alpha2": servo.alpha2, "b": servo.b, "Fc": level, "c": servo.c, "load": level}
    sizes |= {f"sigma{i}": servo.sigma[0] for i in range(len(servo.sigma))}
    limits = {name: VALID_ERROR * ca.fabs(size) for name, size in sizes.items()} | VALID_SHIFT
    sound = ca.logic_and(p.runs > 0, p.innovation_sensor < p.innovation_limit)
    exact = ca.logic_and(sound, p.innovation_sensor < SHAPE_LIMIT)
    return {
        name: ca.logic_and(exact if name in SHAPE else sound, deviations[name] < limits[name])
        for name in deviations
    }


def parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare the sensor's step, what little is known before the start, and the tuning; no value is
    taken from a plant.
    """
    modelled, shaped = (declaring(prefix, f"dixit2008 eq. ({number})") for number in (17, 24))
    regressed, spread = (declaring(prefix, s) for s in (REGRESSION_CITATION, kalman.CITATION))
    moving = "motion that a start is taken from, at least"
    off = "how far that start may be off, logarithmically"
    zero = "how far tau may be from 0 at first; 0: it stays 0"
    wide = "its start; a linear axis in m needs about 0.05"
    return (
        *kalman.parameters(prefix),
        *rls.filter_parameters(prefix, cutoff=60.0, hold_off=0.05),
        regressed("start_time", "T0", "s", (0.7, 1e-3, 1e3), moving),
        modelled("c_start", "c", "1/rad", (100.0, 1e-6, 1e9), "start of the estimate of c"),
        spread("c_spread", "sd(ln c)", "1", (1.5, 1e-3, 10.0), off),
        spread("tau_spread", "sd(tau)", "s", (0.001, 0.0, 1.0), zero),
        spread("delay_spread", "sd(d)", "1", (0.3, 0.0, 3.0), "the same of the delay, in samples"),
        shaped("width_start", "w", "1", (1.0, 1e-6, 1e6), wide),
        spread(
            "width_spread",
            "sd(ln w)",
            "1",
            (0.1, 0.0, 2.0),
            "the same of the logarithm of the width",
        ),
        *_tuning(prefix),
        *_judging(prefix),
    )


def _tuning(prefix: str) -> tuple[Parameter, ...]:
    """Declare noise and memory."""
    adaptive, growing = declaring(prefix, ADAPTIVE), declaring(prefix, GROWING)
    noise = "process noise of {} over the rms acceleration squared"
    misfit = "how much less a position counts where the model is wrong"
    memory = "weight of the past: (time since the start / now)^k"
    longest = "time since the start after which the memory grows no more"
    return (
        adaptive("noise_w", "q_w", "1/s", (6e-4, 0.0, 1e6), noise.format("w")),
        adaptive("noise_v", "q_v", "s", (6e-7, 0.0, 1e6), noise.format("v")),
        growing("early_noise", "q_0", "1", (10.0, 0.0, 1e9), "how much larger it is at a start"),
        growing("early_time", "T_q", "s", (1.5, 1e-3, 1e3), "how long, in time after reversals"),
        adaptive("misfit_noise", "r_m", "1", (100.0, 0.0, 1e9), misfit),
        growing("memory", "k", "1", (1.0, 0.0, 10.0), memory),
        growing("longest_memory", "T_m", "s", (100.0, 1.0, 1e9), longest),
    )


def _judging(prefix: str) -> tuple[Parameter, ...]:
    """Declare what is published, and what counts as a change of the servo."""
    averaged, changed = declaring(prefix, "polyak1992"), declaring(prefix, CHANGE_CITATION)
    adaptive = declaring(prefix, ADAPTIVE)
    mean = "time constant of the published average"
    surprise = "recent innovations that are a change of a right model"
    growth = "growth of the innovations that is a change"
    most = "mean squared innovation over the variance of the sensor up to which estimates are valid"
    return (
        averaged("averaging", "T_a", "s", (0.3, 0.0, 1e3), mean),
        changed("change_window", "T_c", "s", (0.3, 1e-3, 1e3), "what counts as of late"),
        changed("surprise", "s", "1", (12.0, 1.0, 1e12), surprise),
        changed("change_ratio", "rho", "1", (1e4, 1.0, 1e12), growth),
        adaptive("innovation_limit", "r_v", "1", (4.0, 1.0, 1e12), most),
    )


METHOD = Method(
    "self_starting_ekf",
    "joint extended Kalman filter of all parameters, load and delay from position: starts itself,"
    " and again when the servo changes",
    "jazwinski1970 chapter 8 with the model of dixit2008 eq. (15)-(17)",
    "y_theta",
    parameters("self_starting_ekf"),
    (
        *rls.FILTER_STATES,
        *excitation.STATES,
        *information.states(START_COLUMNS),
        *kalman.states(
            "theta, v, w, alpha2, b, G0, G1, G2, ln c, tau, load, delay, ln width",
            "their covariance",
            ORDER,
        ),
        *consistency.states(PARAMETER_COUNT),
        *vector_states("prior", "1", "their standard deviations at the start", ORDER),
        *vector_states(
            "mean",
            "1",
            "averages of alpha2, b, G0, G1, G2, ln c, tau, load, delay, ln width",
            PARAMETER_COUNT,
        ),
        *(
            State(f"input{i}", "V", f"input {i} samples before the last")
            for i in range(1, INPUTS_KEPT)
        ),
        State("level", "rad/s2", "Coulomb friction at the start"),
        State("drive", "rad/s2", "rms acceleration by the input at the start"),
        State("ln_c", "1", "ln c at the start"),
        State("runs", "1", "1 while the filter runs, 0 while a start is looked for"),
        State("resumes", "1", "1 if what comes next starts with the c there was"),
        State("starts", "1", "how often it has started"),
        State("start_reversals", "1", "reversals since a start is looked for"),
        excitation.rest_state(),
        excitation.drifted_state(),
        State("moving", "s", "motion seen since a start is looked for"),
        State("age", "s", "time since the start, as far as it counts as excited"),
        State("innovation_mean", "1", "mean squared innovation over its variance", initial=1.0),
        State("innovation_late", "1", "the same, of late", initial=1.0),
        State(
            "innovation_least",
            "1",
            "the least of that since two seconds after the start",
            initial=1.0,
        ),
        State(
            "innovation_kept", "1", "the first, as it was less than two seconds ago", initial=1.0
        ),
        State(
            "innovation_before", "1", "the first, as it was two seconds before that", initial=1.0
        ),
        State(
            "innovation_sensor",
            "1",
            "mean squared innovation over the variance of the sensor, of late",
            initial=1.0,
        ),
    ),
    _equations,
)
