"""Whatever a foreign FMU does: one line that names it, nothing left of it, within the time
limit.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.fmus import isolate
from bristle.fmus.answer import read_answer, write_answer
from bristle.fmus.host import Fmu
from bristle.fmus.playback import Replay, ReplaySegment, replay_records
from bristle.harness.cosim.bus import Bus, BusUnit
from bristle.harness.cosim.isolate import simulate_isolated
from bristle.harness.cosim.loop import simulate

Maker = Callable[..., Path]
Message = Callable[[Callable[[], Any]], str]
# s; a child process needs a part of it to start, and on a busy machine more
LIMITS = (1.5, 6.0, 30.0)
pytestmark = [
    pytest.mark.usefixtures("no_leftovers"),
    pytest.mark.skipif(os.name != "posix", reason="the faults are those of Unix"),
]


@pytest.fixture(scope="session")
def plant(tiny_fmu: Maker) -> Path:
    return tiny_fmu()


@pytest.fixture
def faulty(plant: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Bus]:
    """Return a maker of buses whose plant has a fault at 0.5 s of 0.9 s, or in its calls before and
    after.
    """

    def make(fault: str) -> Bus:
        monkeypatch.setenv("TINY_TROUBLE", fault)
        unit = BusUnit("plant", Fmu(plant, foreign=True))
        return Bus((unit,), 900, 1e-3, events=((0, ("plant", "u"), 1.0),), record=(("plant", "v"),))

    return make


def left() -> list[str]:
    """Return the processes that have the environment of a fault; this one got it after it had
    started.
    """
    found = []
    for path in Path("/proc").glob("[0-9]*/environ"):
        try:
            if b"TINY_TROUBLE=" in path.read_bytes() and path.parent.name != str(os.getpid()):
                found.append((path.parent / "cmdline").read_text())
        except OSError:
            continue
    return found


def told_of(during: str, message: Message, run: Callable[[float], object]) -> tuple[float, str]:
    """Return the first limit at which a run came as far as a call, and the line that is said."""
    for limit in LIMITS:
        line = message(partial(run, limit))
        if during in line:
            break
    return limit, line


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("fault", "during"),
    [
        ("load", "loading it"),
        ("instantiate", "instantiating it"),
        ("step", "its step 501"),
        ("free", "freeing it"),
        ("stop", "its step 501"),
        ("flood", "its step 501"),
    ],
)
def test_what_hangs_is_ended_and_the_call_is_named(
    fault: str, during: str, faulty: Callable[[str], Bus], message: Message
) -> None:
    limit, line = told_of(
        during, message, lambda limit: simulate_isolated(faulty(fault), timeout=limit)
    )
    assert f"took longer than {limit:g} s ({during})" in line
    assert "none.fmu" in line
    assert "--timeout" in line
    assert left() == []


def test_without_a_limit_a_call_that_does_not_return_is_ended(
    faulty: Callable[[str], Bus], message: Message, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run(limit: float) -> object:
        monkeypatch.setattr(isolate, "LONGEST_CALL", limit)
        return simulate_isolated(faulty("step"))

    limit, line = told_of("its step 501", message, run)
    assert f"did not answer for {limit:g} s (its step 501)" in line
    assert left() == []


@pytest.mark.sampled(4)
def test_a_process_that_it_starts_ends_with_it(faulty: Callable[[str], Bus]) -> None:
    """Also one that has left the group and ignores signals that can be ignored; the run itself is
    not harmed.
    """
    trace = simulate_isolated(faulty("daemon"), timeout=60.0)
    assert trace.failure is None
    assert trace.steps == 900
    assert left() == []


@pytest.mark.sampled(4)
def test_the_worker_does_not_outlive_its_supervisor(
    faulty: Callable[[str], Bus], message: Message
) -> None:
    assert "SIGKILL" in message(lambda: simulate_isolated(faulty("orphan"), timeout=60.0))
    for _ in range(500):
        if left():
            time.sleep(0.01)
    assert left() == []


@pytest.mark.parametrize(
    ("fault", "word"), [("forge", "not what was asked for"), ("pipe", "no file")]
)
def test_a_forged_answer_is_refused_and_runs_no_code(
    fault: str,
    word: str,
    faulty: Callable[[str], Bus],
    message: Message,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert word in message(lambda: simulate_isolated(faulty(fault), timeout=60.0))
    assert not list(tmp_path.rglob("forged"))


@pytest.mark.slow
def test_one_that_takes_all_memory_harms_itself_alone(
    faulty: Callable[[str], Bus], monkeypatch: pytest.MonkeyPatch
) -> None:
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    own = (
        int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        * resource.getpagesize()
    )  # which other tests have used
    limit = max(3 << 30, own + (1 << 28))
    # the limit of the user is kept where it is lower
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    try:
        trace = simulate_isolated(faulty("memory"), timeout=60.0)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
    assert trace.failure is not None
    assert "doStep returned Error" in trace.failure.message


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("fault", "status"), [("discard", "Discard"), ("fatal", "Fatal")])
def test_the_status_is_named(fault: str, status: str, faulty: Callable[[str], Bus]) -> None:
    for engine in ("native", "fmpy"):
        failure = simulate_isolated(faulty(fault), engine=engine).failure
        assert failure is not None
        assert status.lower() in failure.message.lower()
        assert (failure.unit, failure.time) == ("plant", pytest.approx(0.5))


def test_the_unit_that_made_the_nan_is_named(faulty: Callable[[str], Bus]) -> None:
    """And not the controller, which refuses it."""
    from bristle.fmus import obtain

    bus = faulty("nan")
    controller = BusUnit("controller", Fmu(obtain("controller")))
    links = ((("plant", "v"), ("controller", "y_v")),)
    both = replace(bus, instances=(*bus.instances, controller), links=links)
    for engine in ("native", "fmpy"):
        failure = simulate(both, engine=engine).failure
        assert failure is not None
        assert failure.unit == "plant"
        assert "its output v is nan, which controller refused" in failure.message
        assert failure.time == pytest.approx(0.501)


def test_a_replay_has_the_limit_too(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TINY_TROUBLE", "step")
    task = Replay(
        Fmu(plant, foreign=True), 1e-3, (ReplaySegment(0.0, np.ones(900), {}),), ("v",), {}
    )
    with pytest.raises(BristleError, match=f"took longer than {LIMITS[0]:g} s"):
        replay_records(task, timeout=LIMITS[0])
    assert left() == []


def test_an_interrupt_leaves_nothing(faulty: Callable[[str], Bus]) -> None:
    def interrupted(done: int) -> None:
        if done > 100:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate_isolated(faulty("step"), interrupted, timeout=60.0)
    assert left() == []


def test_a_pipe_in_the_place_of_the_file_is_refused(tmp_path: Path, message: Message) -> None:
    os.mkfifo(tmp_path / "pipe.fmu")
    assert "is not a file" in message(lambda: Fmu(tmp_path / "pipe.fmu", foreign=True))


# -- answers ---------------------------------------------------------------------------------------


def test_an_answer_comes_back_as_it_was(tmp_path: Path) -> None:
    sent = {
        "a": np.arange(6.0).reshape(2, 3),
        "b": [None, True, 1, 0.1 + 0.2, "text", {"c": np.array([np.nan])}],
        "d": np.zeros((0, 2)),
    }
    write_answer(tmp_path / "answer", sent)
    found = read_answer(tmp_path / "answer")
    np.testing.assert_array_equal(found["a"], sent["a"])
    assert found["b"][:5] == [None, True, 1, 0.1 + 0.2, "text"]
    assert np.isnan(found["b"][5]["c"]).all()
    assert found["d"].shape == (0, 2)
    assert read_answer(tmp_path / "none") is None


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x80\x04.",
        (
            b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape':"
            b" (1000000000000,), }"
        ),
    ],
)
def test_what_is_no_answer_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "answer").write_bytes(content)
    with pytest.raises(BristleError, match="not what was asked for"):
        read_answer(tmp_path / "answer")


def test_objects_are_not_read(tmp_path: Path) -> None:
    with (tmp_path / "answer").open("wb") as file:
        np.save(file, np.array([signal.SIGTERM], dtype=object), allow_pickle=True)
    with pytest.raises(BristleError, match="not what was asked for"):
        read_answer(tmp_path / "answer")
