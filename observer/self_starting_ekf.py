"""A joint filter from position alone: it computes its own start, adapts its noise and restarts when the servo changes.

Three things make an extended Kalman filter converge here within seconds, without start values:

- coordinates: the friction levels G_i = sigma_i / c in the place of sigma_i, and ln c. The levels are identifiable
  while sliding, whatever c is, and the error of c then has one sign;
- a start by least squares on the data so far, for alpha2, b and Fc, with the standard deviations of that fit;
- a memory that grows with the time since the start, so that data taken with a poor linearisation are forgotten, and
  process noise that decays as it grows.

Where the innovations are as small as their covariance predicts, the model is right and the noise decays further. Where they are
larger, the model is wrong, and the position gets less weight, as in a fit of the whole record.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca

from bristle.model.normalised import units
from bristle.model.variables import Namespace, Parameter, State
from bristle.observer import information, kalman, rls
from bristle.observer.kalman import MOTION_STATES
from bristle.observer.method import EquationContext, Method, Sample, Update, stack, unstack, vector_states

SX = ca.SX
ESTIMATES = units("alpha2", "b", "Fc", "sigma0", "sigma1", "sigma2", "c", "tau")
GROWING = "ljung1983 chapter 5 (forgetting that fades)"
ADAPTIVE = "mehra1970"
CHANGE_CITATION = "basseville1993 chapter 2"
MEANS = kalman.FILTER_ORDER - MOTION_STATES
V, W, ALPHA2, DRIVE, LEVELS, LN_C, TAU = 1, 2, 3, 4, (5, 6, 7), 8, 9  # places in the vector
# Start: what must be known before it, and the uncertainty it is given.
MIN_DETERMINANT = 0.02  # determinant of the correlations of -v, u and -sgn v
LONGEST_START = 5.0  # s of motion after which the filter starts in any case
RIDGE = 1e-3  # share of the information added to its diagonal; shrinks what the start data do not determine
LEVEL = (0.1, 2.0)  # bounds of Fc over the rms drive acceleration b u
LEAST_VISCOUS = 0.05  # of alpha2: acceleration at the rms speed over that of the drive
START_SD = {"v": 0.5, "b": 0.2, "alpha2": 0.5}  # sd over rms speed, over b, over Fc at the rms speed; the levels' is Fc
SMALLEST_LEVEL = 0.01  # of Fc at the start
LARGEST_LEVEL = (4.0, 10.0)  # the same, upper limits: of Coulomb friction, and of the weights of the basis functions (either sign)
PASSED_SAMPLES = 10.0  # samples in which the presliding distance of the start is passed at the rms speed, at least
C_REACH, EARLY_C_REACH = 1e3, 10.0  # factors by which c may differ from its start value; a far too large c is not corrected by data
LONGEST_TAU = 1.0  # s
# Process noise as a function of the innovations.
CONSISTENT_RATIO = 1.05  # mean squared innovation over its variance up to which the model counts as right
FULL_MISFIT = 0.3  # excess over that ratio at which the misfit counts in full
RECENT_MEAN_LIMIT = 2.0  # recent mean up to which the model may be right; one more is full misfit
LEAST_NOISE_SHARE = 1e-5  # share of the process noise that stays when the model is right
JUDGED_AFTER = 5.0  # s after a start from which the innovations are evaluated
MEAN_AGE = 2.0  # s: recent innovations are compared with their mean of one to two such times before
LOST_CRITERION = (2.0, 3.0, 100.0)  # from, to [s] after a start, recent mean: above it throughout, the filter is lost
FIRST_MEMORY = 1.0  # s
SHARED_COUNT = 100.0  # samples with the same count, at most, that share one rounding error
FADING_POWER = 8  # power of time with which the early noise decays
UNTRUSTED_TIME = 10.0  # s after a start during which the model never counts as right
CHANGE_SEARCH_AFTER = 10.0  # s after a start from which changes of the servo are looked for
TRUSTED_AFTER = 20.0  # s after a start from which the model may count as known to be right
VALID_ERROR = 0.1  # standard error of a valid estimate, over the estimate; of sigma_i over c times the Coulomb level


@dataclass(frozen=True)
class _Start:
    """Where the filter starts from, once `ready`; `spread` are standard deviations."""

    ready: SX
    joint: SX
    spread: SX
    level: SX
    speed: SX


def _servo(entries: SX) -> kalman.Servo:
    """Read the parameters from (alpha2, b, G0, G1, G2, ln c, tau)."""
    alpha2, b, *levels, ln_c, tau = ca.vertsplit(entries)
    c = ca.exp(ln_c)
    return kalman.Servo(alpha2, b, [c * level for level in levels], c, tau)


def _start(p: Namespace, s: Sample, r: rls.Regression, seen: SX) -> _Start:
    """Solve the least squares of L v' = -alpha2 L v + b L u - Fc L sgn v, and return how far each entry may be off.

    Source: ljung1999 section 11.2; dixit2008 eq. (23).
    """
    count = ca.fmax(p.moving + s.period, s.period)
    factors = information.Factors(seen + RIDGE * ca.diag(ca.diag(seen)))
    distinct = factors.d[1] * factors.d[2] / ca.fmax(seen[1, 1] * seen[2, 2], 1e-300)
    alpha2, b, friction = ca.vertsplit(factors.regression())
    speed = ca.sqrt(seen[0, 0] * s.period / count)
    drive = ca.fabs(b) * ca.sqrt(seen[1, 1] * s.period / count)
    level = ca.fmax(ca.fmin(ca.fmax(friction, LEVEL[0] * drive), LEVEL[1] * drive), 1e-12)
    alpha2 = ca.fmax(alpha2, LEAST_VISCOUS * drive / ca.fmax(speed, 1e-9))
    ln_c = ca.log(
        ca.fmin(p.c_start, 1 / (PASSED_SAMPLES * ca.fmax(speed, 1e-9) * s.period))
    )  # a larger c would not be corrected by data
    ln_c = ca.if_else(p.resumes > 0, p[f"mean{LN_C - MOTION_STATES}"], ln_c)
    viscous = START_SD["alpha2"] * level / ca.fmax(speed, 1e-9)
    joint = ca.vertcat(s.y1 + p.resolution / 2, -r.h[0], 0, alpha2, b, level, 0, 0, ln_c, p.tau_start)
    spread = ca.vertcat(
        p.resolution,
        START_SD["v"] * speed,
        level,
        viscous,
        START_SD["b"] * ca.fabs(b),
        level,
        level,
        level,
        p.c_spread,
        p.tau_spread,
    )
    enough = ca.logic_or(distinct > MIN_DETERMINANT, count > LONGEST_START)
    return _Start(ca.logic_and(count > p.start_time, enough), joint, spread, level, speed)


def _filter(p: Namespace, s: Sample) -> tuple[SX, SX, SX]:
    """Return (vector, covariance, squared innovation over its variance) after a sample.

    The memory: all of P grows by k h / age, which weights the past by (time / now)^k. It does not grow beyond what a start
    would give, where nothing is learnt.
    Source: jazwinski1970 chapter 8; ljung1983 chapter 5; mehra1970 (noise from innovations).
    """
    h = s.period
    z, covariance = kalman.predict(_servo, *kalman.read(p), s.u, h)
    prior = stack(p, "prior", kalman.FILTER_ORDER)
    known = SX(1)
    for i in range(MOTION_STATES, kalman.FILTER_ORDER):
        known = ca.logic_and(known, covariance[i, i] <= prior[i] ** 2)
    memory = ca.fmin(p.age, p.longest_memory) + FIRST_MEMORY
    covariance = covariance * (1 + ca.if_else(known, p.memory * h / memory, 0))
    misfit = ca.fmin(ca.fmax(ca.fmax((p.innovation - CONSISTENT_RATIO) / FULL_MISFIT, p.innovation_late - RECENT_MEAN_LIMIT), 0), 1)
    early = 1 / (1 + (p.age / p.early_time) ** FADING_POWER)
    doubt = 1 / (1 + (p.age / UNTRUSTED_TIME) ** FADING_POWER)
    noise = p.level**2 * (ca.fmax(ca.fmax(misfit, LEAST_NOISE_SHARE), doubt) + p.early_noise * early)
    rates = [SX(0)] * kalman.FILTER_ORDER
    rates[V], rates[W] = p.noise_v * noise, p.noise_w * noise
    same = ca.fmin(ca.fmax(p.resolution / ca.fmax(ca.fabs(z[V]) * h, 1e-12), 1), SHARED_COUNT)
    quantum = kalman.rounding(p.resolution) * same
    variance = quantum * (1 + p.misfit_noise * misfit + p.early_noise / 10 * early)
    error = s.y1 + p.resolution / 2 - z[0]
    z, covariance, size = kalman.correct(z, kalman.noisy(covariance, rates, h), error, variance, p.gate)
    reach = ca.if_else(p.age < JUDGED_AFTER, EARLY_C_REACH, C_REACH)
    most = {LEVELS[0]: LARGEST_LEVEL[0] * p.level, LEVELS[1]: LARGEST_LEVEL[1] * p.level, LEVELS[2]: LARGEST_LEVEL[1] * p.level}
    low = {ALPHA2: SX(0), LEVELS[0]: SMALLEST_LEVEL * p.level, LN_C: p.ln_c - ca.log(reach), TAU: SX(0)}
    low |= {place: -each for place, each in most.items() if place not in low}
    high = {**most, LN_C: p.ln_c + ca.log(reach), TAU: SX(LONGEST_TAU)}
    return kalman.bounded(z, low, high), covariance, size


def _judge(p: Namespace, h: SX, size: SX) -> tuple[dict[str, SX], SX, SX]:
    """Return (the averages of the innovations, whether the servo has changed, whether the filter is lost).

    The innovations of late are compared with their mean as it was some seconds ago, which a change has not reached yet. Where
    that mean says that the model was right, they need not grow by much: a right model's never do.
    Source: basseville1993 chapter 2 (a mean of late against the mean before).
    """
    size = ca.fmin(size, 1e9)
    late = p.innovation_late + h / p.change_window * (size - p.innovation_late)
    share = ca.if_else(p.age > JUDGED_AFTER, h / (p.age - JUDGED_AFTER + FIRST_MEMORY), 0)
    mean = p.innovation + share * (size - p.innovation)
    kept = ca.floor(p.age / MEAN_AGE) != ca.floor((p.age + h) / MEAN_AGE)
    averages = {
        "innovation": mean,
        "innovation_late": late,
        "innovation_least": ca.if_else(p.age < LOST_CRITERION[0], late, ca.fmin(late, p.innovation_least)),
        "innovation_kept": ca.if_else(kept, mean, p.innovation_kept),
        "innovation_before": ca.if_else(kept, p.innovation_kept, p.innovation_before),
    }
    right = ca.logic_and(p.innovation_before < 1, p.age > TRUSTED_AFTER)
    most = ca.if_else(right, p.surprise, p.change_ratio * ca.fmax(p.innovation_before, 1))
    changed = ca.logic_and(p.age > CHANGE_SEARCH_AFTER, late > most)
    lost = ca.logic_and(
        ca.logic_and(p.age > LOST_CRITERION[1], p.age < CHANGE_SEARCH_AFTER), p.innovation_least > LOST_CRITERION[2]
    )
    return averages, changed, lost


def _equations(context: EquationContext, s: Sample) -> Update:
    p, h = context.p, s.period
    runs = p.runs > 0
    r = rls.regression(p, s)
    row = ca.vertcat(r.h, r.z)
    seen = information.read(p, 4) + ca.if_else(r.counts, 1, 0) * (row @ row.T)
    start = _start(p, s, r, seen)
    z, covariance, size = _filter(p, s)
    averages, changed, lost = _judge(p, h, size)
    go = ca.logic_and(ca.logic_not(runs), start.ready)

    def choose(running: SX, starting: SX, waiting: SX) -> SX:
        return SX(ca.if_else(runs, running, ca.if_else(go, starting, waiting)))

    joint, cov = kalman.read(p)
    follow = ca.vertcat(s.y1, -r.h[0], joint[2:])
    new = {
        **r.next,
        **information.write(ca.if_else(runs, 0, seen)),
        **kalman.write(choose(z, start.joint, follow), choose(covariance, ca.diag(start.spread**2), cov)),
        **unstack("prior", choose(stack(p, "prior", kalman.FILTER_ORDER), start.spread, stack(p, "prior", kalman.FILTER_ORDER))),
        **unstack("mean", choose(_averaged(p, z, h), start.joint[MOTION_STATES:], stack(p, "mean", MEANS))),
        "level": choose(p.level, start.level, p.level),
        "ln_c": choose(p.ln_c, start.joint[LN_C], p.ln_c),
        "runs": ca.if_else(runs, ca.logic_not(ca.logic_or(changed, lost)), go),
        "resumes": ca.if_else(runs, changed, p.resumes),
        "starts": p.starts + go,
        "moving": ca.if_else(runs, 0, p.moving + ca.if_else(r.counts, h, 0)),
        "age": ca.if_else(runs, p.age + h, 0),
        **{name: ca.if_else(runs, value, 1) for name, value in averages.items()},
    }
    return Update(new, _estimates(p), kalman.signals(p, _servo), {"joint0": s.y1}, _valid(p))


def _averaged(p: Namespace, z: SX, h: SX) -> SX:
    """Return the entries averaged: variations within some hundredths of a second are rounding noise.

    Source: polyak1992 (averages of estimates).
    """
    mean = stack(p, "mean", MEANS)
    return mean + h / ca.fmax(p.averaging, h) * (z[MOTION_STATES:] - mean)


def _estimates(p: Namespace) -> dict[str, SX]:
    """Return the parameters; Coulomb friction is the level at high speed, where no basis function is left."""
    servo = _servo(stack(p, "mean", MEANS))
    sigma = {f"sigma{i}": each for i, each in enumerate(servo.sigma)}
    return {"alpha2": servo.alpha2, "b": servo.b, "Fc": servo.sigma[0] / servo.c, **sigma, "c": servo.c, "tau": servo.tau}


def _valid(p: Namespace) -> dict[str, SX]:
    """Return which estimates the covariance makes valid; of tau, which may be zero, against what was known of it before.

    Source: jazwinski1970 chapter 8; sigma_i = exp(ln c) G_i to first order.
    """
    z, covariance = kalman.read(p)
    unit = SX.eye(kalman.FILTER_ORDER)
    slopes = {"alpha2": (unit[:, ALPHA2], z[ALPHA2]), "b": (unit[:, DRIVE], z[DRIVE]), "c": (unit[:, LN_C], SX(1))}
    slopes |= {f"sigma{i}": (unit[:, place] + z[place] * unit[:, LN_C], z[LEVELS[0]]) for i, place in enumerate(LEVELS)}
    slopes |= {"Fc": (unit[:, LEVELS[0]], z[LEVELS[0]]), "tau": (unit[:, TAU], p.tau_spread)}
    return {
        name: ca.logic_and(p.runs > 0, ca.dot(slope, covariance @ slope) < (VALID_ERROR * size) ** 2)
        for name, (slope, size) in slopes.items()
    }


def parameters(prefix: str) -> tuple[Parameter, ...]:
    """Declare the sensor's step, what little is known before the start, and the tuning; no value is taken from a plant."""

    def own(name: str, symbol: str, unit: str, default: float, low: float, high: float, text: str, source: str) -> Parameter:
        return Parameter(f"{prefix}.{name}", symbol, unit, default, low, high, text, source)

    return (
        *kalman.parameters(prefix),
        *rls.filter_parameters(prefix, cutoff=60.0, hold_off=0.05, vc=math.radians(20.0)),
        own("start_time", "T0", "s", 0.7, 1e-3, 1e3, "motion that a start is taken from, at least", "ljung1999 section 11.2"),
        own("c_start", "c", "1/rad", 100.0, 1e-6, 1e9, "start of the estimate of c", "dixit2008 eq. (17)"),
        own("c_spread", "sd(ln c)", "1", 1.5, 1e-3, 10.0, "how far that start may be off, logarithmically", kalman.CITATION),
        own("tau_start", "tau", "s", 0.005, 0.0, 1.0, "start of the estimate of tau", "dixit2008 eq. (11)"),
        own("tau_spread", "sd(tau)", "s", 0.01, 0.0, 1.0, "how far that start may be off", kalman.CITATION),
        own("noise_w", "q_w", "1/s", 6e-4, 0.0, 1e6, "process noise of w over Fc^2", ADAPTIVE),
        own("noise_v", "q_v", "s", 6e-7, 0.0, 1e6, "process noise of v over Fc^2", ADAPTIVE),
        own("early_noise", "q_0", "1", 100.0, 0.0, 1e9, "how much larger it is at a start", GROWING),
        own("early_time", "T_q", "s", 2.0, 1e-3, 1e3, "how long", GROWING),
        own("misfit_noise", "r_m", "1", 100.0, 0.0, 1e9, "how much less a position counts where the model is wrong", ADAPTIVE),
        own("memory", "k", "1", 1.0, 0.0, 10.0, "weight of the past: (time since the start / now)^k", GROWING),
        own("longest_memory", "T_m", "s", 100.0, 1.0, 1e9, "time since the start after which the memory grows no more", GROWING),
        own("averaging", "T_a", "s", 0.3, 0.0, 1e3, "time constant of the published average", "polyak1992"),
        own("change_window", "T_c", "s", 0.3, 1e-3, 1e3, "what counts as of late", CHANGE_CITATION),
        own(
            "surprise",
            "s",
            "1",
            50.0,
            1.0,
            1e12,
            "innovations of late that are a change where the model was right",
            CHANGE_CITATION,
        ),
        own("change_ratio", "rho", "1", 1e4, 1.0, 1e12, "growth of the innovations that is a change", CHANGE_CITATION),
    )


