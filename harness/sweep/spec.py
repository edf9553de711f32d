"""What all runs of a sweep share: scenario, FMUs, what varies, and what identifies it."""

from __future__ import annotations

import copy
import hashlib
import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from bristle.common.cache import digest
from bristle.common.errors import BristleError
from bristle.common.provenance import provenance
from bristle.common.toml import read_toml
from bristle.fmus.host import Fmu
from bristle.harness.run.checked import RunOptions, check_loaded
from bristle.harness.run.outcome import command_of
from bristle.harness.scenario.parts import build_fmus
from bristle.harness.scenario.reading import Loaded, parse
from bristle.harness.scenario.vary import refuse_conflicts
from bristle.harness.sweep.design import Design, SweepPoint, VariedKey
from bristle.harness.sweep.lanes import RUNS_WORTH_IT

MOST_MISTAKES = 10  # lines about values that cannot be run


@dataclass(frozen=True)
class Sweep:
    """What all runs of a sweep share; a run is this and a `SweepPoint`.

    Attributes
    ----------
    path, text : Path, str
        The scenario file.
    axes : tuple of VariedKey
        What varies.
    options : RunOptions
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
    axes: tuple[VariedKey, ...]
    options: RunOptions
    fmus: Mapping[str, dict[str, Fmu]]
    identity: str
    name: str = ""
    files: Mapping[str, bytes] = field(default_factory=dict)
    lanes: bool = False

    def key(self, point: SweepPoint) -> str:
        """Return the hash of all that decides the result of a run."""
        return digest(self.identity, *point.overrides, f"seed {point.seed}")[:32]

    def command(self, point: SweepPoint) -> str:
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


def prepare_sweep(path: Path, design: Design, options: RunOptions) -> Sweep:
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
    fmus: dict[str, dict[str, Fmu]] = {}
    mistakes: dict[str, None] = {}
    first_seed = design.seeds[0] if design.seeds else None
    hashes: set[str] = set()
    # each value once: what it needs is built, and what is wrong with it is collected
    for overrides in design.trials():
        try:
            loaded = load_point(empty, SweepPoint(0, overrides, first_seed))
            key = parts_key(loaded)
            if key not in fmus:
                fmus[key] = build_fmus(loaded, options.fmi, options.kind)
                hashes |= {fmu.sha256 for fmu in fmus[key].values()}
                hashes |= _record_hash(loaded)
            check_loaded(loaded, fmus[key], path.parent, options)
        except BristleError as error:
            mistakes[str(error)] = None
            if len(mistakes) == MOST_MISTAKES:
                break
    if mistakes:
        raise BristleError("\n".join(mistakes))
    # the hashes that name the sweep, and the runs in it
    version = provenance()["version"]
    identity = digest(
        version, text, repr((options.fmi, options.kind, tuple(options.overrides))), *sorted(hashes)
    )
    asked = repr(
        (design.asked, design.seeds, design.samples, design.sampling, design.sampling_seed)
    )
    return replace(
        empty,
        fmus=fmus,
        identity=identity,
        name=digest(identity, asked)[:24],
        lanes=design.runs >= RUNS_WORTH_IT,
    )


def load_point(sweep: Sweep, point: SweepPoint) -> Loaded:
    """Return the scenario of one run."""
    overrides = (*sweep.options.overrides, *point.overrides)
    return parse(sweep.path, sweep.text, copy.deepcopy(_tree(sweep.text)), overrides, point.seed)


@cache
def _tree(text: str) -> dict[str, Any]:
    return tomllib.loads(text)


def parts_key(loaded: Loaded) -> str:
    """Return what a scenario says of its FMUs but start values: where it is equal, the FMUs are."""
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
