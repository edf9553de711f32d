"""What `bristle check` finds: defects put into good FMUs, by the points that find them; false
alarms and time of good FMUs.

python benchmarks/check_mutants.py [OTHER.fmu ...] > benchmarks/results/check_mutants.md
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from bristle.fmus import obtain
from bristle.fmus.conformance import (
    BEHAVIOUR,
    POINTS,
    Severity,
    Verdict,
    conformance,
    static_conformance,
)
from bristle.fmus.conformance.process import Task, judged
from bristle.model.compiler import find_compiler

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "fmus"))
from mutants import (  # type: ignore[import-not-found]  # of tests/fmus, which are no package
    BEHAVIOUR_MUTANTS,
    PACKING_MUTANTS,
    STATIC_MUTANTS,
    good_entries,
    pack,
    pack_badly,
)

SERIOUS = (
    "Serious: error or warning. Seconds: on two cores that other work took, too; on free ones about"
    " half of the last column."
)
OWN = Path(__file__).with_name("check_own.toml")
HEAD = """# What `bristle check` finds

Good FMUs of FMI 2 and 3 (`tests/fmus/mutants.py`, `mutant.c`) with one defect each, and all points.
Made by `python benchmarks/check_mutants.py > benchmarks/results/check_mutants.md`
"""

Row = tuple[str, str, set[str]]  # defect, point made for it, points that find it
OwnRow = tuple[str, set[str]]  # defect, points that find it


def behaviour_rows(good: dict[int, Path]) -> Iterator[Row]:
    """Give each defect of behaviour, the point made for it, and the points that find it."""
    for name, fmi, point in BEHAVIOUR_MUTANTS:
        rows = judged([Task(good[fmi], each, {"MUTANT": name}) for each in BEHAVIOUR])
        yield (
            f"{name} (FMI {fmi})",
            point,
            {row["id"] for row in rows if row["verdict"] is Verdict.failed},
        )


def static_rows(entries: dict[int, dict[str, bytes]], folder: Path) -> Iterator[Row]:
    """Give each defect of archive, libraries or description, the point made for it, and the points
    that find it.
    """

    def found(path: Path) -> set[str]:
        return {r.point.id for r in static_conformance(path) if r.verdict is Verdict.failed}

    for k, (point, fmi, change) in enumerate(STATIC_MUTANTS):
        changed = dict(entries[fmi])
        change(changed)
        yield f"{point} {k + 1} (FMI {fmi})", point, found(pack(folder / f"mutant{k}.fmu", changed))
    for point in PACKING_MUTANTS:
        yield (
            f"{point} (FMI 2)",
            point,
            found(pack_badly(point, folder / f"{point}.fmu", entries[2])),
        )


def rebuilt(entries: dict[str, bytes], defect: dict[str, str], path: Path) -> Path:
    """Compile the sources of an FMU with a defect and write the FMU."""
    changed, name = dict(entries), f"sources/{defect['file']}"
    text = changed[name].decode()
    assert defect["old"] in text, defect["name"]
    changed[name] = text.replace(defect["old"], defect["new"], 1).encode()
    [library] = [name for name in entries if name.startswith("binaries/") and name.endswith(".so")]
    with tempfile.TemporaryDirectory() as folder:
        units = []
        for unit in (
            name.removeprefix("sources/") for name in changed if name.startswith("sources/")
        ):
            Path(folder, unit).write_bytes(changed[f"sources/{unit}"])
            units += [str(Path(folder, unit))] if unit.endswith(".c") else []
        flags = [
            "-std=c99",
            "-O1",
            "-w",
            "-fPIC",
            "-shared",
            "-ffp-contract=off",
            "-fvisibility=hidden",
        ]
        out = Path(folder, "result.so")
        subprocess.run(
            [*find_compiler(), *flags, f"-I{folder}", *units, "-o", str(out), "-lm"], check=True
        )
        changed[library] = out.read_bytes()
    return Path(pack(path, changed))


def own_rows(folder: Path) -> Iterator[OwnRow]:
    """Give each defect in our own sources and the points that find it."""
    with zipfile.ZipFile(obtain("plant", law="viscous", encoder=False)) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    for defect in tomllib.loads(OWN.read_text(encoding="utf-8"))["defect"]:
        results = conformance(rebuilt(entries, defect, folder / "own.fmu"))
        yield defect["name"], {r.point.id for r in results if r.verdict is Verdict.failed}


def checked(title: str, path: Path) -> None:
    begin, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    results = conformance(path)
    seconds, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    work = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    failed = [r for r in results if r.verdict is Verdict.failed]
    passed, notes = (
        sum(r.verdict is Verdict.passed for r in results),
        [r for r in failed if r.point.severity is Severity.note],
    )
    serious = ", ".join(f"`{r.point.id}`" for r in failed if r not in notes) or "-"
    said = ", ".join(f"`{r.point.id}`" for r in notes) or "-"
    print(f"| {title} | {passed} | {serious} | {said} | {seconds:.1f} | {work:.1f} |")


def main(others: list[str]) -> None:
    print(HEAD)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        entries = {fmi: good_entries(fmi, folder) for fmi in (2, 3)}
        good = {fmi: pack(folder / f"good{fmi}.fmu", entries[fmi]) for fmi in (2, 3)}
        rows = [*static_rows(entries, folder), *behaviour_rows(good)]
        own = list(own_rows(folder))
        print_counts(rows, own)
        print(f"""## FMUs without defects

{SERIOUS}

| FMU | points passed | serious | notes | s | s of one core |
|---|---|---|---|---|---|""")
        for fmi in (2, 3):
            checked(f"good, FMI {fmi}", good[fmi])
            for what in ("plant", "observer", "controller"):
                checked(f"{what}, FMI {fmi}", obtain(what, fmi=fmi))
        for path in others:
            checked(Path(path).name, Path(path))
    print_defects(rows, own)


def print_counts(rows: Sequence[Row], own: Sequence[OwnRow]) -> None:
    caught = sum(point in found for _, point, found in rows)
    points = {point for _, point, found in rows if point in found}
    by_any, seen = sum(bool(found) for *_, found in rows), sum(bool(found) for _, found in own)
    count = len(POINTS) + len(BEHAVIOUR)
    print(f"""{count} points, {len(points)} of them seen to fail on a defect that is made for them.
{len(rows)} defects, {caught} found by the point made for them, {by_any} by any.

{len(own)} defects in our own FMU, {seen} found by any.
""")


def print_defects(rows: Sequence[Row], own: Sequence[OwnRow]) -> None:
    print("""
## Defects

| defect | point made for it | found | found by others, too |
|---|---|---|---|""")
    for defect, point, found in rows:
        more = ", ".join(f"`{each}`" for each in sorted(found - {point})) or "-"
        print(f"| {defect} | `{point}` | {'yes' if point in found else 'NO'} | {more} |")
    print("""
## Defects in our own FMU

In the C sources of the plant with viscous friction (`benchmarks/check_own.toml`), found by any
point.

| defect | found by |
|---|---|""")
    for defect, found in own:
        print(f"| {defect} | {', '.join(f'`{each}`' for each in sorted(found)) or 'NONE'} |")


if __name__ == "__main__":
    main(sys.argv[1:])
