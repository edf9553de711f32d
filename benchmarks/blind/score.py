"""Score the effects named against sealed answers: each share with its count, its goal and an exact
95 % bound.

A case is judged by classes: right if the verdict is `named` and the classes named are exactly those
of the truth.
"""

from __future__ import annotations

import json
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from forms import can_be_taken, class_of
from shared import upper_bound

Json = dict[str, Any]
SLACK = 1e-9
# from a strength to an end of its interval, over the strength, from which on the report calls it
# not known
UNKNOWN = 0.5
# factor of the squared error over whole records beyond which the report calls a model worse than
# before
WORSE = 1.2
SINGLE = ("same", "other", "low", "faint")  # groups of one effect each, with rich excitation
OUTCOMES = (
    "right",
    "wrong",
    "in part",
    "tie with truth",
    "tie without",
    "none",
    "not_identifiable",
    "error",
)
BINS = ((0.0, 1.3), (1.3, 1.6), (1.6, 2.0), (2.0, 4.0), (4.0, 10.0), (10.0, math.inf))


def lower_bound(count: int, n: int) -> float:
    """Return the one-sided 95 % lower bound of a share."""
    return 1 - upper_bound(n - count, n) if n else 0.0


def _reach(effect: Json) -> float:
    """Return how far the interval of an effect's strength, or play, reaches, over its value;
    infinite where it is at a bound.
    """
    own = effect["parameters"]
    strength: Json = own["play"] if effect["name"] == "backlash" else next(iter(own.values()), {})
    if strength.get("at_bound") or strength.get("ci95") is None or not strength["value"]:
        return math.inf
    (low, high), value = strength["ci95"], strength["value"]
    return float(max(high - value, value - low) / abs(value))


@dataclass(frozen=True)
class Judged:
    """An answer, a result, and what follows from both."""

    answer: Json
    result: Json

    @property
    def truth(self) -> list[str]:
        """Classes of the hidden effects."""
        return sorted(class_of(effect["name"]) for effect in self.answer["effects"])

    @property
    def named(self) -> list[str]:
        """Classes named, by the scorer's own list; only those of the verdict `named` count."""
        found = self.result["effects"] if self.result["verdict"] == "named" else []
        return sorted({class_of(effect["name"]) for effect in found})

    @property
    def extra(self) -> list[str]:
        """Classes named that the truth does not have."""
        return [name for name in self.named if name not in self.truth]

    @property
    def missed(self) -> list[str]:
        """Classes of the truth that are not named."""
        return [name for name in self.truth if name not in self.named]

    @property
    def tied(self) -> set[str]:
        """Classes in any tie set."""
        return {class_of(name) for names in self.result.get("ties") or [] for name in names}

    @property
    def flagged(self) -> bool:
        """Whether an unexplained residual is reported."""
        return bool((self.result.get("remains") or {}).get("flag"))

    @property
    def doubted(self) -> bool:
        """Whether the report's heading is not green, by what the result says: a flag, records that
        do not agree, a strength that is not known, or whole records whose squared error is larger
        by a fifth than before."""
        agreement = self.result.get("agreement") or {"holds": True}
        horizons = (self.result.get("whole_record") or {}).get("horizons") or []
        worse = (
            bool(horizons)
            and (horizons[-1]["after"] or math.inf) ** 2
            > WORSE * (horizons[-1]["before"] or math.inf) ** 2
        )
        unknown = any(_reach(effect) >= UNKNOWN for effect in self.result["effects"])
        return self.flagged or not agreement["holds"] or unknown or worse

    @property
    def right(self) -> bool:
        """Whether exactly the classes of the truth are named."""
        return bool(self.truth) and self.named == self.truth

    @property
    def takable(self) -> bool:
        """Whether the other form of its effect is one that the catalogue can take as well."""
        return can_be_taken(self.answer["effects"][0]["name"], self.answer["fields"])

    @property
    def strict(self) -> bool:
        """Whether right by name too."""
        names = sorted(effect["name"] for effect in self.answer["effects"])
        return self.right and sorted(effect["name"] for effect in self.result["effects"]) == names

    @property
    def outcome(self) -> str:
        """One of `OUTCOMES`, for a case with an effect."""
        verdict = self.result["verdict"]
        if verdict == "named":
            return "right" if self.right else "wrong" if self.extra else "in part"
        if verdict == "tie":
            return "tie with truth" if set(self.truth) <= self.tied else "tie without"
        return str(verdict)

    @property
    def group(self) -> str:
        """Group of the plan."""
        return str(self.answer["group"])

    @property
    def ratio(self) -> float:
        """Gap ratio of the truth."""
        return float(self.answer["gap"]["ratio"])


