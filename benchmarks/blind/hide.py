"""The cases of scenarios/hidden: one of each effect, some without, in an order that says nothing;
and the sealed answers.

    python benchmarks/blind/hide.py [--out DIR] [--jobs 2]

The same bytes each time, on one machine with one compiler. Back EMF of a drive whose input is a
torque is viscous friction and nothing else, so its case has more of that than the given model, and
a refit takes it up: no name is right there.
"""

from __future__ import annotations

import argparse
import base64
import hashlib
import json
import sys
import zlib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import chain
from multiprocessing import get_context
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))

import numpy as np
from cases import CONTROL_RATIO, REDRAWS, Case, Spec, bounds_of, draw, nominal, seed_of
from forms import EFFECTS, Fields
from gap import measure
from scene import draw_scene, log_uniform
from truth import PERIOD, RESOLUTION, Record, library

from bristle.common.arguments import filled_path

SEED = "hidden"
FOLDER = Path(__file__).resolve().parents[2] / "scenarios" / "hidden"
SEALED, DIGEST = "answers.sealed", "answers.sha256"
SPAN = (4.0, 15.0)  # gap ratios
OUTSIDE, CONTROLS, PAIR = (
    "timed_tone",
    ("noise_only", "wrong_inertia"),
    ("cogging", "quadratic_drag"),
)
STEP = 2.0**-10  # N.m, a 12 bit converter of 2 N.m either way
# came when the others had their numbers
LATER = (
    ("encoder_play", "asymmetric_viscous", "gear_loss"),
    ("return_spring",),
    ("torque_ripple",),
)
CURRENTS = 4  # cases whose input is a current, whatever is hidden in them
CONSTANTS = (0.0625, 0.125, 0.25)  # N.m/A, powers of two: the steps stay exact
ABSORBED = (0.8, 1.8)  # back EMF over viscous friction


def specs() -> list[Spec]:
    """Return all cases, numbered from 1 in an order that says nothing about them; what came later
    has the last numbers.
    """
    first = (name for name in EFFECTS if name not in chain(*LATER))
    found = [Spec(0, "same", "single", (name,), span=SPAN) for name in (*first, "back_emf")]
    found += [
        Spec(0, "control", "control", (name,), span=(0.0, CONTROL_RATIO)) for name in CONTROLS
    ]
    found += [Spec(0, "outside", "outside", (OUTSIDE,), span=SPAN), Spec(0, "pair", "pair", PAIR)]
    order = np.random.default_rng(seed_of(SEED, "order")).permutation(len(found))
    rng = np.random.default_rng(seed_of(SEED, "later"))
    later = (str(name) for names in LATER for name in rng.permutation(names))
    numbered = [
        *(found[j] for j in order),
        *(Spec(0, "same", "single", (name,), span=SPAN) for name in later),
    ]
    return [replace(spec, index=i) for i, spec in enumerate(numbered, 1)]


def motor_constants(count: int) -> dict[int, float]:
    """Return the torque over the current of the cases whose input is a current, by number."""
    rng = np.random.default_rng(seed_of(SEED, "inputs"))
    numbers = rng.permutation(count)[:CURRENTS] + 1
    return {int(number): float(rng.choice(CONSTANTS)) for number in numbers}


def back_emf(spec: Spec) -> Case:
    """Return the case of the back EMF: more viscous friction than the model was drawn around."""
    rng = np.random.default_rng(seed_of(SEED, spec.index))
    scene = draw_scene(rng, "rich")
    constant = scene.base["a2"] * log_uniform(rng, *ABSORBED)
    fields = {"a2": scene.base["a2"] + constant}
    records = scene.records(fields)
    gap, _ = measure(records, scene.plant(fields))
    given = nominal(rng, scene, "")
    effect = {
        "name": "back_emf",
        "class": "back_emf",
        "form": spec.form,
        "parameters": {"constant": constant},
    }
    answer = {
        "case": spec.index,
        "kind": spec.kind,
        "group": spec.group,
        "style": spec.style,
        "variant": None,
        "effects": [effect],
        "gap": {"base": gap.base, "floor": gap.floor, "ratio": gap.ratio, "typical": gap.typical},
        "base": scene.base,
        "fields": fields,
        "alone": [],
        "rejected": [],
        "nominal": given,
        "planned": list(spec.names),
    }
    return Case(spec.index, records, "", answer)


