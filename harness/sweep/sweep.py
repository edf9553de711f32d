"""Many runs of one scenario, in chunks, into a store: by threads over the compiled loop, or by the
workers of a Dask cluster.

A chunk is computed by one function, `run_chunk`, wherever that is, so its digits do not depend on
where or beside what it ran.
"""

from __future__ import annotations

import copy
import ctypes
import hashlib
import itertools
import json
import math
import re
import sys
import threading
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from bristle.common.cache import digest
from bristle.common.errors import BristleError
from bristle.common.output import plain
from bristle.common.provenance import provenance
from bristle.common.toml import read_toml
from bristle.common.work import TemporaryFolder
from bristle.fmus.calls import CONTROL_SIZE, Control
from bristle.fmus.host import Alias, Fmu
from bristle.fmus.isolate import isolated
from bristle.harness.cosim.loop import Bus, Slaves, Trace, simulate
from bristle.harness.run.run import Checked, Options, Simulate, check_loaded, command_of, outcome
from bristle.harness.scenario.plan import find_fmus
from bristle.harness.scenario.scenario import Loaded, parse
from bristle.harness.scenario.vary import refuse_conflicts
from bristle.harness.sweep.design import Axis, Design, Point
from bristle.harness.sweep.lanes import MOST_LANES, RUNS_WORTH_IT, Together, alike
from bristle.harness.sweep.store import ERROR_VERDICT, Store

Rows = list[dict[str, Any]]
Tell = Callable[[int, int], None]  # runs that are done, of how many

CHUNK_RUNS = 1000  # of a large sweep: what a kill loses at most
CHUNKS_A_JOB = 8  # at least, of a small one, so that all jobs end at about the same time
WAIT = 0.2  # s between two looks at what is done
# of result.json
KEPT_NUMBERS = (
    "adapted",
    "innovation",
    "tracking_rms",
    "estimates",
    "states",
    "tracking",
    "validation",
)
CLUSTER_ADDRESS = re.compile(r"[a-z]+://\S+:\d+")
WINDOW = 64  # runs that are read and checked before they are simulated
MOST_MISTAKES = 10  # lines about values that cannot be run
TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3  # parameters of mallopt, as malloc.h numbers them
# bytes of an array whose memory is kept: up to where the C library goes by itself
LARGEST_KEPT = 1 << 25


