"""What a process of its own costs: scenario `quick` over 200 s, its plant built by the run or taken
as a foreign FMU, side by side.

python benchmarks/isolation.py > benchmarks/results/isolation.md
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from bristle.fmus import obtain

ROOT = Path(__file__).resolve().parents[1]
PAIRS = 9
HEAD = f"""# What a process of its own costs

`bristle run` of scenario `quick` as a whole command, by its plant: built (in the process of the
run), or the same FMU given by its file (all FMUs in a process of its own). {PAIRS} pairs in turn.
Made by `python benchmarks/isolation.py > benchmarks/results/isolation.md`

| time simulated, s | built, median (least), s | by its file, median (least), s |\
 ratio (of the least) | same signals |
|---|---|---|---|---|"""


def timed(scenario: Path, out: Path) -> float:
    begin = time.perf_counter()
    command = [sys.executable, "-m", "bristle.cli.main", "run", str(scenario), "--out", str(out)]
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - begin


def main() -> None:
    print(HEAD)
    quick = (
        (ROOT / "scenarios" / "quick.toml")
        .read_text(encoding="utf-8")
        .replace('name = "quick"\n', "")
    )
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "plant.fmu").write_bytes(obtain("plant").read_bytes())
        for duration in (20, 200):
            built = quick.replace('"20 s"', f'"{duration} s"')
            given = built.replace('law = "modified"\n', 'fmu = "plant.fmu"\n')
            given = given.replace("[plant.parameters]", '[plant.parameters]\nlaw = "modified"')
            files = [place / f"{name}{duration}.toml" for name in ("built", "given")]
            for file, text in zip(files, (built, given), strict=True):
                file.write_text(text, encoding="utf-8")
            for file in files:
                timed(file, place)  # builds what is not in the cache
            times = np.array([[timed(file, place) for file in files] for _ in range(PAIRS)])
            signals = [(place / file.stem / "signals.csv").read_bytes() for file in files]
            own, apart = (statistics.median(times[:, k]) for k in (0, 1))
            least = times.min(axis=0)
            cells = [f"{duration}", f"{own:.2f} ({least[0]:.2f})", f"{apart:.2f} ({least[1]:.2f})"]
            cells += [
                f"{apart / own:.2f} ({least[1] / least[0]:.2f})",
                "yes" if signals[0] == signals[1] else "no",
            ]
            print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
