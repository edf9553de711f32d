"""The whole workflow: records and a model in, a `Diagnosis` out."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bristle.diagnosis import result as answer
from bristle.diagnosis import story
from bristle.diagnosis.candidates import ELASTIC, RIGID, Servo, freedom, idle, scanned
from bristle.diagnosis.excitation import excitation
from bristle.diagnosis.fit import Fit, Free, evaluate, resume
from bristle.diagnosis.intake import Record
from bristle.diagnosis.lens import motion
from bristle.diagnosis.modelfile import REACH, Model
from bristle.diagnosis.noise import Noise
from bristle.diagnosis.plausibility import Plausibility, check
from bristle.diagnosis.search import Bench, Stage, Verdict, base_servo, group, search, settle, settle_well, views_of
from bristle.diagnosis.segments import BINS, SEGMENT, SMOOTH, Segments, cut, smooth
from bristle.diagnosis.size import mean_square
from bristle.diagnosis.views import MEASURED, ONCE, STRETCHES, Share, appearances, periods_of, residual_map
from bristle.model.errors import BristleError
from bristle.plant.effects import effect as find_effect
from bristle.plant.effects import effects as all_effects

Array = NDArray[np.float64]
Tell = Callable[[str, float], None]

WIDER, WIDER_AT_EDGES = 2.0, 5.0  # than what the spread of scores gives for an interval
SHORTEST = 0.1  # s: in less, friction and inertia hardly show
STEP = 1e-3  # s: longest internal step
TOLERANCE = 1e-5  # of smooth laws: far below what a record can tell
LEFT = 0.15  # share of the squared error that a view must explain before something is said to remain
CERTAIN = 0.03
VAIN = 1.0  # of the error before: a name that leaves more on the stretches kept from the search is not the whole story
OWN, OTHER = 0.1, 0.05  # and of the error before, once an effect is named: in a view of its own (a form that is not
# quite the catalogue's leaves as much) and in any other
ALONE = 0.05  # p of a view by itself, where the named wave should have taken up what is there
SAME, HARMONICS = 0.03, (2, 3, 4)  # periods that count as equal; multiples that are the form of a wave
EDGE = 0.1  # of the time, at either end, in which no step is looked for
MAPS = 6  # views whose residual is drawn


def bench_of(model: Model, records: Sequence[Record], seconds: float = SEGMENT) -> Bench:
    """Return the records as segments of so many seconds with their smoothed motion."""
    h, velocity = records[0].h, model.output_kind == "velocity"
    length = max(8, round(seconds / h))
    width = max(1, length // BINS)
    bins = length // width
    resolution = model.resolution or max((r.resolution or 0.0 for r in records), default=0.0)
    noise = float(np.median([np.std(r.y - smooth(r.y, h, 3 * h)) for r in records]))
    resolution = resolution or max(noise, 1e-12)
    pieces = []
    for r in records:
        if len(r.u) < 3 * length:
            continue
        pieces.append(cut(r.name, float(r.time[0]), h, r.u, r.y, velocity, resolution, width, bins))
    if not pieces:
        raise BristleError(f"records: none lasts three segments of {SEGMENT:g} s; give longer ones")
    segments = Segments(tuple(pieces), h, width, bins, velocity)
    kept = [r.y for r in records if len(r.u) >= 3 * length]
    least = resolution / math.sqrt(12 * width) / 3
    moved = motion(segments, kept, resolution, max(SMOOTH / 2, 2 * h))
    bench = Bench(segments, moved, resolution, least, excitation(model, records)["narrow"])
    if not model.linear:
        return bench
    refused = {name: "needs a shaft that turns: this axis is linear" for name in ONCE}
    return replace(bench, barred=refused, turn=float(np.ptp(moved.theta)))


def limits(bench: Bench) -> dict[str, tuple[float, float]]:
    """Return how far parameters of effects may move on this axis and in these records.

    Periods: at least two in a turn or, on a linear axis, in the range that was travelled; fewer are no ripple, but any
    slow change with the position. (Friction that changes once in a turn has a cause in a shaft.) A step: where enough is
    seen before and after, else it is a bias with a few odd segments. A stop: touched less than half of the time, else it
    is a spring or a bias.
    """
    least = 2 * 2 * math.pi / bench.turn
    periodic = ("cogging.periods", "position_friction.periods") if bench.barred else ("cogging.periods",)
    first, last = np.quantile(bench.motion.time, [EDGE, 1 - EDGE])
    middle = float(np.median(bench.motion.theta))
    return {
        "disturbance_step.onset": (float(first), float(last)), "hard_stop.upper": (middle, math.inf),
        "hard_stop.lower": (-math.inf, middle), **{name: (least, math.inf) for name in periodic},
    }  # fmt: skip


def fixed_values(h: float) -> dict[str, float]:
    """Return the settings of the simulation for a sampling period."""
    step = h / math.ceil(h / STEP - 1e-9)
    return {"solver.friction_step": step, "solver.tolerance": TOLERANCE, "u_max": 1e6}


def diagnose(model: Model, records: Sequence[Record], progress: Tell | None = None) -> answer.Diagnosis:
    """Find where a model and records disagree, and name what is missing.

    Parameters
    ----------
    model : Model
        Friction law, nominal parameters and bounds; from `load_model`.
    records : sequence of Record
        From `load_records` or `records_from_arrays`; two or more are better than one.
    progress : function, optional
        Called with a text and the fraction done.

    Raises
    ------
    BristleError
        If the records are too short or the model cannot be simulated.
    """
    begun = time.perf_counter()
    tell = progress or (lambda text, fraction: None)
    said = check(model, records)
    bench = bench_of(model, records)
    servo, values = base_of(model, bench)
    if said.proposals:
        return mend_first(model, records, said, nominal_gap(bench, servo, values), time.perf_counter() - begun)
    tell("base refit", 0.0)
    bench, base, lines = prepared(model, records, bench)
    found = examine(model, records, bench, base, tell, begun)
    return replace(found, findings=(*found.findings, *lines, *said.findings))


def prepared(model: Model, records: Sequence[Record], bench: Bench) -> tuple[Bench, Stage, list[str]]:
    """Return the records in segments that the model can follow, the model fitted to them, and findings.

    A light servo in a stiff loop runs away from what was measured as soon as anything is missing; what it does then says
    nothing of what that is. Shorter segments do.
    """
    seconds = SEGMENT
    base = settle_well(bench, *base_of(model, bench))
    while bench.missed(base.fit) > 1.0 and seconds / 2 >= SHORTEST:
        seconds /= 2
        bench = bench_of(model, records, seconds)
        base = settle_well(bench, *base_of(model, bench))
    if seconds == SEGMENT:
        return bench, base, []
    return (
        bench,
        base,
        [f"the model runs away from these records within {SEGMENT:g} s: it was compared over {seconds:g} s at a time"],
    )


def nominal_gap(bench: Bench, servo: Servo, values: Mapping[str, float]) -> float:
    """Return the mean squared error of a servo as it is [output squared]; NaN if it cannot follow the records at all."""
    white = Noise(np.eye(bench.segments.bins), 0.0, 0.0, 1.0, 1.0)
    problem = bench.problem(white, bench.segments.judged)
    fit = evaluate(problem, servo.simulator(bench.segments), servo.free, dict(values), bench.segments.starts)
    live = fit.weight > 0
    return mean_square(fit, live) if live.any() else math.nan


def mend_first(
    model: Model, records: Sequence[Record], said: Plausibility, gap: float, seconds: float, lines: Sequence[str] = ()
) -> answer.Diagnosis:
    """Return a diagnosis that names nothing, because data and model do not speak of the same thing.

    `gap` is the mean squared error of the model as it is [output squared]; `lines` are findings to begin with.
    """
    why = "No effect was looked for: data and model disagree in a way that is more likely a mistake in one of them. Proposed: "
    return answer.Diagnosis(
        verdict="not_identifiable", statement=(why + "; ".join(said.proposals) + ".",), effects=(), ties=(), experiment="",
        where=(), remains=answer.Remains(False, None, 0.0), gap=answer.Gap(gap, gap, None, f"({model.output_unit})2"),
        excitation=excitation(model, records), findings=(*lines, *(f for r in records for f in r.findings), *said.findings),
        base={}, parameters={}, rounds=(), undetected={}, traces=(), model=model, proposals=said.proposals, seconds=seconds,
    )  # fmt: skip


def base_of(model: Model, bench: Bench) -> tuple[Servo, dict[str, float]]:
    """Return the servo that a model describes, its own effects included, and the values it starts from."""
    s = bench.segments
    step = bench.resolution * (s.h if s.velocity else 1.0)
    servo, values = base_servo(model.friction, {"b": 1.0, **model.parameters}, model.bounds, fixed_values(s.h), step)
    rigid = servo.rigid and not set(model.effects) & set(ELASTIC)
    free = tuple(f for f in servo.free if rigid or not f.name.startswith(f"{RIGID}."))
    own = {f"{effect}.{name}": value for effect, given in model.effects.items() for name, value in given.items()}
    more = tuple(f for effect, given in model.effects.items() for f in _held(effect, given))
    servo = replace(servo, effects=tuple(model.effects), free=(*free, *more), rigid=rigid, limits=limits(bench))
    return servo, {**values, **own}


def _held(effect: str, given: Mapping[str, float]) -> Iterator[Free]:
    """Give the free parameters of an effect that the model has already, loosely held by their values there.

    A parameter at a value where it does nothing, such as an amplitude of 0 or a stop that is never reached, stays.
    """
    resting = {key for key, value in idle(effect).items() if given[key.removeprefix(f"{effect}.")] == value}
    for f in freedom(effect, {name: value for name, value in given.items() if f"{effect}.{name}" not in resting}, {}):
        value = given[f.name.removeprefix(f"{effect}.")]
        known = math.log(value) if f.factor else value
        yield replace(f, nominal=known, doubt=1.0 if f.factor else 2.0 * abs(value)) if value else f


def examine(model: Model, records: Sequence[Record], bench: Bench, base: Stage, tell: Tell, begun: float) -> answer.Diagnosis:
    """Search on top of a fitted model, and say what was found; `begun` is when the work began [s, `time.perf_counter`]."""
    final, rounds = search(bench, base, lambda name, share: tell(f"trying {name}", 0.1 + 0.7 * share))
    if final.servo.effects != base.servo.effects and (line := better_unbound(model, bench, base, final)):
        said = Plausibility((line,), ())
        return mend_first(model, records, said, mean_square(base.fit, bench.held), time.perf_counter() - begun)
    tell("what remains", 0.85)
    narrow = bool(bench.narrow) and final is not base
    if narrow and _remains(_views(bench, base, final)[1], final, (), _gap(model, bench, base, final), bench.turn).flag:
        why = f"'{rounds[0].best.name if rounds[0].best else ''}' closes the gap only in part: too uniform a motion to name it"
        final, rounds = base, [replace(rounds[0], named=False, withdrawn=True, decision=why)]
    return _conclude(model, records, bench, base, final, rounds, begun)


def better_unbound(model: Model, bench: Bench, base: Stage, final: Stage) -> str | None:
    """Return a proposal where wider bounds alone explain the records better than the effects that were found within them."""
    stuck = (f for f in base.servo.free if f.name in model.bounds and f.stuck(base.fit.values[f.name]))
    tight = {f.name: f for f in stuck if base.fit.values[f.name] != 0.0}
    if not tight:
        return None
    ends = {name: sorted((f.low / REACH, f.high * REACH)) for name, f in tight.items()}
    free = tuple(replace(f, low=ends[f.name][0], high=ends[f.name][1]) if f.name in tight else f for f in base.servo.free)
    wide = settle(bench, replace(base.servo, free=free), base.fit.values)
    price = 0.5 * (len(final.fit.free) - len(wide.fit.free)) * math.log(np.count_nonzero(bench.train) + 1.0)
    if wide.fit.total < final.fit.total - price:
        return None
    lines = []
    for name, f in tight.items():
        value, unit = wide.fit.values[name], model.unit(name)
        lines.append(f"{name} near {value:.3g} {unit}, outside its bounds [{f.low:.4g}, {f.high:.4g}]")
    return f"wider bounds, for without any effect the records fit {' and '.join(lines)}, better than any effect within the bounds"


def bound_lines(model: Model, plain: Mapping[str, answer.Estimate], whole: Mapping[str, answer.Estimate]) -> list[str]:
    """Return a line on parameters of the plain model that end at a bound, and on whether they still do with what was found."""
    lines = []
    for name, e in plain.items():
        if e.at_bound:
            low, high = model.bounds.get(name, (-math.inf, math.inf))
            unit = "" if e.unit == "1" else f" {e.unit}"
            later = "" if name not in whole or whole[name].at_bound else "; with what was found it does not"
            advice = "none is seen in these records" if e.value == 0.0 == low else "widen it if it may be wrong"
            where = f"its bound {e.value:.4g}{unit} of [{low:.4g}, {high:.4g}]"
            lines.append(f"the base refit of {name} ends at {where}{later}: {advice}")
    return lines


def _conclude(
    model: Model, records: Sequence[Record], bench: Bench, base: Stage, final: Stage, rounds: list[Verdict], begun: float
) -> answer.Diagnosis:
    whole, plain = _whole(bench, final), estimates(model, _whole(bench, base))
    where, after = _views(bench, base, final)
    last = rounds[-1]
    ties = [tuple(sorted({v.best.name, *v.ties})) for v in rounds if v.best and v.ties and (v.named or v is last)]
    named = final.servo.effects[len(model.effects) :]
    verdict = "named" if named else _unnamed(last)
    gap = _gap(model, bench, base, final)
    remains = _remains(after, final, named, gap, bench.turn)
    intervals = estimates(model, whole)
    of = {v.best.name: v for v in rounds if v.best and v.named}
    effects = tuple(
        answer.Named(
            name, group(name), {k.removeprefix(f"{name}."): v for k, v in intervals.items() if k.startswith(f"{name}.")},
            v.gain, v.null.p(name, v.gain),
        )
        for name, v in ((name, of[name]) for name in named)
    )  # fmt: skip
    own = {k: v for k, v in intervals.items() if not any(k.startswith(f"{name}.") for name in named)}
    choices = {c.name: estimates(model, c.fit) for c in last.candidates if c.name in _open(last) and c.fit} if not named else {}
    return answer.Diagnosis(
        verdict=verdict,
        statement=story.statement(verdict, effects, ties, gap, remains, intervals),
        effects=effects,
        ties=tuple(ties),
        experiment=story.experiment(ties, remains, bench.narrow),
        where=where,
        remains=remains,
        gap=gap,
        excitation=excitation(model, records),
        findings=(*(f for r in records for f in r.findings), *bound_lines(model, plain, intervals)),
        base=plain,
        parameters=own,
        rounds=tuple(_round(v) for v in rounds),
        undetected=story.undetected(last.candidates, last.null, named, model),
        traces=_traces(bench, base.fit, final.fit),
        model=model,
        seconds=time.perf_counter() - begun,
        choices={n: {k.removeprefix(f"{n}."): v for k, v in e.items() if k.startswith(f"{n}.")} for n, e in choices.items()},
        choice_parameters={n: {k: v for k, v in e.items() if not k.startswith(f"{n}.")} for n, e in choices.items()},
    )


def _open(verdict: Verdict) -> tuple[str, ...]:
    """Return the members of a tie that was not resolved, or what was withdrawn."""
    open_ = verdict.best and not verdict.named and (verdict.ties or verdict.withdrawn)
    return tuple(sorted({verdict.best.name, *verdict.ties})) if verdict.best and open_ else ()


def _unnamed(last: Verdict) -> str:
    classes = {group(name) for name in _open(last)}
    if not classes:
        return "none"
    return "tie" if len(classes) <= story.MANY and not last.withdrawn else "not_identifiable"


def _traces(bench: Bench, before: Fit, after: Fit) -> tuple[answer.Trace, ...]:
    """Return what was measured and simulated, an average a bin, record by record."""
    s, first, traces = bench.segments, 0, []
    for piece in s.pieces:
        n = len(piece.seen)
        part = slice(first, first + n)
        time_ = piece.time + s.h * (s.width * np.arange(n * s.bins, dtype=np.float64) + (s.width - 1) / 2)
        held = np.repeat(bench.held[part], s.bins)
        old, new = ((piece.seen - fit.residual[part]).ravel() for fit in (before, after))
        u = piece.u.reshape(-1, s.width).mean(axis=1)
        traces.append(answer.Trace(piece.name, time_, u, piece.seen.ravel(), old, new, held))
        first += n
    return tuple(traces)


def _whole(bench: Bench, stage: Stage) -> Fit:
    """Return the servo fitted to all segments, those kept from the search included."""
    problem = stage.problem.only(bench.segments.judged)
    return scanned(resume(problem, stage.fit), lambda fit: problem, stage.servo.effects)


def covariance(fit: Fit) -> Array:
    """Return the covariance of the free parameters (free, free), on the scale each moves on.

    The spread of the segments' own scores stands for the noise. Source: white1982 (sandwich).
    """
    scores = fit.slopes * fit.weight[:, None]
    inverse = np.linalg.pinv(fit.information, rcond=1e-14, hermitian=True)
    n = max(int(np.count_nonzero(fit.weight)) - len(fit.free), 1)
    return np.asarray(inverse @ (scores.T @ scores) @ inverse * (n + len(fit.free)) / n)


def estimates(model: Model, fit: Fit) -> dict[str, answer.Estimate]:
    """Return the free parameters with their 95 % intervals, as wide as development records showed that they must be."""
    deviation = np.sqrt(np.maximum(np.diag(covariance(fit)), 0.0))
    found = {}
    for f, each in zip(fit.free, deviation, strict=True):
        wide = 1.96 * (WIDER_AT_EDGES if _has_edges(f.name) else WIDER) * each
        if f.nominal is not None and f.name.startswith(f"{RIGID}."):
            continue
        value = fit.values[f.name]
        low, high = (value * math.exp(-wide), value * math.exp(min(wide, 50.0))) if f.factor else (value - wide, value + wide)
        found[f.name] = answer.Estimate(value, model.unit(f.name), (low, high), f.stuck(value))
    return found


def _has_edges(parameter: str) -> bool:
    """True for parameters of effects that begin at a place or a level: the likelihood is no parabola there."""
    name = parameter.split(".")[0]
    return name in all_effects() and (find_effect(name).local or find_effect(name).rugged)


def _views(bench: Bench, base: Stage, final: Stage) -> tuple[tuple[answer.View, ...], list[Share]]:
    """Return the views before and after, both as the final noise sees them, with maps; and the shares after."""
    plain = evaluate(final.problem, base.fit.simulator, base.fit.free, base.fit.values, base.fit.starts)
    stages = (Stage(base.servo, final.problem, plain), final)
    found, torques = [], []
    for stage in stages:
        seen, torque = views_of(stage, bench)
        found.append([_along_axis(bench, share) for share in seen])
        torques.append(torque)
    before, after = found
    table = {share.view: share for share in after}
    views: list[answer.View] = []
    for share in before:
        late = table[share.view]
        drawn = residual_map(share.view, bench.motion, torques[0], torques[1]) if len(views) < MAPS else {}
        views.append(answer.View(share.view, share.share, share.p, late.share, late.p, share.label, **drawn))
    return tuple(views), after


def _along_axis(bench: Bench, share: Share) -> Share:
    """Return a share with its label as it is on a linear axis, where the range that was travelled stands for the turn."""
    return replace(share, label=share.label.replace("in a turn", "in the range travelled")) if bench.barred else share


def _remains(after: list[Share], final: Stage, named: Sequence[str], gap: answer.Gap, turn: float) -> answer.Remains:
    """Say whether something predictable is left that is neither small nor only the form of what was named.

    What repeats as a multiple of a named wave is its form. What repeats as the wave itself, which was free to take it up,
    is something else, and evidence in that view alone is enough.
    """
    rattles = any(find_effect(name).coupling for name in named)  # no two runs of a loose load agree in each stretch
    seen = [share for share in after if share.view not in MEASURED and not (rattles and share.view == STRETCHES)]
    own = {view for name in named for view in appearances(name)}
    waves = [periods for name in named if (periods := periods_of(name, final.fit.values, turn)) is not None]
    left = gap.after / gap.before if named and gap.before > 0 else 1.0
    if named and left > VAIN and not rattles and not any(find_effect(name).local for name in named):
        return answer.Remains(True, seen[0].view, seen[0].share)
    certain = []
    for share in seen:
        times = [share.periods / wave for wave in waves] if share.periods else []
        same = any(abs(t - 1) < SAME for t in times)
        if not (share.p <= CERTAIN or (same and share.alone <= ALONE)):
            continue
        certain.append(share)
        form = any(abs(t - k) < SAME * k for t in times for k in HARMONICS)
        least = OWN if share.view in own and not same else OTHER
        if share.share >= LEFT and share.share * left >= least and not form:
            return answer.Remains(True, share.view, share.share)
    first = (certain or after)[0]
    return answer.Remains(False, first.view if certain else None, first.share)


def _gap(model: Model, bench: Bench, base: Stage, final: Stage) -> answer.Gap:
    """Return mean squares over the segments that were kept from the search, and what the noise alone would give."""
    before, after = mean_square(base.fit, bench.held), mean_square(final.fit, bench.held)
    noise = final.problem.noise
    cover = np.linalg.inv(noise.whiten)
    covariance_ = cover @ cover.T
    live = bench.held & (final.fit.weight >= 0)
    floor = []
    for columns in final.fit.raw_by_start[live]:
        q, r = np.linalg.qr(columns)
        q = q[:, np.abs(np.diag(r)) > 1e-9 * max(np.abs(r).max(), 1e-300)]
        floor.append(np.trace(covariance_) - np.trace(q.T @ covariance_ @ q))
    alone = float(np.mean(floor)) / bench.segments.bins
    unit = model.output_unit
    return answer.Gap(before, after, min(alone, after), f"({unit})2")


def _round(v: Verdict) -> answer.Round:
    """Return a round as it is reported."""
    bars = []
    for c in v.candidates:
        gain = c.fit.total - v.base if c.fit else 0.0
        tested = () if c.test is None else (c.test.fall, c.test.kept, *c.test.behind)
        bars.append(answer.Candidate(c.name, gain, v.null.level(c.name), c.refused, *tested))
    bars.sort(key=lambda bar: -bar.gain)
    added = v.best.name if v.best and v.named else None
    top = v.best.name if v.best else bars[0].name if bars else ""
    return answer.Round(tuple(bars), v.null.level(top), v.null.p(top, v.gain), added, v.decision, v.gain, v.size, v.finer)
