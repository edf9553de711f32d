"""System structure packages (SSP 1.0): writing the description of a co-simulation, and reading
those of any maker.

Read are packages of one level: FMUs and columns of CSV files, plain connections, parameter values.
What is beyond that is refused.

Source: ssp2019 (System Structure and Parameterization 1.0).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

from bristle.common.parameter_set import SSV, Value, finite_number, parameter_set, parameter_values
from bristle.common.xml import document
from bristle.harness.exchange.archive import Archive

Port = tuple[str, str]  # (component, connector)

SPACE = "http://ssp-standard.org/SSP1/"
SSD, SSC = (f"{SPACE}SystemStructure{part}" for part in ("Description", "Common"))
# of the annotation of OMSimulator
OMS = "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd"
FMU_TYPE, CSV_TYPE = "application/x-fmu-sharedlibrary", "text/csv"
DESCRIPTION = "SystemStructure.ssd"


@dataclass(frozen=True)
class Component:
    """An FMU of the system, its connectors by name with their kind (input, output, parameter), and
    its parameter values.
    """

    name: str
    source: str  # inside the package
    connectors: Mapping[str, str]
    values: Mapping[str, Value] = field(default_factory=dict)
    type: str = FMU_TYPE


@dataclass(frozen=True)
class SystemStructure:
    """What is co-simulated: components, connections of outputs to inputs, times in s or None."""

    name: str
    components: tuple[Component, ...]
    connections: tuple[tuple[Port, Port], ...]
    stop: float | None = None
    step: float | None = None
    start: float = 0.0


# -- writing ---------------------------------------------------------------------------------------
def package_files(system: SystemStructure) -> dict[str, bytes]:
    """Return SystemStructure.ssd and the components' parameter sets, by names in the package."""
    for prefix, space in (("ssd", SSD), ("ssc", SSC), ("oms", OMS)):
        ET.register_namespace(prefix, space)
    sets = {
        f"resources/{each.name}.ssv": parameter_set(each.name, each.values)
        for each in system.components
        if each.values
    }
    return {DESCRIPTION: _description(system), **sets}


def _description(system: SystemStructure) -> bytes:
    root = ET.Element(
        f"{{{SSD}}}SystemStructureDescription",
        version="1.0",
        name=system.name,
        generationTool="Bristle",
    )
    whole = ET.SubElement(root, f"{{{SSD}}}System", name=system.name)
    elements = ET.SubElement(whole, f"{{{SSD}}}Elements")
    # components with their connectors and parameter values
    for each in system.components:
        component = ET.SubElement(
            elements, f"{{{SSD}}}Component", name=each.name, type=each.type, source=each.source
        )
        connectors = ET.SubElement(component, f"{{{SSD}}}Connectors")
        for name, kind in each.connectors.items():
            ET.SubElement(
                ET.SubElement(connectors, f"{{{SSD}}}Connector", name=name, kind=kind),
                f"{{{SSC}}}Real",
            )
        if each.values:
            bindings = ET.SubElement(component, f"{{{SSD}}}ParameterBindings")
            ET.SubElement(
                bindings, f"{{{SSD}}}ParameterBinding", source=f"resources/{each.name}.ssv"
            )
    # connections between them
    connections = ET.SubElement(whole, f"{{{SSD}}}Connections")
    for (source, output), (target, given) in system.connections:
        ends = {
            "startElement": source,
            "startConnector": output,
            "endElement": target,
            "endConnector": given,
        }
        ET.SubElement(connections, f"{{{SSD}}}Connection", ends)
    # the step and the times of a run
    if system.step is not None:
        _annotate(whole, system.step)
    times = {
        "startTime": repr(system.start),
        **({} if system.stop is None else {"stopTime": repr(system.stop)}),
    }
    ET.SubElement(root, f"{{{SSD}}}DefaultExperiment", times)
    return document(root)


def _annotate(whole: ET.Element, step: float) -> None:
    """Add the step in the way that OMSimulator reads it."""
    annotations = ET.SubElement(whole, f"{{{SSD}}}Annotations")
    annotation = ET.SubElement(annotations, f"{{{SSC}}}Annotation", type="org.openmodelica")
    about = ET.SubElement(
        ET.SubElement(annotation, f"{{{OMS}}}Annotations"), f"{{{OMS}}}SimulationInformation"
    )
    master = {
        "description": "oms-ma",
        "stepSize": repr(step),
        "absoluteTolerance": "1e-4",
        "relativeTolerance": "1e-4",
    }
    ET.SubElement(about, f"{{{OMS}}}FixedStepMaster", master)


