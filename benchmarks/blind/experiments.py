"""Does the experiment that a diagnosis proposes resolve its ties? Poorly excited cases, their
experiment played on the true servo.

    python benchmarks/blind/run.py generate --seed experiment --scale 0.1 --only poor --out DIR
    python benchmarks/blind/experiments.py --out DIR [--jobs 2] [--style sine] [--publish]

Each case is diagnosed; its experiment.csv is followed by the loop that gave the records or, if it
is an input, played back in open loop, on the servo with its hidden effect, a disturbance of the
same size and its encoder; the records and the new one are diagnosed together. An interrupted run
continues with the cases that are missing. `--publish` writes benchmarks/results/experiments.md.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from run import ROOT, go_on
from scene import NOISE
from score import Judged
from shared import write_json
from truth import PERIOD, base_friction, disturbance, library, play, run

from bristle.common.arguments import filled_path

PUBLISHED = ROOT / "benchmarks" / "results" / "experiments.md"
SESSION_TIME = 60.0  # s: when the experiment begins; the records end at 45 s
KEYS = ("verdict", "effects", "ties", "experiment", "experiment_input", "remains", "seconds")
Json = dict[str, Any]


def try_one(folder: Path, answer: Path, target: Path) -> None:
    """Diagnose a case, do its experiment, and diagnose the records with the new one."""
    from bristle.common.errors import BristleError
    from bristle.diagnosis import diagnose, load_model, load_records

    truth = json.loads(answer.read_text(encoding="utf-8"))
    model = load_model(folder / "model.toml")
    files = [folder / "a.npz", folder / "b.npz"]
    found = diagnose(model, load_records(model, files))
    kept: Json = {"answer": truth, "before": {key: found.to_dict()[key] for key in KEYS}}
    given = found.designed
    if given is not None and given.written:
        base = truth["base"]
        plant = {**base, **base_friction(base["J"], base["Fc"]), **truth["fields"]}
        rng = np.random.default_rng(truth["case"])
        noise = disturbance(rng, given.u.size + 1, NOISE * base["Fc"])
        if given.loop is None:
            u, theta = given.u, play(plant, SESSION_TIME, given.u, noise, given.start)
        else:
            v = np.gradient(given.u, PERIOD)
            reference = np.column_stack([given.u, v, np.gradient(v, PERIOD)])
            followed = run(plant, truth["loop"], SESSION_TIME, reference, noise)
            u, theta = followed.u, followed.theta
        new = target.with_suffix(".npz")
        np.savez_compressed(new, t=SESSION_TIME + given.time, u=u, theta=theta)
        kept["loop"] = given.loop
        moved = np.concatenate([np.load(f)["theta"] for f in files])
        kept["over_range"] = float(
            max(moved.min() - theta.min(), theta.max() - moved.max(), 0.0) / np.ptp(moved)
        )
        try:
            after = diagnose(model, load_records(model, [*files, new])).to_dict()
        except BristleError as error:
            after = {"verdict": "error", "effects": [], "ties": [], "error": str(error)}
        kept["after"] = {key: after.get(key) for key in KEYS}
    write_json(target, kept)


def style_of(answer: Path) -> str:
    """Return how the servo moves in the records of a case."""
    return str(json.loads(answer.read_text(encoding="utf-8"))["style"])


def rows(out: Path) -> list[Json]:
    """Return what has been tried."""
    return [
        json.loads(path.read_text(encoding="utf-8"))
        for path in sorted((out / "experiments").glob("*.json"))
    ]


def table(tried: list[Json]) -> str:
    """Return the counts and a row a case as markdown."""
    lines = [
        "| verdict before | cases | with an experiment | named right after it | tie or no name |"
        " named wrong |"
    ]
    lines += ["|---|---|---|---|---|---|"]
    for verdict in ("tie", "not_identifiable", "named"):
        own = [
            each
            for each in tried
            if each["before"]["verdict"] == verdict and each["before"]["experiment_input"]
        ]
        done = [Judged(each["answer"], each["after"]).outcome for each in own if "after" in each]
        right, wrong = done.count("right"), done.count("wrong")
        lines.append(
            f"| `{verdict}` | {len(own)} | {len(done)} | {right} | {len(done) - right - wrong} |"
            f" {wrong} |"
        )
    lines += ["", "| case | hidden | gap ratio | before | gain [nats] | after | beyond the range |"]
    lines += ["|---|---|---|---|---|---|---|"]
    for each in tried:
        answer, before, after = each["answer"], each["before"], each.get("after")
        hidden = ", ".join(effect["name"] for effect in answer["effects"])
        given = before["experiment_input"]
        gain = f"{given['gain']:.3g}" if given else "-"
        over = f"{100 * each['over_range']:.0f} %" if "over_range" in each else "-"
        ends = [said(before), gain, said(after) if after else "-", over]
        lines.append(
            f"| {answer['case']} ({answer['style']}) | {hidden} | {answer['gap']['ratio']:.2f} |"
            f" {' | '.join(ends)} |"
        )
    return "\n".join(lines)


def said(result: Json) -> str:
    """Return a verdict with its names."""
    names = [effect["name"] for effect in result["effects"]] or [
        " / ".join(tie) for tie in result["ties"]
    ]
    return f"{result['verdict']} {', '.join(names)}".strip()


def main() -> None:
    """Try the experiments of all cases of a folder."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=filled_path, required=True)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--style", choices=("sine", "slow"), help="of the records; both without it")
    parser.add_argument("--publish", action="store_true")
    given = parser.parse_args()
    (given.out / "experiments").mkdir(exist_ok=True)
    library()  # compiled once, before the workers start
    ready = [
        path
        for path in sorted((given.out / "answers").glob("*.json"))
        if given.style in (None, style_of(path))
    ]
    calls = [
        (given.out / "cases" / path.stem, path, given.out / "experiments" / path.name)
        for path in ready
    ]
    go_on(try_one, calls, given.jobs, "experiments")
    text = table(rows(given.out))
    print(text)
    if given.publish:
        plan = json.loads((given.out / "plan.json").read_text(encoding="utf-8"))
        about = (
            f"{__doc__}\nSeed {plan['seed']}, scale {plan['scale']:g}, records:"
            f" {given.style or 'sine and slow'}."
        )
        PUBLISHED.write_text(
            f"# Experiments that a diagnosis proposes\n\n{about}\n\n{text}\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main()
