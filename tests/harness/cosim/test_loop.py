"""The compiled loop, FMPy's calls, and what one sample of delay does."""

from __future__ import annotations

import ctypes
import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bristle.fmus.calls import CONTROL_SIZE
from bristle.fmus.host import Fmu
from bristle.harness.cosim import compiled as compiled_loop
from bristle.harness.cosim.bus import Bus, BusUnit
from bristle.harness.cosim.compiled import HUGE
from bristle.harness.cosim.drive import Drive
from bristle.harness.cosim.isolate import simulate_isolated
from bristle.harness.cosim.loop import simulate
from bristle.harness.scenario.parts import Kind, build_fmus
from bristle.harness.scenario.plan import identification, prepare
from bristle.harness.scenario.reading import load

Maker = Callable[..., Path]
Message = Callable[[Callable[[], object]], str]
pytestmark = pytest.mark.usefixtures("no_leftovers")

COMPENSATED = [
    "controller.compensation=valid",
    "controller.parameters.fade=1 ms",
    "controller.parameters.test_time=10 ms",
]
STIMULUS = (
    '[[stimuli]]\nvariable = "load_scale"\npoints = [["0 s", 1.0], ["0.3 s", 1.7]]\n[[checks]]'
)


NUMBERS = {
    "int": ctypes.c_int,
    "unsigned": ctypes.c_uint,
    "long long": ctypes.c_longlong,
    "double": ctypes.c_double,
}


def fields_in_c(structure: str) -> list[tuple[str, object]]:
    """Return the names and types, as of ctypes, of a structure of loop.c: what has a star, or is a
    function, is an address.
    """
    text = (Path(compiled_loop.__file__).parent / "loop.c").read_text(encoding="utf-8")
    found = re.search(
        r"typedef struct \{([^}]*)\} " + structure + ";",
        re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL),
    )
    assert found is not None
    fields = []
    for line in filter(None, map(str.strip, found[1].split(";"))):
        kind, first, others = re.fullmatch(
            r"(.*?)(\**\w+)((?:,\s*\*?\w+)*)", line, re.DOTALL
        ).groups()  # type: ignore[union-attr]
        for name in [first, *re.split(r",\s*", others)[1:]]:
            address = "*" in kind or "*" in name or kind.strip() == "Function"
            fields.append((name.strip("*"), ctypes.c_void_p if address else NUMBERS[kind.strip()]))
    return fields


@pytest.mark.parametrize(
    "twin",
    [
        getattr(compiled_loop, name)
        for name in ("LoopUnit", "_Link", "_Event", "_Flag", "_Master", "Lifecycle")
    ],
)
def test_the_structures_are_those_of_the_c_code(twin: type[ctypes.Structure]) -> None:
    fields = [(name.rstrip("_"), kind) for name, kind, *_ in twin._fields_]
    assert fields == fields_in_c(twin.__name__.lstrip("_"))


def bus_of(path: Path, fmi: int = 2, kind: Kind = "native", *overrides: str) -> Bus:
    loaded = load(path, overrides)
    return identification(prepare(loaded, build_fmus(loaded, fmi, kind)))


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("fmi", "kind"), [(2, "native"), (3, "native"), (2, "python")])
def test_the_compiled_loop_gives_the_digits_of_fmpys_calls(
    fmi: int, kind: Kind, base: str, scenario_file: Maker
) -> None:
    path = scenario_file(base.replace("[[checks]]", STIMULUS))
    bus = bus_of(
        path, fmi, kind, "duration=0.7 s", "sensor=encoder", "observer.method=rls", *COMPENSATED
    )
    assert (("observer", "b_valid"), ("controller", "b_valid")) in bus.links  # Booleans too
    compiled, called = simulate(bus, engine="native"), simulate(bus, engine="fmpy")
    assert compiled.steps == 700
    assert np.array_equal(compiled.values, called.values, equal_nan=True)
    assert compiled.flags.ports == called.flags.ports
    assert compiled.flags.rows[0] == called.flags.rows[0]
    assert np.array_equal(compiled.flags.values[0], called.flags.values[0], equal_nan=True)
    assert np.ptp(compiled["plant", "theta"]) > 0.01
    assert np.abs(compiled["controller", "u_compensation"]).max() > 0.1


