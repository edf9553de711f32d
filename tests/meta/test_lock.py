"""requirements-dev.lock pins, with hashes, all that pyproject.toml names for development."""

import re
import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[2]
PIN = re.compile(
    r"^([A-Za-z0-9._-]+)==([^ ;\\]+)(?: ; [^\\]+)? \\\n((?:    --hash=sha256:[0-9a-f]{64}(?:"
    r" \\)?\n)+)",
    re.MULTILINE,
)
EXTRAS = ("docs", "dev")  # what is installed for development, besides the dependencies


def test_the_lock_file_pins_every_dependency_with_hashes():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    text = (ROOT / "requirements-dev.lock").read_text(encoding="utf-8")
    pinned = {}
    for name, version, _hashes in PIN.findall(text):
        pinned.setdefault(canonicalize_name(name), []).append(Version(version))
    # nothing is without hashes
    assert sum(map(len, pinned.values())) == len(re.findall(r"^[A-Za-z0-9]", text, re.MULTILINE))
    named = [
        *project["dependencies"],
        *(each for extra in EXTRAS for each in project["optional-dependencies"][extra]),
    ]
    needed = [each for each in map(Requirement, named) if each.name != project["name"]]
    assert len(needed) > 20
    for each in needed:
        versions = pinned.get(canonicalize_name(each.name), [])
        assert versions, f"{each.name}: make requirements-dev.lock again, as CONTRIBUTING.md says"
        assert all(version in each.specifier for version in versions), each
