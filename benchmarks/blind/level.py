"""How often chance lifts an effect above the level: a parametric bootstrap of models fitted to
records without any effect.

    python benchmarks/blind/level.py [--controls 12] [--replicates 20] [--jobs 2] [--out out/level]

Each control of the blind generator is fitted; from that fit records are simulated with new noise
(disturbance torque and sensor as estimated, the encoder's steps) under the same input; in each of
these all effects are tried, as in a diagnosis. The table goes to benchmarks/results/level.md. An
interrupted run continues with what is missing.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))

import numpy as np
import run
from cases import CONTROL_RATIO, CONTROLS, Spec, draw, write
from scipy.stats import binomtest
from shared import write_json
from truth import RESOLUTION, Array

from bristle.common.arguments import filled_path
from bristle.diagnosis import Record, load_model, load_records, records_from_arrays
from bristle.diagnosis.checks.preparation import PreparedCase, prepared_case
from bristle.diagnosis.estimation.dataset import (
    Piece,
    Segments,
)
from bristle.diagnosis.estimation.fitted_model import FittedModel
from bristle.diagnosis.experiment.discrimination import disturbance
from bristle.diagnosis.modelfile import Model
from bristle.diagnosis.selection.null_distribution import FALSE_ALARM_RATE, REFIT_FACTOR
from bristle.diagnosis.selection.start_values import SearchOptions
from bristle.diagnosis.selection.stepwise import search

LEVEL_SEED = "level"
FACTORS = (1.0, 2.0, 3.0, 4.0)  # times the quantile of the scores
MOST_CONTROLS = 100  # replicates of a control are numbered from so many times its own number


def prepared(model: Model, records: Sequence[Record]) -> PreparedCase:
    """Return the case as a diagnosis prepares it before effects are tried."""
    case = prepared_case(model, records, (), lambda *_: None)
    assert isinstance(case, PreparedCase)
    return case


def replicate(
    fitted: FittedModel, records: Sequence[Record], rng: np.random.Generator
) -> list[tuple[str, Array, Array, Array]]:
    """Return records (name, time, u, y) that the fitted model gives under the same inputs and new
    noise.
    """
    fit, made = fitted.fit, []
    grid = fit.simulator.segments
    for record, piece in zip(records, grid.pieces, strict=True):
        u, noise = np.asarray(record.u), fit.noise
        torque = u + disturbance(len(u), noise, fit.values["b"], record.h, rng)
        none, start, unsure = np.zeros((1, len(u))), piece.initial[:1], np.ones((1, 2))
        whole = Piece(
            record.name, float(record.time[0]), torque, none, start, unsure, piece.seconds
        )
        simulator = fit.simulator.over(Segments(record.h, 1, len(u), grid.velocity, (whole,)))
        simulated, _, good, _ = simulator.run(fit.values, whole.initial)
        if not good.all():
            raise RuntimeError(f"{record.name}: the fitted model cannot be simulated")
        # of a sample, beside the steps
        beside = math.sqrt(max(noise.sensor**2 * grid.width - RESOLUTION**2 / 12, 0.0))
        y = simulated[0] + beside * rng.standard_normal(len(u))
        made.append((record.name, record.time, u, np.round(y / RESOLUTION) * RESOLUTION))
    return made


def searched(folder: Path, number: int, target: Path) -> None:
    """Try all effects on one replicate of a control, and write how far the best one is above what
    chance gives.
    """
    model = load_model(folder / "model.toml")
    records = load_records(model, [folder / "a.npz", folder / "b.npz"])
    rng = np.random.default_rng([number, 1])
    again = records_from_arrays(model, replicate(prepared(model, records).base, records, rng))
    case = prepared(model, again)
    base = case.base
    [first, *_] = search(case.dataset, base, SearchOptions(jobs=1, test_input_hold=False)).rounds
    excess = [
        c.gain_over(base.fit) - first.null.typical.get(c.name, 0.0) for c in first.trials if c.fit
    ]
    quantile = float(np.quantile(first.null.draws, 1 - FALSE_ALARM_RATE)) / REFIT_FACTOR
    named = first.best.name if first.said.outcome in ("added", "withdrawn") and first.best else ""
    write_json(
        target,
        {
            "excess": max(excess),
            "quantile": quantile,
            "outcome": first.said.outcome,
            "named": named,
        },
    )


def level_specs(count: int) -> list[Spec]:
    """Return the controls, of each kind in turn."""
    return [
        Spec(k, "control", "control", (CONTROLS[k % len(CONTROLS)],), span=(0.0, CONTROL_RATIO))
        for k in range(1, count + 1)
    ]


def level_rows(results: Sequence[dict[str, Any]]) -> str:
    """Return the lines of the table."""

    def row(what: str, hits: int) -> str:
        low, high = (
            100 * end for end in binomtest(hits, len(results)).proportion_ci(0.95, "exact")
        )
        return (
            f"| {what} | {hits} of {len(results)} ({100 * hits / len(results):.1f} %) | {low:.1f}"
            f" to {high:.1f} % |"
        )

    lines = [
        row(
            f"{factor:g} times the quantile of the scores",
            sum(r["excess"] > factor * r["quantile"] for r in results),
        )
        for factor in FACTORS
    ]
    return "\n".join([*lines, row("an effect named", sum(bool(r["named"]) for r in results))])


def main() -> None:
    """Make the controls and their replicates, and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--controls", type=int, default=12)
    parser.add_argument("--replicates", type=int, default=20, help="of each control")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=filled_path, default=run.ROOT / "out" / "level")
    parser.add_argument(
        "--finished", action="store_true", help="write the table of what is done, and make no more"
    )
    given = parser.parse_args()
    (given.out / "results").mkdir(parents=True, exist_ok=True)
    specs = level_specs(given.controls)
    for spec in [] if given.finished else specs:
        if not (given.out / "answers" / f"{spec.index:05d}.json").exists():
            write(draw(LEVEL_SEED, spec), given.out)
    numbers = [
        (spec, MOST_CONTROLS * spec.index + k) for k in range(given.replicates) for spec in specs
    ]
    calls = [
        (given.out / "cases" / f"{spec.index:05d}", n, given.out / "results" / f"{n}.json")
        for spec, n in numbers
    ]
    if not given.finished:
        run.go_on(searched, calls, given.jobs, "level")
    results = [
        json.loads(path.read_text(encoding="utf-8")) for _, _, path in calls if path.exists()
    ]
    rows = level_rows(results)
    (run.ROOT / "benchmarks" / "results" / "level.md").write_text(
        LEVEL_PAGE.format(controls=len(specs), replicates=given.replicates, rows=rows), "utf-8"
    )
    print(rows)


LEVEL_PAGE = """# How often chance lifts an effect above its level

`python benchmarks/blind/level.py --controls {controls} --replicates {replicates}`: a parametric
bootstrap of the null. Controls of the blind generator (nothing hidden; noise of several kinds, a
wrong inertia, a quiet servo, another formulation of friction) are fitted, records are simulated
from each fit under the same input with new noise (the estimated disturbance torque and error of the
sensor, the encoder's steps), and all effects are tried in these as in a diagnosis.

| first round of a search: the largest gain, less what is usual for its effect, is above | found |\
 95 % interval |
|---|---|---|
{rows}

The quantile is that which the null distribution exceeds in 1 of 500 draws of random signs of the
segments' scores (rule 3 in [how the diagnosis decides](../../docs/diagnosis_rules.md)), a matter of
milliseconds. Refits from several starts gain more than scores tell, as the first line shows, so
that the level is `REFIT_FACTOR` times that quantile. An effect above the level is named only if it
meets the rest of the criterion too (last line). Intervals are those of Clopper and Pearson over all
replicates, as if those of one control were independent.
"""


if __name__ == "__main__":
    main()