METHOD = Method(
    "self_starting_ekf",
    "joint extended Kalman filter of all parameters from position: starts itself, and again when the servo changes",
    "jazwinski1970 chapter 8 with the model of dixit2008 eq. (15)-(17)",
    "y_theta",
    parameters("self_starting_ekf"),
    (
        *rls.FILTER_STATES,
        *information.states(4),
        *kalman.states("theta, v, w, alpha2, b, G0, G1, G2, ln c, tau", "their covariance"),
        *vector_states("prior", "1", "their standard deviations at the start", kalman.FILTER_ORDER),
        *vector_states("mean", "1", "averages of alpha2, b, G0, G1, G2, ln c, tau", MEANS),
        State("level", "rad/s2", "Coulomb friction at the start"),
        State("ln_c", "1", "ln c at the start"),
        State("runs", "1", "1 while the filter runs, 0 while a start is looked for"),
        State("resumes", "1", "1 if what comes next starts with the c there was"),
        State("starts", "1", "how often it has started"),
        State("moving", "s", "motion seen since a start is looked for"),
        State("age", "s", "time since the start"),
        State("innovation", "1", "mean squared innovation over its variance", initial=1.0),
        State("innovation_late", "1", "the same, of late", initial=1.0),
        State("innovation_least", "1", "the least of that since two seconds after the start", initial=1.0),
        State("innovation_kept", "1", "the first, as it was less than two seconds ago", initial=1.0),
        State("innovation_before", "1", "the first, as it was two seconds before that", initial=1.0),
    ),
    _equations,
)
