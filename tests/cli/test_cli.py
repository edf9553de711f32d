"""The command line as a user meets it: exit codes, one line for an error, nothing left behind."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from bristle.common.errors import BristleError
from bristle.fmus import obtain
from bristle.harness.metrics.validation import lean_fmus
from bristle.harness.scenario.catalogue import find_scenario

Cli = Callable[..., "subprocess.CompletedProcess[str]"]


def command(arguments: Sequence[object]) -> list[str]:
    return [sys.executable, "-m", "bristle.cli.main", *map(str, arguments)]


@pytest.fixture
def temporary(tmp_path: Path) -> Path:
    """The folder for temporary files of the commands under test."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    return folder


@pytest.fixture(scope="module")
def compiled() -> None:
    """Compile what the commands use: they say so when they do it."""
    obtain("controller")
    for law in ("modified", "lugre"):
        obtain("plant", law=law)
    for method in ("bastin_gevers", "rls"):
        obtain("observer", method=method)
    lean_fmus()


@pytest.fixture
def cli(temporary: Path, compiled: None) -> Cli:
    """Return what runs the command line to its end; it must leave no temporary file."""

    def call(*arguments: object) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "TMPDIR": str(temporary)}
        done = subprocess.run(
            command(arguments),
            capture_output=True,
            text=True,
            env=environment,
            timeout=300,
            check=False,
        )
        assert os.listdir(temporary) == []
        assert "Traceback" not in done.stderr or "--debug" in arguments
        return done

    return call