@dataclass(frozen=True)
class Figure:
    """A figure beside its goal."""

    name: str
    value: float
    n: int
    goal: str
    met: bool | None  # None: reported, not judged
    bound: float | None = None
    count: int | None = None

    def row(self) -> str:
        """Return a row of the table."""
        value = f"{self.value:.4g}" if self.count is None else f"{self.count} of {self.n}"
        bound = "" if self.bound is None else f"{100 * self.bound:.2f} %"
        met = {True: "yes", False: "**no**", None: ""}[self.met]
        return f"| {self.name} | {value} | {self.n} | {bound} | {self.goal} | {met} |"


def judged_cases(out: Path, indices: Iterable[int]) -> list[Judged]:
    """Return those of the cases in a folder that have been diagnosed."""
    found = []
    for name in (f"{index:05d}.json" for index in indices):
        if (out / "results" / name).exists():
            answer, result = (
                json.loads((out / part / name).read_text(encoding="utf-8"))
                for part in ("answers", "results")
            )
            found.append(Judged(answer, result))
    return found


def _at_most(
    name: str, bad: Iterable[bool], limit: float | None, basis: int | None = None
) -> Figure:
    """Return a count of failures; `limit` of `basis` is allowed, in proportion for a smaller run
    (never less than none).
    """
    marks = list(bad)
    count, n = sum(marks), len(marks)
    goal, met = "reported", None
    if limit is not None:
        allowed = (
            math.floor(limit * max(n, 1) / basis + SLACK)
            if basis
            else math.floor(limit * n + SLACK)
        )
        goal, met = (
            (f"<= {limit:g} of {basis}" if basis else f"<= {100 * limit:g} %"),
            count <= allowed if n else None,
        )
    return Figure(
        name,
        count / n if n else math.nan,
        n,
        goal,
        met,
        upper_bound(count, n) if n else None,
        count,
    )


def _at_least(name: str, good: Iterable[bool], share: float | None) -> Figure:
    """Return a count of successes with the lower bound of their share."""
    marks = list(good)
    count, n = sum(marks), len(marks)
    met = None if share is None or not n else count >= share * n - SLACK
    goal = "reported" if share is None else f">= {100 * share:g} %"
    return Figure(name, count / n if n else math.nan, n, goal, met, lower_bound(count, n), count)


def _number(
    name: str,
    values: Sequence[float],
    reduce: Callable[[Any], Any],
    goal: str,
    passes: Callable[[float], bool] | None,
) -> Figure:
    value = float(reduce(values)) if len(values) else math.nan
    return Figure(name, value, len(values), goal, passes(value) if passes and len(values) else None)


def percentile(share: float) -> Callable[[Sequence[float]], float]:
    """Return the function that takes a percentile."""
    return lambda values: float(np.percentile(values, share))


# sizes of waves with their phases
WAVES = (("amplitude", "phase"), ("amplitude2", "phase2"), ("share", "phase"))


def _turn(angle: float) -> float:
    return (angle + math.pi) % (2 * math.pi) - math.pi


def normalise(name: str, values: dict[str, float]) -> dict[str, float]:
    """Return parameters of a wave with a positive amplitude and a phase within half a turn: (A,
    phi) is (-A, phi + pi).
    """
    out = dict(values)
    for amplitude, phase in WAVES:
        if amplitude in out and phase in out:
            if out[amplitude] < 0:
                out[amplitude], out[phase] = -out[amplitude], out[phase] + math.pi
            out[phase] = _turn(out[phase])
    return out


def parameter_error(parameter: str, true: float, found: float) -> float:
    """Return the relative error; of an angle its difference over a turn, of a place or a time the
    difference itself.
    """
    if parameter.startswith("phase"):
        return abs(_turn(found - true)) / (2 * math.pi)
    if parameter in ("upper", "lower", "onset"):
        return abs(found - true)  # over 1 rad, over 1 s: relative to an arbitrary zero says nothing
    return abs(found / true - 1)


def covers(parameter: str, true: float, ci: Sequence[float], value: float) -> bool:
    """Return whether an interval has the truth inside; of an angle, whatever turn or sign of
    amplitude it is reported in.
    """
    low, high = min(ci), max(ci)
    if parameter.startswith("phase"):
        return any(low <= true + math.pi * half * 2 <= high for half in range(-4, 5))
    return low <= true <= high