@dataclass(frozen=True)
class Sweep:
    """What all runs of a sweep share; a run is this and a `Point`.

    Attributes
    ----------
    path, text : Path, str
        The scenario file.
    axes : tuple of Axis
        What varies.
    options : Options
        How to run.
    fmus : mapping of str to mapping of str to Fmu
        The FMUs of a run by what the scenario says of them (`parts_key`).
    identity : str
        Hash of all that decides the results, but for the values and the seed.
    name : str
        Hash of what is asked for: of the above, the values and the seeds.
    files : mapping of str to bytes
        The FMUs by their path, where the runs are made on another machine.
    lanes : bool
        Simulate several runs in step where that can be: the same digits in less time, but for what
        it takes to begin.
    """

    path: Path
    text: str
    axes: tuple[Axis, ...]
    options: Options
    fmus: Mapping[str, dict[str, Fmu]]
    identity: str
    name: str = ""
    files: Mapping[str, bytes] = field(default_factory=dict)
    lanes: bool = False

    def key(self, point: Point) -> str:
        """Return the hash of all that decides the result of a run."""
        return digest(self.identity, *point.overrides, f"seed {point.seed}")[:32]

    def command(self, point: Point) -> str:
        """Return the command that repeats one run alone."""
        overrides = (*self.options.overrides, *point.overrides)
        return command_of(self.path, replace(self.options, overrides=overrides, seed=point.seed))

    @cached_property
    def sha256(self) -> str:
        """Hash of the scenario file."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @property
    def all_fmus(self) -> list[Fmu]:
        """All FMUs that may take part; one may be there several times."""
        return [fmu for each in self.fmus.values() for fmu in each.values()]


@dataclass
class Summary:
    """How a sweep ended: runs by verdict, the same of those that were there before, and the seconds
    it took.
    """

    verdicts: dict[str, int]
    there: dict[str, int]
    seconds: float

    @property
    def kept(self) -> int:
        """Runs that were there before."""
        return sum(self.there.values())

    @property
    def worst(self) -> str:
        """The worst verdict of all runs that were asked for."""
        return next(
            (
                word
                for word in (ERROR_VERDICT, "fail")
                if self.verdicts.get(word) or self.there.get(word)
            ),
            "pass",
        )

    @property
    def runs(self) -> int:
        """Runs that were made."""
        return sum(self.verdicts.values())


def prepare_sweep(path: Path, design: Design, options: Options) -> Sweep:
    """Read a scenario, try all listed values and the ends of the distributions, and build the FMUs.

    Raises
    ------
    BristleError
        A line for each value that cannot be run.
    """
    refuse_conflicts(design.asked, design.seeds, options.overrides)
    path = path.absolute()  # the working directory changes while FMUs are loaded
    text, _ = read_toml(path, "scenario file")
    empty = Sweep(path, text, design.axes, options, {}, "")
    found: dict[str, dict[str, Fmu]] = {}
    mistakes: dict[str, None] = {}
    first_seed = design.seeds[0] if design.seeds else None
    hashes: set[str] = set()
    for overrides in design.trials():
        try:
            loaded = load_point(empty, Point(0, overrides, first_seed))
            key = parts_key(loaded)
            if key not in found:
                found[key] = find_fmus(loaded, options.fmi, options.kind)
                hashes |= {fmu.sha256 for fmu in found[key].values()}
                hashes |= _record_hash(loaded)
            check_loaded(loaded, found[key], path.parent, options)
        except BristleError as error:
            mistakes[str(error)] = None
            if len(mistakes) == MOST_MISTAKES:
                break
    if mistakes:
        raise BristleError("\n".join(mistakes))
    version = provenance()["version"]
    identity = digest(
        version, text, repr((options.fmi, options.kind, tuple(options.overrides))), *sorted(hashes)
    )
    asked = repr(
        (design.asked, design.seeds, design.samples, design.sampling, design.sampling_seed)
    )
    return replace(
        empty,
        fmus=found,
        identity=identity,
        name=digest(identity, asked)[:24],
        lanes=design.runs >= RUNS_WORTH_IT,
    )


def load_point(sweep: Sweep, point: Point) -> Loaded:
    """Return the scenario of one run."""
    overrides = (*sweep.options.overrides, *point.overrides)
    return parse(sweep.path, sweep.text, copy.deepcopy(_tree(sweep.text)), overrides, point.seed)


@cache
def _tree(text: str) -> dict[str, Any]:
    return tomllib.loads(text)


def parts_key(loaded: Loaded) -> str:
    """Return what a scenario says of its FMUs, but for start values: where that is equal, the FMUs
    are.
    """
    scenario = loaded.scenario
    parts = (scenario.plant, None if scenario.open_loop else scenario.controller, scenario.observer)
    return json.dumps(
        [None if part is None else part.model_dump(exclude={"parameters"}) for part in parts],
        sort_keys=True,
    )


def _record_hash(loaded: Loaded) -> set[str]:
    record = loaded.scenario.record
    if record is None:
        return set()
    try:
        return {hashlib.sha256(loaded.beside(record.file).read_bytes()).hexdigest()}
    except OSError:
        return set()  # the check that follows says what is wrong with it


# -- one chunk -------------------------------------------------------------------------------------


class Watcher:
    """What the threads of a sweep share: how many runs are done, and whether to stop."""

    def __init__(self) -> None:
        self.done, self.stopped = 0, False
        self._controls: list[Control] = []

    def control(self) -> Control:
        """Return memory by which a run can be stopped."""
        made = np.zeros(CONTROL_SIZE, dtype=np.int64)
        self._controls.append(made)
        return made

    def stop(self) -> None:
        """End all runs at their next step."""
        self.stopped = True
        for each in self._controls:
            each[1] = 1


def run_chunk(sweep: Sweep, points: Sequence[Point], watcher: Watcher | None = None) -> Rows:
    """Make some runs, one after the other, and return a row for each; fewer if it is stopped.

    Runs with FMUs that may harm their process are made in a child process; if that dies, the runs
    are halved until the one that kills it is found, which is an error.
    """
    watcher = watcher or Watcher()
    here = _unpacked(sweep)
    if not any(fmu.risky for fmu in here.all_fmus):
        return _rows(here, points, watcher.control(), watcher)
    return _isolated_rows(here, points, watcher)


def _isolated_rows(sweep: Sweep, points: Sequence[Point], watcher: Watcher) -> Rows:
    def look(_done: int) -> None:
        if watcher.stopped:
            raise BristleError("stopped")

    paths = sorted({fmu.path for fmu in sweep.all_fmus})
    limit = None if sweep.options.timeout is None else sweep.options.timeout * len(points)
    try:
        rows: Rows = isolated(_rows_in_child, (sweep, list(points)), paths, list, look, limit)
        watcher.done += len(rows)
        return rows
    except BristleError as error:
        if watcher.stopped:
            return []
        if len(points) > 1:
            half = len(points) // 2
            return [
                *_isolated_rows(sweep, points[:half], watcher),
                *_isolated_rows(sweep, points[half:], watcher),
            ]
        watcher.done += 1
        return [_row(sweep, points[0]) | _error(error)]


def _rows_in_child(asked: tuple[Sweep, list[Point]], control: Control) -> Rows:
    return _rows(*asked, control, Watcher())


def _rows(sweep: Sweep, points: Sequence[Point], control: Control, watcher: Watcher) -> Rows:
    rows: dict[int, dict[str, Any]] = {}
    with Slaves() as slaves:
        for run, simulate_run in _Simulation(sweep, control, slaves).each(points):
            row = _judged(run, simulate_run)
            if watcher.stopped:
                break
            rows[run.point.index] = row
            watcher.done += 1
    return [rows[index] for index in sorted(rows)]


@dataclass
class _Prepared:
    """What is known of a run, the seconds it took so far, and, unless it cannot be made, the run as
    checked and its `parts_key`.
    """

    point: Point
    row: dict[str, Any]
    seconds: float
    checked: Checked | None = None
    parts: str = ""


def _prepared(sweep: Sweep, point: Point) -> _Prepared:
    row, begun = _row(sweep, point), time.perf_counter()
    try:
        loaded = load_point(sweep, point)
        parts = parts_key(loaded)
        fmus = sweep.fmus.get(parts) or find_fmus(loaded, sweep.options.fmi, sweep.options.kind)
        checked = check_loaded(loaded, fmus, sweep.path.parent, sweep.options)
    except BristleError as error:
        return _Prepared(point, row | _error(error), time.perf_counter() - begun)
    return _Prepared(point, row, time.perf_counter() - begun, checked, parts)


def _error(error: BristleError) -> dict[str, Any]:
    return {"verdict": ERROR_VERDICT, "message": str(error)}


class _Simulation:
    """Simulates the runs of a chunk, in one thread: in lanes where that can be, each alone with its
    FMUs otherwise.
    """

    def __init__(self, sweep: Sweep, control: Control, slaves: Slaves) -> None:
        self._sweep, self._control, self._slaves = sweep, control, slaves
        self._together: dict[str, Together | None] = {}

    def each(self, points: Sequence[Point]) -> Iterator[tuple[_Prepared, Simulate]]:
        """Yield each run with the function that simulates it, which is to be used before the next
        one is asked for.
        """
        for begin in range(0, len(points), WINDOW):
            groups: dict[object, list[_Prepared]] = {}
            for point in points[begin : begin + WINDOW]:
                run = _prepared(self._sweep, point)
                groups.setdefault(self._key(run), []).append(run)
            for group in groups.values():
                yield from self._simulated(group)

    def _key(self, run: _Prepared) -> object:
        """Return what runs that can be in step have in common."""
        if run.checked is None or self._of(run) is None:
            return run.point.index
        return run.parts, alike(run.checked.bus)

    def _of(self, run: _Prepared) -> Together | None:
        """Return what makes such runs in lanes, None if nothing can."""
        if run.checked is None or not self._sweep.lanes:
            return None
        if run.parts not in self._together:
            try:
                self._together[run.parts] = Together(run.checked.setup)
            except BristleError:
                self._together[run.parts] = None
        return self._together[run.parts]

    def _simulated(self, group: Sequence[_Prepared]) -> Iterator[tuple[_Prepared, Simulate]]:
        together = self._of(group[0]) if len(group) > 1 else None
        width = 1 if together is None else together.width
        for begin in range(0, len(group), width):
            runs = group[begin : begin + width]
            traces = [None] * len(runs) if together is None else self._in_step(runs, together)
            for run, trace in zip(runs, traces, strict=True):
                yield run, partial(self._alone, run, trace)

    def _in_step(self, runs: Sequence[_Prepared], together: Together) -> Sequence[Trace | None]:
        begun = time.perf_counter()
        traces = together.run(
            [run.checked.bus for run in runs if run.checked is not None], self._control
        )
        spent = time.perf_counter() - begun
        for run in runs:
            run.seconds += spent / len(runs)
        return traces

    def _alone(
        self,
        run: _Prepared,
        trace: Trace | None,
        bus: Bus,
        _progress: object = None,
        _timeout: object = None,
    ) -> Trace:
        """Return the trace that is there, for the bus that it is of; simulate any other."""
        if trace is not None and run.checked is not None and bus is run.checked.bus:
            return trace
        return simulate(bus, control=self._control, slaves=self._slaves)


def _judged(run: _Prepared, simulate_run: Simulate) -> dict[str, Any]:
    """Make one run."""
    row, begun = run.row, time.perf_counter() - run.seconds
    if run.checked is None:
        return row | {"wall_s": run.seconds}
    try:
        found = outcome(replace(run.checked, simulate=simulate_run)).result
    except BristleError as error:
        return row | _error(error) | {"wall_s": time.perf_counter() - begun}
    failed = [check["name"] for check in found["checks"] if not check["pass"]]
    verdict = {
        "verdict": found["verdict"],
        "message": found["diverged"]["message"] if "diverged" in found else "",
        "failed": "; ".join(failed),
        "checks": len(found["checks"]),
        "checks_passed": len(found["checks"]) - len(failed),
        "steps": found["steps"],
        "wall_s": time.perf_counter() - begun,
    }
    hashes = {f"sha256.{name}": fmu["sha256"] for name, fmu in found["fmus"].items()}
    numbers = _numbers({name: found[name] for name in KEPT_NUMBERS if name in found})
    # as given, if it varies
    return (
        row | verdict | hashes | {name: value for name, value in numbers.items() if name not in row}
    )


def _row(sweep: Sweep, point: Point) -> dict[str, Any]:
    """Return what is known of a run before it is made."""
    return {
        "key": sweep.key(point),
        "sweep": sweep.name,
        "run": point.index,
        "scenario": sweep.path.stem,
        "scenario_sha256": sweep.sha256,
        "seed": point.seed,
        "command": sweep.command(point),
    } | {
        axis.path: axis.value(each) for axis, each in zip(sweep.axes, point.overrides, strict=True)
    }


def _numbers(tree: Mapping[str, Any], before: str = "") -> dict[str, float | bool | None]:
    """Return the numbers of a tree by their dotted paths; what is not finite is null."""
    found: dict[str, float | bool | None] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            found |= _numbers(value, f"{before}{name}.")
        elif isinstance(value, bool | np.bool_):
            found[before + name] = bool(value)
        elif isinstance(value, int | float | np.number):
            found[before + name] = float(value) if math.isfinite(value) else None
        elif value is None:
            found[before + name] = None
    return found


# -- another machine -------------------------------------------------------------------------------


def packed(sweep: Sweep) -> Sweep:
    """Return a sweep with its files, for a machine that does not have them."""
    return replace(
        sweep, files={str(path): path.read_bytes() for path in {fmu.path for fmu in sweep.all_fmus}}
    )


def _unpacked(sweep: Sweep) -> Sweep:
    """Return a sweep whose files are on this machine; they are written, and read, once a
    process.
    """
    if not sweep.files:
        return sweep
    with _unpacking:
        if sweep.name not in _found:
            _keep_memory()
            places = _written(sweep.files)
            _found[sweep.name] = {
                key: {name: _moved(fmu, places) for name, fmu in each.items()}
                for key, each in sweep.fmus.items()
            }
    return replace(sweep, fmus=_found[sweep.name], files={})


_unpacking = threading.Lock()
# the FMUs of a sweep on this machine, by its name
_found: dict[str, Mapping[str, dict[str, Fmu]]] = {}
_folders: list[TemporaryFolder] = []  # which live as long as the process


def _keep_memory() -> None:
    """Let the C library keep what a run frees for the next one, as it does by itself.

    Dask tells its workers to give memory back at once (MALLOC_TRIM_THRESHOLD_), so that each array
    of a run is mapped and cleared by the system: a chunk takes half as long again.
    """
    if sys.platform != "linux":
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # of the GNU C library
    if mallopt is not None:
        mallopt(MMAP_THRESHOLD, LARGEST_KEPT)
        mallopt(TRIM_THRESHOLD, 2 * LARGEST_KEPT)


def _written(files: Mapping[str, bytes]) -> dict[str, Path]:
    _folders.append(TemporaryFolder("sweep"))
    found = {}
    for place, (name, content) in enumerate(files.items()):
        found[name] = Path(_folders[-1].name) / str(place) / Path(name).name
        found[name].parent.mkdir()
        found[name].write_bytes(content)
    return found


def _moved(fmu: Fmu, places: Mapping[str, Path]) -> Fmu:
    aliases: dict[str, Alias] = fmu.aliases
    return Fmu(places[str(fmu.path)], fmu.foreign, aliases)


# -- all chunks ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Means:
    """How a sweep is made.

    Attributes
    ----------
    jobs : int
        Threads; not used with a cluster.
    cluster : str, optional
        Address of the scheduler of a Dask cluster.
    resume : bool
        Go on with a store that has runs already.
    command : str
        For the provenance.
    """

    jobs: int = 1
    cluster: str | None = None
    resume: bool = False
    command: str = ""


def run_sweep(
    sweep: Sweep,
    design: Design,
    store: Store,
    means: Means | None = None,
    progress: Tell | None = None,
) -> Summary:
    """Make the runs of a sweep that the store does not have, chunk by chunk.

    Parameters
    ----------
    sweep, design : Sweep, Design
        What to run, of `prepare_sweep`.
    store : Store
        Where the rows go.
    means : Means, optional
        How.
    progress : function, optional
        Called now and then.

    Raises
    ------
    BristleError
        If the store cannot be written, has runs and `resume` is not given, or the cluster cannot be
        reached.
    """
    means = means or Means()
    if store.files() and not means.resume:
        raise BristleError(
            f"{store.path}: has runs already; resume it to make those that are missing, or give"
            " another folder"
        )
    if means.jobs < 1:
        raise BristleError(f"jobs {means.jobs}: give at least 1")
    begun, watcher = time.perf_counter(), Watcher()
    done = store.done() if means.resume else {}
    there = (
        Counter(done[key] for key in map(sweep.key, design.points()) if key in done)
        if done
        else Counter()
    )
    todo = (point for point in design.points() if sweep.key(point) not in done)
    total, verdicts = design.runs - there.total(), dict.fromkeys(("pass", "fail", ERROR_VERDICT), 0)
    tell = progress or (lambda _done, _total: None)
    with _executor(sweep, means, watcher) as (submit, workers):
        described = _described(sweep, design, means.command)
        store.describe(sweep.name, {**described, "finished": False})
        size = max(1, min(CHUNK_RUNS, math.ceil(total / (workers * CHUNKS_A_JOB))))
        # so that no lane is left over
        size = math.ceil(size / MOST_LANES) * MOST_LANES if sweep.lanes else size
        for rows in _finished(
            submit, _batches(todo, size), 2 * workers, lambda: tell(watcher.done, total)
        ):
            store.add(rows)
            for row in rows:
                verdicts[row["verdict"]] += 1
            watcher.done = max(watcher.done, sum(verdicts.values()))
        store.describe(sweep.name, {**described, "finished": True})
    tell(total, total)
    return Summary(
        verdicts,
        {word: there[word] for word in verdicts if word in there},
        time.perf_counter() - begun,
    )


def _batches(points: Iterator[Point], size: int) -> Iterator[list[Point]]:
    """Give the points in lists of a size, the last one shorter."""
    while batch := list(itertools.islice(points, size)):
        yield batch


def _finished(
    submit: Callable[[list[Point]], Future[Rows]],
    chunks: Iterator[list[Point]],
    most: int,
    look: Callable[[], None],
) -> Iterator[Rows]:
    """Give the rows of each chunk when it is done, with a bounded number of them under way."""
    waiting = {submit(chunk) for _, chunk in zip(range(most), chunks, strict=False)}
    while waiting:
        done, waiting = wait(waiting, WAIT, FIRST_COMPLETED)
        look()
        for future in done:
            yield future.result()
            waiting |= {submit(chunk) for _, chunk in zip(range(1), chunks, strict=False)}


@contextmanager
def _executor(
    sweep: Sweep, means: Means, watcher: Watcher
) -> Iterator[tuple[Callable[[list[Point]], Future[Rows]], int]]:
    """Give what takes chunks, and how many it works on at once; leaving the context in an error
    stops all of them.
    """
    with ExitStack() as stack:
        if means.cluster is None:
            pool: Executor = stack.enter_context(ThreadPoolExecutor(means.jobs))
            try:
                yield lambda points: pool.submit(run_chunk, sweep, points, watcher), means.jobs
            except BaseException:
                watcher.stop()
                pool.shutdown(cancel_futures=True)
                raise
            return
        client = stack.enter_context(_client(means.cluster))
        workers = sum(client.nthreads().values())
        if not workers:
            raise BristleError(
                f"cluster {means.cluster}: has no workers; start some with dask worker"
                f" {means.cluster}"
            )
        shipped = client.scatter(packed(sweep), broadcast=True, hash=False)
        remote = client.get_executor(pure=False)
        try:
            yield lambda points: remote.submit(run_chunk, shipped, points), workers
        except BaseException:
            remote.shutdown(wait=False)  # which cancels what is waiting or under way
            raise


def _client(address: str) -> Any:
    if CLUSTER_ADDRESS.fullmatch(address) is None:
        raise BristleError(
            f"cluster {address}: is no address of a Dask scheduler; write for example"
            " tcp://host:8786"
        )
    try:
        client: Any = import_module("distributed").Client
    except ImportError:
        raise BristleError("cluster: needs Dask; run: pip install 'bristle[cluster]'") from None
    try:
        return client(address, timeout="10s", set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        line = " ".join(str(error).split()) or type(error).__name__
        raise BristleError(
            f"cluster {address}: {line}; give the address of a Dask scheduler, such as"
            " tcp://host:8786"
        ) from None


def _described(sweep: Sweep, design: Design, command: str) -> dict[str, Any]:
    fmus = dict.fromkeys(f"{fmu.path.name} {fmu.sha256}" for fmu in sweep.all_fmus)
    return {
        "scenario": sweep.path.stem,
        "scenario_sha256": sweep.sha256,
        "text": sweep.text,
        "vary": {axis.path: axis.meaning for axis in sweep.axes},
        "runs": design.runs,
        "seeds": list(design.seeds),
        "samples": design.samples,
        "sampling": design.sampling,
        "sampling_seed": design.sampling_seed,
        "options": plain(vars(sweep.options)),
        "fmus": list(fmus),
        "provenance": {**provenance(), "command": command},
    }
