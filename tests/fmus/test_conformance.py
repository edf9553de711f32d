"""Points of archive, libraries and description: a good FMU has no finding, and each point finds the
defects made for it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from bristle.common.errors import BristleError
from bristle.fmus.conformance import POINTS, Verdict, static_conformance

sys.path.insert(0, str(Path(__file__).parent))
from mutants import PACKING_MUTANTS, STATIC_MUTANTS, good_entries, of_fmpy, pack, pack_badly, swap

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the mutants are those of Linux")


@pytest.fixture(scope="module")
def entries(tmp_path_factory: pytest.TempPathFactory) -> dict[int, dict[str, bytes]]:
    return {fmi: good_entries(fmi, tmp_path_factory.mktemp("good")) for fmi in (2, 3)}


def failed(path: Path) -> set[str]:
    return {r.point.id for r in static_conformance(path) if r.verdict is Verdict.failed}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("fmi", [2, 3])
def test_good(fmi, entries, tmp_path):
    assert failed(pack(tmp_path / "good.fmu", entries[fmi])) == set()


@pytest.mark.parametrize(("point", "fmi", "change"), STATIC_MUTANTS)
def test_mutant(point, fmi, change, entries, tmp_path):
    changed = dict(entries[fmi])
    change(changed)
    assert point in failed(pack(tmp_path / "mutant.fmu", changed))


def test_limits_may_be_equal(entries, tmp_path):
    """One value is a range, too."""
    changed = dict(entries[2])
    swap('min="-10" max="10"', 'min="0" max="0"')(changed)
    assert "description-limits" not in failed(pack(tmp_path / "one.fmu", changed))


@pytest.mark.parametrize("point", PACKING_MUTANTS)
def test_packing(point, entries, tmp_path):
    assert point in failed(pack_badly(point, tmp_path / "mutant.fmu", entries[2]))


def test_libraries_of_other_platforms(entries, tmp_path):
    """Of Windows, and of macOS for two machines."""
    changed = dict(entries[2])
    for folder, suffix in (("win32", "dll"), ("win64", "dll"), ("darwin64", "dylib")):
        changed[f"binaries/{folder}/good.{suffix}"] = of_fmpy(f"logging/{folder}/logging.{suffix}")
    path = pack(tmp_path / "good.fmu", changed)
    results = {r.point.id: r for r in static_conformance(path) if r.verdict is Verdict.failed}
    assert set(results) == {"binary-functions"}
    assert len(results["binary-functions"].findings) == 4


def test_every_point_has_a_mutant():
    assert {*PACKING_MUTANTS, *(point for point, _, _ in STATIC_MUTANTS)} == set(POINTS)


def test_not_tested(tmp_path):
    results = static_conformance(pack(tmp_path / "none.fmu", {"a": b""}))
    assert {r.point.id for r in results if r.verdict is Verdict.not_tested} == {
        p.id for p in POINTS.values() if p.needs_description
    }
    (tmp_path / "text.fmu").write_text("no")
    with pytest.raises(BristleError, match="not a zip archive"):
        static_conformance(tmp_path / "text.fmu")