def _compare(truth: Json, found: Json) -> list[tuple[str, float, bool | None]]:
    """Return (parameter, error, covered) for every true parameter that is reported."""
    reported = {key.split(".")[-1]: entry for key, entry in found["parameters"].items()}
    values = {key: float(entry["value"]) for key, entry in reported.items()}
    flips = {phase: size for size, phase in WAVES if phase in values and values.get(size, 1.0) < 0}
    true, seen = normalise(truth["name"], truth["parameters"]), normalise(truth["name"], values)
    rows = []
    for key, value in true.items():
        if key not in seen:
            continue
        ci = reported[key].get("ci95")
        covered = None
        if ci is not None and None not in ci:
            shift = math.pi if key in flips else 0.0
            ends = [-ci[1], -ci[0]] if key in flips.values() else [ci[0] + shift, ci[1] + shift]
            covered = covers(key, value, ends, seen[key])
        rows.append((f"{truth['name']}.{key}", parameter_error(key, value, seen[key]), covered))
    return rows


def parameter_rows(cases: Iterable[Judged]) -> list[tuple[str, float, bool | None]]:
    """Return errors and coverage of all parameters of effects in the catalogue's own form that are
    named by name.
    """
    rows = []
    for case in cases:
        if not case.right:
            continue
        found = {effect["name"]: effect for effect in case.result["effects"]}
        for truth in case.answer["effects"]:
            if truth["form"] == "same" and truth["name"] in found:
                rows += _compare(truth, found[truth["name"]])
    return rows


def _poor_wrong(case: Judged) -> bool:
    """Return whether a case of poor excitation is misjudged: a wrong name, or a tie set without the
    truth.
    """
    return bool(case.extra) or case.outcome == "tie without" or case.outcome == "error"


def _poor_helped(case: Judged) -> bool:
    """Return whether the truth is named or in the tie set, or the data are called insufficient."""
    return case.right or case.outcome in ("tie with truth", "not_identifiable")


def _naming(cases: list[Judged]) -> list[Figure]:
    of = defaultdict(list)
    for case in cases:
        of[case.group].append(case)
    clear = [c for c in cases if c.answer["effects"]]
    named = [c for c in clear if c.result["verdict"] == "named"]
    takable = [c for c in of["other"] if c.takable]
    untakable = [c for c in of["other"] if not c.takable]
    doubted = "in doubt (no green heading) although named right"
    takes, not_takes = (
        f"of these, a form that {it}" for it in ("the catalogue can take", "it cannot take")
    )
    return [
        _at_most("not named right, own form, ratio >= 2", map(_wrong, of["same"]), 3, 300),
        _at_most("not named right, other form, ratio >= 2", map(_wrong, of["other"]), 9, 300),
        _at_most(takes, map(_wrong, takable), None),
        _at_most(not_takes, map(_wrong, untakable), None),
        _at_least("named right, ratio 1.3 to 2", map(RIGHT, of["low"]), 0.85),
        _at_least("named right, ratio < 1.3", map(RIGHT, of["faint"]), None),
        _at_most("a wrong class among all that were named", map(_extra, named), 1, 450),
        _at_least(
            "strictly right by name, ratio >= 2", map(STRICT, of["same"] + of["other"]), None
        ),
        _at_most(doubted, (c.doubted for c in clear if c.right), None),
        _at_most("a wrong name, and no doubt said", map(_undoubted, filter(_named, cases)), None),
    ]


RIGHT, FLAGGED, STRICT = attrgetter("right"), attrgetter("flagged"), attrgetter("strict")


def _wrong(case: Judged) -> bool:
    return not case.right


def _named(case: Judged) -> bool:
    return bool(case.named)


def _extra(case: Judged) -> bool:
    return bool(case.extra)


def _undoubted(case: Judged) -> bool:
    return bool(case.extra) and not case.doubted


def _unflagged(case: Judged) -> bool:
    return not case.flagged


def _restraint(cases: list[Judged]) -> list[Figure]:
    controls = [c for c in cases if c.group == "control"]
    outside = [c for c in cases if c.group == "outside"]
    right = [c for c in cases if c.group in SINGLE and c.right]
    ties = (c.result["verdict"] == "tie" for c in controls)
    misnamed = (_named(c) and _unflagged(c) for c in outside)
    return [
        _at_most("false alarm on a control (anything named)", map(_named, controls), 1, 240),
        _at_most("tie reported on a control", ties, None),
        _at_most("control flagged 'unexplained residual'", map(FLAGGED, controls), None),
        _at_most("outside: misnamed without a flag", misnamed, 1, 240),
        _at_most("outside: not flagged", map(_unflagged, outside), 6, 240),
        _at_most("outside: misnamed, flagged or not", map(_named, outside), None),
        _at_most("false 'unexplained residual' when named right", map(FLAGGED, right), 0.05),
    ]


