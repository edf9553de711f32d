"""Terminals and icon of an FMU: variables that belong together, to be connected as one, and a
picture for diagrams.
"""

from __future__ import annotations

from importlib.resources import files
from xml.etree import ElementTree as ET

from bristle.common.xml import document
from bristle.fmus.interface import Interface

# what plant, observer and controller exchange, by the names on the observer
BUS = ("u", "y_theta", "y_v")
MEMBER = {"theta": "y_theta", "v": "y_v"}  # name on the bus of what a plant gives
SIDE = 100.0  # of the icon, in the coordinate system of diagrams
ICON = "icon"


def _members(interface: Interface) -> list[tuple[str, str]]:
    """Return (variable, name on the bus) of the inputs and outputs that are on the bus."""
    pairs = [(x.name, MEMBER.get(x.name, x.name)) for x in interface.of("input", "output")]
    return [(name, member) for name, member in pairs if member in BUS]


def icon_files(interface: Interface) -> dict[str, bytes]:
    """Return the icon by format, ``png`` and ``svg``; empty for a program without one."""
    folder = files("bristle.fmus") / "icons"
    found = {kind: folder / f"{interface.program.name}.{kind}" for kind in ("png", "svg")}
    return {kind: path.read_bytes() for kind, path in found.items() if path.is_file()}


def terminals(interface: Interface, icon: bool) -> bytes:
    """Return terminalsAndIcons.xml of FMI 3.0: a terminal `bus`, and the place of the icon."""
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    corners = {"x1": str(-SIDE), "y1": str(-SIDE), "x2": str(SIDE), "y2": str(SIDE)}
    if icon:
        graphical = ET.SubElement(root, "GraphicalRepresentation")
        ET.SubElement(
            graphical, "CoordinateSystem", {**corners, "suggestedScalingFactorTo_mm": "0.1"}
        )
        ET.SubElement(graphical, "Icon", corners)
    if members := _members(interface):
        group = ET.SubElement(root, "Terminals")
        text = "voltage to the drive and what its sensor shows"
        terminal = ET.SubElement(
            group, "Terminal", name="bus", matchingRule="bus", description=text
        )
        for name, member in members:
            ET.SubElement(
                terminal,
                "TerminalMemberVariable",
                variableName=name,
                memberName=member,
                variableKind="signal",
            )
    return document(root)


def terminal_files(interface: Interface, fmi: int) -> dict[str, bytes]:
    """Return the files of the archive: in FMI 2.0 the icon alone."""
    icon = icon_files(interface)
    if fmi == 2:
        return {"model.png": icon["png"]} if icon else {}
    shown = {f"terminalsAndIcons/{ICON}.{kind}": content for kind, content in icon.items()}
    return {"terminalsAndIcons/terminalsAndIcons.xml": terminals(interface, bool(icon)), **shown}
