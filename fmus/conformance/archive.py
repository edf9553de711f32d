"""Points of the archive: how it is packed and what belongs into it."""

from __future__ import annotations

import posixpath
import stat
import zipfile
import zlib
from collections.abc import Iterator

from bristle.fmus.conformance.registry import Package, Severity, parsed, point

STORED_OR_DEFLATED = (0, 8)
HIGHEST_VERSION = 20  # ZIP 2.0
READ_SIZE = 1 << 20  # bytes
ENCRYPTED = 1  # bit of an entry's flags


@point("archive-description", "modelDescription.xml at the root, well-formed", description=False)
def _root(package: Package) -> Iterator[str]:
    if package.root is None:
        yield "modelDescription.xml is missing at the root or is not well-formed XML"


@point("archive-method", "entries stored or deflated, not encrypted, ZIP 2.0", description=False)
def _method(package: Package) -> Iterator[str]:
    for e in package.entries:
        if (
            e.compress_type not in STORED_OR_DEFLATED
            or e.flag_bits & ENCRYPTED
            or e.extract_version > HIGHEST_VERSION
        ):
            yield (
                f"{e.filename}: method {e.compress_type}, version {e.extract_version}, flags"
                f" {e.flag_bits}"
            )


@point("archive-paths", "relative paths with / that stay inside", description=False)
def _paths(package: Package) -> Iterator[str]:
    for entry in package.entries:
        name = entry.orig_filename
        if (
            "\\" in name
            or name.startswith("/")
            or ".." in name.split("/")
            or ":" in name.split("/")[0]
        ):
            yield name


@point("archive-twice", "each entry once", description=False)
def _twice(package: Package) -> Iterator[str]:
    yield from sorted({name for name in package.names if package.names.count(name) > 1})


@point(
    "archive-case", "no two names that differ in case alone", Severity.warning, description=False
)
def _case(package: Package) -> Iterator[str]:
    seen: dict[str, str] = {}
    for name in dict.fromkeys(package.names):
        if seen.setdefault(name.casefold(), name) != name:
            yield f"{seen[name.casefold()]} and {name}"


@point(
    "archive-whole",
    "each entry can be unpacked and has the checksum that is stored with it",
    description=False,
)
def _whole(package: Package) -> Iterator[str]:
    with zipfile.ZipFile(package.path) as archive:
        for entry in package.entries:
            try:
                with archive.open(entry) as file:
                    while file.read(READ_SIZE):
                        pass
            except (
                zipfile.BadZipFile,
                zlib.error,
                EOFError,
                NotImplementedError,
                RuntimeError,
            ) as error:
                yield f"{entry.filename}: {' '.join(str(error).split())}"


@point(
    "archive-times",
    "one time for all entries, so that a second build gives the same bytes",
    Severity.note,
    description=False,
)
def _times(package: Package) -> Iterator[str]:
    times = sorted({entry.date_time for entry in package.entries})
    if len(times) > 1:
        first, last = (
            "{}-{:02}-{:02} {:02}:{:02}:{:02}".format(*time) for time in (times[0], times[-1])
        )
        yield f"from {first} to {last}"


@point("archive-sources", "each source file that is listed is there")
def _sources(package: Package) -> Iterator[str]:
    text = (
        package.read("sources/buildDescription.xml")
        if "sources/buildDescription.xml" in package.names
        else b""
    )
    listed = [("sources", each) for each in package.root.iterfind(".//SourceFiles/File")]
    if text:
        try:
            listed += [("sources", each) for each in parsed(text).iterfind(".//SourceFile")]
        except ValueError:
            yield "sources/buildDescription.xml is not well-formed"
    for folder, each in listed:
        name = posixpath.normpath(f"{folder}/{each.get('name', '')}")
        if name not in package.names:
            yield name


@point(
    "archive-terminals", "each variable that terminalsAndIcons.xml names is one of the description"
)
def _terminals(package: Package) -> Iterator[str]:
    place = (
        "terminalsAndIcons/terminalsAndIcons.xml"
        if package.fmi == 3
        else "icons/terminalsAndIcons.xml"
    )
    if place not in package.names:
        return
    try:
        root = parsed(package.read(place))
    except ValueError:
        yield f"{place} is not well-formed"
        return
    known = {v.get("name") for v, _ in package.variables} | {
        a.get("name") for v, _ in package.variables for a in v.iterfind("Alias")
    }
    yield from (
        str(each.get("variableName"))
        for each in root.iter()
        if each.get("variableName", None) not in {None, *known}
    )


@point("archive-links", "no symbolic links", description=False)
def _links(package: Package) -> Iterator[str]:
    yield from (e.filename for e in package.entries if stat.S_ISLNK(e.external_attr >> 16))


@point(
    "archive-documentation",
    "documentation/index.html (FMI 2 also main.html)",
    Severity.note,
    description=False,
)
def _documentation(package: Package) -> Iterator[str]:
    if not {
        "documentation/index.html",
        "documentation/_main.html",
        "documentation/main.html",
    } & set(package.names):
        yield "there is no start page"


@point("archive-binary", "each binary is named like a modelIdentifier")
def _binary(package: Package) -> Iterator[str]:
    parts = [name.split("/") for name in package.names if name.startswith("binaries/")]
    for platform in sorted({each[1] for each in parts if len(each) == 3 and each[2]}):
        files = {
            each[2].rpartition(".")[0] for each in parts if len(each) == 3 and each[1] == platform
        }
        yield from (
            f"binaries/{platform}: no {name}" for name in package.identifiers if name not in files
        )