@pytest.fixture
def inside(
    call: Callable[..., tuple[int, str, str]], temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> Cli:
    """As `cli`, but in this process, which has imported everything: for what the start of a process
    cannot change.
    """
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        code, said, complained = call(*arguments)
        assert os.listdir(temporary) == []
        assert "Traceback" not in complained
        return subprocess.CompletedProcess(arguments, code, said, complained)

    return run


def test_all_pass_is_0(cli: Cli, case: Path, tmp_path: Path) -> None:
    done = cli("run", case, "--out", tmp_path / "out")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split()[:2] == ["case", "pass"]
    assert len(done.stdout.splitlines()) == 1
    assert str(tmp_path / "out" / "case" / "report.html") in done.stdout
    assert sorted(os.listdir(tmp_path / "out")) == ["case"]


def test_a_failed_verdict_is_1(inside: Cli, case: Path, tmp_path: Path) -> None:
    done = inside("run", case, "--out", tmp_path / "out", "--set", "checks.0.min=1e6")
    assert done.returncode == 1
    assert "fail" in done.stdout
    assert "b moves" in done.stdout
    assert json.loads((tmp_path / "out/case/result.json").read_text())["verdict"] == "fail"


def one_line(done: subprocess.CompletedProcess[str], *words: str) -> None:
    assert done.returncode == 2
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("bristle: ")
    for word in words:
        assert word in lines[0]


@pytest.mark.sampled(4)
def test_errors_are_2_and_one_line(cli: Cli, inside: Cli, case: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    one_line(cli("run", tmp_path / "nowhere.toml", "--out", out), "nowhere.toml", "No such file")
    one_line(
        inside("run", case, "--out", out, "--set", "plant.parameters.J=-1 kg.m2"),
        "plant.parameters.J",
        "outside",
    )
    one_line(inside("run", case, "--out", case), "output folder", str(case))
    one_line(inside("run", case, case, "--out", out), "given 2 times")
    one_line(inside("run", tmp_path, "--out", out), "is a folder; give a scenario file")
    one_line(
        inside("run", case, "--out", out, "--seed", "-1"),
        "controller.parameters.seed = -1: outside [1, 2147483646]; choose",
    )
    one_line(
        inside("run", case, "--out", out, "--sed", "3"),
        "No such option: --sed (Possible options: --seed)",
    )
    one_line(inside("run", case, "--foo"), "No such option: --foo; see bristle run --help")
    one_line(
        inside("run", case, "--out", out, "--set", "duration=-1"),
        'write a unit behind the number, such as "1 s"',
    )
    one_line(inside("run", case, "--out", out, "--fmi", "4"), "--fmi")
    one_line(inside("run", case, "--out", out, "--kind", "python", "--fmi", "3"), "FMI 3")
    one_line(inside("dance"), "dance")
    one_line(
        inside("diagnos"),
        "No such command 'diagnos' (did you mean 'diagnose'?); see bristle --help",
    )
    one_line(cli(), "list, build, run")
    one_line(inside("build", "plant", "--law", "honey", "--out", out), "honey", "modified")
    one_line(
        inside("build", "plant", "--effects", "coging", "--out", out),
        "unknown effect 'coging'",
        "did you mean 'cogging'",
    )
    one_line(
        inside("build", "observer", "--effects", "bias", "--out", out),
        "the observer has no effects to add",
    )
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (["run", "quick", "--out", ""], "--out"),
        (["run", "quick", "--out="], "--out"),
        (["run", ""], "SCENARIO"),
        (["build", "controller", "--out", ""], "--out"),
        (["reproduce", "--out", ""], "--out"),
        (["diagnose", "m.toml", "--data", "a.csv", "--out", ""], "--out"),
        (["diagnose", "m.toml", "--data", ""], "--data"),
        (["diagnose", "", "--data", "a.csv"], "MODEL.toml"),
        (["diagnose", "--fmu", "", "--data", "a.csv"], "--fmu"),
    ],
)
def test_an_empty_path_is_not_the_current_folder(
    inside: Cli, arguments: list[str], option: str, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(temporary)  # of which `inside` demands that it stays empty
    one_line(
        inside(*arguments),
        f"Invalid value for '{option}': it is empty; give a path; see bristle {arguments[0]}"
        " --help",
    )


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (["test", "quick", "--json", "-"], "--json"),
        (["test", "quick", "--junit", "-"], "--junit"),
        (["run", "-"], "SCENARIO"),
        (["check", "a.fmu", "--json", "-"], "--json"),
        (["diff", "a.fmu", "b.fmu", "--json", "-"], "--json"),
    ],
)
def test_a_hyphen_is_no_file(
    inside: Cli, arguments: list[str], option: str, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(temporary)
    one_line(
        inside(*arguments),
        f"Invalid value for '{option}': - is no path; give that of a file, such as /dev/stdout",
    )


def test_results_are_in_out_where_no_folder_is_given(
    inside: Cli, case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    one_line(inside("run", "quik"), "did you mean 'quick'?")
    one_line(inside("diagnose", "none.toml", "--data", "none.csv"), "none.toml", "No such file")
    assert inside("run", case).returncode == 0
    assert (tmp_path / "out" / "case" / "result.json").exists()


def test_a_model_file_is_no_scenario(inside: Cli, tmp_path: Path) -> None:
    model = Path(__file__).resolve().parents[2] / "scenarios" / "hidden" / "07" / "model.toml"
    one_line(
        inside("run", model, "--out", tmp_path / "out"),
        "is a model file, no scenario file; give it to bristle diagnose",
    )


def test_a_scenario_is_no_model_file(inside: Cli, case: Path, tmp_path: Path) -> None:
    asked = ("diagnose", case, "--data", "none.csv", "--out", tmp_path / "out")
    one_line(inside(*asked), "is a scenario file, no model file; give it to bristle run")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs a pipe with a name")
def test_what_could_be_read_for_ever_is_no_file(
    tmp_path: Path, inside: Cli, case: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("pipe", "pipe.toml", "pipe.ssp"):
        os.mkfifo(tmp_path / name)
    for given in ("pipe", "pipe.toml", "pipe.ssp", "/dev/zero"):
        one_line(
            inside("run", given, "--out", "out"),
            f"{given}: is not a regular file but a pipe or device; write",
        )
    one_line(inside("validate", "pipe.toml", "--data", case), "pipe.toml: is not a regular file")
    (tmp_path / "result.json").symlink_to("/dev/zero")
    one_line(inside("compare", tmp_path, tmp_path), "result.json: is not a regular file")


def test_a_folder_is_no_scenario_but_hides_none(
    tmp_path: Path, inside: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("mine", "quick"):
        (tmp_path / name).mkdir()
    one_line(inside("run", "mine"), "mine: is a folder; give a scenario file")
    assert find_scenario(Path("quick")).is_file()


def test_the_command_line_is_a_module_too_and_has_a_short_help(tmp_path: Path) -> None:
    for arguments in (["--version"], ["-h"], ["run", "-h"]):
        done = subprocess.run(
            [sys.executable, "-m", "bristle", *arguments],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.startswith("bristle " if arguments == ["--version"] else "Usage: ")


def test_every_command_is_described_in_one_line(inside: Cli) -> None:
    listed = inside("--help").stdout.partition("Commands:")[2].splitlines()
    assert [line.split()[0] for line in listed if line] == [
        "list",
        "build",
        "run",
        "test",
        "accept",
        "compare",
        "sweep",
        "query",
        "report",
        "export",
        "coupling",
        "reproduce",
        "schema",
        "new",
        "init",
        "diagnose",
        "validate",
        "stiction",
        "diff",
        "check",
    ]
    assert all(line.endswith(".") and not line.endswith("...") for line in listed if line)


@pytest.mark.sampled(4)
def test_deprecated_keys_are_one_line(cli: Cli, tmp_path: Path) -> None:
    rows = [f"{0.001 * k},{math.sin(0.02 * k)},{math.cos(0.01 * k)}" for k in range(500)]
    (tmp_path / "r.csv").write_text("\n".join(["t,u,y", *rows]))
    old = tmp_path / "old.toml"
    old.write_text("""
[record]
file = "r.csv"
time = { column = "t", unit = "s" }
u = { column = "u", unit = "V" }
theta = { column = "y", unit = "rad" }
[observer]
method = "rls"
[[checks]]
quantity = "estimates.b.final"
min = -1e9
""")
    done = cli("run", old, "--out", tmp_path / "out")
    assert done.returncode in (0, 1)
    [line] = done.stderr.splitlines()
    assert line.startswith(
        f"bristle: {old}: record: the keys u, theta are deprecated; write u as [record.input]"
    )
    result = json.loads((tmp_path / "out/old/result.json").read_text())
    assert f"bristle: {result['notes'][0]}" == line


def test_what_was_found_in_a_record_is_printed(inside: Cli, tmp_path: Path) -> None:
    rows = [
        f"{0.001 * k + 0.0001 * math.sin(k * k)},{math.sin(0.02 * k)},{math.cos(0.01 * k)}"
        for k in range(500)
    ]
    (tmp_path / "r.csv").write_text("\n".join(["t,u,y", *rows]))
    scenario = tmp_path / "recorded.toml"
    scenario.write_text("""
[record]
file = "r.csv"
time = { column = "t", unit = "s" }
input = { column = "u", unit = "V", kind = "voltage" }
output = { column = "y", unit = "rad", kind = "position" }
[observer]
method = "rls"
[[checks]]
quantity = "record.samples"
min = 100
""")
    head, note = inside("run", scenario, "--out", tmp_path / "out").stdout.splitlines()
    assert head.startswith("recorded ")
    assert note.startswith("  - record r: sampling intervals scatter by ")
    assert note[4:] in json.loads((tmp_path / "out/recorded/result.json").read_text())["notes"]


def test_all_scenarios_are_checked_before_the_first_runs(
    inside: Cli, case: Path, tmp_path: Path
) -> None:
    """Paths, keys, and what only the FMUs can tell; all that are wrong are named."""
    keys, fmus = tmp_path / "keys.toml", tmp_path / "fmus.toml"
    keys.write_text("duration = 3")
    fmus.write_text(case.read_text().replace("modified", "honey"))
    done = inside("run", case, tmp_path / "nowhere.toml", keys, fmus, "--out", tmp_path / "out")
    assert (done.returncode, done.stdout) == (2, "")
    assert [line.split(": ")[1] for line in done.stderr.splitlines()] == [
        str(tmp_path / "nowhere.toml"),
        str(keys),
        str(fmus),
    ]
    assert not (tmp_path / "out").exists()


def test_a_scenario_is_found_by_its_name(inside: Cli, case: Path, tmp_path: Path) -> None:
    done = inside(
        "run",
        "quick",
        "--out",
        tmp_path / "out",
        "--set",
        "duration=1 s",
        "--set",
        "checks.0.max_abs=1e9",
    )
    assert done.stdout.split()[0] == "quick"
    assert (tmp_path / "out" / "quick" / "report.html").is_file()
    one_line(
        inside("run", "quik", "--out", tmp_path / "out"),
        "scenario 'quik'",
        "did you mean 'quick'",
        "give a path or one of",
    )


def test_a_scenario_of_a_plugin_folder_is_found_by_its_name(
    monkeypatch: pytest.MonkeyPatch, case: Path, tmp_path: Path
) -> None:
    (tmp_path / "scenarios").mkdir()
    mine = case.rename(tmp_path / "scenarios" / "mine.toml")
    monkeypatch.setenv("BRISTLE_PLUGINS", str(tmp_path))
    assert find_scenario(Path("mine")) == mine
    mine.rename(tmp_path / "scenarios" / "quick.toml")
    with pytest.raises(
        BristleError, match=f"{tmp_path}/scenarios/quick.toml: a scenario is called 'quick' already"
    ):
        find_scenario(Path("quick"))


@pytest.mark.sampled(4)
def test_debug_shows_the_traceback_and_still_exits_with_2(cli: Cli, tmp_path: Path) -> None:
    done = cli("run", tmp_path / "nowhere.toml", "--out", tmp_path, "--debug")
    assert done.returncode == 2
    assert "Traceback" in done.stderr


@pytest.mark.slow
def test_only_what_a_scenario_names_is_compiled_and_told_once(case: Path, tmp_path: Path) -> None:
    """On the error output, so that a pipe of the verdicts has none of it; the cache is empty at
    first.
    """
    environment = {**os.environ, "BRISTLE_CACHE": str(tmp_path / "cache")}
    build = command(["run", case, "--out", tmp_path / "out"])
    told = [
        rf"bristle: compiling an FMU \({which}\) once, about [1-9] s; later runs take it from the"
        " cache"
        for which in ("controller", "plant, modified", "observer, bastin_gevers")
    ]
    for lines in (told, []):
        done = subprocess.run(build, capture_output=True, text=True, env=environment, check=False)
        said = done.stderr.splitlines()
        assert len(said) == len(lines)
        assert all(map(re.fullmatch, lines, said)), said
        assert "compiling" not in done.stdout
    equations = [path.name.split("-")[0] for path in (tmp_path / "cache").glob("model_*.o")]
    assert sorted(equations) == ["model_bastin_gevers", "model_controller", "model_modified"]


@pytest.mark.sampled(4)
def test_list_compiles_nothing(tmp_path: Path) -> None:
    environment = {**os.environ, "BRISTLE_CACHE": str(tmp_path / "cache")}
    done = subprocess.run(
        command(["list"]), capture_output=True, text=True, env=environment, check=False
    )
    assert (done.returncode, done.stderr, (tmp_path / "cache").exists()) == (0, "", False)
    heavy = ["scipy.signal", "fmpy", "matplotlib", "pythonfmu"]
    code = (
        "import sys; import bristle.cli.commands; from bristle.cli.app import app; app(['list'],"
        " standalone_mode=False); "
    )
    code += f"print({{*{heavy}}} & {{*sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"


def test_list_names_what_there_is(cli: Cli) -> None:
    done = cli("list")
    assert done.returncode == 0
    for word in ("modified", "coulomb", "bastin_gevers", "rls", "quick"):
        assert word in done.stdout


def test_build_writes_readable_fmus(cli: Cli, inside: Cli, tmp_path: Path) -> None:
    from fmpy import read_model_description

    done = cli("build", "controller", "--fmi", "3", "--out", tmp_path / "fmus")
    [path] = done.stdout.split()
    assert read_model_description(path).fmiVersion.startswith("3.")
    lean = inside("build", "plant", "--law", "viscous", "--out", tmp_path / "fmus")
    assert read_model_description(lean.stdout.strip()).modelName == "ServoPlant_viscous"
    assert sorted(os.listdir(tmp_path / "fmus")) == ["Controller.fmu", "ServoPlant_viscous.fmu"]
    more = inside(
        "build",
        "plant",
        "--law",
        "lugre",
        "--effects",
        "cogging",
        "--effects",
        " bias",
        "--fmi",
        "3",
        "--out",
        tmp_path / "fmus",
    )
    found = {v.name: v for v in read_model_description(more.stdout.strip()).modelVariables}
    assert more.stdout.strip().endswith("ServoPlant_lugre_bias_cogging.fmu")
    assert (found["cogging.amplitude"].unit, found["bias.torque"].causality) == ("N.m", "parameter")


def test_help_is_quick(cli: Cli) -> None:
    """Nothing heavy is imported for it."""
    heavy = {"numpy", "casadi", "scipy", "fmpy", "matplotlib", "pydantic"}
    code = f"import sys; import bristle.cli.main; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert cli("--help").returncode == 0


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("number", "stage"),
    [
        (signal.SIGINT, "simulation"),
        (signal.SIGTERM, "simulation"),
        (signal.SIGINT, "fits"),
        (signal.SIGINT, "child"),
    ],
)
def test_an_interrupt_is_one_line_and_leaves_nothing(
    number: int, stage: str, case: Path, tmp_path: Path, temporary: Path, inside: Cli
) -> None:
    from bristle.fmus import build

    out = tmp_path / "out"
    assert inside("run", case, "--out", out).returncode == 0
    before = (out / "case" / "result.json").read_text()
    long = ["--set", "duration=4000 s"]
    if stage == "fits":
        long = [
            "--set",
            "duration=300 s",
            "--set",
            "plant.law=lugre",
            "--set",
            "validation.duration=100 s",
        ]
    if stage == "child":
        case.write_text(case.read_text().replace('law = "modified"', 'fmu = "foreign.fmu"'))
        build("plant", tmp_path / "foreign.fmu", law="modified")
    environment = {**os.environ, "TMPDIR": str(temporary)}
    running = subprocess.Popen(
        command(["run", case, "--out", out, *long]),
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )
    prefix, count = {
        "simulation": (".bristle-fmu-", 3),
        "fits": (".bristle-fmu-", 2),
        "child": (".bristle-run-", 1),
    }[stage]
    _wait_for(
        lambda: sum(name.startswith(prefix) for name in os.listdir(temporary)) == count, running
    )
    if stage == "fits":  # the drives come after the co-simulation's three
        _wait_for(lambda: len(os.listdir(temporary)) == 2, running)
    time.sleep(0.3)
    running.send_signal(number)
    _, said = running.communicate(timeout=20)
    assert (running.returncode, said) == (2, "bristle: interrupted\n")
    assert os.listdir(temporary) == []
    assert os.listdir(out) == ["case"]
    assert (out / "case" / "result.json").read_text() == before
    # a child that was only just being started ends when it finds its parent gone
    until = time.monotonic() + 10
    while (left := _children_of(temporary)) and time.monotonic() < until:
        time.sleep(0.05)
    assert not left


def _wait_for(condition: Callable[[], bool], running: subprocess.Popen[str]) -> None:
    until = time.monotonic() + 60
    while not condition():
        assert running.poll() is None, "ended before it could be interrupted"
        assert time.monotonic() < until, "never came so far"
        time.sleep(0.01)


def _children_of(temporary: Path) -> list[str]:
    """Return the command lines of processes that still work in a folder."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/cmdline") if Path("/proc").is_dir() else ():
        try:
            line = entry.read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        if str(temporary) in line:
            found.append(line)
    return found


def test_a_record_is_also_estimated_at_once(inside: Cli, case: Path, tmp_path: Path) -> None:
    """What stands beside the observer's estimates is near the plant that made the record."""
    made, scenario = tmp_path / "out" / case.stem, tmp_path / "recorded.toml"
    inside("run", case, "--out", tmp_path / "out", "--full")
    true = json.loads((made / "result.json").read_text())["estimates"]
    scenario.write_text(f"""
[record]
file = "{made / "signals.csv"}"
time = {{ column = "time", unit = "s" }}
input = {{ column = "u", unit = "V", kind = "voltage" }}
output = {{ column = "theta", unit = "rad", kind = "position" }}
[observer]
method = "rls"
""")
    printed = inside("run", scenario, "--out", tmp_path / "out").stdout
    batch = json.loads((tmp_path / "out/recorded/result.json").read_text())["batch"]
    for name in ("alpha2", "b", "Fc"):
        off = batch[name]["value"] - true[name]["true"]
        assert abs(off) < min(3 * batch[name]["sd"], 0.03 * true[name]["true"])
        assert batch[name]["valid"]
        assert f"{name} {batch[name]['value']:.4g}" in printed
    report = (tmp_path / "out/recorded/report.html").read_text()
    assert "From the whole record at once" in report
