"""The registry of points, and the function that judges an FMU by all of them."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bristle.common.errors import BristleError
from bristle.fmus.conformance.library import SUFFIXES, Library, libraries

if TYPE_CHECKING:
    from bristle.fmus.conformance.running import BehaviourPoint


LARGEST_READ = 1 << 28  # bytes of an entry that are looked at


class Severity(StrEnum):
    """How much a finding matters."""

    error = "error"
    warning = "warning"
    note = "note"


class Verdict(StrEnum):
    """What came out of a point."""

    passed = "pass"
    failed = "fail"
    not_tested = "not tested"
    not_applicable = "not applicable"


@dataclass(frozen=True)
class Package:
    """An FMU as an archive: its path, its entries, and the root element of modelDescription.xml
    (None if it has none).
    """

    path: Path
    entries: tuple[zipfile.ZipInfo, ...]
    root: Any

    @property
    def names(self) -> list[str]:
        """Names of the entries."""
        return [entry.filename for entry in self.entries]

    def read(self, name: str) -> bytes:
        """Return the bytes of an entry; none if it is damaged or larger than LARGEST_READ."""
        try:
            with zipfile.ZipFile(self.path) as archive, archive.open(name) as file:
                data = file.read(LARGEST_READ + 1)
        except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError):
            return b""
        return data if len(data) <= LARGEST_READ else b""

    @property
    def fmi(self) -> int:
        """Major version of FMI."""
        return 3 if str(self.root.get("fmiVersion", "")).startswith("3") else 2

    @cached_property
    def binary_folders(self) -> dict[str, list[str]]:
        """Entries of each folder of binaries/, by its name."""
        found: dict[str, list[str]] = {}
        for name in self.names:
            parts = name.split("/")
            if parts[0] == "binaries" and len(parts) > 2 and parts[-1]:
                found.setdefault(parts[1], []).append(name)
        return found

    @cached_property
    def libraries(self) -> tuple[Library, ...]:
        """The libraries of all platforms."""
        names = [
            n
            for entries in self.binary_folders.values()
            for n in entries
            if n.count("/") == 2 and n.endswith(SUFFIXES)
        ]
        return tuple(
            each for name in dict.fromkeys(names) for each in libraries(name, self.read(name))
        )

    @property
    def identifiers(self) -> list[str]:
        """The modelIdentifier of each interface type, empty where there is none."""
        kinds = ("CoSimulation", "ModelExchange", "ScheduledExecution")
        return [
            str(each.get("modelIdentifier", ""))
            for kind in kinds
            for each in self.root.findall(kind)
        ]

    @property
    def variables(self) -> list[tuple[Any, Any]]:
        """For each variable the element with its name, and the one with its type and start (in FMI
        3 the same).
        """
        three = self.fmi == 3
        found = [v for v in self.root.iterfind("ModelVariables/*") if isinstance(v.tag, str)]
        return [(v, v if three else v[0]) for v in found if three or len(v)]


Judge = Callable[[Package], Iterator[str]]


@dataclass(frozen=True)
class Point:
    """One point: id, title, severity, and the function that gives what it finds in an archive."""

    id: str
    title: str
    severity: Severity
    judge: Judge
    needs_description: bool


@dataclass(frozen=True)
class PointResult:
    """The verdict of a point, with what it found or why it was not tested."""

    point: Point | BehaviourPoint
    verdict: Verdict
    findings: tuple[str, ...] = ()


POINTS: dict[str, Point] = {}


def point(
    name: str, title: str, severity: Severity = Severity.error, *, description: bool = True
) -> Callable[[Judge], Judge]:
    """Enter a function into the registry; `description`: it reads modelDescription.xml."""

    def enter(judge: Judge) -> Judge:
        POINTS[name] = Point(name, title, severity, judge, description)
        return judge

    return enter


def parsed(text: bytes) -> Any:
    """Return the root element of an XML text, whose entities are left alone.

    Raises
    ------
    ValueError
        If it is not well-formed.
    """
    from lxml import etree

    try:
        return etree.fromstring(text, etree.XMLParser(resolve_entities=False, no_network=True))
    except etree.XMLSyntaxError as error:
        raise ValueError(str(error)) from None


def static_conformance(path: Path) -> list[PointResult]:
    """Return the result of each point for an FMU; it is read, not run.

    Raises
    ------
    BristleError
        If the file cannot be read or is no zip archive.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = tuple(archive.infolist())
            known = {entry.filename for entry in entries}
            text = archive.read("modelDescription.xml") if "modelDescription.xml" in known else None
        root = None if text is None else parsed(text)
    except OSError as error:
        raise BristleError(f"FMU {path}: {error.strerror}; check the path") from None
    except zipfile.BadZipFile:
        raise BristleError(
            f"FMU {path}: not a zip archive, or a damaged one; give an .fmu file"
        ) from None
    except (ValueError, NotImplementedError, RuntimeError):
        root = None
    package = Package(path, entries, root)
    return [_result(each, package) for each in POINTS.values()]


def _result(each: Point, package: Package) -> PointResult:
    if each.needs_description and package.root is None:
        return PointResult(each, Verdict.not_tested, ("modelDescription.xml cannot be read",))
    findings = tuple(each.judge(package))
    return PointResult(each, Verdict.failed if findings else Verdict.passed, findings)
