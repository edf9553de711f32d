"""Records sampled more slowly than the drive works: what is named, with the input as detected and
with it taken as held.

    low_rate_records.py [--out out/slow] [--jobs 2]

Controls and single effects from the generator of the blind test, whose drive works at 1 kHz; every
fourth or sixteenth sample is kept. The table goes to docs/diagnosis.md. An interrupted run
continues with the cases that are missing.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import shutil
from pathlib import Path
from typing import Any

import run  # sets the threads, before numpy
from page import put
from score import Judged

from bristle.common.arguments import filled_path

# seed of the generator; share of its full plan
LOW_RATE_SEED, LOW_RATE_SCALE = "slow, second", 0.02
KEPT_EVERY = (4, 16)  # every how many-th sample is kept
# how the input between samples is taken: held, or as the diagnosis detects it
INPUT_WAYS = ("held", "found")


def thinned(case: Path, every: int, folder: Path) -> Path:
    """Write each `every`-th sample of a case and return the folder."""
    import numpy as np  # after the threads are set

    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(case / "model.toml", folder)
    for name in ("a.npz", "b.npz"):
        with np.load(case / name) as record:
            np.savez(folder / name, **{key: record[key][::every] for key in record.files})
    return folder


def diagnose_slow(case: Path, every: int, way: str, target: Path) -> None:
    """Diagnose a thinned case; with the way "held" the input is taken as held without a check."""
    folder = thinned(case, every, target.parent / "records" / f"{target.stem}")
    run.diagnose_one(folder, target, {"test_input_hold": way == "found"})


def row(out: Path, answers: list[Any], every: int, way: str) -> str:
    """Return a line of the table."""
    judged = [
        Judged(a, json.loads(_target(out, a, every, way).read_text(encoding="utf-8")))
        for a in answers
    ]
    controls, singles = (
        [j for j in judged if (j.group == "control") is wanted] for wanted in (True, False)
    )
    false, right, wrong = (
        sum(map(bool, each))
        for each in (
            [j.named for j in controls],
            [j.right for j in singles],
            [j.extra for j in singles],
        )
    )
    said = sum(
        j.result.get("excitation", {}).get("input_between_samples") == "changing" for j in judged
    )
    figures = (
        f"{false} of {len(controls)} | {right} of {len(singles)} | {wrong} of {len(singles)} |"
        f" {said} of {len(judged)}"
    )
    return f"| {1000 / every:.3g} Hz | {way} | {figures} |"


def _target(out: Path, answer: Any, every: int, way: str) -> Path:
    return out / "slow" / f"{answer['case']:05d}-{every}-{way}.json"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=filled_path, default=run.ROOT / "out" / "slow")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    a = parser.parse_args()
    run.generate(LOW_RATE_SEED, a.out, LOW_RATE_SCALE, a.jobs, ("controls", "single"))
    answers = [
        json.loads(path.read_text(encoding="utf-8"))
        for path in sorted((a.out / "answers").glob("*.json"))
    ]
    calls = [
        (a.out / "cases" / f"{each['case']:05d}", every, way, _target(a.out, each, every, way))
        for each, every, way in itertools.product(answers, KEPT_EVERY, INPUT_WAYS)
    ]
    run.go_on(diagnose_slow, calls, a.jobs, "diagnose")
    rows = "\n".join(row(a.out, answers, every, way) for every in KEPT_EVERY for way in INPUT_WAYS)
    put(
        "slow records",
        "benchmarks/blind/low_rate_records.py",
        f"""## Records with a low sampling rate

`python benchmarks/blind/low_rate_records.py`: controls and single effects of gap ratio 2 and more,
half in another form, from a drive that works at 1 kHz; every fourth or sixteenth sample is kept.
`held`: the diagnosis assumes an input that is constant between these samples, which it was not;
`found`: it decides by rule 1 of diagnosis_rules.md how the input changes between them. (What it
estimates includes any delay of less than half a sample.)

| logged at | input | controls named | named right | with a wrong name | reported as not held |
|---|---|---|---|---|---|
{rows}

With so few cases the table gives no bound on an error rate. They come from the generator of the
blind test, so its limits apply; and as its drive works at 1 kHz, the input is never truly held
between the samples kept.
""",
    )
    print(rows)


if __name__ == "__main__":
    main()
