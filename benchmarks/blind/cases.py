"""The plan of the blind test and its cases: which effect, how visible, in which records; and the
sealed answers.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from forms import (
    EFFECTS,
    LOCAL,
    OUTSIDE,
    PARAMETERS,
    Fields,
    Generator,
    Setting,
    Shape,
    can_join,
    class_of,
    other_friction,
)
from gap import EVERY, Gap, measure
from scene import LIMIT, Scene, draw_scene, log_uniform, with_friction
from shared import write_json
from truth import RESOLUTION, Array, Record

CONTROLS = ("wrong_inertia", "noise_only", "quiet", "other_friction")
QUIET = 0.01  # rms of the disturbance over Fc in the controls of that name
STRONG, WEAK, FAINT = (2.0, 30.0), (1.3, 2.0), (1.05, 1.3)  # gap ratios
TOGETHER = 5.0  # least gap ratio of a pair
CONTROL_RATIO = 1.15  # highest gap ratio of a control, as a mean and typically
SIZES = {
    "same": 300,
    "other": 300,
    "low": 100,
    "faint": 40,
    "control": 240,
    "outside": 240,
    "pair": 160,
    "poor": 160,
}
SELECTIONS = {
    "single": ("same", "other"),
    "weak": ("low", "faint"),
    "controls": ("control",),
    "outside": ("outside",),
    "pairs": ("pair",),
    "poor": ("poor",),
}
TRIES = 8  # simulations with which a strength is sought
CLOSE = 0.35  # accepted |log((ratio - 1)/(target - 1))|
SHAPES = 2  # draws of one effect before another takes its place
REDRAWS = 24


@dataclass(frozen=True)
class Spec:
    """One case of the plan, before anything is drawn."""

    index: int
    group: str
    kind: str  # single, control, outside, pair, poor
    # effects, or the variant of a control or of an effect outside the catalogue
    names: tuple[str, ...]
    form: str = "same"
    span: tuple[float, float] = STRONG
    style: str = "rich"


@dataclass
class Case:
    """A case: what the workflow gets, and the answer."""

    index: int
    records: list[Record]
    model: str
    answer: dict[str, Any] = field(default_factory=dict)


def seed_of(commit: str, index: int | str) -> int:
    """Return the seed of a case."""
    return int.from_bytes(hashlib.sha256(f"{commit}:{index}".encode()).digest())


def _balanced(rng: Generator, names: Sequence[str], count: int) -> list[str]:
    """Return `count` names, each as often as the others to within one, in random order."""
    rounds = [
        str(name) for _ in range(-(-count // len(names))) for name in rng.permutation(list(names))
    ]
    return rounds[:count]


def _partner(rng: Generator, name: str) -> str:
    return str(rng.choice([other for other in EFFECTS if can_join(name, other)]))


def _group(rng: Generator, group: str, count: int) -> list[Spec]:
    """Return the specs of one group, not numbered yet."""
    forms = ["same", "other"]
    if group == "control":
        return [
            Spec(0, group, "control", (CONTROLS[i % len(CONTROLS)],), span=(0.0, CONTROL_RATIO))
            for i in range(count)
        ]
    if group == "outside":
        return [
            Spec(0, group, "outside", (name,)) for name in _balanced(rng, tuple(OUTSIDE), count)
        ]
    names = _balanced(rng, tuple(EFFECTS), count)
    if group == "pair":
        return [
            Spec(0, group, "pair", (name, _partner(rng, name)), forms[i % 2])
            for i, name in enumerate(names)
        ]
    if group == "poor":
        styles = ["sine", "sine", "slow", "slow"]
        return [
            Spec(0, group, "poor", (name,), forms[i % 2], style=styles[i % 4])
            for i, name in enumerate(names)
        ]
    span = {"low": WEAK, "faint": FAINT}.get(group, STRONG)
    fixed = group if group in forms else ""
    return [
        Spec(0, group, "single", (name,), fixed or forms[i % 2], span)
        for i, name in enumerate(names)
    ]


def plan(commit: str, scale: float = 1.0) -> list[Spec]:
    """Return all cases, numbered from 1 in an order that says nothing about them."""
    rng = np.random.default_rng(seed_of(commit, "plan"))
    specs = [
        spec
        for group, size in SIZES.items()
        for spec in _group(rng, group, math.ceil(size * scale))
    ]
    return [replace(specs[j], index=i + 1) for i, j in enumerate(rng.permutation(len(specs)))]


@dataclass(frozen=True)
class Found:
    """Effects at work with their records and gap; the fields are those of the plant."""

    fields: Fields
    records: list[Record]
    gap: Gap


def _calm(records: list[Record], quiet: list[Record]) -> bool:
    """Return whether the loop is still in order: not far off the motion without the effect, and not
    at its limit.
    """
    speed = [
        np.sqrt(np.mean([np.mean(r.states[:, 1] ** 2) for r in each])) for each in (records, quiet)
    ]
    limited = np.mean([np.mean(np.abs(r.u) >= LIMIT) for r in records])
    return bool(speed[0] < 1.4 * speed[1] and limited < 0.1)


def _aim(tried: list[tuple[float, float]], power: float, shape: Shape) -> float:
    """Return the logarithm of the strength to try next, from pairs (log strength, log miss)."""
    x, miss = tried[-1]
    if len(tried) > 1 and abs(x - tried[-2][0]) > 1e-9:
        power = float(np.clip((miss - tried[-2][1]) / (x - tried[-2][0]), 0.4 * power, 2.5 * power))
    below = [a for a, b in tried if b < 0]
    above = [a for a, b in tried if b >= 0]
    wanted = x - miss / power
    if below and above and not max(below) < wanted < min(above) and max(below) < min(above):
        wanted = 0.5 * (max(below) + min(above))
    return float(np.clip(wanted, math.log(shape.low), math.log(shape.high)))


def adapt(
    scene: Scene,
    quiet: list[Record],
    shape: Shape,
    span: tuple[float, float],
    target: float,
    every: int,
) -> Found | None:
    """Return the effect at a strength whose gap ratio is in the span, near the target; None if
    there is none.
    """
    tried: list[tuple[float, float]] = []
    at: float = math.log(
        np.clip(shape.guess * ((target - 1) / 4) ** (1 / shape.power), shape.low, shape.high)
    )
    fitted: Array | None = None
    best: tuple[float, Found] | None = None
    for _ in range(TRIES):
        fields = shape.fields(math.exp(at))
        records = scene.records(fields)
        if not _calm(records, quiet):
            tried.append((at, 3.0))
        else:
            gap, fitted = measure(records, scene.plant(fields), fitted, every)
            miss = math.log(max(gap.ratio - 1, 0.01) / (target - 1))
            tried.append((at, miss))
            if span[0] <= gap.ratio < span[1] and (best is None or abs(miss) < best[0]):
                best = abs(miss), Found(fields, records, gap)
                if best[0] < CLOSE:
                    break
        after = _aim(tried, shape.power, shape)
        if any(abs(after - x) < 0.01 for x, _ in tried):
            break
        at = after
    return best[1] if best else None


def _every(*names: str) -> int:
    return 1 if LOCAL.intersection(names) else EVERY


def _target(rng: Generator, span: tuple[float, float]) -> float:
    return log_uniform(rng, 1.04 * span[0], 0.96 * span[1])


def _single(
    rng: Generator, spec: Spec, name: str, scene: Scene, quiet: list[Record]
) -> Found | None:
    draw = OUTSIDE[name] if spec.kind == "outside" else EFFECTS[name]
    shape = draw(rng, Setting(scene, quiet, spec.form == "other"))
    return adapt(scene, quiet, shape, spec.span, _target(rng, spec.span), _every(name))


def _pair(
    rng: Generator, spec: Spec, names: Sequence[str], scene: Scene, quiet: list[Record]
) -> tuple[Found, list[float]] | None:
    """Return a pair, and the gap ratio of each effect alone."""
    shapes = [EFFECTS[name](rng, Setting(scene, quiet, spec.form == "other")) for name in names]
    wide = (STRONG[0], 3 * STRONG[1])
    targets = [log_uniform(rng, 2.5, STRONG[1]) for _ in names]
    for _ in range(3):
        alone = []
        for name, shape, target in zip(names, shapes, targets, strict=True):
            one = adapt(scene, quiet, shape, wide, target, _every(name))
            if one is None:
                return None
            alone.append(one)
        fields = alone[0].fields | alone[1].fields
        records = scene.records(fields)
        if not _calm(records, quiet):
            return None
        gap, _ = measure(records, scene.plant(fields), every=_every(*names))
        if gap.ratio >= TOGETHER:
            return Found(fields, records, gap), [one.gap.ratio for one in alone]
        targets = [min(2 * target, 2 * STRONG[1]) for target in targets]
    return None


def _control(rng: Generator, spec: Spec, variant: str) -> tuple[Scene, Found, str] | None:
    """Return a control with its scene; its formulation of friction is part of the variant's
    name.
    """
    scene = draw_scene(rng, "rich", QUIET) if variant == "quiet" else draw_scene(rng, "rich")
    if variant == "other_friction":
        formulation, friction = other_friction(rng, scene.base)
        scene, variant = with_friction(scene, friction), f"{variant}: {formulation}"
    records = scene.records()
    gap, _ = measure(records, scene.plant())
    return (
        (scene, Found({}, records, gap), variant)
        if max(gap.ratio, gap.typical) < spec.span[1]
        else None
    )


def nominal(rng: Generator, scene: Scene, variant: str) -> Fields:
    """Return the parameters the workflow is given: up to 30 % off, or an inertia off by two."""
    given = {name: value * log_uniform(rng, 1 / 1.3, 1.3) for name, value in scene.base.items()}
    if variant == "wrong_inertia":
        given["J"] = scene.base["J"] * (2.0 if rng.random() < 0.5 else 0.5)
    return given


def bounds_of(given: Fields) -> dict[str, tuple[float, float]]:
    """Return how far each parameter may move."""
    return {
        name: (0.0 if name == "a2" else 0.2 * value, 5 * value) for name, value in given.items()
    }


def model_text(given: Fields) -> str:
    """Return the model file of a case."""
    lines = [
        'friction = "coulomb"',
        "[parameters]",
        *(f"{name} = {value:.6g}" for name, value in given.items()),
    ]
    lines += [
        "[bounds]",
        *(f"{name} = [{low:.6g}, {high:.6g}]" for name, (low, high) in bounds_of(given).items()),
    ]
    lines += ["[time]", 'column = "t"', 'unit = "s"']
    lines += ["[input]", 'column = "u"', 'kind = "torque"', 'unit = "N.m"']
    lines += [
        "[output]",
        'column = "theta"',
        'kind = "position"',
        'unit = "rad"',
        f"resolution = {RESOLUTION!r}",
    ]
    return "\n".join(lines) + "\n"


def parameters_of(name: str, fields: Fields) -> dict[str, float]:
    """Return the true parameters of an effect by their names in the catalogue; those without a part
    in it are left out.
    """
    values = {parameter: fields.get(f"{name}_{parameter}", 0.0) for parameter in PARAMETERS[name]}
    if name == "cogging" and values["amplitude2"] == 0:
        del values["amplitude2"], values["phase2"]
    if name == "load_friction" and values["falling"] == 0:
        del values["falling"], values["speed"]
    if name == "hard_stop":
        values = {key: value for key, value in values.items() if abs(value) < 1e5}
    return values


def _answer(
    spec: Spec, names: Sequence[str], scene: Scene, found: Found, variant: str | None
) -> dict[str, Any]:
    effects = (
        []
        if spec.kind in ("control", "outside")
        else [
            {
                "name": name,
                "class": class_of(name),
                "form": spec.form,
                "parameters": parameters_of(name, found.fields) if spec.form == "same" else {},
            }
            for name in names
        ]
    )
    return {
        "case": spec.index,
        "kind": spec.kind,
        "group": spec.group,
        "style": spec.style,
        "variant": variant,
        "effects": effects,
        "gap": {
            "base": found.gap.base,
            "floor": found.gap.floor,
            "ratio": found.gap.ratio,
            "typical": found.gap.typical,
        },
        "base": scene.base,
        "loop": scene.loop,
        "fields": {key: value for key, value in found.fields.items() if value != 0},
    }


def _names(rng: Generator, spec: Spec, attempt: int, shapes: int) -> tuple[str, ...]:
    """Return what the plan asks for, or what takes its place after some attempts in vain."""
    if attempt < shapes or spec.kind == "control":
        return spec.names
    if spec.kind == "outside":
        return (str(rng.choice(list(OUTSIDE))),)
    first = str(rng.choice(list(EFFECTS)))
    return (first, _partner(rng, first)) if spec.kind == "pair" else (first,)


def draw(commit: str, spec: Spec, shapes: int = SHAPES) -> Case:
    """Draw a case; what did not reach its gap ratio in `shapes` attempts is listed in the answer
    under `rejected`.
    """
    rng = np.random.default_rng(seed_of(commit, spec.index))
    rejected: list[str] = []
    for attempt in range(REDRAWS):
        names = _names(rng, spec, attempt, shapes)
        alone: list[float] = []
        found: Found | None = None
        variant = names[0] if spec.kind in ("control", "outside") else None
        if spec.kind == "control":
            control = _control(rng, spec, names[0])
            if control is not None:
                scene, found, variant = control
        else:
            scene = draw_scene(rng, spec.style)
            quiet = scene.records()
            if spec.kind == "pair":
                pair = _pair(rng, spec, names, scene, quiet)
                found, alone = pair if pair is not None else (None, [])
            else:
                found = _single(rng, spec, names[0], scene, quiet)
        if found is not None:
            given = nominal(rng, scene, names[0])
            answer = _answer(spec, names, scene, found, variant)
            answer |= {
                "alone": alone,
                "rejected": rejected,
                "nominal": given,
                "planned": list(spec.names),
            }
            return Case(spec.index, found.records, model_text(given), answer)
        rejected.append("+".join(names))
    raise RuntimeError(
        f"case {spec.index}: nothing reached gap ratios {spec.span} in {REDRAWS} draws: {rejected}"
    )


def write(case: Case, out: Path) -> None:
    """Write a case and its answer; the answer comes last, so that its presence means that the case
    is whole.
    """
    folder = out / "cases" / f"{case.index:05d}"
    folder.mkdir(parents=True, exist_ok=True)
    for name, record in zip("ab", case.records, strict=True):
        np.savez_compressed(folder / f"{name}.npz", t=record.t, u=record.u, theta=record.theta)
    (folder / "model.toml").write_text(case.model, encoding="utf-8")
    write_json(out / "answers" / f"{case.index:05d}.json", case.answer, indent=1)


def seal(out: Path) -> str:
    """Write the hashes of all answers (in the form of sha256sum) and return the hash of that
    list.
    """
    lines = [
        f"{hashlib.sha256(p.read_bytes()).hexdigest()}  answers/{p.name}\n"
        for p in sorted((out / "answers").glob("*.json"))
    ]
    text = "".join(lines)
    (out / "answers.sha256").write_text(text, encoding="utf-8")
    return hashlib.sha256(text.encode()).hexdigest()
