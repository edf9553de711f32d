"""Instances: reset, interleaving, states in and out, splitting of steps, threads, memory."""

import ctypes
import json
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from bristle.model.compiler import find_compiler

HERE = Path(__file__).parent
H = 1e-3
DRIVE = {"plant": "u", "controller": "y_v", "observer": "y_v"}
CASES = [(what, fmi) for what in DRIVE for fmi in (2, 3)]


def force(what, k):
    """The varying input at step k."""
    return 6.0 * np.sin(0.021 * k) + (2.0 if k % 97 < 40 else -1.0)


def choices(fmu):
    """Return the values of the selector, or one None."""
    selector = [v for v in fmu.description.modelVariables if v.type == "Enumeration"]
    return (
        [(selector[0].name, k) for k in range(1, int(selector[0].max) + 1)] if selector else [None]
    )


def prepared(raw, choice, **start):
    handle = raw.instantiate()
    if choice:
        assert raw.set(handle, choice[0], choice[1], "Integer") == 0
    assert raw.start(handle, **start) == 0
    return handle


def run(raw, handle, what, outputs, first, last):
    """Step and return all outputs after each step, as bytes: NaN equals NaN, and -0 is not 0."""
    rows = []
    for k in range(first, last):
        assert raw.set(handle, DRIVE[what], float(force(what, k))) == 0
        assert raw.step(handle, H * k, H) == 0, raw.messages
        rows.append(raw.get(handle, *outputs))
    return np.array(rows).tobytes()


@pytest.mark.sampled(4)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_reset_gives_a_fresh_instance_from_every_state(built, Raw, case):
    """Ten lifecycles, each abandoned somewhere else; what comes after a reset is bitwise what a new
    instance gives.
    """
    what, fmi = case
    fmu = built(what, fmi=fmi)
    raw, outputs = Raw(fmu.info), fmu.names("output")
    expected = run(raw, prepared(raw, None), what, outputs, 0, 60)
    handle = raw.instantiate()
    for life in range(10):
        leave = life % 5
        if leave >= 1:
            assert raw.enter(handle, 3.0) == 0
        if leave >= 2:
            assert raw.set(handle, "sample_time", 0.002) == 0
            assert raw.call("ExitInitializationMode", handle) == 0
            assert raw.step(handle, 3.0, 0.01 * (life + 1)) == 0
        if leave == 3:
            assert raw.step(handle, raw_time(3.0, life), 1e9) == 3  # failed
        if leave == 4:
            assert raw.call("Terminate", handle) == 0
        assert raw.call("Reset", handle) == 0
        assert raw.start(handle) == 0
        assert run(raw, handle, what, outputs, 0, 60) == expected
        assert raw.call("Reset", handle) == 0


def raw_time(start, life):
    return start + 0.01 * (life + 1)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_interleaved_instances_do_not_interact(built, Raw, case):
    what, fmi = case
    fmu = built(what, fmi=fmi)
    raw, outputs = Raw(fmu.info), fmu.names("output")
    for choice in choices(fmu):
        alone = run(raw, prepared(raw, choice), what, outputs, 0, 40)
        other, handle, rows = prepared(raw, None), prepared(raw, choice), b""
        for k in range(40):
            rows += run(raw, handle, what, outputs, k, k + 1)
            assert raw.set(other, DRIVE[what], -3.0) == 0
            assert raw.step(other, 7e-4 * k, 7e-4) == 0
        assert rows == alone
        raw.free(other)
        raw.free(handle)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_states_continue_bitwise(built, Raw, case):
    """Get, continue elsewhere, set, go on; and the same through bytes, in another instance and in
    another process.
    """
    what, fmi = case
    fmu = built(what, fmi=fmi)
    raw, outputs, states, rows = Raw(fmu.info), fmu.names("output"), [], []
    for choice in choices(fmu):
        handle = prepared(raw, choice)
        run(raw, handle, what, outputs, 0, 150)
        status, state = raw.get_state(handle)
        assert status == 0
        data = raw.serialise(handle, state)
        expected = run(raw, handle, what, outputs, 150, 250)
        assert raw.set_state(handle, state) == 0
        assert run(raw, handle, what, outputs, 150, 250) == expected
        other = prepared(raw, None)
        status, copy = raw.deserialise(other, data)
        assert status == 0
        assert raw.set_state(other, copy) == 0
        assert run(raw, other, what, outputs, 150, 250) == expected
        states.append(data.hex())
        rows.append(expected)
        assert raw.free_state(handle, state) == raw.free_state(other, copy) == 0
    assert elsewhere(fmu, states, what, outputs) == b"".join(rows)


