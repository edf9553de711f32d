"""Servo friction models and the adaptive observers that identify them, as FMUs; and the diagnosis
of measured servos.

    import bristle

    result = bristle.run("quick", out="out")                      # co-simulate a scenario
    found = bristle.diagnose("model.toml", ["a.csv", "b.csv"])    # what does the model lack?
    how_far = bristle.validate("model.toml", "c.csv", out="out")  # over records not fitted to
    path = bristle.build("plant", "fmus", fmi=3)                  # an FMU for another tool
    paper = bristle.reproduce("out")                              # figures and numbers of the paper

    # many runs, a row each
    many = bristle.sweep("quick", {"sensor": ["clean", "encoder"]}, seeds=range(1, 9), out="store")

    result.to_pandas("estimates"), result.to_xarray()  # with pip install 'bristle[frames]'

The functions do what the commands of the same names do. The rest of the library is imported when a
function first needs it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from bristle.common.arguments import as_choice, as_names, as_path, as_paths, as_whole_number
from bristle.common.errors import BristleError

if TYPE_CHECKING:
    from bristle.diagnosis import Diagnosis, Model, Record, Validation
    from bristle.records.intake import RecordArrays
    from bristle.result import Reproduction, Result, SweepResult

    __version__: str

__all__ = [
    "BristleError",
    "Diagnosis",
    "Model",
    "Record",
    "Reproduction",
    "Result",
    "SweepResult",
    "Validation",
    "__version__",
    "build",
    "diagnose",
    "load_model",
    "load_record",
    "load_records",
    "records_from_arrays",
    "reproduce",
    "run",
    "sweep",
    "validate",
]

PathLike = str | os.PathLike[str]
PARTS = ("plant", "observer", "controller")  # FMUs that can be built
KINDS: tuple[Literal["native", "python"], ...] = ("native", "python")  # of FMUs
FMI_VERSIONS = (2, 3)

_LATER = {  # class: where it is when it is asked for
    "Diagnosis": "bristle.diagnosis",
    "Model": "bristle.diagnosis",
    "Record": "bristle.diagnosis",
    "Validation": "bristle.diagnosis",
    "Reproduction": "bristle.result",
    "Result": "bristle.result",
    "SweepResult": "bristle.result",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("bristle")
    if name in _LATER:
        from importlib import import_module

        return getattr(import_module(_LATER[name]), name)
    raise AttributeError(f"module 'bristle' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def run(
    scenario: PathLike,
    out: PathLike = "out",
    *,
    overrides: Mapping[str, object] | None = None,
    seed: int | None = None,
    kind: Literal["native", "python"] = "native",
    fmi: Literal[2, 3] = 2,
) -> Result:
    """Co-simulate a scenario and write its result folder ``out/<scenario>``.

    Parameters
    ----------
    scenario : path
        Scenario file (TOML), or the name of a scenario that comes with the library, such as
        ``"quick"``.
    out : path, optional
        Folder for the result folders; created if it is missing.
    overrides : mapping of str to object, optional
        Values that replace those of the file, by their path in it, such as ``{"plant.parameters.J":
        "0.002 kg.m2"}``; what has a unit is text with the unit.
    seed : int, optional
        Seed of the controller's reference signal.
    kind : {"native", "python"}, optional
        Compiled FMUs, or FMUs written in Python.
    fmi : {2, 3}, optional
        Version of FMI; FMUs written in Python are of version 2.

    Returns
    -------
    Result
        Verdict, estimates, checks, and the folder with report.html.

    Raises
    ------
    BristleError
        If the scenario cannot be read, or an FMU cannot be built or refuses to start. Nothing is
        written then. A simulation that diverges is no error: its verdict is ``"fail"``.
    """
    from bristle.common.output import plain
    from bristle.harness.run.checked import RunOptions
    from bristle.harness.run.run import run as run_scenario
    from bristle.harness.scenario.catalogue import find_scenario
    from bristle.result import Result

    path, folder = find_scenario(as_path("scenario", scenario)), as_path("out", out)
    chosen = seed if seed is None else as_whole_number("seed", seed)
    options = RunOptions(
        as_choice("fmi", fmi, FMI_VERSIONS),
        as_choice("kind", kind, KINDS),
        _overrides(overrides),
        chosen,
        batch=_batch,
    )
    done = run_scenario(path, folder, options)
    return Result(plain(done.result), done.folder)


def _batch(*record: Any) -> Any:
    from bristle.diagnosis.sliding.batch import batch_estimates

    return batch_estimates(*record)


def sweep(
    scenario: PathLike,
    vary: Mapping[str, str | Sequence[object]] | None = None,
    out: PathLike = "store",
    *,
    seeds: Iterable[int] | str = (),
    samples: int | None = None,
    sampling: Literal["lhs", "sobol", "random"] = "lhs",
    sampling_seed: int = 0,
    overrides: Mapping[str, object] | None = None,
    jobs: int | None = None,
    cluster: str | None = None,
    resume: bool = False,
) -> SweepResult:
    """Run a scenario with many values and seeds; what comes of each run is a row of the store
    `out`.

    Parameters
    ----------
    scenario : path
        As of `run`.
    vary : mapping of str to object, optional
        By the path of a key: a list of values, or text: ``"0.001:0.002:5 kg.m2"``, or a
        distribution by its name in scipy.stats, such as ``"uniform(0.001, 0.002) kg.m2"``.
    out : path, optional
        Folder of the store; created if it is missing.
    seeds : iterable of int, or text, optional
        Seeds of the controller's reference signal, each with all values; as text such as
        ``"1-12"``.
    samples : int, optional
        How many values are drawn from the distributions; required with them.
    sampling : {"lhs", "sobol", "random"}, optional
        How they are drawn: Latin hypercube, Sobol' points or independently.
    sampling_seed : int, optional
        Seed of that.
    overrides : mapping of str to object, optional
        As of `run`; for all runs.
    jobs : int, optional
        Threads; one a core without it.
    cluster : str, optional
        Address of the scheduler of a Dask cluster, in place of threads.
    resume : bool, optional
        Make only the runs that the store does not have.

    Returns
    -------
    SweepResult
        How many runs have which verdict, and the rows.

    Raises
    ------
    BristleError
        If the scenario cannot be run with one of the values, the store has runs and `resume` is not
        given, or pyarrow is not installed (``pip install 'bristle[parquet]'``). A run that fails is
        no error.
    """
    from bristle.harness.run.checked import RunOptions
    from bristle.harness.scenario.catalogue import find_scenario
    from bristle.harness.scenario.vary import seeds_of
    from bristle.harness.sweep.design import SAMPLINGS, design
    from bristle.harness.sweep.executor import Means
    from bristle.harness.sweep.spec import prepare_sweep
    from bristle.harness.sweep.store import Store
    from bristle.harness.sweep.sweep import run_sweep
    from bristle.result import SweepResult

    specs = _overrides(_varied(vary or {}))
    if not isinstance(seeds, Iterable):
        raise BristleError(
            f"seeds is {seeds!r}; give several, such as [1, 2], or text such as '1-12'"
        )
    if isinstance(seeds, str):
        wanted = seeds_of(seeds)
    else:
        wanted = [as_whole_number("seeds", seed) for seed in seeds]
    number = None if samples is None else as_whole_number("samples", samples)
    drawn = as_choice("sampling", sampling, SAMPLINGS)
    asked = design(specs, wanted, number, drawn, as_whole_number("sampling_seed", sampling_seed))
    store = Store(as_path("out", out))
    path = find_scenario(as_path("scenario", scenario))
    prepared = prepare_sweep(path, asked, RunOptions(overrides=_overrides(overrides)))
    threads = os.cpu_count() or 1 if jobs is None else as_whole_number("jobs", jobs)
    means = Means(threads, cluster, bool(resume), "bristle.sweep")
    found = run_sweep(prepared, asked, store, means)
    return SweepResult(store.path, found.verdicts, found.kept)


def _varied(vary: Mapping[str, str | Sequence[object]]) -> dict[str, str | list[object]]:
    """Return the values of each key, as lists or texts."""
    if not isinstance(vary, Mapping):
        raise BristleError(
            f'vary is a {type(vary).__name__}; give a dict such as {{"sensor": ["clean",'
            ' "encoder"]}'
        )
    for path, spec in vary.items():
        if not isinstance(spec, str | Sequence):
            raise BristleError(
                f"vary[{path!r}] is {spec!r}; give a list of values, or text such as"
                " 'uniform(1, 2)'"
            )
    return {path: spec if isinstance(spec, str) else list(spec) for path, spec in vary.items()}


def reproduce(
    out: PathLike = "out", *, progress: Callable[[str, float], None] | None = None
) -> Reproduction:
    """Make the figures and numbers of the paper: as printed, as repaired, and by the best observer,
    on one page.

    Parameters
    ----------
    out : path, optional
        Folder for reproduce.json, report.html and the figures; created if it is missing.
    progress : callable, optional
        Called with what is done now (text) and how much of the whole is done (0 to 1).

    Returns
    -------
    Reproduction
        Verdict, estimates, eq. (25) of all models, and the folder.

    Raises
    ------
    BristleError
        If an FMU cannot be built or the folder cannot be written. Nothing is written then.
    """
    from bristle.harness.paper.reproduce import reproduce as make
    from bristle.result import Reproduction

    folder = as_path("out", out)
    return Reproduction(make(folder, progress), folder)


def _overrides(given: object) -> tuple[str, ...]:
    """Return overrides as the texts path=value."""
    import json

    if given is None:
        return ()
    if not isinstance(given, Mapping):
        raise BristleError(
            f'overrides is a {type(given).__name__}; give a dict such as {{"plant.parameters.J":'
            ' "0.002 kg.m2"}'
        )
    texts = []
    for path, value in given.items():
        try:
            texts.append(f"{path}={value if isinstance(value, str) else json.dumps(value)}")
        except TypeError:
            raise BristleError(
                f"overrides[{path!r}] is a {type(value).__name__}; give text, a number or a list"
            ) from None
    return tuple(texts)


def build(
    part: Literal["plant", "observer", "controller"],
    out: PathLike = ".",
    *,
    kind: Literal["native", "python"] = "native",
    fmi: Literal[2, 3] = 2,
    law: str | None = None,
    method: str | None = None,
    effects: Sequence[str] = (),
    encoder: bool = True,
    platforms: str = "host",
) -> Path:
    """Build an FMU.

    Parameters
    ----------
    part : {"plant", "observer", "controller"}
        Which FMU.
    out : path, optional
        Folder for the file; created if it is missing.
    kind : {"native", "python"}, optional
        Compiled, or written in Python for importing tools that run in Python.
    fmi : {2, 3}, optional
        Version of FMI; FMUs written in Python are of version 2.
    law : str, optional
        A plant with this friction law only, instead of all laws behind a parameter.
    method : str, optional
        An observer with this method only, instead of all methods behind a parameter.
    effects : sequence of str, optional
        Effects of the plant, such as ``["cogging", "bias"]``; their parameters are called
        ``cogging.amplitude``. Without a law, the plant has all laws that the effects can join.
    encoder : bool, optional
        False leaves the encoder outputs of the plant out; that of one smooth law then also offers
        Model Exchange.
    platforms : str, optional
        What a native FMU runs on: ``"host"``, ``"all"``, or names such as ``"win64,linux64"``;
        others than this machine need the extra ``cross``.

    Returns
    -------
    pathlib.Path
        The file, such as ``ServoPlant.fmu`` or ``ServoPlant_lugre.fmu``.

    Raises
    ------
    BristleError
        If there is no such part, law, method, effect or platform, an effect cannot join the law,
        there is no compiler, or the folder cannot be written.
    """
    from bristle.harness.scenario.catalogue import Choice, build_files

    choice = Choice(law, method, as_names("effects", effects), encoder, platforms)
    made = build_files(
        {as_choice("part", part, PARTS): choice},
        as_path("out", out),
        fmi=as_choice("fmi", fmi, FMI_VERSIONS),
        kind=as_choice("kind", kind, KINDS),
    )
    return made[0]


def diagnose(
    model: PathLike | Model | None,
    data: PathLike | Record | Sequence[PathLike | Record],
    out: PathLike | None = None,
    *,
    fmu: PathLike | None = None,
    choose: str | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Diagnosis:
    """Find where a model and measured records disagree, and name the effect that the model lacks.

    Parameters
    ----------
    model : path or Model or None
        Model file (TOML), or what `load_model` returns. None if `fmu` alone describes the servo:
        the FMU must then have the parameters J, a2 and b, and the columns of the records are t [s],
        u and theta or v, in the units of the FMU.
    data : path or Record, or sequence of either
        Measured files (CSV, XLSX, MAT and others) or records that are loaded already; two or more
        records are better than one.
    out : path, optional
        Folder for diagnosis.json, report.html and the augmented model; without it nothing is
        written.
    fmu : path, optional
        Plant FMU (Co-Simulation) to diagnose instead of the equations of the model file.
    choose : str, optional
        Effect to add to the written model when effects of several classes tie.
    progress : callable, optional
        Called with what is done now (text) and how much of the whole is done (0 to 1).

    Returns
    -------
    Diagnosis
        Verdict, effects with their parameters (SI units) and 95 % intervals, ties, localisation of
        the residual, gap.

    Raises
    ------
    BristleError
        If model or data cannot be read or do not fit together, nothing moves in the records, the
        model cannot be simulated, or the folder cannot be written.
    """
    from bristle import diagnosis
    from bristle.diagnosis.report.export import check_places
    from bristle.plant.effects import effect

    files, records = _split(data)
    if choose is not None:
        effect(choose)
    if out is not None:
        check_places(
            as_path("out", out),
            [Path(path) for path in (model, fmu) if isinstance(path, (str, os.PathLike))] + files,
        )
    known = _model(model, fmu)
    if files:
        records = diagnosis.load_records(known, files)
    if fmu is None:
        found = diagnosis.diagnose(known, records, progress=progress)
    else:
        found = diagnosis.diagnose_fmu(as_path("fmu", fmu), known, records, progress=progress)
    if out is not None:
        diagnosis.write(found, Path(out), choose, made=_made(model, fmu, files))
    return found


def validate(
    model: PathLike | Model | None,
    data: PathLike | Record | Sequence[PathLike | Record],
    out: PathLike | None = None,
    *,
    fmu: PathLike | None = None,
    timeout: float | None = None,
    start_samples: int | None = None,
) -> Validation:
    """Simulate a model or a plant FMU over whole records in open loop, and say how far it is from
    what was measured.

    Parameters
    ----------
    model : path or Model or None
        Model file (TOML), such as the augmented.toml of a diagnosis, or what `load_model` returns.
        None if `fmu` alone describes the servo, as of `diagnose`.
    data : path or Record, or sequence of either
        Measured files, or records that are loaded already.
    out : path, optional
        Folder for validation.json and report.html; without it nothing is written.
    fmu : path, optional
        Plant FMU (Co-Simulation) to validate instead of the equations of the model file, which then
        gives the columns.
    timeout : float, optional
        Seconds that a simulation of an FMU may take.
    start_samples : int, optional
        Simulate each record also from a start that is fitted to so many of its first samples alone,
        and give the errors after them.

    Returns
    -------
    Validation
        Of each record: rms error, FIT, error of eq. (25), and the rms error over shorter horizons.

    Raises
    ------
    BristleError
        If model or data cannot be read or do not fit together, the FMU crashes or takes too long,
        or the folder cannot be written.
    """
    from bristle import diagnosis
    from bristle.diagnosis.report.validation_page import check_validation_places

    files, records = _split(data)
    given = [Path(path) for path in (model, fmu) if isinstance(path, (str, os.PathLike))]
    if out is not None:
        check_validation_places(as_path("out", out), [*given, *files])
    known = _model(model, fmu)
    if files:
        records = diagnosis.load_records(known, files)
    if fmu is None:
        found = diagnosis.validate(known, records, start_samples)
    else:
        path = as_path("fmu", fmu)
        found = diagnosis.validate_fmu(path, known, records, timeout, start_samples)
    if out is not None:
        diagnosis.write_validation(found, Path(out), _made(model, fmu, files))
    return found


def _made(model: object, fmu: object, files: list[Path]) -> dict[str, Any]:
    """Return where a result comes from; of a model or FMU that is no file there is no hash."""
    from bristle.common.provenance import provenance_of

    one, other = (
        Path(path) if isinstance(path, (str, os.PathLike)) else None for path in (model, fmu)
    )
    return provenance_of(one or other, files, fmu=other)


def _split(data: object) -> tuple[list[Path], list[Record]]:
    """Return measured files, or records that are loaded already: one of both lists is empty."""
    from bristle.diagnosis import Record

    items: list[object] = (
        list(data)
        if isinstance(data, Iterable) and not isinstance(data, (str, os.PathLike))
        else [data]
    )
    records = [item for item in items if isinstance(item, Record)]
    if records and len(records) < len(items):
        raise BristleError(
            "data mixes files and loaded records; load all with load_records, so that they get one"
            " sampling period"
        )
    return ([] if records else as_paths("data", items)), records


def _model(model: PathLike | Model | None, fmu: PathLike | None = None) -> Model:
    """Return a model from what stands for one."""
    from bristle import diagnosis

    if isinstance(model, (str, os.PathLike)):
        return diagnosis.load_model(Path(model))
    if isinstance(model, diagnosis.Model):
        return model
    if model is not None:
        raise BristleError(
            f"model is a {type(model).__name__}; give the path of a model file or a Model"
        )
    if fmu is None:
        raise BristleError(
            "nothing to diagnose: model is None; give a model file, a Model, or fmu=PLANT.fmu"
        )
    return diagnosis.fmu_model(as_path("fmu", fmu))


def load_model(file: PathLike) -> Model:
    """Read and check a model file.

    Parameters
    ----------
    file : path
        TOML file with the friction law, parameters, bounds and columns of the records.

    Returns
    -------
    Model

    Raises
    ------
    BristleError
        One line that names file, key, value and what is allowed.
    """
    return _model(file)


def load_record(model: PathLike | Model, file: PathLike) -> Record:
    """Read, check and clean one measured file.

    Parameters
    ----------
    model : path or Model
        Says which columns hold time, input and output, and their units.
    file : path
        File of any format that is read: CSV, XLSX, MAT, NPZ, Parquet and others.

    Returns
    -------
    Record
        Time [s], input and output (SI units) on an even grid, with findings about what was cleaned.

    Raises
    ------
    BristleError
        If the file cannot be read or its columns are not usable, or a gap splits it into several
        records: then use `load_records`.
    """
    records = load_records(model, file)
    if len(records) != 1:
        raise BristleError(f"{file}: gaps split it into {len(records)} records; use load_records")
    return records[0]


def load_records(model: PathLike | Model, files: PathLike | Sequence[PathLike]) -> list[Record]:
    """Read, check and clean measured files.

    Parameters
    ----------
    model : path or Model
        Says which columns hold time, input and output, and their units.
    files : path or sequence of path
        Files of any format that is read: CSV, XLSX, MAT, NPZ, Parquet and others.

    Returns
    -------
    list of Record
        At least one for each file, all with the same sampling period.

    Raises
    ------
    BristleError
        If a file cannot be read or its columns are not usable. Files sampled at different rates are
        brought to the slowest.
    """
    from bristle import diagnosis

    return diagnosis.load_records(_model(model), as_paths("files", files))


def records_from_arrays(model: PathLike | Model, arrays: Iterable[RecordArrays]) -> list[Record]:
    """Check and clean records in memory.

    Parameters
    ----------
    model : path or Model
        Says what the arrays are; its column names and units are not used.
    arrays : iterable of (name, time, input, output)
        Name of the record, and three arrays of shape (n,) in SI units.

    Returns
    -------
    list of Record
        At least one for each entry, all with the same sampling period.

    Raises
    ------
    BristleError
        If a record is not usable.
    """
    from bristle import diagnosis

    return diagnosis.records_from_arrays(_model(model), arrays)
