"""Commands that are killed at random instants: nothing reported done is lost, no wrong digit after,
no litter older than a day.

python benchmarks/kill.py > benchmarks/results/kill.md

Each command is killed (SIGKILL) so and so many times, in a fork of a process that has imported what
it needs, at an instant drawn evenly from its usual duration and a tenth more. Whatever it said to
be done before it died must be there. What the next command finds in the result folder (it finishes
what was begun) must be the old result or the new one, complete; it must end well, with the digits
of a command that was never killed. All work in progress that is left is made two days old before
that, and the next command must remove it.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bristle.cli import main as cli
from bristle.common import work
from bristle.common.output import check_writable
from bristle.common.work import OLD
from bristle.harness.sweep.store import Store

ROOT = Path(__file__).resolve().parents[1]
# keys of results that no two calls have in common
OF_THE_CALL = {"wall_s", "seconds", "date", "command", "times_s", "timing"}
MARGIN = 1.1  # the latest instant, as a share of the usual duration
SAMPLES = 4000  # of the record that is diagnosed
SEED = 20


@dataclass(frozen=True)
class Command:
    """A command to kill.

    Attributes
    ----------
    name : str
        As the table names it.
    arguments : tuple of str
        Of `bristle`; results go into the folder `out` of the working directory.
    done : str
        What it says when its result is written.
    kills : int
        How often it is killed.
    empty_cache : bool
        Whether each begins with an empty cache of compiled files.
    """

    name: str
    arguments: tuple[str, ...]
    done: str
    kills: int
    empty_cache: bool = False


COMMANDS = (
    Command("run", ("run", "case.toml", "--out", "out"), "report.html", 140),
    Command(
        "diagnose",
        ("diagnose", "model.toml", "--data", "a.npz", "--jobs", "1", "--out", "out"),
        "report.html",
        20,
    ),
    Command(
        "build, empty cache",
        ("build", "controller", "--out", "out"),
        "Controller.fmu",
        40,
        empty_cache=True,
    ),
)
SWEEP = Command(
    "sweep",
    ("sweep", "case.toml", "--seeds", "1-48", "-j", "2", "--out", "out", "--resume"),
    " runs in ",
    40,
)
SCENARIO = """
duration = "5 s"
[plant]
law = "modified"
[observer]
method = "rls"
[[checks]]
quantity = "estimates.b.moved_percent"
min = 1
"""
HEAD = f"""# Commands that are killed

Each command was killed (SIGKILL), its imports done, at instants drawn evenly from its usual
duration and a tenth more. "Old" and "new" say which result was in the folder afterwards, complete;
the next command then had to give the digits of one that was never killed. "Done" says how often the
command had said before that its result was written. All work in progress that was left was made two
days old; the next command had to remove it. The record that is diagnosed has {SAMPLES} samples. The
store of a sweep was empty before ("old"), whole ("new") or held some of its runs ("neither");
`--resume` made the rest. Made by `python benchmarks/kill.py > benchmarks/results/kill.md`

| command | usual duration, s | kills | done | old | new | neither | done and lost |\
 wrong digits after | litter older than a day |
