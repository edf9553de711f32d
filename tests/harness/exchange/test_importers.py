"""The closed loop in other importers, FMU by FMU: unified and lean, FMI 2 and 3, with the digits of
our loop.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bristle.fmus import obtain
from bristle.fmus.host import Fmu
from bristle.harness.cosim.loop import simulate
from bristle.harness.scenario.parts import build_fmus
from bristle.harness.scenario.plan import identification, prepare
from bristle.harness.scenario.reading import load

SCENARIO = """
duration = "1 s"
sensor = "encoder"
[plant]
law = "lugre"
[observer]
method = "rls"
[[checks]]
quantity = "estimates.b.error_percent"
max_abs = 50.0
"""
STEPS, STRIDE = 1000, 50
SEEN = ["plant.theta", "plant.v", "plant.theta_enc", "controller.u", "observer.b_hat"]
ECOS = """
from ecospy import EcosSimulation, EcosSimulationStructure
structure = EcosSimulationStructure()
for name, file in FILES.items():
    structure.add_model(name, file)
for a, b in LINKS:
    structure.make_real_connection(a.replace(".", "::", 1), b.replace(".", "::", 1))
values = {name.replace(".", "::", 1): value for name, value in VALUES.items()}
structure.add_parameter_set("start", values)
sim = EcosSimulation(structure=structure, step_size=1e-3)
sim.init(parameter_set="start")
for _ in range(STEPS // STRIDE):
    sim.step(STRIDE)
    rows.append([sim.get_real(name.replace(".", "::", 1)) for name in SEEN])
"""
COSIM = """
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave
run = CosimExecution.from_step_size(1_000_000)
text = lambda each: each.decode() if isinstance(each, bytes) else each
slaves = {name: CosimLocalSlave(file, name) for name, file in FILES.items()}
unit = {name: run.add_local_slave(slave) for name, slave in slaves.items()}
place = {}
for name, i in unit.items():
    for v in run.slave_variables(i):
        place[f"{name}.{text(v.name)}"] = (i, v.reference)
for name, value in VALUES.items():
    give = run.integer_initial_value if isinstance(value, int) else run.real_initial_value
    give(*place[name], value)
for a, b in LINKS:
    run.connect_real_variables(*place[a], *place[b])
seen = CosimObserver.create_last_value()
run.add_observer(seen)
for _ in range(STEPS // STRIDE):
    run.step(STRIDE)
    rows.append([seen.last_real_values(i, [vr])[0] for i, vr in map(place.__getitem__, SEEN)])
"""
# libcosim has no FMI 3
CASES = [("ecospy", ECOS, 2), ("ecospy", ECOS, 3), ("libcosimpy", COSIM, 2)]


def closed_loop(path, fmi, lean):
    """Return bus and files: FMUs of all laws and methods, or of the one that the scenario has."""
    path.write_text(SCENARIO, encoding="utf-8")
    loaded = load(path)
    setup = prepare(loaded, build_fmus(loaded, fmi))
    files = {name: fmu.path for name, fmu in setup.fmus.items()}
    if lean:
        files |= {
            "plant": obtain("plant", fmi=fmi, law="lugre"),
            "observer": obtain("observer", fmi=fmi, method="rls"),
        }
    return identification(setup), {name: str(file) for name, file in files.items()}


@pytest.mark.parametrize("lean", [False, True], ids=["unified", "lean"])
@pytest.mark.parametrize(
    ("importer", "code", "fmi"), CASES, ids=[f"{name}-fmi{fmi}" for name, _, fmi in CASES]
)
def test_another_importer_gives_our_digits(tmp_path, importer, code, fmi, lean, rows_of):
    bus, files = closed_loop(tmp_path / "loop.toml", fmi, lean)
    values = {}
    for each in bus.instances:
        for name, value in each.values.items():
            if name not in ("law", "method"):
                values[f"{each.name}.{name}"] = value
            elif not lean:  # the enumeration by its place, which every importer can set
                values[f"{each.name}.{name}_index"] = int(value)
    links = [(".".join(a), ".".join(b)) for a, b in bus.links]
    theirs = rows_of(
        importer,
        code,
        FILES=files,
        LINKS=links,
        VALUES=values,
        STEPS=STEPS,
        STRIDE=STRIDE,
        SEEN=SEEN,
    )
    ours = simulate(bus)
    for name, got in zip(SEEN, theirs.T, strict=True):
        expected = ours[tuple(name.split("."))]
        assert np.ptp(expected) > 0
        assert np.abs(got - expected[STRIDE::STRIDE]).max() <= 1e-12 * np.ptp(expected), name


@pytest.mark.parametrize("lean", [False, True], ids=["unified", "lean"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_fmpy_gives_our_digits(tmp_path, fmi, lean):
    """FMPy's calls step by step; lean FMUs have neither the selectors nor other laws."""
    bus, files = closed_loop(tmp_path / "loop.toml", fmi, lean)
    instances = tuple(
        (
            replace(
                each,
                fmu=Fmu(Path(files[each.name])),
                values={k: v for k, v in each.values.items() if k not in ("law", "method")},
            )
            if lean
            else each
        )
        for each in bus.instances
    )
    theirs = simulate(replace(bus, instances=instances, steps=200), engine="fmpy")
    assert np.array_equal(
        theirs.values[:, : len(bus.record)], simulate(replace(bus, steps=200)).values
    )