def _several(cases: list[Judged]) -> list[Figure]:
    pairs = [c for c in cases if c.group == "pair"]
    poor = [c for c in cases if c.group == "poor"]
    return [
        _at_most("pairs: an effect missed", (bool(c.missed) for c in pairs), 3, 160),
        _at_most("pairs: both missed", (len(c.missed) == 2 for c in pairs), None),
        _at_most("pairs: a wrong extra effect", (bool(c.extra) for c in pairs), 1, 160),
        _at_most(
            "poor excitation: truth neither named nor in the tie, nor called not identifiable",
            (not _poor_helped(c) for c in poor),
            3,
            160,
        ),
        _at_most(
            "poor excitation: a wrong name, or a tie without the truth",
            (_poor_wrong(c) for c in poor),
            None,
        ),
    ]


def _quality(cases: list[Judged]) -> list[Figure]:
    right = [c for c in cases if c.right and c.group != "poor"]
    gaps = [(c.result.get("gap") or {}).get("shrink") for c in right]
    shrink = [float(gap) for gap in gaps if gap is not None]
    seconds = [float(c.result["seconds"]) for c in cases]
    failed = (c.result["verdict"] == "error" for c in cases)
    return [
        _number("shrink when right, median", shrink, np.median, ">= 0.98", lambda x: x >= 0.98),
        *_own_form(c for c in cases if c.group == "same"),
        _number("seconds of one core a case, median", seconds, np.median, "reported", None),
        _number("seconds of one core a case, longest", seconds, max, "<= 10", lambda x: x <= 10),
        _at_most("cases that ended in an error", failed, 0.0),
    ]


def _own_form(same: Iterable[Judged]) -> list[Figure]:
    rows = parameter_rows(same)
    errors = [error for _, error, _ in rows]
    half, most = "parameter error, own form, median", "parameter error, own form, 90th percentile"
    covered = (c for *_, c in rows if c is not None)
    coverage = _at_least("95 % intervals that cover the truth, own form", covered, None)
    # a few that all cover are not too wide
    met = coverage.value >= 0.9 and (coverage.bound or 0.0) <= 0.99 if coverage.n else None
    return [
        _number(half, errors, np.median, "<= 0.02", lambda x: x <= 0.02),
        _number(most, errors, percentile(90), "reported", None),
        replace(coverage, goal="90 to 99 %", met=met),
    ]


def figures(cases: list[Judged]) -> list[Figure]:
    """Return all figures."""
    return _naming(cases) + _restraint(cases) + _several(cases) + _quality(cases)


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return [*lines, *("| " + " | ".join(str(cell) for cell in row) + " |" for row in rows), ""]


def _share(count: int, n: int) -> str:
    return f"{count} of {n}" if n else ""


def _outcomes(cases: list[Judged], groups: Sequence[str]) -> list[str]:
    rows = []
    for group in groups:
        some = [c for c in cases if c.group == group]
        counted = Counter(c.outcome for c in some)
        rows.append(
            [group, len(some), *(counted[o] for o in OUTCOMES), sum(c.strict for c in some)]
        )
    return _table(["group", "n", *OUTCOMES, "strict name"], rows)


def _by_ratio(cases: list[Judged]) -> list[str]:
    rows = []
    for low, high in BINS:
        some = [c for c in cases if c.answer["kind"] == "single" and low <= c.ratio < high]
        right = sum(c.right for c in some)
        bound = f"{100 * lower_bound(right, len(some)):.1f} %" if some else ""
        rows.append(
            [f"{low:g} to {high:g}", len(some), right, bound, sum(bool(c.extra) for c in some)]
        )
    return _table(["gap ratio", "n", "right", "at least (95 %)", "wrong"], rows)


