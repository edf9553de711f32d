"""The command line: list, build, run, reproduce, init, diagnose, validate, diff.

Exit code 0: all verdicts pass (diagnose, validate: it completed), 1: one failed, 2: an error, reported in one line.
"""

from __future__ import annotations

import difflib
import os
import re
import shlex
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bristle.cli.files import DataCommand, files_of
from bristle.common.arguments import filled_path
from bristle.common.errors import BristleError, IncompleteError

if TYPE_CHECKING:
    from rich.progress import Progress

    from bristle.diagnosis.report.result import Diagnosis
    from bristle.diagnosis.selection.start_values import SearchOptions
    from bristle.harness.run import Checked, Options, Run

PASS, FAIL, ERROR = 0, 1, 2
DID_YOU_MEAN = re.compile(r"\. Did you mean (.*\?)$")  # how the option parser proposes a command
SECONDS_BETWEEN_LINES = 5.0  # s, of progress where there is no terminal for a bar
LIKE = 0.75  # least likeness of an option that is proposed for one that does not exist

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None)


class Interrupted(BaseException):
    """Ctrl-C or SIGTERM; not a KeyboardInterrupt, which the option parser would turn into its own exit code."""


class Kind(StrEnum):
    """native: compiled C99; python: for hosts that run in Python."""

    native = "native"
    python = "python"


class What(StrEnum):
    """Which FMU."""

    plant = "plant"
    observer = "observer"
    controller = "controller"
    all = "all"


class Fmi(StrEnum):
    """Version of FMI."""

    two = "2"
    three = "3"


def _path(given: str | Path) -> Path:
    """Return the path of an option or argument."""
    try:
        return filled_path(given)
    except BristleError as error:
        raise typer.BadParameter(str(error)) from None  # the parser adds which option it is


KindOption = Annotated[Kind, typer.Option(help="native: compiled; python: for hosts that run in Python")]
FmiOption = Annotated[Fmi, typer.Option(help="version of FMI")]
DebugOption = Annotated[bool, typer.Option("--debug", help="show the traceback of an error")]


def _say(line: str) -> None:
    print(" ".join(line.split()), file=sys.stderr, flush=True)


def _print_version(wanted: bool) -> None:
    if wanted:
        import bristle as library

        print(f"bristle {library.__version__}")
        raise typer.Exit(PASS)


@app.callback()
def bristle(
    version: Annotated[bool, typer.Option("--version", callback=_print_version, is_eager=True, help="print the version")] = False,
) -> None:
    """Servo friction and the adaptive observers that identify it, as FMUs, co-simulated over scenario files."""


# -- list ------------------------------------------------------------------------------------------------------------


@app.command("list", short_help="List friction laws, observers, effects and scenarios.")
def list_command() -> None:
    """List friction laws, observer methods, effects and the scenarios that come with bristle."""
    from bristle.harness.catalogue import catalogue
    from bristle.plant.effects import effects
    from bristle.plant.signal_effects import SIGNAL_EFFECTS

    found = {name: f"{e.description} (class {e.group})" if e.group != name else e.description for name, e in effects().items()}
    signal = {name: e.description for name, e in SIGNAL_EFFECTS.items()}
    for title, entries in {**catalogue(), "effects": found, "effects on signals (not part of a diagnosis)": signal}.items():
        print(f"{title}:")
        width = max((len(name) for name in entries), default=0)
        for name, description in entries.items():
            print(f"  {name:<{width}}  {description}".rstrip())


# -- build -----------------------------------------------------------------------------------------------------------


