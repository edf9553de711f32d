"""Terminals, icons and display units: valid by the standard's schema, and of variables that
exist.
"""

import math
import struct
from pathlib import Path
from zipfile import ZipFile

import fmpy
import pytest
from lxml import etree

SCHEMA = Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3TerminalsAndIcons.xsd"
WHOLE = ("plant", "observer", "controller")
SHOWN = {"deg": math.degrees(1.0), "rpm": 30.0 / math.pi, "ms": 1000.0}


def members(fmu):
    document = etree.parse(str(fmu.folder / "terminalsAndIcons" / "terminalsAndIcons.xml"))
    etree.XMLSchema(file=str(SCHEMA)).assertValid(document)
    return {
        e.get("memberName"): e.get("variableName") for e in document.iter("TerminalMemberVariable")
    }


@pytest.mark.sampled(3, "observer")
def test_the_bus_joins_plant_observer_and_controller_by_names(built):
    buses = {what: members(built(what, fmi=3)) for what in WHOLE}
    assert buses["plant"].keys() == buses["observer"].keys() == {"u", "y_theta", "y_v"}
    assert buses["controller"].keys() == {"u", "y_v"}
    for what, bus in buses.items():
        variables = {v.name: v for v in built(what, fmi=3).description.modelVariables}
        causality = {variables[name].causality for name in bus.values()}
        assert causality <= {"input", "output"}
        assert variables[bus["u"]].causality == ("output" if what == "controller" else "input")


@pytest.mark.sampled(3)
@pytest.mark.parametrize("what", WHOLE)
def test_icons_are_pictures(built, what):
    with ZipFile(built(what, fmi=3).path) as archive:
        png = archive.read("terminalsAndIcons/icon.png")
        assert etree.fromstring(archive.read("terminalsAndIcons/icon.svg")).tag.endswith("svg")
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", png[16:24]) == (128, 128)
    for kind in ("native", "python"):
        assert (built(what, kind=kind).folder / "model.png").read_bytes() == png


@pytest.mark.sampled(3)
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("what", WHOLE)
def test_display_units_are_defined_with_their_factors(built, what, fmi):
    document = etree.parse(str(built(what, fmi=fmi).folder / "modelDescription.xml"))
    defined = {
        (unit.get("name"), shown.get("name")): float(shown.get("factor"))
        for unit in document.iter("Unit")
        for shown in unit.iter("DisplayUnit")
    }
    for (_, shown), factor in defined.items():
        assert math.isclose(factor, SHOWN[shown], rel_tol=1e-15)
    used = {(e.get("unit"), e.get("displayUnit")) for e in document.iter() if e.get("displayUnit")}
    assert used
    assert used <= defined.keys()
    time = [
        e
        for e in document.iter()
        if e.get("name") == "time" and e.get("causality") == "independent"
    ]
    assert all(e.get("displayUnit") is None for e in time)