|---|---|---|---|---|---|---|---|---|---|"""


def without(tree: Any) -> Any:
    """Return the content of a JSON file without what no two calls have in common."""
    if isinstance(tree, dict):
        return {key: without(value) for key, value in tree.items() if key not in OF_THE_CALL}
    return [without(each) for each in tree] if isinstance(tree, list) else tree


def content(folder: Path) -> dict[str, Any]:
    """Return what is in a result folder, as far as two calls have it in common: of a page whether
    it is complete.
    """
    found: dict[str, Any] = {}
    for path in sorted(folder.rglob("*") if folder.exists() else ()):
        if path.is_file() and ".bristle-" not in str(path):
            data, name = path.read_bytes(), path.relative_to(folder).as_posix()
            if path.suffix == ".json":
                found[name] = without(json.loads(data))
            else:
                found[name] = data.rstrip().endswith(b"</html>") if path.suffix == ".html" else data
    return found


class Place:
    """A folder in which a command runs, with its own cache and its own folder for temporary
    files.
    """

    def __init__(self, folder: Path, command: Command) -> None:
        self.folder, self.command, self.cache = folder, command, folder / "cache"
        (folder / "tmp").mkdir()
        (folder / "case.toml").write_text(SCENARIO, encoding="utf-8")
        hidden = ROOT / "scenarios" / "hidden" / "07"
        shutil.copy(hidden / "model.toml", folder)
        with np.load(hidden / "a.npz") as record:
            np.savez(
                folder / "a.npz", **{name: values[:SAMPLES] for name, values in record.items()}
            )

    def imported(self) -> None:
        """Run the command in this process, which then has all imported, and keep what it says for
        itself.
        """
        before, sys.argv = Path.cwd(), ["bristle", *self.command.arguments]
        os.chdir(self.folder)
        with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
            cli.main()
        os.chdir(before)

    def start(self) -> tuple[int, int]:
        """Start the command in a fork, which has imported what it needs; return process id and the
        pipe of what it says.
        """
        said, answer = os.pipe()
        if child := os.fork():
            os.close(answer)
            return child, said
        for output in (1, 2):
            os.dup2(answer, output)
        os.chdir(self.folder)
        os.environ["TMPDIR"] = str(self.folder / "tmp")
        tempfile.tempdir = None
        if self.command.empty_cache:
            os.environ["BRISTLE_CACHE"] = str(self.cache)
        work._swept.clear()  # as a new process begins
        sys.argv = ["bristle", *self.command.arguments]
        code = 2
        try:
            cli.main()
        except SystemExit as done:
            code = int(done.code or 0)
        sys.stdout.flush()
        os._exit(code)

    def end(self, started: tuple[int, int]) -> tuple[int, str]:
        """Wait for the end of a command; return its exit code and what it said."""
        with os.fdopen(started[1]) as pipe:
            said = pipe.read()
        return os.waitstatus_to_exitcode(os.waitpid(started[0], 0)[1]), said

    def whole(self) -> dict[str, Any]:
        """Run the command to its end and return what it wrote."""
        code, said = self.end(self.start())
        if code != 0:
            raise SystemExit(f"{self.command.name}: exit code {code}: {said}")
        return content(self.folder / "out")

    def reset(self, old: Path) -> None:
        """Put the old result back, and empty the cache if the command begins so."""
        shutil.rmtree(self.folder / "out", ignore_errors=True)
        shutil.copytree(old, self.folder / "out")
        if self.command.empty_cache:
            shutil.rmtree(self.cache, ignore_errors=True)

    def left(self, age: float = 0.0) -> list[Path]:
        """Return what is left of work in progress; it becomes older by `age` in s."""
        found = list(self.folder.rglob(".bristle-*"))
        for path in found if age else ():
            os.utime(path, (time.time() - age,) * 2)
        return found


def older(place: Place) -> Path:
    """Make an old result, which no new one equals: without its last files, the rest changed."""
    old = Path(shutil.copytree(place.folder / "out", place.folder / "old"))
    files = sorted(path for path in old.rglob("*") if path.is_file())
    for path in files:
        if path.suffix == ".json":
            path.write_text(
                json.dumps(json.loads(path.read_text()) | {"notes": ["old"]}), encoding="utf-8"
            )
        elif path.suffix in (".fmu", ".toml", ".csv"):
            path.write_bytes(b"old")
    return old


def row(command: Command, share: float, chance: random.Random) -> str:
    """Kill a command and return its row of the table."""
    with tempfile.TemporaryDirectory() as name:
        place = Place(Path(name), command)
        place.imported()
        if command.empty_cache:
            shutil.rmtree(place.cache, ignore_errors=True)
        begin = time.perf_counter()
        new, usual = place.whole(), time.perf_counter() - begin
        old = older(place)
        before = content(old)
        count = dict.fromkeys(("done", "old", "new", "neither", "lost", "wrong", "litter"), 0)
        kills = max(1, round(share * command.kills))
        for k in range(kills):
            print(f"{command.name}: {k} of {kills}", end="\r", file=sys.stderr, flush=True)
            place.reset(old)
            started = place.start()
            time.sleep(chance.uniform(0.0, MARGIN * usual))
            os.kill(started[0], signal.SIGKILL)
            said = command.done in place.end(started)[1]
            check_writable(place.folder / "out")
            found = content(place.folder / "out")
            state = "new" if found == new else "old" if found == before else "neither"
            count[state] += 1
            count["done"] += said
            count["lost"] += said and state != "new"
            place.left(2 * OLD)
            count["wrong"] += place.whole() != new
            count["litter"] += bool(place.left())
        figures = [f"{usual:.1f}", str(kills), *(str(count[key]) for key in count)]
    return (
        f"| `{command.arguments[0]}`{command.name.removeprefix(command.arguments[0])} |"
        f" {' | '.join(figures)} |"
    )


def sweep_row(share: float, chance: random.Random) -> str:
    """Kill a sweep, go on with --resume, and return its row: "new" says that its store was whole
    already.
    """
    with tempfile.TemporaryDirectory() as name:
        place = Place(Path(name), SWEEP)
        place.imported()
        shutil.rmtree(place.folder / "out")
        begin = time.perf_counter()
        place.whole()
        usual, new = time.perf_counter() - begin, table(place)
        count = dict.fromkeys(("done", "old", "new", "neither", "lost", "wrong", "litter"), 0)
        kills = max(1, round(share * SWEEP.kills))
        for k in range(kills):
            print(f"{SWEEP.name}: {k} of {kills}", end="\r", file=sys.stderr, flush=True)
            shutil.rmtree(place.folder / "out", ignore_errors=True)
            started = place.start()
            time.sleep(chance.uniform(0.0, MARGIN * usual))
            os.kill(started[0], signal.SIGKILL)
            said = SWEEP.done in place.end(started)[1]
            found = table(place)
            count["new" if found == new else "old" if not found else "neither"] += 1
            count["done"] += said
            count["lost"] += said and found != new
            count["wrong"] += any(new.get(key) != run for key, run in found.items())
            place.left(2 * OLD)
            place.whole()
            count["wrong"] += table(place) != new
            count["litter"] += bool(place.left())
        return (
            f"| `sweep` | {usual:.1f} | {kills} |"
            f" {' | '.join(str(each) for each in count.values())} |"
        )


def table(place: Place) -> dict[str, Any]:
    """Return the runs of a store by their keys, without the time that they took; none if there is
    no store.
    """
    store = Store(place.folder / "out")
    rows = store.table().to_pylist() if store.files() else []
    return {row["key"]: without(row) for row in rows}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--share", type=float, default=1.0, help="of the kills, for a quick look")
    share, chance = parser.parse_args().share, random.Random(SEED)
    print(HEAD)
    for command in COMMANDS:
        print(row(command, share, chance), flush=True)
    print(sweep_row(share, chance), flush=True)


if __name__ == "__main__":
    main()