@app.command()
def build(
    what: Annotated[What, typer.Argument(help="which FMU")] = What.all,
    out: Annotated[Path, typer.Option(help="folder for the .fmu files", metavar="FOLDER", parser=_path)] = Path(),
    fmi: FmiOption = Fmi.two,
    kind: KindOption = Kind.native,
    law: Annotated[str | None, typer.Option(help="a plant of one friction law")] = None,
    method: Annotated[str | None, typer.Option(help="an observer of one method")] = None,
    effects: Annotated[str | None, typer.Option(help="effects of the plant, separated by commas", metavar="NAME,...")] = None,
    encoder: Annotated[bool, typer.Option(help="without: Model Exchange for a plant of one smooth law")] = True,
    debug: DebugOption = False,
) -> None:
    """Build FMUs."""
    from bristle.harness.catalogue import Choice, build_file

    added = tuple(name.strip() for name in effects.split(",")) if effects else ()
    choices = {"plant": Choice(law, None, added, encoder), "observer": Choice(None, method), "controller": Choice()}
    if what is not What.all:
        choices = {what.value: Choice(law, method, added, encoder)}
    for part, choice in choices.items():
        print(build_file(part, out, fmi=int(fmi.value), kind=kind.value, choice=choice))


# -- run -------------------------------------------------------------------------------------------------------------


@app.command(short_help="Run scenarios, and compare estimates with true values.")
def run(
    scenarios: Annotated[list[Path], typer.Argument(help="files, or names from bristle list", metavar="SCENARIO", parser=_path)],
    out: Annotated[Path, typer.Option(help="folder for the results", metavar="FOLDER", parser=_path)] = Path("out"),
    kind: KindOption = Kind.native,
    fmi: FmiOption = Fmi.two,
    set_: Annotated[list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="override a value of the file")] = None,
    seed: Annotated[int | None, typer.Option(help="seed of the controller's reference")] = None,
    full: Annotated[bool, typer.Option("--full", help="signals.csv at full rate")] = False,
    debug: DebugOption = False,
) -> None:
    """Run scenarios and write a result folder for each; none runs before all are checked."""
    from bristle.common.output import output_folder
    from bristle.harness.run import Options

    _refuse_duplicates(scenarios)
    options = Options(int(fmi.value), kind.value, tuple(set_ or ()), seed, full)
    with output_folder(out):
        checked = [_checked(path, out, options, debug) for path in scenarios]
        ready = [each for each in checked if each is not None]
        worst = max(_executed(each, debug) for each in ready) if len(ready) == len(checked) else ERROR
        raise typer.Exit(worst)  # in the context, which removes a folder that stays empty


def _checked(path: Path, out: Path, options: Options, debug: bool) -> Checked | None:
    """Check a scenario; of one that cannot be run, print the error and return None."""
    from bristle.harness.catalogue import find_scenario
    from bristle.harness.run import check

    try:
        with _progress(path.stem) as tell:
            return check(find_scenario(path), out, options, tell)
    except BristleError as error:
        _complain(error, debug)
        return None


def _executed(checked: Checked, debug: bool) -> int:
    """Run a scenario, print its verdict or its error, and return the exit code."""
    from bristle.harness.run import execute

    try:
        with _progress(checked.setup.loaded.name) as tell:
            done = execute(checked, tell)
    except BristleError as error:
        _complain(error, debug)
        return ERROR
    _report(done)
    return PASS if done.passed else FAIL


def _complain(error: BaseException, debug: bool) -> None:
    """Print an error as one line."""
    if debug:
        traceback.print_exc()
    _say(_explain(error))


def _refuse_duplicates(paths: Sequence[Path]) -> None:
    stems = [path.stem for path in paths]
    for path in paths:
        if stems.count(path.stem) > 1:
            raise BristleError(
                f"scenario '{path.stem}' is given {stems.count(path.stem)} times; results are named by the file: rename one"
            )


def _report(done: Run) -> None:
    """Print the verdict of a run, why it failed, and findings on its record."""
    result = done.result
    failed = [check["name"] for check in result["checks"] if not check["pass"]]
    why = ""
    if "diverged" in result:
        why = f"  {result['diverged']['fmu']} stopped at {result['diverged']['time_s']:g} s: {result['diverged']['message']}"
    elif failed:
        why = f"  failed: {', '.join(failed)}"
    head = f"{result['scenario']:<24} {result['verdict']:<4} {result['wall_s']:7.1f} s"
    print(f"{head}  {done.folder / 'report.html'}{why}", flush=True)
    for line in done.findings:
        print(f"  - {line}", flush=True)