def _by_effect(cases: list[Judged]) -> list[str]:
    singles = [c for c in cases if c.answer["kind"] == "single"]
    rows = []
    for name in sorted({c.answer["effects"][0]["name"] for c in singles}):
        some = [c for c in singles if c.answer["effects"][0]["name"] == name]
        cells = []
        for group in SINGLE:
            part = [c for c in some if c.group == group]
            cells.append(_share(sum(c.right for c in part), len(part)))
        rows.append([name, *cells, sum(c.strict for c in some), sum(bool(c.extra) for c in some)])
    return _table(
        ["effect", "own form", "other form", "1.3 to 2", "< 1.3", "strict name", "wrong"], rows
    )


def _by_variant(cases: list[Judged], group: str) -> list[str]:
    some = [c for c in cases if c.group == group]
    rows = []
    for variant in sorted({c.answer["variant"] for c in some}):
        part = [c for c in some if c.answer["variant"] == variant]
        names = Counter("+".join(c.named) for c in part if c.named)
        rows.append(
            [
                variant,
                len(part),
                sum(bool(c.named) for c in part),
                sum(c.result["verdict"] == "tie" for c in part),
                sum(not c.flagged for c in part),
                sum(bool(c.named) and not c.flagged for c in part),
                ", ".join(f"{name} {count}" for name, count in names.most_common()),
            ]
        )
    return _table(["kind", "n", "named", "tie", "not flagged", "named, not flagged", "names"], rows)


def _confusion(cases: list[Judged]) -> list[str]:
    singles = [c for c in cases if c.answer["kind"] == "single"]
    counted: dict[str, Counter[str]] = defaultdict(Counter)
    for c in singles:
        counted[c.truth[0]]["+".join(c.named) or c.result["verdict"]] += 1
    columns = sorted({name for counter in counted.values() for name in counter})
    return _table(
        ["truth / named", *columns],
        ([t, *(counted[t][name] or "" for name in columns)] for t in sorted(counted)),
    )


def _parameters(cases: list[Judged]) -> list[str]:
    rows: dict[str, list[tuple[float, bool | None]]] = defaultdict(list)
    for name, error, covered in parameter_rows(c for c in cases if c.group == "same"):
        rows[name].append((error, covered))
    lines = []
    for name in sorted(rows):
        errors = [error for error, _ in rows[name]]
        known = [covered for _, covered in rows[name] if covered is not None]
        middle, tail = f"{np.median(errors):.3g}", f"{np.percentile(errors, 90):.3g}"
        lines.append([name, len(errors), middle, tail, _share(sum(known), len(known))])
    return _table(["parameter", "n", "median error", "90th percentile", "interval covers"], lines)


def _draws(cases: list[Judged]) -> list[str]:
    rejected = Counter(name for c in cases for name in c.answer["rejected"])
    return _table(["drawn in vain", "times"], rejected.most_common())


NOTE = """Class named right: verdict "named" and exactly the classes of the truth. Bounds are
one-sided 95 % Clopper-Pearson bounds: upper for failures, lower for successes. A smaller run is
allowed failures in proportion, rounded down. Errors of parameters are relative; of angles in turns,
of a stop's place in rad, of an onset in s; (A, phi) and (-A, phi + pi) are one; a parameter that is
not reported, such as a second stop that was not found, has none. The gap ratio is the truth's own,
see benchmarks/blind/gap.py. Of the other forms some are within what a parameter of the catalogue's
form can do (a second harmonic, a power, a settling drift: see `TAKEN` in
benchmarks/blind/forms.py).
"""


def tables(pairs: Sequence[tuple[Json, Json]]) -> tuple[str, str, Json]:
    """Return the figures and the other tables as markdown, and the figures as data, from pairs of
    (answer, result).
    """
    cases = [Judged(answer, result) for answer, result in pairs]
    found = figures(cases)
    head = _table(["figure", "value", "n", "95 % bound", "goal", "met"], [])[:-1]
    lines = ["## Outcomes", "", *_outcomes(cases, (*SINGLE, "pair", "poor"))]
    lines += ["## By gap ratio", "", *_by_ratio(cases), "## By effect", "", *_by_effect(cases)]
    lines += [
        "## Controls",
        "",
        *_by_variant(cases, "control"),
        "## Outside the catalogue",
        "",
        *_by_variant(cases, "outside"),
    ]
    lines += ["## Confusion", "", *_confusion(cases), "## Parameters", "", *_parameters(cases)]
    lines += ["## Draws", "", *_draws(cases)]
    data = [
        {**figure.__dict__, "value": None if math.isnan(figure.value) else figure.value}
        for figure in found
    ]
    return (
        "\n".join([NOTE, *head, *(figure.row() for figure in found)]),
        "\n".join(lines),
        {"cases": len(cases), "figures": data},
    )
