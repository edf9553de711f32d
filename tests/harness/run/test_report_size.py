"""Every shipped scenario passes, and its report fits into a mail: no more than a megabyte."""

from pathlib import Path

import pytest

from bristle.harness.run.run import run
from bristle.harness.scenario.catalogue import scenario_files

MOST_BYTES = 1_000_000


@pytest.mark.slow
@pytest.mark.parametrize("name", scenario_files())
def test_a_shipped_scenario_passes_and_its_report_is_no_larger_than_a_megabyte(
    name: str, tmp_path: Path
) -> None:
    done = run(scenario_files()[name], tmp_path)
    assert done.passed, done.findings
    assert (done.folder / "report.html").stat().st_size <= MOST_BYTES
