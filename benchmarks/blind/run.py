"""The blind test: generate cases with a hidden effect, diagnose them, score the effects named
against the sealed answers.

    run.py generate --seed dev1 --out DIR [--scale 0.1] [--jobs 2] [--only single]
    run.py diagnose --out DIR [--jobs 2]
    run.py score --out DIR
    run.py publish [--jobs 2]     all three, seeded by the commit's hash; not a tree with changes

An interrupted step continues with the cases that are missing. The diagnosis never reads the
answers; answers.sha256 seals them.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

# before numpy: one thread a worker
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")
sys.path.append(str(Path(__file__).resolve().parents[1]))

from cases import SELECTIONS, Spec, draw, plan, seal, write
from page import put
from score import tables
from shared import BLIND_TEST_LIMITS, write_json
from truth import library

from bristle.common.arguments import filled_path

ROOT = Path(__file__).resolve().parents[2]
BLIND_TEST_INTRODUCTION = """## How often it is wrong

`scripts/blind` generates cases with a hidden effect by code of its own (another integrator, another
formulation of friction, half of the effects in another form of the same physics), seeded by the
hash of the commit under test; diagnoses them; and scores the results against sealed answers. A
commit is tested once and the first run counts. Further tables, by effect, by gap ratio and by
parameter, are in [benchmarks/results/blind.md](../benchmarks/results/blind.md).