def model_text(given: Fields, constant: float | None) -> str:
    """Return the model file of a case; `constant` [N.m/A] where the input is a current."""
    kind, unit = ("torque", "N.m") if constant is None else ("current", "A")
    lines = [
        'friction = "coulomb"',
        "",
        "[parameters]",
        *(f"{name} = {value:.6g}" for name, value in given.items()),
    ]
    lines += [] if constant is None else [f"b = {constant:g}"]
    lines += [
        "",
        "[bounds]",
        *(f"{name} = [{low:.6g}, {high:.6g}]" for name, (low, high) in bounds_of(given).items()),
    ]
    lines += ["", "[time]", 'column = "t"', 'unit = "ms"']
    lines += ["", "[input]", 'column = "u"', f'kind = "{kind}"', f'unit = "{unit}"']
    lines += [
        "",
        "[output]",
        'column = "theta"',
        'kind = "position"',
        'unit = "1"',
        f'scale = "{RESOLUTION!r} rad"',
    ]
    return "\n".join([*lines, "resolution = 1"]) + "\n"


def columns(record: Record, constant: float | None) -> dict[str, Any]:
    """Return what a logger would have kept: milliseconds, steps of the converter, counts of the
    encoder.
    """
    begin = round(record.start / PERIOD)
    return {
        "t": np.arange(begin, begin + record.u.size, dtype=np.int32),
        "u": (np.rint(record.u / STEP) * (STEP / (constant or 1.0))).astype(np.float32),
        "theta": np.rint(record.theta / RESOLUTION).astype(np.int32),
    }


def make(spec: Spec, constant: float | None, out: Path) -> dict[str, Any]:
    """Draw and write one case; return its answer."""
    case = back_emf(spec) if spec.names == ("back_emf",) else draw(SEED, spec, REDRAWS)
    folder = out / f"{spec.index:02d}"
    folder.mkdir(parents=True, exist_ok=True)
    for name, record in zip("ab", case.records, strict=True):
        np.savez_compressed(folder / f"{name}.npz", **columns(record, constant))
    (folder / "model.toml").write_text(
        model_text(case.answer["nominal"], constant), encoding="utf-8"
    )
    return case.answer | {"input": "torque" if constant is None else "current"}


def seal(answers: list[dict[str, Any]], out: Path) -> None:
    """Write all answers as one text that is not read by accident, and its hash in the form of
    sha256sum.
    """
    plain = json.dumps({f"{answer['case']:02d}": answer for answer in answers}, sort_keys=True)
    text = base64.encodebytes(zlib.compress(plain.encode(), 9))
    (out / SEALED).write_bytes(text)
    (out / DIGEST).write_text(f"{hashlib.sha256(text).hexdigest()}  {SEALED}\n", encoding="utf-8")


def main() -> None:
    """Make all cases."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=filled_path, default=FOLDER)
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    plan = specs()
    constants = motor_constants(len(plan) - len([*chain(*LATER)]))
    library()  # compiled once, before the workers start
    with ProcessPoolExecutor(arguments.jobs, mp_context=get_context("spawn")) as pool:
        calls = [pool.submit(make, spec, constants.get(spec.index), arguments.out) for spec in plan]
        answers = [call.result() for call in calls]
    seal(answers, arguments.out)
    print(
        f"{len(answers)} cases in {arguments.out},"
        f" {(arguments.out / DIGEST).read_text(encoding='utf-8').split()[0]}"
    )


if __name__ == "__main__":
    main()
