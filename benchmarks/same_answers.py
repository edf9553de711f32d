"""Compare the results of two states of the project, digit by digit.

    git worktree add ../before REVISION && ../before/scripts/run      # what to compare with
    python benchmarks/same_answers.py collect before.json --bristle ../before/.venv/bin/bristle
    python benchmarks/same_answers.py collect after.json              # this environment
    python benchmarks/same_answers.py compare before.json after.json  # exit code 1: they differ

The results are collected through the command line alone, so that both states may differ in
everything inside:

- FMU: SHA-256 of each C or Python source in the FMUs that `bristle build` writes;
- scenario: SHA-256 of signals.csv at full rate, estimates and verdict of all shipped scenarios;
- hidden, measured: numbers and names in diagnosis.json for the cases of scenarios/hidden, and for
  the measured sets in the folder that BRISTLE_DATA names (default ../shared/data; missing sets are
  left out).

Sentences, times and provenance are not compared, nor are keys that only the later state has.
Collect both states on the same machine: friction that sticks amplifies differences in rounding. An
interrupted `collect` continues with the missing results; `--quick` takes all FMUs, six hidden
cases, two measured sets and three scenarios.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent / "measured"))

import measured_data as measured
from shared import write_json

ROOT = Path(__file__).resolve().parents[1]
Json = dict[str, Any]
Job = Callable[[], Json]

KEYS_NOT_COMPARED = {  # keys of diagnosis.json that hold sentences or times, at any depth
    "statement",
    "findings",
    "proposals",
    "experiment",
    "undetected",
    "decision",
    "note",
    "label",
    "seconds",
    "narrow",
    "caveats",
    "provenance",
    "wall_s",
}
QUICK_SELECTION = {
    "hidden": ("01", "05", "07", "12", "18", "23"),
    "measured": ("odrive_off", "go1_2kg"),
    "scenario": ("quick", "self_starting", "lugre_original"),
}
# nominal models of the measured sets: kind of input, unit of the output, parameters [SI]
NOMINAL_MODELS = {
    "emps": ("voltage", "m", {"J": 100.0, "a2": 150.0, "Fc": 30.0, "b": 35.15}),
    "xl330": ("voltage", "rad", {"J": 0.005, "a2": 0.03, "Fc": 0.04, "b": 0.1}),
    "go1": ("torque", "rad", {"J": 0.002, "a2": 0.02, "Fc": 0.02}),
    "odrive": ("current", "rad", {"J": 2.5e-4, "a2": 1e-3, "Fc": 5e-3, "b": 7.5e-3}),
}
SHOWN_DIFFERENCES = 60  # lines printed at most
INPUT_UNITS = {"torque": "N.m", "voltage": "V", "current": "A"}


def numbers_of(content: Any) -> Any:
    """Return a result without the keys that are not compared."""
    if isinstance(content, dict):
        return {
            key: numbers_of(value) for key, value in content.items() if key not in KEYS_NOT_COMPARED
        }
    return [numbers_of(each) for each in content] if isinstance(content, list) else content


def run(command: Sequence[str], *arguments: str | Path) -> None:
    """Run bristle with one thread; raise an error if its exit code is neither 0 nor 1."""
    environment = os.environ | {
        name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    }
    done = subprocess.run(
        [*command, *map(str, arguments)],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    if done.returncode not in (0, 1):
        raise RuntimeError(f"bristle {' '.join(map(str, arguments))}: {done.stderr.strip()}")


def diagnosed(command: Sequence[str], model: Path, data: Sequence[Path]) -> Json:
    """Return the numbers of a diagnosis."""
    with tempfile.TemporaryDirectory() as out:
        run(
            command,
            "diagnose",
            model,
            *(part for path in data for part in ("--data", path)),
            "--out",
            Path(out, "d"),
        )
        content: Json = json.loads(Path(out, "d", "diagnosis.json").read_text(encoding="utf-8"))
        kept: Json = numbers_of(content)
        return kept


def simulated(command: Sequence[str], scenario: Path) -> Json:
    """Return the hash of the signals of a scenario, its estimates and its verdict."""
    with tempfile.TemporaryDirectory() as out:
        run(command, "run", scenario, "--full", "--out", out)
        folder = Path(out, scenario.stem)
        result: Json = json.loads((folder / "result.json").read_text(encoding="utf-8"))
        digest = hashlib.sha256((folder / "signals.csv").read_bytes()).hexdigest()
        return {
            "signals.csv": digest,
            "estimates": result["estimates"],
            "verdict": result["verdict"],
        }


def built(command: Sequence[str], what: str, *options: str) -> Json:
    """Return the hash of each source in an FMU: the generated C, or the generated Python."""
    with tempfile.TemporaryDirectory() as out:
        run(command, "build", what, *options, "--out", out)
        [path] = Path(out).glob("*.fmu")
        with zipfile.ZipFile(path) as archive:
            names = [n for n in archive.namelist() if n.startswith("sources/") or n.endswith(".py")]
            return {
                name: hashlib.sha256(archive.read(name)).hexdigest()
                for name in names
                if not name.endswith("/")
            }


def measured_entries() -> Iterator[tuple[str, str, Sequence[measured.Entry]]]:
    """Give name, rig and records of each measured set whose folder exists."""
    there = {path.name for path in measured.MEASURED_FOLDER.glob("*")}
    if "emps" in there:
        yield "emps", "emps", measured.emps()
    if "bam_xl330_gain" in there:
        yield "xl330", "xl330", measured.xl330()
    for mass in (1.0, 2.0, 3.0) if "bam_go1_load" in there else ():
        yield f"go1_{mass:g}kg", "go1", measured.go1(mass)
    for word, compensated in (("off", False), ("on", True)) if "odrive_cogging" in there else ():
        yield f"odrive_{word}", "odrive", measured.odrive(compensated)


def measured_case(
    folder: Path, rig: str, entries: Sequence[measured.Entry]
) -> tuple[Path, list[Path]]:
    """Write a model file and records into a folder and return where they are."""
    kind, unit, parameters = NOMINAL_MODELS[rig]
    lines = [
        'friction = "coulomb"',
        "[parameters]",
        *(f"{name} = {value!r}" for name, value in parameters.items()),
    ]
    lines += [
        "[time]",
        'column = "t"',
        'unit = "s"',
        "[input]",
        'column = "u"',
        f'kind = "{kind}"',
        f'unit = "{INPUT_UNITS[kind]}"',
    ]
    lines += ["[output]", 'column = "y"', 'kind = "position"', f'unit = "{unit}"']
    folder.mkdir(parents=True, exist_ok=True)
    model = folder / "model.toml"
    model.write_text("\n".join(lines) + "\n", encoding="utf-8")
    paths = []
    for name, t, u, y, _ in entries:
        paths.append(folder / f"{name}.npz")
        np.savez(paths[-1], t=t, u=u, y=y)
    return model, paths


def jobs(command: Sequence[str], folder: Path, quick: bool) -> dict[str, Job]:
    """Return the functions that collect a result, by its name."""
    work: dict[str, Job] = {}

    def add(kind: str, name: str, function: Callable[..., Json], *arguments: Any) -> None:
        if not quick or name in QUICK_SELECTION.get(kind, (name,)):
            work[f"{kind} {name}"] = lambda: function(command, *arguments)

    for what in ("plant", "observer", "controller"):
        for options in (("--fmi", "2"), ("--fmi", "3"), ("--kind", "python")):
            add("FMU", f"{what} {' '.join(options)}", built, what, *options)
    add("FMU", "plant --law lugre", built, "plant", "--law", "lugre")
    for path in sorted((ROOT / "scenarios").glob("*.toml")):
        add("scenario", path.stem, simulated, path)
    for name, rig, entries in measured_entries():
        add("measured", name, diagnosed, *measured_case(folder / name, rig, entries))
    for path in sorted((ROOT / "scenarios" / "hidden").glob("*/model.toml")):
        add(
            "hidden",
            path.parent.name,
            diagnosed,
            path,
            [path.parent / "a.npz", path.parent / "b.npz"],
        )
    return work


def collect(
    target: Path, command: Sequence[str], workers: int, quick: bool, only: Sequence[str]
) -> int:
    """Write the results of one state into a file; those that it holds already are kept."""
    answers: Json = json.loads(target.read_text(encoding="utf-8")) if target.exists() else {}
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(workers) as pool:
        todo = {
            name: job
            for name, job in jobs(command, Path(folder), quick).items()
            if name not in answers and (not only or name in only)
        }
        calls = {pool.submit(job): name for name, job in todo.items()}
        for done, call in enumerate(as_completed(calls), 1):
            answers[calls[call]] = call.result()
            write_json(target, answers)
            print(f"{done} of {len(todo)}: {calls[call]}", file=sys.stderr, flush=True)
    return 0


def differences(before: Any, after: Any, where: str) -> Iterator[str]:
    """Give a line for each difference of two results; keys that only the later one has are no
    difference.
    """
    if isinstance(before, dict) and isinstance(after, dict):
        for key, value in before.items():
            yield from (
                differences(value, after[key], f"{where} {key}")
                if key in after
                else [f"{where} {key}: gone"]
            )
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for i, (old, new) in enumerate(zip(before, after, strict=True)):
            yield from differences(old, new, f"{where} {i}")
    elif before != after:
        yield f"{where}: {before} before, {after} after"


def compare(before: Path, after: Path) -> int:
    """Print the differences of two files of results; return 1 if there are any or the later one
    lacks a result.
    """
    old, new = (
        numbers_of(json.loads(path.read_text(encoding="utf-8"))) for path in (before, after)
    )
    lines = list(differences({key: old[key] for key in old if key in new}, new, ""))
    missing = sorted(set(old) - set(new))
    for line in lines[:SHOWN_DIFFERENCES]:
        print(line.strip())
    print(
        f"{len(lines)} differences in {len(set(old) & set(new))} answers; {len(missing)} missing"
        f" {', '.join(missing)}".rstrip()
    )
    return int(bool(lines or missing or not old))


def main() -> int:
    """Collect or compare."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    one = verbs.add_parser("collect")
    one.add_argument("target", type=Path)
    one.add_argument(
        "--bristle", default=shutil.which("bristle"), help="the command of the state to collect"
    )
    one.add_argument("--jobs", type=int, default=2)
    one.add_argument("--quick", action="store_true")
    one.add_argument(
        "--only",
        nargs="*",
        default=[],
        metavar="NAME",
        help='such as "hidden 07" "scenario quick" "measured emps"',
    )
    two = verbs.add_parser("compare")
    two.add_argument("before", type=Path)
    two.add_argument("after", type=Path)
    given = parser.parse_args()
    if given.verb == "compare":
        return compare(given.before, given.after)
    if given.bristle is None:
        parser.error("no bristle on the path; give its path with --bristle")
    return collect(given.target, [given.bristle], given.jobs, given.quick, given.only)


if __name__ == "__main__":
    sys.exit(main())
