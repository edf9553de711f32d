"""Points of calls: their order, references and pointers that do not exist, tokens, and messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from ctypes import byref, c_char_p, c_double, c_void_p

from bristle.fmus.conformance.instance import STATE, CallFailed, Instance, Options, Subject
from bristle.fmus.conformance.registry import Severity
from bristle.fmus.conformance.running import (
    NotApplicable,
    Run,
    behaviour,
    default_step,
    differing,
    fresh,
    refused,
    times,
)

TYPES_PLATFORM = b"default"  # of FMI 2
UNKNOWN_STEP = 1000  # beyond the largest value reference, a reference that does not exist
LARGEST_REFERENCE = 2**32 - 1
WRONG_TOKEN = b"{not-the-token-of-this-file}"


@behaviour("run-version", "its functions tell the FMI version of the description")
def _version(subject: Subject) -> Iterator[str]:
    names = {"GetVersion": str(subject.description.fmiVersion).encode()}
    if subject.fmi == 2:
        names["GetTypesPlatform"] = TYPES_PLATFORM
    for name, expected in names.items():
        function = getattr(subject.library, f"fmi{subject.fmi}{name}")
        function.restype = c_char_p
        found = function()
        if found != expected:
            yield f"fmi{subject.fmi}{name} gives {found!r} instead of {expected!r}"


@behaviour("run-token", "a wrong guid or instantiationToken is refused", Severity.warning)
def _token(subject: Subject) -> Iterator[str]:
    try:
        Instance(subject, Options(token=WRONG_TOKEN)).free()
    except CallFailed:
        return
    yield "an instance was made"


@behaviour("run-name", "an instance without a name is refused, or does no harm", Severity.warning)
def _name(subject: Subject) -> Iterator[str]:
    for name in (None, b""):
        try:
            with Run(subject, Options(name=name)) as run:
                run.begin()
                run.steps(2)
        except CallFailed:
            continue
    yield from ()


@behaviour("run-null", "NULL, where the standard allows it, does no harm")
def _null(subject: Subject) -> Iterator[str]:
    null, state = c_void_p(None), STATE[subject.fmi][2]
    with Run(subject, Options(logger=subject.fmi == 2)) as run:
        instance = run.instance
        free = instance.function(f"fmi{subject.fmi}FreeInstance")
        free.restype = None
        subject.note(f"fmi{subject.fmi}FreeInstance(NULL)")
        free(null)
        run.begin()
        for verb in ("Get", "Set"):
            word = subject.typed("Real" if subject.fmi == 2 else "Float64")[0]
            instance.call(f"{verb}{word}", null, 0, null, *((0,) if subject.fmi == 3 else ()))
        if subject.claims("canGetAndSetFMUstate", "canGetAndSetFMUState"):
            instance.call(state, byref(c_void_p(None)))
        run.steps(2)
    yield from ()


@behaviour("run-unknown", "a value reference that does not exist is refused", Severity.warning)
def _unknown(subject: Subject) -> Iterator[str]:
    kind = "Real" if subject.fmi == 2 else "Float64"
    largest = max((int(v.valueReference) for v in subject.variables.values()), default=0)
    with Run(subject) as run:
        run.begin()
        for reference in (min(largest + UNKNOWN_STEP, LARGEST_REFERENCE - 1), LARGEST_REFERENCE):
            for verb in ("Get", "Set"):
                if not refused(run.instance.access(verb, reference, kind, (c_double * 1)())):
                    yield f"{verb}{kind} of reference {reference} has status OK"
        yield from _of_another_type(run.instance)


def _of_another_type(instance: Instance) -> Iterator[str]:
    """Give what is read of real variables as of another type, where no variable of that type has
    the reference.
    """
    subject = instance.subject
    for kind in ("Integer", "Boolean") if subject.fmi == 2 else ("Int32", "Boolean"):
        used = {
            v.valueReference for v in subject.variables.values() if v.type in (kind, "Enumeration")
        }
        real = subject.scalars("output", "input", "parameter")
        names = [name for name in real if subject.variables[name].valueReference not in used]
        for name in names[:1]:
            if not refused(
                instance.access(
                    "Get", subject.reference(name), kind, (subject.typed(kind)[1] * 1)()
                )
            ):
                yield f"{name} is read as {kind}, with status OK"


# -- order -----------------------------------------------------------------------------------------


@behaviour("run-early", "a step before the end of initialisation is refused", Severity.warning)
def _early(subject: Subject) -> Iterator[str]:
    start, h = times(subject)[0], default_step(subject)
    for when in ("before", "in"):
        with Instance(subject) as instance:
            if when == "in":
                instance.enter(start)
            if not refused(instance.step_status(start, h)):
                yield f"a step {when} initialisation has status OK"


@behaviour("run-late", "a step after the end is refused", Severity.warning)
def _late(subject: Subject) -> Iterator[str]:
    with Run(subject) as run:
        run.begin()
        run.steps(2)
        run.instance.do("Terminate")
        if not refused(run.instance.step_status(run.t, run.h)):
            yield "a step after Terminate has status OK"


@behaviour(
    "run-twice",
    "initialisation is not entered twice, nor left without being entered",
    Severity.warning,
)
def _twice(subject: Subject) -> Iterator[str]:
    with Instance(subject) as instance:
        if not refused(instance.call("ExitInitializationMode")):
            yield "ExitInitializationMode of a new instance has status OK"
    with Instance(subject) as instance:
        instance.enter()
        again = () if subject.fmi == 2 else (False, 0.0, 0.0, False, 0.0)
        if not refused(instance.call("EnterInitializationMode", *again)):
            yield "EnterInitializationMode has status OK a second time"


@behaviour("run-fixed", "a fixed parameter is not changed after initialisation", Severity.note)
def _fixed(subject: Subject) -> Iterator[str]:
    names = [n for n in subject.scalars("parameter") if subject.variables[n].variability == "fixed"]
    if not names:
        raise NotApplicable("it has no fixed real parameter")
    with Run(subject) as run:
        run.begin()
        run.steps(2)
        yield from _changed(run.instance, names)


@behaviour("run-computed", "an output that is no state cannot be set between steps", Severity.note)
def _computed(subject: Subject) -> Iterator[str]:
    states = {v.derivative.name for v in subject.variables.values() if v.derivative is not None}
    names = [name for name in subject.scalars("output") if name not in states]
    if not names:
        raise NotApplicable("it has no real output that is no state")
    with Run(subject) as run:
        run.begin()
        run.steps(2)
        yield from _changed(run.instance, names)


def _changed(instance: Instance, names: list[str]) -> Iterator[str]:
    """Give the variables that take another value though they should not."""
    for name in names:
        before = instance.number(name)
        if (
            not refused(instance.write(name, [before + 1.0]))
            and instance.number(name) == before + 1.0
        ):
            yield f"{name} is set, with status OK"


@behaviour("run-legal", "each legal order of calls is taken")
def _legal(subject: Subject) -> Iterator[str]:
    def stepped(run: Run) -> None:
        run.begin()
        run.steps(2)

    def ended(run: Run) -> None:
        stepped(run)
        run.instance.do("Terminate")
        run.outputs()

    starts: dict[str, Callable[[Run], None]] = {
        "a new instance": lambda run: None,
        "initialisation mode": lambda run: run.instance.enter(),
        "steps": stepped,
        "the end": ended,
    }
    for where, begin in starts.items():
        for what in ("freed", "reset"):
            try:
                with Run(subject) as run:
                    begin(run)
                    if what == "reset":
                        run.instance.do("Reset")
                        stepped(run)
            except CallFailed as error:
                yield f"{what} from {where}: {error}"


# -- messages --------------------------------------------------------------------------------------


@behaviour("run-log-same", "with debug logging it gives the same digits")
def _log_same(subject: Subject) -> Iterator[str]:
    with Run(subject) as run:
        yield from differing(run.columns, fresh(subject), fresh(subject, Options(logging=True)))


@behaviour(
    "run-log-off",
    "without debug logging it sends no message where nothing is wrong",
    Severity.warning,
)
def _log_off(subject: Subject) -> Iterator[str]:
    with Run(subject, moved=False) as run:
        run.begin()
        run.steps()
        for _, category, text in run.instance.messages[:1]:
            yield f"{category}: {' '.join(text.split())[:80]}"


@behaviour(
    "run-log-categories", "messages are of the categories of the description", Severity.warning
)
def _log_categories(subject: Subject) -> Iterator[str]:
    declared = {c.name for c in subject.description.logCategories or ()}
    if not declared:
        raise NotApplicable("it declares no categories of messages")
    with Run(subject, Options(logging=True)) as run:
        run.begin()
        run.steps(2)
        run.instance.access(
            "Get", LARGEST_REFERENCE, "Real" if subject.fmi == 2 else "Float64", (c_double * 1)()
        )
        run.instance.step_status(run.t, -math.inf)
        used = {category for _, category, _ in run.instance.messages}
    yield from (f"'{category}'" for category in sorted(used - declared))


@behaviour(
    "run-log-set",
    "debug logging is switched on and off, for the categories of the description, too",
)
def _log_set(subject: Subject) -> Iterator[str]:
    names = [c.name.encode() for c in subject.description.logCategories or ()]
    with Run(subject) as run:
        run.instance.do("SetDebugLogging", True, 0, None)
        if names:
            run.instance.do("SetDebugLogging", True, len(names), (c_char_p * len(names))(*names))
        run.begin()
        run.steps(2)
        run.instance.do("SetDebugLogging", False, 0, None)
        run.steps(2)
    yield from ()