In the table, an effect in its **own form** follows the equation of the catalogue, one in **another
form** a different equation of the same physics. A **control** has no hidden effect. **Outside**
means that the hidden effect is not in the catalogue, **pairs** that two effects are hidden, **poor
excitation** that the records move too little or too uniformly. **Flagged** means that the answer
reports an [unexplained residual](glossary.md#unexplained-residual). The [gap
ratio](glossary.md#gap-ratio) says how large the effect is.
"""
PUBLISHED_TABLES = ROOT / "benchmarks" / "results" / "blind.md"


def generate_one(commit: str, spec: Spec, out: Path) -> None:
    """Draw and write one case."""
    write(draw(commit, spec), out)


def diagnose_one(folder: Path, target: Path, search: Mapping[str, Any] | None = None) -> None:
    """Diagnose one case as a user would and write the result, also if it fails; `seconds` is
    processor time of one core.

    `search` holds fields of `SearchOptions` that are not the default.
    """
    begun = time.process_time()
    try:
        from bristle.diagnosis import SearchOptions, diagnose, load_model, load_records

        model = load_model(folder / "model.toml")
        records = load_records(model, [folder / "a.npz", folder / "b.npz"])
        result = diagnose(model, records, options=SearchOptions(**(search or {}))).to_dict()
    except ImportError:
        raise
    except Exception as error:
        result = {
            "verdict": "error",
            "error": f"{type(error).__name__}: {error}",
            "effects": [],
            "ties": [],
        }
    result["seconds"] = time.process_time() - begun
    write_json(target, result)


def work(
    function: Callable[..., None], calls: Iterable[Sequence[Any]], jobs: int, label: str
) -> None:
    """Call a function in worker processes, with a line of progress on the standard error."""
    todo = list(calls)
    begun, step = time.perf_counter(), max(1, len(todo) // 50)
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        for done, future in enumerate(
            as_completed([pool.submit(function, *call) for call in todo]), 1
        ):
            future.result()
            if done % step == 0 or done == len(todo):
                spent = time.perf_counter() - begun
                left = spent / done * (len(todo) - done)
                print(
                    f"{label}: {done} of {len(todo)}, {spent:.0f} s, {left:.0f} s left",
                    file=sys.stderr,
                    flush=True,
                )


def go_on(
    function: Callable[..., None], calls: Iterable[Sequence[Any]], jobs: int, label: str
) -> None:
    """Do those calls of `work` whose last argument, the file to write, does not exist yet."""
    work(function, [call for call in calls if not call[-1].exists()], jobs, label)


def generate(seed: str, out: Path, scale: float, jobs: int, only: Sequence[str]) -> None:
    """Write the cases that are missing, and the hashes that seal the answers."""
    groups = [group for name in only or SELECTIONS for group in SELECTIONS[name]]
    specs = [spec for spec in plan(seed, scale) if spec.group in groups]
    note = {"seed": seed, "scale": scale}
    path = out / "plan.json"
    if path.exists() and json.loads(path.read_text(encoding="utf-8")) != note:
        raise SystemExit(f"{out} holds cases of another seed or scale; give another folder")
    write_json(path, note)
    library()  # compiled once, before the workers start
    missing = [spec for spec in specs if not (out / "answers" / f"{spec.index:05d}.json").exists()]
    work(generate_one, [(seed, spec, out) for spec in missing], jobs, "generate")
    print(f"{len(specs)} cases in {out}; sha256 of answers.sha256: {seal(out)}")


def check_seal(out: Path) -> None:
    """Raise an error if an answer does not match its hash."""
    sealed = {}
    for line in (out / "answers.sha256").read_text(encoding="utf-8").splitlines():
        digest, name = line.split("  ")
        sealed[name] = digest
    for path in sorted((out / "answers").glob("*.json")):
        name = f"answers/{path.name}"
        if sealed.get(name) != hashlib.sha256(path.read_bytes()).hexdigest():
            raise SystemExit(f"{name} does not match answers.sha256; generate the cases again")


def diagnose_all(out: Path, jobs: int) -> None:
    """Diagnose the cases without a result, in an order that makes those done at any time a fair
    sample.
    """
    if not (out / "answers.sha256").exists():
        raise SystemExit("the answers are not sealed yet; run generate to its end")
    stamp(out)
    order = sorted(
        (out / "cases").iterdir(), key=lambda f: hashlib.sha256(f.name.encode()).hexdigest()
    )
    go_on(diagnose_one, [(f, out / "results" / f"{f.name}.json") for f in order], jobs, "diagnose")


def stamp(out: Path) -> str:
    """Write which code the results of a folder come from, and return it; raise an error if they
    come from other code.
    """
    code = _git("rev-parse", "HEAD") + (" with changes" if _git("status", "--porcelain") else "")
    path = out / "code.txt"
    if path.exists() and path.read_text(encoding="utf-8") != code:
        raise SystemExit(
            f"{out} holds results of commit {path.read_text(encoding='utf-8')}, this is {code};"
            " give another folder"
        )
    out.mkdir(parents=True, exist_ok=True)
    path.write_text(code, encoding="utf-8")
    return code


def answered(out: Path) -> list[tuple[Any, Any]]:
    """Return (answer, result) of each case that has been diagnosed; the answers must match their
    hashes.
    """
    check_seal(out)
    pairs = []
    for path in sorted((out / "results").glob("*.json")):
        answer = json.loads((out / "answers" / path.name).read_text(encoding="utf-8"))
        pairs.append((answer, json.loads(path.read_text(encoding="utf-8"))))
    return pairs


def score_all(out: Path) -> tuple[str, str]:
    """Score what has been diagnosed; write score.md and score.json; return the figures and the
    other tables as markdown.
    """
    figures, others, data = tables(answered(out))
    (out / "score.md").write_text(f"{figures}\n\n{others}", encoding="utf-8")
    write_json(out / "score.json", data, indent=1)
    return figures, others


def _git(*arguments: str) -> str:
    return subprocess.run(
        ["git", *arguments], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.strip()


def publish(out: Path | None, jobs: int, scale: float) -> None:
    """Run all three steps with the commit's hash as seed; tables go to benchmarks/results/blind.md,
    figures to the docs.
    """
    if changed := _git("status", "--porcelain"):
        raise SystemExit(
            "the tree has changes; commit them first, the seeds come from the commit's"
            f" hash:\n{changed}"
        )
    commit = _git("rev-parse", "HEAD")
    out = out or ROOT / "out" / "blind" / commit[:12]
    generate(commit, out, scale, jobs, ())
    seal_line = hashlib.sha256((out / "answers.sha256").read_bytes()).hexdigest()
    diagnose_all(out, jobs)
    stamp(out)  # raises an error if the code changed meanwhile
    head = (
        f"Commit {commit}, which seeds every case; sha256 of the sealed answers' list:"
        f" {seal_line}.\n"
    )
    figures, others = score_all(out)
    limits = BLIND_TEST_LIMITS.strip()
    PUBLISHED_TABLES.write_text(
        f"# Blind test\n\n{head}\n{figures}\n\n#{limits}\n\n{others}", encoding="utf-8"
    )
    put("blind test", "scripts/blind", f"{BLIND_TEST_INTRODUCTION}\n{head}\n{figures}\n\n{limits}")
    print(PUBLISHED_TABLES.read_text(encoding="utf-8"))


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("generate", "diagnose", "score", "publish"):
        command = commands.add_parser(name)
        command.add_argument("--out", type=filled_path, required=name != "publish")
        if name != "score":
            command.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
        if name in ("generate", "publish"):
            command.add_argument("--scale", type=float, default=1.0, help="share of the full plan")
        if name == "generate":
            command.add_argument("--seed", required=True, help="a commit's hash, or any string")
            command.add_argument("--only", choices=list(SELECTIONS), action="append", default=[])
    a = parser.parse_args(arguments)
    if a.command == "generate":
        generate(a.seed, a.out, a.scale, a.jobs, a.only)
    elif a.command == "diagnose":
        diagnose_all(a.out, a.jobs)
    elif a.command == "score":
        print("\n\n".join(score_all(a.out)))
    else:
        publish(a.out, a.jobs, a.scale)


if __name__ == "__main__":
    main()
