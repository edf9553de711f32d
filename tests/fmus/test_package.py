"""The archive: reproducible, complete, compiles elsewhere; written as a whole or not at all;
fetched quickly.
"""

import importlib
import os
import subprocess
import sys
import zipfile
from importlib.resources import files
from importlib.util import module_from_spec
from pathlib import Path

import pytest

from bristle.common.errors import BristleError
from bristle.fmus import build, obtain
from bristle.fmus.native import FMI_HEADERS
from bristle.fmus.pack import write_archive
from bristle.fmus.platforms import host
from bristle.model.compiler import find_compiler

NATIVE = [("plant", 2), ("plant", 3), ("controller", 2), ("observer", 3)]


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    "options",
    [
        pytest.param({}, marks=pytest.mark.slow),
        pytest.param({"fmi": 3}, marks=pytest.mark.slow),
        {"law": "lugre"},
        {"law": "coulomb", "fmi": 3},
        {"kind": "python"},
    ],
    ids=str,
)
def test_building_twice_gives_the_same_bytes(tmp_path, options):
    """In two folders and two processes, whose hashes are seeded differently, with nothing in the
    cache.
    """
    results = []
    for seed in ("1", "2"):
        out = tmp_path / f"folder {seed} ä" / "Servo.fmu"
        out.parent.mkdir()
        code = (
            "from pathlib import Path; from bristle.fmus import build; build('plant',"
            f" Path({str(out)!r}), **{options!r})"
        )
        environment = os.environ | {
            "PYTHONHASHSEED": seed,
            "TMPDIR": str(out.parent),
            "BRISTLE_CACHE": str(tmp_path / seed),
        }
        done = subprocess.run(
            [sys.executable, "-c", code],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert [p.name for p in out.parent.iterdir()] == [out.name]  # nothing is left lying about
        results.append(out.read_bytes())
    assert results[0] == results[1]


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("what", "fmi"), NATIVE)
def test_archive(built, what, fmi):
    fmu = built(what, fmi=fmi)
    with zipfile.ZipFile(fmu.path) as archive:
        names = archive.namelist()
        assert names == sorted(names)
        for entry in archive.infolist():
            assert entry.date_time == (1980, 1, 1, 0, 0, 0)
            assert entry.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
            assert not entry.filename.startswith("/")
            assert "\\" not in entry.filename
    name = fmu.description.coSimulation.modelIdentifier
    assert f"binaries/{host().folder(fmi)}/{name}.so" in names or sys.platform != "linux"
    assert {
        "modelDescription.xml",
        "documentation/index.html",
        "documentation/licenses/license.txt",
    } <= set(names)
    assert {f"sources/{header}" for header in FMI_HEADERS[fmi]} <= set(names)


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("what", "fmi"), NATIVE)
def test_no_trace_of_the_building_machine(built, what, fmi):
    folder = built(what, fmi=fmi).folder
    for path in folder.rglob("*"):
        if path.is_file():
            content = path.read_bytes()
            for trace in (str(Path(__file__).parents[2]), str(Path.home()), sys.prefix, "/tmp/"):
                assert trace.encode() not in content, (path, trace)


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("what", "fmi"),
    [*NATIVE[:-1], pytest.param(*NATIVE[-1], marks=pytest.mark.slow), ("lean", 2), ("lean", 3)],
)
def test_sources_compile_from_a_clean_extract(built, what, fmi, tmp_path):
    """With nothing but the compiler and the folder sources/, and every function of the standard
    comes out of it.
    """
    fmu = (
        built("plant", law="modified", fmi=fmi, encoder=False)
        if what == "lean"
        else built(what, fmi=fmi)
    )
    sources = tmp_path / "sources"
    with zipfile.ZipFile(fmu.path) as archive:
        for name in archive.namelist():
            if name.startswith("sources/"):
                archive.extract(name, tmp_path)
    [configuration] = fmu.description.buildConfigurations
    units = configuration.sourceFileSets[0].sourceFiles
    assert sorted(units) == sorted(p.name for p in sources.glob("*.c"))
    # Without optimisation, which takes most of the time: the warnings that it adds are errors when
    # the FMU is built.
    flags = ["-std=c99", "-O0", "-fPIC", "-shared", "-Wall", "-Wextra", "-pedantic", "-Werror"]
    # the standard's own fmi3FunctionTypes.h declares two callbacks with ()
    flags.append("-Wno-strict-prototypes")
    command = [*find_compiler(), *flags, *units, "-o", "out.so", "-lm"]
    done = subprocess.run(command, cwd=sources, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    header = (files("fmpy") / "c-code" / f"fmi{fmi}Functions.h").read_text(encoding="utf-8")
    binary = (sources / "out.so").read_bytes()
    wanted = {
        word
        for word in header.replace(";", " ").split()
        if word.startswith(f"fmi{fmi}") and f"{word}TYPE {word};" in " ".join(header.split())
    }
    assert len(wanted) == {2: 44, 3: 75}[fmi]
    for name in wanted:
        assert name.encode() + b"\0" in binary, name


# -- building and obtaining ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("motor",), ("motor", "plant, observer, controller")),
        (("plant", {"fmi": 1}), ("FMI 1", "2 or 3")),
        (("plant", {"fmi": 3, "kind": "python"}), ("python", "FMI 3")),
        (("plant", {"kind": "java"}), ("java", "native, python")),
        (("plant", {"law": "tanh"}), ("tanh", "known", "lugre")),
        (("observer", {"method": "guess"}), ("guess", "known")),
        (("controller", {"law": "lugre"}), ("controller", "law")),
        (("plant", {"method": "rls"}), ("plant", "method")),
    ],
)
def test_what_cannot_be_built_is_said_in_one_line(tmp_path, arguments, words):
    what, options = arguments[0], dict(arguments[1]) if len(arguments) > 1 else {}
    for make in (
        lambda: build(what, tmp_path / "x.fmu", **options),
        lambda: obtain(what, **options),
    ):
        with pytest.raises(BristleError) as error:
            make()
        text = str(error.value)
        assert "\n" not in text
        assert all(word in text for word in words), text
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there(tmp_path):
    with pytest.raises(BristleError, match=r"cannot write .*missing.*choose") as error:
        build("controller", tmp_path / "missing" / "x.fmu")
    assert "\n" not in str(error.value)


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    """The disk fills up half way: the file that was there is still there, and nothing else."""
    out = tmp_path / "x.fmu"
    out.write_bytes(b"old")

    def full(self, *arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(zipfile.ZipFile, "writestr", full)
    with pytest.raises(BristleError, match="No space left"):
        write_archive(out, {"a": b"b"})
    assert out.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["x.fmu"]


@pytest.mark.sampled(3, "observer")
def test_what_is_there_is_not_built_again():
    """A second `obtain` imports nothing symbolic and starts no compiler."""
    paths = {what: str(obtain(what)) for what in ("plant", "observer", "controller")}
    code = """
import subprocess, sys
def never(*a, **k): raise AssertionError("a process was started")
subprocess.Popen.__init__ = never
from bristle.fmus import obtain
paths = [str(obtain(what)) for what in ("plant", "observer", "controller")]
imported = {"casadi", "fmpy", "pythonfmu"} & set(sys.modules)
assert not imported, "symbolic or FMI packages were imported"
print(*paths, sep="\\n")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == list(paths.values())


def test_a_changed_source_is_another_fmu(monkeypatch):
    """The key covers what the FMU is made from: another compiler or source, another file."""
    # the name in the package is the function
    module = importlib.import_module("bristle.fmus.build")

    def keys():
        return {module._key((), "native", what, 2, None) for what in ("plant", "controller")}

    before = keys()
    assert len(before) == 2
    python = module._key((), "python", "plant", 2, None)
    monkeypatch.setattr(module, "compiler_identity", lambda: "another one")
    after = keys()
    assert not before & after
    assert module._key((), "python", "plant", 2, None) == python  # made without a compiler
    monkeypatch.undo()
    original = Path.read_bytes
    monkeypatch.setattr(
        Path,
        "read_bytes",
        lambda self: original(self) + (b" " if self.name == "instance.c" else b""),
    )
    # a file that changes while the process runs: the process still builds from the code it has read
    assert keys() == before
    fresh = module_from_spec(module.__spec__)
    module.__spec__.loader.exec_module(fresh)
    assert fresh._key("native", "plant", 2, None) not in before


def test_the_time_that_is_told_grows_with_the_equations(monkeypatch):
    """Of one law, of several on one core, and of the same with a core for each."""
    module = importlib.import_module("bristle.fmus.build")
    laws = [module.program_of("plant", law) for law in ("viscous", "modified", "gms")]
    alone = [module.compile_seconds(each) for each in laws]
    assert 1.0 < alone[0] < alone[1] < alone[2] < 3.0
    whole = module.program_of("plant")
    times = []
    for cores in (1, 2, 100):
        monkeypatch.setattr(os, "cpu_count", lambda cores=cores: cores)
        times.append(module.compile_seconds(whole))
    assert times[0] > times[1] > times[2] >= alone[2]