@contextmanager
def _bar() -> Iterator[Progress | None]:
    """Give a progress bar on a terminal, else None."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.fields[name]}"),
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        yield bar


@contextmanager
def _progress(name: str) -> Iterator[Callable[[str, int, int], None]]:
    """Show the progress of a run, stage by stage."""
    with _bar() as bar:
        if bar is None:
            yield lambda stage, done, total: _check_interrupt()
            return
        current = [bar.add_task("starting", name=name, total=None)]
        stages = ["starting"]

        def tell(stage: str, done: int, total: int) -> None:
            _check_interrupt()
            if stage != stages[-1]:
                bar.remove_task(current.pop())
                current.append(bar.add_task(stage, name=name, total=total or None))
                stages.append(stage)
            bar.update(current[0], completed=done)

        yield tell


@contextmanager
def _fraction(name: str) -> Iterator[Callable[[str, float], None]]:
    """Show the progress of a long computation: its present step, and the share that is done."""
    with _bar() as bar:
        task = None if bar is None else bar.add_task("starting", name=name, total=1.0)
        last = time.monotonic()

        def tell(text: str, fraction: float) -> None:
            nonlocal last
            _check_interrupt()
            if bar is not None and task is not None:
                bar.update(task, description=text, completed=fraction)
            elif time.monotonic() > last + SECONDS_BETWEEN_LINES:
                last = time.monotonic()
                print(f"{name}: {text}, {fraction:.0%}", file=sys.stderr, flush=True)

        yield tell


# -- reproduce -------------------------------------------------------------------------------------------------------


@app.command(
    short_help="Make the figures and numbers of the paper.",
    epilog="Exit code 0: every run is as it is expected to be; 1: one is not; 2: an error.",
)
def reproduce(
    out: Annotated[
        Path, typer.Option(help="folder for report.html, its figures and reproduce.json", metavar="FOLDER", parser=_path)
    ] = Path("out"),
    debug: DebugOption = False,
) -> None:
    """Make the figures and numbers of the paper: as printed, as repaired, and by the best observer, on one page."""
    from bristle.harness.reproduce import reproduce as make

    with _fraction("reproduce") as tell:
        content = make(out, tell)
    print(f"{content['verdict']}  {out / 'report.html'}", flush=True)
    raise typer.Exit(PASS if content["verdict"] == "pass" else FAIL)


# -- init ------------------------------------------------------------------------------------------------------------


@app.command(
    short_help="Propose a model file from measured records.",
    epilog="Exit code 0: the model file is written; 2: an error.",
)
def init(
    data: Annotated[list[Path], typer.Argument(help="measured files or patterns", metavar="FILE", parser=_path)],
    out: Annotated[Path, typer.Option(help="model file to write", metavar="MODEL.toml", parser=_path)] = Path("model.toml"),
    time: Annotated[str | None, typer.Option(help="column of the time", metavar="COLUMN")] = None,
    input_: Annotated[str | None, typer.Option("--input", help="column of the input", metavar="COLUMN")] = None,
    output: Annotated[str | None, typer.Option(help="column of the output", metavar="COLUMN")] = None,
    unit: Annotated[list[str] | None, typer.Option(help="unit of a column", metavar="COLUMN=UNIT")] = None,
    force: Annotated[bool, typer.Option("--force", help="replace MODEL.toml if it exists")] = False,
    debug: DebugOption = False,
) -> None:
    """Find time, input and output in measured files, estimate rough parameters, and write a commented model file."""
    from bristle.cli.files import pairs
    from bristle.diagnosis.proposal import propose
    from bristle.diagnosis.proposal_text import next_command, summary, write_model

    files = files_of(data)
    found = propose(files, {"time": time, "input": input_, "output": output}, pairs("--unit", unit or []))
    write_model(found, out, force)
    for line in summary(found):
        print(line)
    print(f"{out}  next: {next_command(found, out)}")


# -- diagnose --------------------------------------------------------------------------------------------------------


@app.command(
    cls=DataCommand,
    short_help="Name the effect that a model lacks, from measured records.",
    epilog="With both MODEL.toml and --fmu, the FMU is diagnosed, and the file gives the columns and the nominal J and friction. "
    "With --fmu alone, it must have the parameters J, a2 and b, and the columns are t [s], u and theta or, "
    "of an FMU without it, v, in the units of the FMU. "
    "Exit code 0: it completed, whatever it found; 2: an error.",
)
def diagnose(
    data: Annotated[
        list[Path], typer.Option(help="measured files or patterns (two files or more are best)", metavar="FILE...", parser=_path)
    ],
    out: Annotated[
        Path, typer.Option(help="folder for diagnosis.json, report.html and the augmented model", metavar="FOLDER", parser=_path)
    ] = Path("out"),
    model: Annotated[Path | None, typer.Argument(help="model file", metavar="MODEL.toml", parser=_path)] = None,
    fmu: Annotated[Path | None, typer.Option(help="plant FMU to diagnose", metavar="PLANT.fmu", parser=_path)] = None,
    choose: Annotated[str | None, typer.Option(help="effect of a tie to add to the model", metavar="NAME")] = None,
    fill: Annotated[bool, typer.Option("--fill", help="put what is left unexplained into the model, as an unnamed torque")] = False,
    jobs: Annotated[int, typer.Option(help="effects tried at a time; 0: one on each core", min=0, metavar="N")] = 0,
    budget: Annotated[str | None, typer.Option(help="time for the whole diagnosis, such as 60s", metavar="TIME")] = None,
    fmi: Annotated[Fmi, typer.Option(help="version of FMI of what is written")] = Fmi.two,
    debug: DebugOption = False,
) -> None:
    """Find where a model and measured records disagree, name the missing effect, and write the model with it."""
    if model is None and fmu is None:
        raise BristleError("nothing to diagnose; give MODEL.toml or --fmu PLANT.fmu")
    _check_effect(choose)
    data = files_of(data)
    from bristle.common.output import output_folder
    from bristle.common.provenance import provenance_of
    from bristle.diagnosis.report.export import check_places, nothing_filled, write

    options = _search_options(jobs, budget)
    check_places(out, [path for path in (model, fmu, *data) if path is not None])
    with output_folder(out), _fraction("diagnose") as tell:
        found = _diagnosed(model, fmu, data, tell, options)
        tell("writing", 1.0)
        problem = None
        try:
            write(found, out, choose, fmi=int(fmi.value), made=provenance_of(fmu or model, data, _command()), fill=fill)
        except BristleError as error:
            problem = error
    _summary(found, choose if problem is None else None)  # the answer is printed even if it cannot be written
    if fill and not (found.unnamed is not None and found.unnamed.offered):
        print(nothing_filled(found))
    if problem is None or isinstance(problem, IncompleteError):
        print(f"{found.verdict}  {out / 'report.html'}", flush=True)
    if problem is not None:
        raise problem


def _command() -> str:
    """Return the command that repeats this call."""
    return shlex.join(["bristle", *sys.argv[1:]])


def _check_effect(name: str | None) -> None:
    """Raise BristleError for an unknown effect, before a long computation."""
    if name is not None:
        from bristle.plant.effects import effect

        effect(name)


def _search_options(jobs: int, budget: str | None) -> SearchOptions:
    """Return the options of a search; raise BristleError for a budget that is no time above 0."""
    from bristle.common.units import quantity
    from bristle.diagnosis.selection.start_values import SearchOptions

    if budget is None:
        return SearchOptions(jobs=jobs)
    try:
        seconds = quantity(re.sub(r"(?<=[\d.])(?=[a-z]+$)", " ", budget), "s")
    except BristleError as error:
        raise BristleError(f"--budget: {error}") from None
    if not seconds > 0:
        raise BristleError(f"--budget is {budget}; give a time above 0, such as 60s")
    return SearchOptions(jobs=jobs, budget=seconds)


def _diagnosed(
    model: Path | None, fmu: Path | None, data: Sequence[Path], tell: Callable[[str, float], None], options: SearchOptions
) -> Diagnosis:
    """Read and diagnose a model or an FMU."""
    from bristle import diagnosis

    tell("reading", 0.0)
    if fmu is not None:
        known = diagnosis.load_model(model) if model is not None else diagnosis.fmu_model(fmu)
        return diagnosis.diagnose_fmu(fmu, known, diagnosis.load_records(known, data), progress=tell, options=options)
    assert model is not None
    known = diagnosis.load_model(model)
    return diagnosis.diagnose(known, diagnosis.load_records(known, data), progress=tell, options=options)


def _summary(found: Diagnosis, chosen: str | None = None) -> None:
    """Print the answer in one line and in sentences, what to measure next, findings, and the parameters of the effects."""
    from bristle.diagnosis.report.headline import headline
    from bristle.diagnosis.report.text import effect_name, plain_texts

    print(headline(found))
    text = "\n".join(found.statement)
    for line in (*found.statement, *(line for line in found.proposals if line.rstrip("?.") not in text)):
        print(line)
    if found.experiment:
        print(f"What to measure next: {found.experiment}")
    if chosen is not None:
        print(f"The augmented model has {effect_name(chosen)}, as chosen.")
    elif found.choices:
        print(f"For a model with one of these effects, give --choose: {', '.join(found.choices)}")
    for line in found.findings:
        print(f"  - {line}")
    rows = [("effect", "parameter", "value", "95 % interval", "unit")]
    for effect in found.effects:
        for name, e in effect.parameters.items():
            value, low, high = plain_texts(e)
            interval = f"{low} ... {high}" if low else "-"
            rows.append((effect.name, name, value + (" (at its bound)" if e.at_bound else ""), interval, e.unit))
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    for row in rows if len(rows) > 1 else ():
        print("  " + "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip())


# -- validate --------------------------------------------------------------------------------------------------------


@app.command(
    cls=DataCommand,
    short_help="Compare a model or a plant FMU with records, in open loop.",
    epilog="The columns are those of MODEL.toml (a model file, or the augmented.toml of a diagnosis). With an FMU alone, which "
    "must have the parameters J, a2 and b, they are t [s], u and theta or, of an FMU without it, v, in the units of the FMU. "
    "Exit code 0: it completed, however large the error; 2: an error.",
)
def validate(
    model: Annotated[Path, typer.Argument(help="model file or plant FMU", metavar="MODEL.toml|PLANT.fmu", parser=_path)],
    data: Annotated[list[Path], typer.Option(help="measured files or patterns", metavar="FILE...", parser=_path)],
    out: Annotated[Path, typer.Option(help="folder for validation.json and report.html", metavar="FOLDER", parser=_path)] = Path(
        "out"
    ),
    fmu: Annotated[
        Path | None,
        typer.Option(help="plant FMU to validate; MODEL.toml then gives the columns", metavar="PLANT.fmu", parser=_path),
    ] = None,
    timeout: Annotated[float | None, typer.Option(help="seconds that a simulation of an FMU may take", min=0.001)] = None,
    debug: DebugOption = False,
) -> None:
    """Simulate a model or a plant FMU over whole records in open loop, and say how far it is from what was measured."""
    from bristle import diagnosis
    from bristle.common.output import output_folder
    from bristle.common.provenance import provenance_of
    from bristle.diagnosis.whole.report import check_validation_places, sentences, write_validation

    data = files_of(data)
    if model.suffix.lower() == ".fmu":
        if fmu is not None:
            raise BristleError(f"{model} and {fmu} are both FMUs; give one, and MODEL.toml for the columns")
        fmu = model
    check_validation_places(out, [model, *data, *([] if fmu is None else [fmu])])
    with output_folder(out), _fraction("validate") as tell:
        tell("reading", 0.0)
        known = diagnosis.fmu_model(model) if model == fmu else diagnosis.load_model(model)
        records = diagnosis.load_records(known, data)
        tell("simulating", 0.2)
        found = diagnosis.validate(known, records) if fmu is None else diagnosis.validate_fmu(fmu, known, records, timeout)
        tell("writing", 0.9)
        write_validation(found, out, provenance_of(fmu or model, data, _command()))
    for line in (*sentences(found), *(f"  - {finding}" for finding in found.findings), out / "report.html"):
        print(line)


# -- diff ------------------------------------------------------------------------------------------------------------


@app.command(
    short_help="Compare two FMUs: interface, start values, behaviour.",
    epilog="Behaviour: both run over the default experiment of the first one, with inputs that move within their ranges. "
    "Exit code 0: what uses A.fmu may use B.fmu and sees no difference; 1: it may not, or sees one; 2: an error.",
)
def diff(
    first: Annotated[Path, typer.Argument(help="the FMU that is used", metavar="A.fmu", parser=_path)],
    second: Annotated[Path, typer.Argument(help="the one that is to take its place", metavar="B.fmu", parser=_path)],
    json: Annotated[Path | None, typer.Option(help="file for the differences", metavar="FILE", parser=_path)] = None,
    debug: DebugOption = False,
) -> int:
    """Say what differs between two FMUs, and whether that matters to who uses the first one."""
    from bristle.common.output import check_not_replaced, replace_files, to_json
    from bristle.fmus.difference import HARMLESS, fmu_differences
    from bristle.fmus.host import Fmu

    if json is not None:
        check_not_replaced(json.parent, [json.name], [first, second])
    found = fmu_differences(*(Fmu(path, foreign=True) for path in (first, second)))
    for each in found:
        print(f"{each.change:<9}  {each.place}: {each.text}")
    serious = sum(each.change not in HARMLESS for each in found)
    print(f"{len(found)} differences, {serious} that a user of {first.name} may notice" if found else "no difference")
    if json is not None:
        rows = [{"kind": str(each.change), "place": each.place, "text": each.text} for each in found]
        content = to_json({"first": str(first), "second": str(second), "differences": rows}).encode()
        replace_files(json.parent, {json.name: content}, [json.name])
    return FAIL if serious else PASS


# -- entry -----------------------------------------------------------------------------------------------------------


_interrupts: list[int] = []


def _interrupt(number: int, _frame: object) -> None:
    """Raise once; later signals are ignored, so that the clean-up can finish."""
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, signal.SIG_IGN)
    _interrupts.append(number)
    raise Interrupted(number)


def _check_interrupt() -> None:
    """Raise an interrupt again that came in a finaliser or a callback from C, where Python drops exceptions."""
    if _interrupts:
        raise Interrupted(_interrupts[0])


def main() -> None:
    """Run the command line; an error ends with one line and exit code 2."""
    debug = "--debug" in sys.argv
    for library in ("OPENBLAS", "OMP", "MKL"):  # before NumPy: its threads do not pay on matrices this small
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    warnings.showwarning = _show_warning
    try:
        code = app(standalone_mode=False)
    except (Exception, Interrupted) as error:
        _complain(error, debug)
        raise SystemExit(ERROR) from None
    raise SystemExit(code if isinstance(code, int) else PASS)


def _show_warning(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, file: object = None, line: str | None = None
) -> None:
    """Print in one line what is deprecated; of other warnings also where they come from."""
    _say(f"bristle: {message}" if issubclass(category, FutureWarning) else f"{filename}:{lineno}: {category.__name__}: {message}")


def _explain(error: BaseException) -> str:
    """Return an error as one line; wrong options are errors of the option parser."""
    usage = getattr(error, "format_message", None)
    if isinstance(error, Interrupted):
        return "bristle: interrupted"
    if isinstance(error, BristleError):
        return f"bristle: {error}"
    if type(error).__name__ == "NoArgsIsHelpError":
        return (
            "bristle: no command; choose one of list, build, run, reproduce, init, diagnose, validate, diff, or see bristle --help"
        )
    if type(error).__name__ == "NoSuchOption":  # click also proposes options that are hardly alike
        name, known = getattr(error, "option_name", ""), getattr(error, "possibilities", None) or []
        error.possibilities = difflib.get_close_matches(name, known, 1, LIKE)  # type: ignore[attr-defined]  # of click, by its name
    if usage is not None:
        context = getattr(error, "ctx", None)
        command = "bristle" if context is None or context.parent is None else f"bristle {context.info_name}"
        said = DID_YOU_MEAN.sub(r" (did you mean \1)", usage().replace("Value error, ", "").rstrip("."))
        return f"bristle: {said}; see {command} --help"
    return f"bristle: {type(error).__name__}: {error}; run again with --debug and report the traceback"


if __name__ == "__main__":
    main()
