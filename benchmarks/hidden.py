"""Diagnose the cases of scenarios/hidden and compare the results with the sealed answers.

    python benchmarks/hidden.py              # all cases; the table goes to results/hidden.md too
    python benchmarks/hidden.py 07 12        # these only, printed

Exit code 1 if the file of answers does not match its hash. The answers are opened after the last
diagnosis.
"""

from __future__ import annotations

import argparse
import base64
import hashlib
import json
import sys
import tempfile
import zlib
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent / "blind"))

from run import diagnose_one
from score import Judged

ROOT = Path(__file__).resolve().parents[1]
HIDDEN_CASES = ROOT / "scenarios" / "hidden"
SEALED, DIGEST = "answers.sealed", "answers.sha256"
HIDDEN_TABLE = ROOT / "benchmarks" / "results" / "hidden.md"
# the refit of viscous friction takes it up: the right answer names no effect
ABSORBED_EFFECTS = ["back_emf"]
NO_CATALOGUE_EFFECT = {"control": "nothing", "outside": "not in the catalogue"}
HIDDEN_INTRODUCTION = """# Scenarios with a hidden effect

`python benchmarks/hidden.py`: every case of scenarios/hidden, diagnosed from its model and its two
records alone; the sealed answers are opened afterwards. The gap ratio follows from the true
parameters (benchmarks/blind/gap.py). An answer is right if it names exactly the hidden effects
("class": another effect of the same class); for a control, if it names none; for an effect outside
the catalogue, if it names none and flags an unexplained residual; for back_emf, if it names none,
since with a torque input back EMF is the same as viscous friction, which the refit takes up.

These 30 cases come from the generator of the blind test, so its limits apply: see "What these
figures do not say" in [docs/diagnosis.md](../../docs/diagnosis.md). They are diagnosed again with
every change of the rules. They are a regression test, and 30 of 30 is no estimate of an error rate.
"""

Json = dict[str, Any]


def broken(folder: Path = HIDDEN_CASES) -> bool:
    """Return whether the answers differ from what was sealed, without opening them."""
    digest, name = (folder / DIGEST).read_text(encoding="utf-8").split()
    return name != SEALED or hashlib.sha256((folder / SEALED).read_bytes()).hexdigest() != digest


def open_answers(folder: Path = HIDDEN_CASES) -> dict[str, Json]:
    """Return the answers by the name of their case; raise ValueError if the seal is broken."""
    if broken(folder):
        raise ValueError(
            f"{folder / SEALED} does not match its hash; restore it, or generate the cases again"
        )
    answers: dict[str, Json] = json.loads(
        zlib.decompress(base64.b64decode((folder / SEALED).read_bytes()))
    )
    return answers


def cases(folder: Path = HIDDEN_CASES) -> list[Path]:
    """Return the folders of all cases."""
    return sorted(path.parent for path in folder.glob("*/model.toml"))


def diagnosed(folder: Path, out: Path) -> Json:
    """Return the result of one case; a diagnosis that fails is a result too."""
    target = out / f"{folder.name}.json"
    diagnose_one(folder, target)
    found: Json = json.loads(target.read_text(encoding="utf-8"))
    return found


def diagnose_all(folders: Sequence[Path], jobs: int) -> dict[str, Json]:
    """Return the result of every case, found by worker processes of one thread each."""
    results: dict[str, Json] = {}
    with (
        tempfile.TemporaryDirectory() as out,
        ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool,
    ):
        calls = {pool.submit(diagnosed, folder, Path(out)): folder.name for folder in folders}
        for call in as_completed(calls):
            name = calls[call]
            results[name] = call.result()
            print(
                f"{name}: {said(results[name])}, {results[name]['seconds']:.0f} s",
                file=sys.stderr,
                flush=True,
            )
    return results


def said(result: Json) -> str:
    """Return the diagnosis in a few words."""
    words = str(result["verdict"])
    if words == "named":
        words = " + ".join(effect["name"] for effect in result["effects"])
    elif words == "tie":
        words = "tie of " + ", ".join(" / ".join(names) for names in result["ties"])
    return words + (", unexplained residual" if flagged(result) else "")


def flagged(result: Json) -> bool:
    """Return whether an unexplained residual is reported."""
    return bool((result.get("remains") or {}).get("flag"))


def truth(answer: Json) -> str:
    """Return what was hidden in a few words."""
    if answer["kind"] in NO_CATALOGUE_EFFECT:
        return f"{NO_CATALOGUE_EFFECT[answer['kind']]} ({answer['variant']})"
    return " + ".join(effect["name"] for effect in answer["effects"])


def right(answer: Json, result: Json) -> str:
    """Return yes, class (another name of the same class) or no."""
    case = Judged(answer, result)
    if answer["kind"] in NO_CATALOGUE_EFFECT or case.truth == ABSORBED_EFFECTS:
        quiet = result["verdict"] in ("none", "not_identifiable")
        return "yes" if quiet and (answer["kind"] != "outside" or case.flagged) else "no"
    return "yes" if case.strict else "class" if case.right else "no"


def table(answers: Mapping[str, Json], results: Mapping[str, Json]) -> str:
    """Return the cases that have a result as a table, with their count below."""
    lines = ["| case | gap ratio | result | truth | right |", "|---|---|---|---|---|"]
    marks = []
    for name, result in sorted(results.items()):
        answer = answers[name]
        marks.append(right(answer, result))
        lines.append(
            f"| {name} | {answer['gap']['ratio']:.1f} | {said(result)} | {truth(answer)} |"
            f" {marks[-1]} |"
        )
    count = (
        f"{len(marks) - marks.count('no')} of {len(marks)} right, {marks.count('class')} of them by"
        " class only."
    )
    return "\n".join([*lines, "", count]) + "\n"


def main() -> int:
    """Diagnose, open the answers, compare."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cases", nargs="*", help="numbers of cases; all without one")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    if broken():
        print(
            f"{HIDDEN_CASES / SEALED} does not match its hash; restore it, or generate the cases"
            " again",
            file=sys.stderr,
        )
        return 1
    chosen = [folder for folder in cases() if not arguments.cases or folder.name in arguments.cases]
    if unknown := set(arguments.cases) - {folder.name for folder in chosen}:
        parser.error(f"no such case: {', '.join(sorted(unknown))}")
    results = diagnose_all(chosen, arguments.jobs)
    text = table(open_answers(), results)
    print(text)
    if not arguments.cases:
        HIDDEN_TABLE.write_text(f"{HIDDEN_INTRODUCTION}\n{text}", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
