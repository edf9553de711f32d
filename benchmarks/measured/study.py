"""Diagnose measured data of four rigs whose missing effect is known, and write the results.

    python benchmarks/measured/study.py            # all four
    python benchmarks/measured/study.py emps       # these folders only

All four write benchmarks/results/measured.md, docs/images and docs/diagnosis.md; of some only, the
tables are printed, and figures go to out/measured.

The data are not part of the repository: they are looked for in the folder that BRISTLE_DATA names.
A set that is not there is skipped, with a line that says so.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

# before numpy
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")
sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent))

import draw
from cases import FOLDERS, Run
from measured_data import MEASURED_FOLDER
from page import put

from bristle.diagnosis import Diagnosis
from bristle.diagnosis.report.text.names import view_name

ROOT = Path(__file__).resolve().parents[2]
IMAGES, MEASURED_TABLE = ROOT / "docs" / "images", ROOT / "benchmarks" / "results" / "measured.md"
MEASURED_INTRODUCTION = """## Measured data

`python benchmarks/measured/study.py`: each set is diagnosed from a rough model, with the bounds of
a model file that gives none. Errors are those of held-out segments. An answer is right if it names
the hidden effect and none that is not there, by itself or by its tie.

What these figures do not say:

- Right refers to the names alone. The column "against it" lists what the same result says against
  the answer: an error on held-out segments that does not fall, a residual that is not explained,
  parameters that end at a bound.
- The effects were known in advance and the sets were at hand while the rules were made: they are
  examples, not a sample that gives an error rate.
- For XL330 gravity counts as right alone, with load_friction, and with load_friction and back_emf.

The records are not part of the repository. They are looked for in `../shared/data` beside it, or
where `BRISTLE_DATA` says; a set that is not there is skipped with a line on standard error, and the
exit code stays 0. EMPS (Janot, Gautier and Brunot, Workshop on Nonlinear System Identification
Benchmarks, 2019) lies in `emps/`, from github.com/forgi86/sysid-neural-continuous; XL330 in
`bam_xl330_gain/`, from github.com/Rhoban/bam; Go1 in `bam_go1_load/`, from the fork
github.com/rimim/bam; ODrive in `odrive_cogging/`, from github.com/gchenfc/ODrive
(analysis/cogging_torque).
"""
SET_DESCRIPTIONS = {
    "emps": (
        """Linear axis with a ball screw, 25 s at 1 kHz; the input is in volts with its known gain
in N/V. The model has viscous and symmetric Coulomb friction; the authors of the data name an
offset, and friction that differs by direction."""
    ),
    "bam_xl330_gain": (
        """Half a kilogram at 0.1 m on a small servo, 12 runs of 6 s at four gains of its position
loop; the input is the voltage. Gravity is missing from the model. Those who recorded the data also
name friction that grows with the load. In the first round cogging gains more than gravity, but with
its number of periods at the limit, two in a turn, where it stands in for another effect."""
    ),
    "bam_go1_load": (
        """Runs of 6 s at 62.5 Hz with 0, 1, 2 and 3 kg at 0.15 m. The model is fitted to the runs
without a load; with one, gravity must grow in proportion, and inertia by as much for each kilogram,
from what motor and arm have: on a straight line then, and not one through zero. The logged torque
is that of the rotor, ahead of a gear that the data do not mention."""
    ),
    "odrive_cogging": (
        """A motor turned once, slowly, three times with its anti-cogging compensation off and three
times on; the input is the measured current, compensation included: the compensation changes the
motion, not the motor. With it off, cogging must be named; with it on, the cogging of the motion
must be gone or much smaller, and may be named or not. Simulations of these records diverge easily,
so the end of the refit depends on how a processor rounds. On another processor the error with the
compensation off falls from 0.00955 to 0.00913 rad; the names are the same, also from a nominal
inertia 4 % smaller."""
    ),
}


def lines_of(run: Run) -> list[str]:
    """Return the result of one diagnosis, as a list in markdown."""
    found = run.found
    lines = [
        f"**{run.name}** ({len(run.records)} {'records' if len(run.records) > 1 else 'record'},"
        f" {run.question}): **{run.said}**, {'right' if run.right else 'wrong'}."
    ]
    lines += [f"  - {line}" for line in found.statement]
    lines += [f"  - {name}: {text}" for name, text in run.numbers.items()]
    return [f"- {lines[0]}", *lines[1:]]


def objections(found: Diagnosis) -> list[str]:
    """Return what a result itself says against its answer, in a few words each."""
    said = []
    if found.effects and found.gap.after >= found.gap.before:
        said.append("the error does not fall")
    if found.remains.flag:
        view = (
            view_name(found.remains.view, found.remains.label)
            if found.remains.view
            else "no motion variable"
        )
        said.append(f"{found.remains.share:.0%} of the residual follows {view}")
    if stuck := [name for name, estimate in (found.parameters or {}).items() if estimate.at_bound]:
        said.append(f"{', '.join(stuck)} at a bound")
    return said


def table(runs: Sequence[Run]) -> list[str]:
    """Return all diagnoses as a table."""
    rows = [
        (
            "| records | question | result | right | against it | rms error before | after | noise"
            " alone | s |"
        ),
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for run in runs:
        gap = run.found.gap
        squares = (gap.before, gap.after, gap.noise_floor)
        cells = [
            f"{x**0.5:.3g} {gap.output_unit}" if x is not None and x >= 0 else "–" for x in squares
        ]
        mark = "yes" if run.right else "no"
        judged = f"{mark} | {'; '.join(objections(run.found)) or '–'}"
        rows.append(
            f"| {run.name} | {run.question} | {run.said} | {judged} | {' | '.join(cells)} |"
            f" {run.found.seconds:.0f} |"
        )
    return rows


def section(folder: str, runs: Sequence[Run], image: str) -> list[str]:
    """Return the text on one data set."""
    title, _ = FOLDERS[folder]
    body = [line for run in runs for line in lines_of(run)]
    return [f"### {title}", "", SET_DESCRIPTIONS[folder], "", f"![{title}]({image})", "", *body, ""]


def main(folders: Sequence[str]) -> int:
    """Diagnose the data sets that are there."""
    chosen, said, runs, complete = folders or list(FOLDERS), [], [], True
    for folder in chosen:
        if not (MEASURED_FOLDER / folder).is_dir():
            print(
                f"{folder}: skipped, {MEASURED_FOLDER / folder} is not there (set BRISTLE_DATA)",
                file=sys.stderr,
            )
            complete = False
            continue
        done = list(FOLDERS[folder][1](lambda what: print(what, file=sys.stderr, flush=True)))
        picture = draw.write(folder, done, IMAGES if not folders else ROOT / "out" / "measured")
        said += section(folder, done, f"images/{picture.name}")
        runs += done
    if not runs:
        return 0
    text = "\n".join([MEASURED_INTRODUCTION, *table(runs), "", *said])
    if folders or not complete:
        print(text)
        return 0
    MEASURED_TABLE.write_text(
        "# Measured data\n\n" + "\n".join(table(runs)) + "\n", encoding="utf-8"
    )
    put("measured data", "benchmarks/measured/study.py", text)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
