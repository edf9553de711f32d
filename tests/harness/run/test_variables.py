"""An FMU with names and units of its own takes part as it is: [plant.variables]."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bristle.harness.cosim.isolate import simulate_isolated
from bristle.harness.cosim.loop import simulate
from bristle.harness.scenario.parts import build_fmus
from bristle.harness.scenario.plan import identification, prepare
from bristle.harness.scenario.reading import load

Maker = Callable[..., Path]
Message = Callable[[Callable[[], Any]], str]
BUILT = 'law = "modified"\n\n[plant.parameters]\nJ = "0.001 kg.m2"'
NAMES = {b'"u"': b'"voltage"', b'"theta"': b'"pos"', b'"v"': b'"speed"'}
MAP = """
[plant.variables]
u = { name = "voltage", unit = "mV" }
theta = { name = "pos", unit = "deg" }
v = { name = "speed", unit = "deg/s" }
"""


@pytest.fixture
def own_names(tiny_fmu: Maker, tmp_path: Path) -> Path:
    path = tmp_path / "mine.fmu"
    with zipfile.ZipFile(tiny_fmu()) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            for word, other in NAMES.items() if name == "modelDescription.xml" else ():
                content = content.replace(b"name=" + word, b"name=" + other)
            new.writestr(name, content)
    return path


def scenario(base: str, fmu: Path, gain: float, variables: str = "") -> str:
    return base.replace(BUILT, f'fmu = "{fmu}"\n{variables}\n[plant.parameters]\ngain = {gain!r}')


@pytest.mark.sampled(4)
def test_names_and_units_of_its_own_give_the_same_run(
    own_names: Path, tiny_fmu: Maker, base: str, scenario_file: Maker
) -> None:
    """In mV and degrees with a gain to match, it is the same plant: exactly so but for the rounding
    of the factors.
    """
    traces = []
    gain = 6.0 * math.degrees(1.0) / 1000
    for k, text in enumerate(
        (scenario(base, tiny_fmu(), 6.0), scenario(base, own_names, gain, MAP))
    ):
        loaded = load(scenario_file(text, f"case{k}"))
        bus = identification(prepare(loaded, build_fmus(loaded)))
        native = simulate(bus)
        assert native.failure is None
        np.testing.assert_allclose(
            simulate(bus, engine="fmpy").values, native.values, rtol=0, atol=0
        )
        np.testing.assert_array_equal(simulate_isolated(bus).values, native.values)
        traces.append(native)
    assert np.ptp(traces[0]["plant", "v"]) > 0.1
    for port in (("plant", "theta"), ("plant", "v"), ("controller", "u")):
        np.testing.assert_allclose(traces[1][port], traces[0][port], rtol=1e-9, atol=1e-12)
    assert set(traces[0].record) == set(traces[1].record)


def test_a_name_alone_is_enough(
    own_names: Path, tiny_fmu: Maker, base: str, scenario_file: Maker
) -> None:
    names = '[plant.variables]\nu = "voltage"\ntheta = "pos"\nv = "speed"\n'
    values = []
    for k, text in enumerate(
        (scenario(base, tiny_fmu(), 6.0), scenario(base, own_names, 6.0, names))
    ):
        loaded = load(scenario_file(text, f"case{k}"))
        values.append(simulate(identification(prepare(loaded, build_fmus(loaded)))).values)
    np.testing.assert_array_equal(*values)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("u = {", "uu = {"), ["plant.variables.uu", "did you mean 'u'", "tau_load"]),
        (
            ('"voltage"', '"volt"'),
            ["plant.fmu", "no variable 'volt' for u", "did you mean 'voltage'"],
        ),
        (('"mV"', '"rad"'), ["plant.variables.u"]),
        (('unit = "mV"', 'unti = "mV"'), ["plant.variables.u", "write { name"]),
        (('unit = "mV"', "scale = 0"), ["plant.variables.u", "other than 0"]),
        (
            ('u = { name = "voltage", unit = "mV" }\n', ""),
            ["no Real input 'u'", "voltage", "[plant.variables] u ="],
        ),
    ],
)
def test_a_wrong_map_is_one_line(
    change: tuple[str, str],
    words: list[str],
    own_names: Path,
    base: str,
    scenario_file: Maker,
    message: Message,
) -> None:
    assert change[0] in MAP
    path = scenario_file(scenario(base, own_names, 6.0, MAP.replace(*change)))
    line = message(lambda: build_fmus(load(path)))
    for word in words:
        assert word in line


def test_a_built_plant_has_no_names_of_its_own(
    base: str, scenario_file: Maker, message: Message
) -> None:
    path = scenario_file(
        base.replace('law = "modified"\n', 'law = "modified"\nvariables = { u = "voltage" }\n')
    )
    assert "give plant.fmu" in message(lambda: build_fmus(load(path)))
