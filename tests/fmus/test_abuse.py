"""Misuse ends in an FMI error: never a crash, never silence. Each case runs in a process of its
own.
"""

import json
import re
import shutil
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent / "abuse.py"
CASES = re.findall(r"^@case\ndef (\w+)", SCRIPT.read_text(encoding="utf-8"), re.MULTILINE)
HEADER = {2: "fmi2FunctionTypes.h", 3: "fmi3FunctionTypes.h"}


def test_all_cases_are_found(abuse):
    assert sorted(CASES) == sorted(abuse)
    assert len(CASES) > 25


@pytest.fixture(scope="module")
def copies(built, tmp_path_factory):
    """A second file with the same library, which the loader takes for another one."""

    def give(fmi):
        library = Path(built("plant", fmi=fmi).info["library"])
        return shutil.copy(library, tmp_path_factory.mktemp("copy") / library.name)

    return give


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("case", CASES)
def test_misuse_is_an_error(built, copies, fmi, case):
    header = str(files("fmpy") / "c-code" / HEADER[fmi])
    command = [
        sys.executable,
        str(SCRIPT),
        json.dumps(built("plant", fmi=fmi).info),
        case,
        header,
        str(copies(fmi)),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    assert done.stderr == ""
