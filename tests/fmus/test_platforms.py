"""Binaries for other platforms: all in one file, the same bytes every time, the same digits where
they can be run.
"""

from __future__ import annotations

import importlib.util
import shutil
import struct
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.fmus import build
from bristle.fmus.native import fmi_headers
from bristle.fmus.platforms import ALL, FAT_ALIGNMENT, fat, find_platforms, host
from bristle.model import compiler
from bristle.model.compiler import HOST, Target, find_compiler

HERE = Path(__file__).parent
ZIG = importlib.util.find_spec("ziglang") is not None
needs_zig = pytest.mark.skipif(not ZIG, reason="the compiler zig is not installed (bristle[cross])")
NAMED = {each.name: each for each in ALL}
FOLDERS = {
    2: {"linux64", "aarch64-linux", "win64", "darwin64"},
    3: {"x86_64-linux", "aarch64-linux", "x86_64-windows", "x86_64-darwin", "aarch64-darwin"},
}


# -- names -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("linux64", ["x86_64-linux"]),
        ("win64, x86_64-windows", ["x86_64-windows"]),
        ("darwin64", ["x86_64-darwin", "aarch64-darwin"]),
        ("host", [host().name]),
        ("host,all", [host().name, *(each.name for each in ALL if each.name != host().name)]),
    ],
)
def test_platforms_have_the_names_of_both_versions(text: str, found: list[str]) -> None:
    assert [each.name for each in find_platforms(text)] == found


def test_this_machine_uses_its_own_compiler_unless_it_is_named() -> None:
    assert find_platforms("host")[0].target.triple == ""
    assert all(each.target.triple for each in find_platforms("all"))


@pytest.mark.parametrize(
    ("text", "words"),
    [("win6", ("win6", "did you mean 'win64'")), ("", ("unknown platform ''", "host, all"))],
)
def test_an_unknown_platform_is_refused(text: str, words: Sequence[str], tmp_path: Path) -> None:
    with pytest.raises(BristleError) as refused:
        build("controller", tmp_path / "a.fmu", platforms=text)
    assert all(word in str(refused.value) for word in words)
    assert list(tmp_path.iterdir()) == []


def test_an_fmu_in_python_has_no_platforms(tmp_path: Path) -> None:
    with pytest.raises(BristleError, match="no binary of its own"):
        build("controller", tmp_path / "a.fmu", kind="python", platforms="all")


def test_a_missing_compiler_is_named_with_what_installs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler.importlib.util, "find_spec", lambda name: None)
    find_compiler.cache_clear()
    try:
        with pytest.raises(BristleError, match=r"pip install 'bristle\[cross\]'"):
            build("controller", tmp_path / "a.fmu", platforms="win64")
    finally:
        find_compiler.cache_clear()


def test_a_fat_library_holds_each_machine_at_an_aligned_place() -> None:
    parts = {"x86_64": b"first" * 5000, "aarch64": b"second"}
    made = fat(parts)
    magic, count = struct.unpack_from(">II", made)
    assert (magic, count) == (0xCAFEBABE, 2)
    kinds = {0x01000007: "x86_64", 0x0100000C: "aarch64"}
    for k in range(count):
        kind, _, offset, size, power = struct.unpack_from(">5I", made, 8 + 20 * k)
        assert offset % (1 << power) == 0
        assert power == FAT_ALIGNMENT
        assert made[offset : offset + size] == parts[kinds[kind]]


# -- binaries --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def every(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Return the maker of a plant of one law for all platforms, once for each version of FMI."""
    folder = tmp_path_factory.mktemp("platforms")

    def make(fmi: int) -> Path:
        path = folder / f"{fmi}.fmu"
        return (
            path if path.exists() else build("plant", path, fmi=fmi, law="lugre", platforms="all")
        )

    return make


def content(path: Path) -> dict[str, bytes]:
    with ZipFile(path) as archive:
        return {
            name: archive.read(name) for name in archive.namelist() if name.startswith("binaries/")
        }


@needs_zig
@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_one_file_has_every_platform_and_the_same_bytes_again(
    fmi: int, every: Callable[..., Path], tmp_path: Path
) -> None:
    made = content(every(fmi))
    assert {Path(name).parent.name for name in made} == FOLDERS[fmi]
    again = build("plant", tmp_path / "elsewhere.fmu", fmi=fmi, law="lugre", platforms="all")
    assert again.read_bytes() == every(fmi).read_bytes()
    for name, binary in made.items():
        for trace in (str(Path(__file__).parents[2]), str(Path.home()), "/tmp/"):
            assert trace.encode() not in binary, (name, trace)
        assert f"fmi{fmi}Instantiate".encode() in binary


