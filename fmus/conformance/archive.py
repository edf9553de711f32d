"""Points of the archive: how it is packed and what belongs into it."""

from __future__ import annotations

import stat
from collections.abc import Iterator

from bristle.fmus.conformance.registry import Package, Severity, point

STORED_OR_DEFLATED = (0, 8)
HIGHEST_VERSION = 20  # ZIP 2.0
ENCRYPTED = 1  # bit of an entry's flags


@point("archive-description", "modelDescription.xml at the root, well-formed", description=False)
def _root(package: Package) -> Iterator[str]:
    if package.root is None:
        yield "modelDescription.xml is missing at the root or is not well-formed XML"


@point("archive-method", "entries stored or deflated, not encrypted, ZIP 2.0", description=False)
def _method(package: Package) -> Iterator[str]:
    for e in package.entries:
        if e.compress_type not in STORED_OR_DEFLATED or e.flag_bits & ENCRYPTED or e.extract_version > HIGHEST_VERSION:
            yield f"{e.filename}: method {e.compress_type}, version {e.extract_version}, flags {e.flag_bits}"


@point("archive-paths", "relative paths with / that stay inside", description=False)
def _paths(package: Package) -> Iterator[str]:
    for entry in package.entries:
        name = entry.orig_filename
        if "\\" in name or name.startswith("/") or ".." in name.split("/") or ":" in name.split("/")[0]:
            yield name


@point("archive-twice", "each entry once", description=False)
def _twice(package: Package) -> Iterator[str]:
    yield from sorted({name for name in package.names if package.names.count(name) > 1})


@point("archive-links", "no symbolic links", description=False)
def _links(package: Package) -> Iterator[str]:
    yield from (e.filename for e in package.entries if stat.S_ISLNK(e.external_attr >> 16))


@point("archive-documentation", "documentation/index.html (FMI 2 also main.html)", Severity.note, description=False)
def _documentation(package: Package) -> Iterator[str]:
    if not {"documentation/index.html", "documentation/_main.html", "documentation/main.html"} & set(package.names):
        yield "there is no start page"


@point("archive-binary", "each binary is named like a modelIdentifier")
def _binary(package: Package) -> Iterator[str]:
    parts = [name.split("/") for name in package.names if name.startswith("binaries/")]
    for platform in sorted({each[1] for each in parts if len(each) == 3 and each[2]}):
        files = {each[2].rpartition(".")[0] for each in parts if len(each) == 3 and each[1] == platform}
        yield from (f"binaries/{platform}: no {name}" for name in package.identifiers if name not in files)