# -- reading ---------------------------------------------------------------------------------------
class SystemPackage(Archive):
    """A package as a file of any maker; nothing is unpacked before it is asked for.

    Raises
    ------
    BristleError
        One line, if it is no package, or holds what is not supported.
    """

    suffix = ".ssp"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.system = self._system()

    def _system(self) -> SystemStructure:
        root = self.tree(DESCRIPTION)
        whole = root.find(f"{{{SSD}}}System")
        if root.tag != f"{{{SSD}}}SystemStructureDescription" or whole is None:
            raise self.mistake(f"{DESCRIPTION} is no description of a system by SSP 1.0")
        # components with values of their own or the whole system's, and connections
        shared = dict(self._values(whole))
        components = tuple(
            self._component(each, shared) for each in whole.findall(f"{{{SSD}}}Elements/*")
        )
        if not components:
            raise self.mistake("has no components")
        connections = tuple(
            self._connection(each)
            for each in whole.findall(f"{{{SSD}}}Connections/{{{SSD}}}Connection")
        )
        self._check_ends(components, connections)
        # times of a run, and the step that OMSimulator keeps in an annotation
        about = root.find(f"{{{SSD}}}DefaultExperiment")
        times = (
            {}
            if about is None
            else {
                key: self._number(about.get(key))
                for key in ("startTime", "stopTime")
                if about.get(key)
            }
        )
        master = next(iter(root.iter(f"{{{OMS}}}FixedStepMaster")), None)
        step = None if master is None else self._number(master.get("stepSize"))
        name = root.get("name") or self.path.stem
        return SystemStructure(
            name, components, connections, times.get("stopTime"), step, times.get("startTime", 0.0)
        )

    def _component(self, element: ET.Element, shared: Mapping[str, Value]) -> Component:
        name, kind = element.get("name", ""), element.get("type", FMU_TYPE)
        if element.tag != f"{{{SSD}}}Component":
            raise self.mistake(
                f"'{name}' is a system within the system; only one level is supported"
            )
        source = element.get("source", "")
        if kind not in (FMU_TYPE, CSV_TYPE) or not source:
            raise self.mistake(
                f"component '{name}' is of type {kind}; supported are FMUs ({FMU_TYPE}) and"
                f" {CSV_TYPE}"
            )
        connectors = {
            each.get("name", ""): each.get("kind", "")
            for each in element.findall(f"{{{SSD}}}Connectors/{{{SSD}}}Connector")
        }
        values = {
            key.removeprefix(f"{name}."): value
            for key, value in shared.items()
            if key.startswith(f"{name}.")
        }
        return Component(name, source, connectors, values | dict(self._values(element)), kind)

    def _values(self, element: ET.Element) -> Iterator[tuple[str, Value]]:
        """Give the parameter values that are bound to an element, as (name, value)."""
        for binding in element.findall(f"{{{SSD}}}ParameterBindings/{{{SSD}}}ParameterBinding"):
            if binding.find(f"{{{SSD}}}ParameterMapping") is not None:
                raise self.mistake("maps names of parameters, which is not supported")
            source = binding.get("source")
            sets = [self.tree(source)] if source else list(binding.iter(f"{{{SSV}}}ParameterSet"))
            prefix = binding.get("prefix", "")
            with self.named():
                yield from (
                    (f"{prefix}{name}", value)
                    for each in sets
                    for name, value in parameter_values(each)
                )

    def _number(self, text: str | None) -> float:
        with self.named():
            return finite_number(text)

    def _connection(self, element: ET.Element) -> tuple[Port, Port]:
        if list(element):
            extras = [
                each.tag.rpartition("}")[2]
                for each in element
                if not each.tag.endswith("ConnectionGeometry")
            ]
            if extras:
                raise self.mistake(f"a connection has a {extras[0]}, which is not supported")
        given = {
            key: element.get(key)
            for key in ("startElement", "startConnector", "endElement", "endConnector")
        }
        missing = [key for key, value in given.items() if not value]
        if missing:
            raise self.mistake(
                f"a connection has no {missing[0]}: connectors of the system itself are not"
                " supported"
            )
        return (
            (str(given["startElement"]), str(given["startConnector"])),
            (str(given["endElement"]), str(given["endConnector"])),
        )

    def _check_ends(
        self, components: Sequence[Component], connections: Sequence[tuple[Port, Port]]
    ) -> None:
        known = {each.name for each in components}
        targets = [target for _, target in connections]
        for unit, name in targets:
            if targets.count((unit, name)) > 1:
                raise self.mistake(f"{unit}.{name} has two connections; an input takes one")
        if len(known) < len(components):
            raise self.mistake("two components have one name")
        for name, connector in (end for pair in connections for end in pair):
            if name not in known:
                raise self.mistake(
                    f"a connection ends at {name}.{connector}, and there is no component '{name}'"
                )
