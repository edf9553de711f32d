"""`bristle sweep`: many runs of one scenario into a store."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from bristle.cli.app import (
    ERROR,
    FAIL,
    PASS,
    DebugOption,
    Fmi,
    FmiOption,
    Kind,
    KindOption,
    ScenarioArgument,
    SetOption,
    TimeoutOption,
    app,
    path_of,
)
from bristle.cli.terminal import command_line, complain_each, fraction
from bristle.common.errors import BristleError


class Sampling(StrEnum):
    """How values are drawn from distributions: Latin hypercube, Sobol' points, or independently."""

    lhs = "lhs"
    sobol = "sobol"
    random = "random"


VaryOption = Annotated[
    list[str] | None,
    typer.Option(
        help="values of a key: a:b:n, [v1, v2], or a distribution such as uniform(a, b)",
        metavar="PATH=SPEC",
    ),
]
SamplesOption = Annotated[
    int | None,
    typer.Option(help="how many are drawn from the distributions", min=1, metavar="N"),
]
SamplingSeedOption = Annotated[
    int, typer.Option(help="seed of the drawing", min=0, max=2**32 - 1, metavar="N")
]
SeedsOption = Annotated[
    str | None, typer.Option(help="seeds of the reference: 1-200 or 1,4,7-9", metavar="SEEDS")
]
ResumeOption = Annotated[
    bool, typer.Option("--resume", help="make only the runs that the store does not have")
]
JobsOption = Annotated[
    int | None,
    typer.Option("--jobs", "-j", help="threads; else one a core", min=1, max=1024, metavar="N"),
]
ClusterOption = Annotated[
    str | None, typer.Option(help="scheduler of a Dask cluster", metavar="ADDRESS")
]


@app.command(
    short_help="Run a scenario with many values and seeds, into a store.",
    epilog=(
        "Exit code 0: all runs pass, also those that were there; 1: a check does not hold in some;"
        " 2: a run could not be made."
    ),
)
def sweep(
    scenario: ScenarioArgument,
    out: Annotated[Path, typer.Option(help="folder of the store", metavar="STORE", parser=path_of)],
    vary: VaryOption = None,
    samples: SamplesOption = None,
    sampling: Annotated[Sampling, typer.Option(help="how they are drawn")] = Sampling.lhs,
    sampling_seed: SamplingSeedOption = 0,
    seeds: SeedsOption = None,
    set_: SetOption = None,
    resume: ResumeOption = False,
    jobs: JobsOption = None,
    cluster: ClusterOption = None,
    kind: KindOption = Kind.native,
    fmi: FmiOption = Fmi.two,
    timeout: TimeoutOption = None,
    debug: DebugOption = False,
) -> int:
    """Run a scenario with all values and seeds; what comes of each run is a row of STORE."""
    from bristle.common.output import output_folder
    from bristle.harness.run.checked import RunOptions
    from bristle.harness.scenario.catalogue import find_scenario
    from bristle.harness.scenario.vary import seeds_of
    from bristle.harness.sweep.design import design
    from bristle.harness.sweep.executor import Means
    from bristle.harness.sweep.spec import prepare_sweep
    from bristle.harness.sweep.store import Store
    from bristle.harness.sweep.sweep import run_sweep

    asked = design(
        vary or (), () if seeds is None else seeds_of(seeds), samples, sampling.value, sampling_seed
    )
    store = Store(out)
    try:
        options = RunOptions(int(fmi.value), kind.value, tuple(set_ or ()), timeout=timeout)
        prepared = prepare_sweep(find_scenario(scenario), asked, options)
    except BristleError as error:
        complain_each(error, debug)
        return ERROR
    with output_folder(out), fraction("sweep") as tell:
        means = Means(jobs or os.cpu_count() or 1, cluster, resume, command_line())
        found = run_sweep(prepared, asked, store, means, _shown(tell))
    counts = counted(found.verdicts)
    before = f"; {found.kept} were there: {counted(found.there)}" if found.kept else ""
    print(
        f"{found.runs} {'run' if found.runs == 1 else 'runs'} in {found.seconds:.1f} s:"
        f" {counts}{before}  {out}",
        flush=True,
    )
    return {"error": ERROR, "fail": FAIL}.get(found.worst, PASS)


def _shown(tell: Callable[[str, float], None]) -> Callable[[int, int], None]:
    """Return a function that shows how many of all runs are made, and how long it still takes."""
    begun = time.monotonic()

    def show(done: int, total: int) -> None:
        rate = done / max(1e-9, time.monotonic() - begun)
        left = f", {(total - done) / rate:.0f} s left" if done and done < total else ""
        tell(f"{done} of {total} runs, {rate:.1f} a second{left}", done / max(1, total))

    return show


def counted(verdicts: Mapping[str, int]) -> str:
    """Return how many runs have which verdict, in words."""
    return ", ".join(
        f"{count} {word}" for word, count in verdicts.items() if count or word == "pass"
    )
