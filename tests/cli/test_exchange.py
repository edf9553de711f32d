"""`bristle export`, and `bristle run` of what was packed: exit codes, what is printed, what is left
behind.
"""

import zipfile

import pytest

SCENARIO = """
duration = "0.5 s"
[plant]
law = "coulomb"
[observer]
method = "rls"
[[checks]]
quantity = "states.v.rms"
max = 1e9
"""


@pytest.fixture
def kit(call, tmp_path):
    (tmp_path / "axis.toml").write_text(SCENARIO, encoding="utf-8")
    code, text, _ = call("export", tmp_path / "axis.toml", "--out", tmp_path / "kit")
    assert code == 0
    assert str(tmp_path / "kit" / "axis.ssp") in text
    return tmp_path / "kit"


def bent(ending, old, new):
    """Return the change of one of the files of an archive."""

    def change(name, content):
        assert not name.endswith(ending) or old in content
        return content.replace(old, new) if name.endswith(ending) else content

    return change


def test_what_is_exported_passes_and_what_is_changed_fails(call, kit, tmp_path, changed):
    assert {path.name for path in kit.iterdir()} == {"axis.ssp", "README.md", "fmus", "reference"}
    code, text, _ = call("run", kit / "axis.ssp", "--out", tmp_path / "out")
    assert (code, " pass " in text) == (0, True)
    code, text, _ = call("run", *sorted((kit / "fmus").iterdir()), "--out", tmp_path / "out")
    assert (code, text.count(" pass ")) == (0, 6)
    coarse = changed(
        kit / "axis.ssp",
        tmp_path / "coarse.ssp",
        bent(".ssd", b'stepSize="0.001"', b'stepSize="0.002"'),
    )
    code, text, _ = call("run", coarse, "--out", tmp_path / "out")
    assert (code, " fail " in text) == (1, True)
    other = changed(
        kit / "fmus" / "plant.fmu",
        tmp_path / "other.fmu",
        bent("validation-stimuli.csv", b"\n0.1,", b"\n0.1,9\n0.1001,"),
    )
    code, text, _ = call("run", other, "--out", tmp_path / "out")
    assert (code, text.count(" pass "), text.count(" fail ")) == (1, 1, 2)
    assert (
        "not as when it was made: extra/org.fmi-standard.fmi-ls-ref/validation-stimuli.csv" in text
    )


@pytest.mark.slow
def test_experiments_beside_an_fmu_run_with_it(call, kit, tmp_path):
    with zipfile.ZipFile(kit / "fmus" / "plant.fmu") as archive:
        archive.extractall(tmp_path)
    source = tmp_path / "extra" / "org.fmi-standard.fmi-ls-ref" / "smoke-test.exp"
    code, text, _ = call(
        "run", source, "--fmu", kit / "fmus" / "plant.fmu", "--out", tmp_path / "out"
    )
    assert (code, " pass " in text) == (0, True)
    code, text, _ = call(
        "run",
        source,
        kit / "fmus" / "observer.fmu",
        "--fmu",
        kit / "fmus" / "plant.fmu",
        "--out",
        tmp_path / "out",
    )
    assert (code, text.count(" pass "), text.count("42 of 42")) == (0, 3, 2)
    code, _, said = call("run", source, "--out", tmp_path / "out")
    assert (code, "add --fmu FILE" in said) == (2, True)


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["axis.ssp", "--set", "plant.law=dahl"], "run as they are"),
        (["axis.ssp", "--seed", "1"], "run as they are"),
        (["axis.ssp", "quick"], "run as they are"),
        (["axis.ssp", "axis.ssp"], "given 2 times"),
        (["axis.ssp", "--fmu", "x.fmu"], "goes with .exp files"),
        (["none.ssp"], "check the path"),
        (["none.fmu"], "check the path"),
        (["README.md.ssp"], "not a zip archive"),
        (["README.md.fmu"], "not a zip archive"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(
    call, kit, tmp_path, monkeypatch, arguments, message
):
    monkeypatch.chdir(kit)
    for ending in ("ssp", "fmu"):
        (kit / f"README.md.{ending}").write_text("no archive", encoding="utf-8")
    code, _, said = call("run", *arguments, "--out", tmp_path / "out")
    assert (code, len(said.strip().splitlines())) == (2, 1)
    assert message in said
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_folder_with_other_files_is_left_as_it_is(call, kit, tmp_path):
    code, _, _ = call("export", tmp_path / "axis.toml", "--out", kit)  # again
    assert code == 0
    (tmp_path / "other.toml").write_text(SCENARIO, encoding="utf-8")
    (tmp_path / "project").mkdir()
    (tmp_path / "project" / "README.md").write_text("mine", encoding="utf-8")
    (tmp_path / "tree" / "axis.ssp" / "keep").mkdir(parents=True)
    for name, out in (("other", kit), ("axis", tmp_path / "project"), ("axis", tmp_path / "tree")):
        before = sorted(out.rglob("*"))
        code, _, said = call("export", tmp_path / f"{name}.toml", "--out", out)
        assert (code, "choose an empty folder" in said) == (2, True)
        assert sorted(out.rglob("*")) == before
    assert (tmp_path / "project" / "README.md").read_text(encoding="utf-8") == "mine"


def test_what_cannot_be_exported_is_exit_code_2(call, tmp_path):
    (tmp_path / "bad.toml").write_text(SCENARIO.replace("coulomb", "coulom"), encoding="utf-8")
    code, _, said = call("export", tmp_path / "bad.toml", "--out", tmp_path / "kit")
    assert (code, len(said.strip().splitlines())) == (2, 1)
    assert not (tmp_path / "kit").exists()