def test_a_bus_is_jacobi(tiny_fmu: Maker) -> None:
    """Two integrators in a ring see each other's value at the start of the step, whatever their
    order.
    """
    fmu = Fmu(tiny_fmu(), foreign=True)
    units = (BusUnit("a", fmu, {"gain": 1.0}), BusUnit("b", fmu, {"gain": 3.0}))
    links = ((("a", "v"), ("b", "u")), (("b", "v"), ("a", "u")))
    bus = Bus(units, 200, 1e-3, links=links, events=(), record=(("a", "v"), ("b", "v")), series={})
    kicked = dataclasses.replace(
        bus, links=links[:1], events=((0, ("a", "u"), 1.0), (100, ("a", "u"), -1.0))
    )
    a = b = 0.0
    expected = [(a, b)]
    for k in range(200):
        u = 1.0 if k < 100 else -1.0
        a, b = a + 1e-3 * (1.0 * u - 2 * a), b + 1e-3 * (3.0 * a - 2 * b)
        expected.append((a, b))
    assert np.allclose(simulate(kicked).values, expected, rtol=0, atol=1e-15)
    swapped = dataclasses.replace(kicked, instances=units[::-1])
    assert np.array_equal(simulate(kicked).values, simulate(swapped).values)
    assert not simulate(bus).values.any()


def test_progress_and_stop(
    base: str, scenario_file: Maker, monkeypatch: pytest.MonkeyPatch
) -> None:
    # no call is so short that the next does more
    monkeypatch.setattr(compiled_loop, "SHORT_CALL", 0.0)
    bus = bus_of(scenario_file(base), 2, "native", "duration=12 s")
    seen: list[int] = []
    control = np.zeros(CONTROL_SIZE, dtype=np.int64)

    def progress(done: int) -> None:
        seen.append(done)
        control[1] = done >= 10_000

    trace = simulate(bus, progress, control=control)
    assert seen == [*range(60, 10_021, 60)]  # 200 looks
    assert trace.steps == control[0] == 10_020


def test_a_unit_that_fails_ends_the_run_with_its_name_and_time(tiny_fmu: Maker) -> None:
    bus = Bus(
        (BusUnit("plant", Fmu(tiny_fmu("error"), foreign=True)),),
        900,
        1e-3,
        record=(("plant", "v"),),
    )
    for engine in ("native", "fmpy"):
        trace = simulate(bus, engine=engine)
        assert trace.failure is not None
        assert (trace.failure.unit, trace.steps) == ("plant", 500)
        assert trace.failure.time == pytest.approx(0.5)


def test_a_huge_estimate_ends_the_run(tiny_fmu: Maker) -> None:
    unit = BusUnit("observer", Fmu(tiny_fmu(), foreign=True))
    events = ((0, ("observer", "u"), 0.0), (300, ("observer", "u"), 1e13))
    bus = Bus((unit,), 900, 1e-3, events=events, record=(("observer", "v"),), watch=("observer",))
    for engine in ("native", "fmpy"):
        trace = simulate(bus, engine=engine)
        assert trace.failure is not None
        assert trace.steps == 301
        assert abs(trace["observer", "v"][-1]) > HUGE
        assert (np.abs(trace["observer", "v"][:-1]) < HUGE).all()


def test_recorded_inputs_reach_the_unit_at_their_step(tiny_fmu: Maker) -> None:
    u = np.random.default_rng(1).normal(size=50)
    bus = Bus(
        (BusUnit("p", Fmu(tiny_fmu(), foreign=True)),),
        50,
        1e-3,
        series={("p", "u"): u},
        record=(("p", "v"),),
    )
    v = [0.0]
    for value in u:
        v.append(v[-1] + 1e-3 * (6.5 * value - 2 * v[-1]))
    assert np.allclose(simulate(bus)["p", "v"], v, rtol=0, atol=1e-15)


def test_drive_equals_a_run_and_starts_afresh_for_each_set() -> None:
    from bristle.fmus import obtain

    fmu = Fmu(obtain("plant", law="modified"))
    u = 3.0 * np.sin(np.arange(400) * 0.02)
    drive = Drive(fmu, ["u"], ["theta", "v"], ["b", "modified.c"])
    sets = np.array([[0.0065, 150.0], [0.004, 80.0], [0.0065, 150.0]])
    out = drive.run(u[:, None], sets, 1e-3)
    drive.close()
    assert np.array_equal(out[0], out[2])
    assert not np.array_equal(out[0], out[1])
    values = {"b": 0.004, "modified.c": 80.0}
    bus = Bus(
        (BusUnit("p", fmu, values),),
        400,
        1e-3,
        series={("p", "u"): u},
        record=(("p", "theta"), ("p", "v")),
    )
    assert np.array_equal(simulate(bus).values, out[1])


def test_drive_gives_nan_for_what_fails(tiny_fmu: Maker) -> None:
    drive = Drive(Fmu(tiny_fmu("error"), foreign=True), ["u"], ["v"], ["gain"])
    out = drive.run(np.ones((800, 1)), np.array([[1.0]]), 1e-3)
    drive.close()
    assert np.isfinite(out[0, :501]).all()
    assert np.isnan(out[0, 501:]).all()