@needs_zig
@pytest.mark.slow
def test_compiled_anew_it_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not only linked: nothing that was compiled before is used."""
    source = {
        "a.c": (
            "#include <math.h>\ndouble f(double x);\ndouble f(double x) { return exp(x) +"
            " (double)__LINE__; }\n"
        )
    }
    monkeypatch.setattr(
        compiler, "cached", lambda name, make: (make(tmp_path / name), tmp_path / name)[1]
    )
    for each in ALL:
        found = []
        for name in ("here", "there"):
            folder = tmp_path / each.name / name
            folder.mkdir(parents=True)
            compiler.compile_shared(source, folder / "lib", each.target)
            found.append((folder / "lib").read_bytes())
            for made in tmp_path.glob("*.o"):
                made.unlink()
        assert found[0] == found[1], each.name


@needs_zig
@pytest.mark.slow
def test_libraries_need_the_system_only(every: Callable[..., Path]) -> None:
    for name, binary in content(every(3)).items():
        where = Path(name).parent.name
        if where.endswith("linux"):
            versions = {
                tuple(map(int, part.split(b"\0")[0].split(b".")))
                for part in binary.split(b"GLIBC_")[1:]
            }
            assert versions
            assert max(versions) <= (2, 17)
        elif where.endswith("windows"):
            needed = {
                part[-40:].split(b"\0")[-1].decode("latin1")
                for part in binary.split(b".dll\0")[:-1]
            }
            assert all(
                each in ("KERNEL32", f"{Path(name).stem}") or each.startswith("api-ms-win-crt-")
                for each in needed
            ), needed
        else:
            assert b"/usr/lib/libSystem.B.dylib" in binary
            assert f"@rpath/{Path(name).name}".encode() in binary
            assert binary.count(b".dylib\0") == 2


RUNNERS: dict[str, list[str]] = {
    "x86_64-linux": [],
    "aarch64-linux": ["qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"],
    "x86_64-windows": ["wine"],
}


def driver(target: Target, folder: Path) -> Path:
    """Compile the host of this folder for a platform."""
    for name, text in fmi_headers(2).items():
        (folder / name).write_text(text, encoding="utf-8")
    program = folder / ("drive.exe" if target.system == "win32" else "drive")
    link = [] if target.system == "win32" else ["-ldl"]
    command = [
        *find_compiler(target.triple),
        "-std=c99",
        "-O1",
        f"-I{folder}",
        str(HERE / "drive.c"),
        "-o",
        str(program),
        *link,
    ]
    subprocess.run(command, check=True, capture_output=True)
    return program


def driven(
    target: Target, runner: Sequence[str], fmu: Any, library: bytes, folder: Path
) -> list[str]:
    """Return the bits of the outputs that the host prints, line by line, one a step."""
    folder.mkdir()
    model = folder / f"model{target.suffix}"
    model.write_bytes(library)
    vr = fmu.info["vr"]
    numbers = [str(vr[name]) for name in ("u", "theta", "v", "F", "theta_enc")]
    found = model.name if target.system == "win32" else str(model)
    done = subprocess.run(
        [*runner, str(driver(target, folder)), found, fmu.info["token"], "600", *numbers],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        env={
            "WINEDEBUG": "-all",
            "WINEPREFIX": str(folder / "wine"),
            "PATH": "/usr/bin:/bin",
            "HOME": str(folder),
        },
    )
    assert done.returncode == 0, done.stderr[-500:]
    return done.stdout.splitlines()


@needs_zig
@pytest.mark.slow
@pytest.mark.skipif(
    host().name != "x86_64-linux", reason="the runners are those of Linux on x86_64"
)
@pytest.mark.parametrize("name", list(RUNNERS))
def test_the_digits_are_those_of_this_machine(name: str, built: Any, tmp_path: Path) -> None:
    """To the last bit; on Windows within what its C library's exp differs, where the law has
    one.
    """
    runner, place = RUNNERS[name], NAMED[name]
    if runner and (
        shutil.which(runner[0]) is None or not all(Path(each).exists() for each in runner[2:])
    ):
        pytest.skip(
            f"{runner[0]} is not installed (Debian: wine64, qemu-user with libc6-arm64-cross)"
        )
    for law in ("coulomb", "lugre"):
        own = built("plant", law=law)
        path = build("plant", tmp_path / f"{law}.fmu", fmi=2, law=law, platforms=name)
        [library] = content(path).values()
        expected = driven(
            HOST, [], own, Path(own.info["library"]).read_bytes(), tmp_path / f"{law}-here"
        )
        found = driven(place.target, runner, own, library, tmp_path / law)
        assert len(found) == 600
        assert len(set(found)) > 500
        if place.system == "windows" and law == "lugre":
            np.testing.assert_allclose(numbers(found), numbers(expected), rtol=1e-12, atol=1e-14)
        else:
            assert found == expected


def numbers(lines: Sequence[str]) -> Any:
    """Return what the host printed as numbers, shape (steps, outputs)."""
    return np.array(
        [[struct.unpack(">d", bytes.fromhex(bits))[0] for bits in line.split()] for line in lines]
    )