def elsewhere(fmu, states, what, outputs):
    """Continue from bytes in a new process, each state in a new instance."""
    code = f"""
import json, sys
sys.path[:0] = [{str(HERE)!r}]
from raw import Raw
import numpy as np
raw = Raw(json.loads({json.dumps(fmu.info)!r}))
rows = []
for data in json.load(sys.stdin):
    handle = raw.instantiate()
    status, state = raw.deserialise(handle, bytes.fromhex(data))
    assert status == 0 and raw.set_state(handle, state) == 0
    for k in range(150, 250):
        force = 6.0 * np.sin(0.021 * k) + (2.0 if k % 97 < 40 else -1.0)
        assert raw.set(handle, {DRIVE[what]!r}, float(force)) == 0
        assert raw.step(handle, {H} * k, {H}) == 0
        rows.append(raw.get(handle, *{outputs!r}))
sys.stdout.buffer.write(np.array(rows).tobytes())
"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        input=json.dumps(states).encode(),
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout


def test_a_state_keeps_mode_and_parameters(built, Raw):
    """A state taken in initialization leads back there, parameters included; an old handle is
    filled again.
    """
    raw = Raw(built("plant").info)
    handle = raw.instantiate()
    assert raw.enter(handle) == 0
    assert raw.set(handle, "J", 0.002) == 0
    state = raw.get_state(handle)[1]
    kept = state.value
    assert raw.set(handle, "J", 0.003) == 0
    assert raw.call("ExitInitializationMode", handle) == 0
    assert raw.set_state(handle, state) == 0
    assert raw.get(handle, "J") == [0.002]
    assert raw.set(handle, "J", 0.004) == 0
    assert raw.get_state(handle, state)[0] == 0
    assert state.value == kept
    assert raw.set_state(handle, state) == 0
    assert raw.get(handle, "J") == [0.004]


# -- steps -----------------------------------------------------------------------------------------


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    "law", ["lugre", "elastoplastic", "gms", "leuven", "modified", "viscous", "coulomb"]
)
def test_splitting_a_step_changes_little(built, Raw, law):
    """One step of 8 ms, two of 4 ms, eight of 1 ms: the same motion within the integrator's
    tolerance.
    """
    raw = Raw(built("plant", law=law).info)

    def final(parts):
        handle = raw.instantiate()
        assert raw.start(handle) == 0
        h, time = 8e-3 / parts, 0.0
        for k in range(200):
            assert raw.set(handle, "u", float(force("plant", 8 * k))) == 0
            for _ in range(parts):
                assert raw.step(handle, time, h) == 0
                time += h
        return np.array(raw.get(handle, "theta", "v"))

    once = final(1)
    assert np.abs(once).max() > 0.1
    for parts in (2, 8):
        np.testing.assert_allclose(
            final(parts), once, rtol=2e-4 if law == "coulomb" else 1e-6, atol=1e-7
        )


@pytest.mark.sampled(3)
@pytest.mark.parametrize("what", list(DRIVE))
def test_noise_in_the_last_bits_of_time_does_not_matter(built, Raw, what):
    """Host clocks add up to 2.950000000003: samples neither double nor drop out, and the values
    stay.
    """
    fmu = built(what)
    raw, outputs = Raw(fmu.info), fmu.names("output")
    rng = np.random.default_rng(2)

    def table(noise):
        handle, rows = prepared(raw, None), []
        for k in range(3000):
            assert raw.set(handle, DRIVE[what], float(force(what, k))) == 0
            assert raw.step(handle, H * k + noise * rng.uniform(-1, 1), H) == 0, raw.messages
            rows.append(raw.get(handle, *outputs))
        return np.array(rows)

    exact, noisy = table(0.0), table(3e-12)
    np.testing.assert_allclose(noisy, exact, rtol=1e-6, atol=1e-7)


def test_time_is_the_hosts(built, Raw):
    """After a step the FMU is where the host's point and step size say, not where it thought it
    was.
    """
    raw = Raw(built("plant", law="lugre", fmi=3).info)
    handle = raw.running()
    for k in range(100):
        point = H * k + (3e-12 if k % 2 else 0.0)
        assert raw.step(handle, point, H) == 0
        assert raw.get(handle, "time") == [point + H]


def test_an_odd_step_size_keeps_the_sampling(built, Raw):
    """The controller ticks every sample_time, however the host cuts its steps."""
    raw = Raw(built("controller").info)
    whole, cut = raw.running(), raw.running()
    for k in range(50):
        assert raw.step(whole, H * k, H) == 0
    h = 50 * H / 35
    for k in range(35):
        assert raw.step(cut, h * k, h) == 0
    assert raw.get(whole, "u", "reference") == raw.get(cut, "u", "reference")


# -- many instances --------------------------------------------------------------------------------


def resident():
    return int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1]) * 4096


@pytest.mark.sampled(4)
@pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="needs /proc to read the memory in use"
)
@pytest.mark.parametrize("fmi", [2, 3])
def test_memory_does_not_grow_with_lifecycles(built, Raw, fmi):
    raw = Raw(built("plant", fmi=fmi).info)

    def lives(n):
        for _ in range(n):
            handle = raw.running()
            assert raw.step(handle, 0.0, H) == 0
            state = raw.get_state(handle)[1]
            raw.free_state(handle, state)
            raw.free(handle)

    lives(200)
    before = resident()
    lives(20_000)
    assert resident() - before < 400_000  # 20 bytes a life; an instance alone has several hundred


def test_many_instances_at_once(built, Raw):
    raw = Raw(built("controller").info)
    handles = [raw.instantiate() for _ in range(5000)]
    assert len(set(handles)) == 5000
    assert all(handles)
    for k, handle in enumerate(handles):
        assert raw.start(handle, seed=float(k + 1)) == 0
    values = [raw.get(handle, "reference")[0] for handle in handles]
    assert len(set(values)) > 4000  # the clipped ones coincide
    for handle in handles:
        raw.free(handle)


@pytest.mark.skipif(sys.platform == "win32", reason="threads.c is written for POSIX")
def test_threads(built, tmp_path):
    """A host in C makes, steps and frees 80 000 instances in four threads; without the lock it
    fails or crashes.
    """
    info = built("controller").info
    program, headers = tmp_path / "threads", str(files("fmpy") / "c-code")
    flags = ["-std=gnu99", "-O2", "-pthread", f"-I{headers}"]
    subprocess.run(
        [*find_compiler(), *flags, str(HERE / "threads.c"), "-o", str(program), "-ldl"], check=True
    )
    for _ in range(3):
        done = subprocess.run(
            [program, info["library"], info["token"], str(info["vr"]["reference"])],
            check=False,
            timeout=60,
        )
        assert done.returncode == 0


def test_handles_are_not_addresses(built, Raw):
    """What the host holds leads nowhere: no mapped memory begins there."""
    raw = Raw(built("plant").info)
    handle = raw.running()
    spans = [
        line.split()[0].split("-")
        for line in Path("/proc/self/maps").read_text(encoding="utf-8").splitlines()
    ]
    assert not any(int(a, 16) <= handle < int(b, 16) for a, b in spans)
    assert ctypes.sizeof(ctypes.c_void_p) == 8