# -- somebody else's FMUs --------------------------------------------------------------------------


def foreign_bus(path: Path) -> Bus:
    return Bus(
        (BusUnit("plant", Fmu(path, foreign=True)),),
        900,
        1e-3,
        events=((0, ("plant", "u"), 1.0),),
        record=(("plant", "v"),),
    )


def test_a_process_of_its_own_gives_the_same_digits(tiny_fmu: Maker) -> None:
    bus = foreign_bus(tiny_fmu())
    assert np.array_equal(simulate_isolated(bus).values, simulate(bus).values)


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("fault", "word"), [("abort", "SIGABRT"), ("segfault", "SIGSEGV"), ("exit", "exit code 7")]
)
def test_a_crash_is_one_line(fault: str, word: str, tiny_fmu: Maker, message: Message) -> None:
    line = message(lambda: simulate_isolated(foreign_bus(tiny_fmu(fault))))
    assert f"{fault}.fmu" in line
    assert word in line


def test_a_failure_inside_comes_back(tiny_fmu: Maker) -> None:
    trace = simulate_isolated(foreign_bus(tiny_fmu("error")))
    assert trace.failure is not None
    assert trace.failure.unit == "plant"


def test_no_binary_for_this_machine(tiny_fmu: Maker, message: Message) -> None:
    bus = foreign_bus(tiny_fmu(binary=False))
    assert "no binary for this machine" in message(lambda: simulate_isolated(bus))


def test_what_must_not_be_unpacked_is_refused(
    tiny_fmu: Maker, tmp_path: Path, message: Message
) -> None:
    import zipfile

    path = tiny_fmu(identifier="../../tiny")
    assert "not a plain name" in message(lambda: Fmu(path, foreign=True))
    bomb = tmp_path / "bomb.fmu"
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", " " * (80 << 20))
    assert "archive bomb" in message(lambda: Fmu(bomb, foreign=True))


def test_units_and_names_of_a_foreign_plant_are_checked(
    tiny_fmu: Maker, base: str, scenario_file: Maker, message: Message
) -> None:
    for path, words in (
        (tiny_fmu(unit='unit="deg"'), ["'theta' is in deg", "rad"]),
        (tiny_fmu(v="speed"), ["no Real output 'v'", "speed"]),
    ):
        text = base.replace(
            'law = "modified"\n\n[plant.parameters]\nJ = "0.001 kg.m2"', f'fmu = "{path}"'
        )
        case = scenario_file(text)
        line = message(lambda case=case: build_fmus(load(case)))
        for word in words:
            assert word in line


def test_a_foreign_plant_may_be_in_the_units_of_a_rig(
    tiny_fmu: Maker, base: str, scenario_file: Maker
) -> None:
    """A linear axis in m, as the augmented plant of a diagnosis is; the numbers are connected as
    they are.
    """
    path = tiny_fmu(unit='unit="m"')
    found = build_fmus(
        load(
            scenario_file(
                base.replace(
                    'law = "modified"\n\n[plant.parameters]\nJ = "0.001 kg.m2"', f'fmu = "{path}"'
                )
            )
        )
    )
    assert found["plant"].unit("theta") == "m"


# -- timing ----------------------------------------------------------------------------------------


@pytest.mark.sampled(4)
def test_one_sample_of_shift_spoils_the_estimates(base: str, scenario_file: Maker) -> None:
    """The observer pairs u_(k-1) with y_(k-1) and y_k; fed one sample late or early it must get
    worse.

    Step 2 of the paper sees it best: its regression uses presliding, where a shift of one sample
    matters.
    """
    known = (
        '[observer.parameters]\n"besancon.alpha2" = "2 1/s"\n"besancon.b" = "6.5'
        ' rad/(s2.V)"\n\n[[checks]]'
    )
    text = base.replace("bastin_gevers", "besancon").replace("[[checks]]", known)
    bus = bus_of(scenario_file(text), 2, "native", "duration=60 s")
    trace = simulate(bus)
    u, theta, v = trace["controller", "u"], trace["plant", "theta"], trace["plant", "v"]
    observer = next(i for i in bus.instances if i.name == "observer")
    final = {}
    for shift in (-1, 0, 1):
        series = {
            ("observer", "u"): np.roll(u, shift)[1:-2],
            ("observer", "y_theta"): theta[1:-2],
            ("observer", "y_v"): v[1:-2],
        }
        record = (("observer", "sigma0_hat"), ("observer", "c_hat"))
        alone = simulate(Bus((observer,), len(u) - 3, bus.h, series=series, record=record))
        final[shift] = 100 * np.abs(alone.values[-1] / [600.0, 150.0] - 1).max()
    assert final[0] < 5.0
    assert final[-1] > 3 * final[0]
    assert final[1] > 3 * final[0]
