"""Experiments that come with an FMU: ours, and files as others may write them; each difference is
seen.
"""

import json
import shutil
import zipfile

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.fmus import build
from bristle.harness.exchange.experiment import repeat

FOLDER = "extra/org.fmi-standard.fmi-ls-ref/"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return build("plant", tmp_path_factory.mktemp("made") / "plant.fmu", law="lugre")


def of(ending, change):
    return lambda name, content: change(content) if name.endswith(ending) else content


@pytest.mark.sampled(4)
def test_an_fmu_is_tried_with_what_it_holds(made, tmp_path):
    done = repeat(made, tmp_path)
    assert done.passed
    [one] = done.experiments
    assert len(one.agreement) == 5
    assert max(each.worst for each in one.agreement) < 1e-11
    result = json.loads((tmp_path / "plant" / "result.json").read_text(encoding="utf-8"))
    assert (result["verdict"], result["changed"]) == ("pass", [])
    assert (
        (tmp_path / "plant" / "signals_1.csv").read_text(encoding="utf-8").startswith("time,theta,")
    )


def test_another_number_in_the_reference_fails(made, tmp_path, changed):
    def bent(content):
        lines = content.decode().splitlines()
        cells = lines[50].split(",")
        lines[50] = ",".join([cells[0], repr(float(cells[1]) + 1e-5), *cells[2:]])
        return "\n".join(lines).encode()

    done = repeat(
        changed(made, tmp_path / "bent.fmu", of("-reference.csv", bent)), tmp_path / "out"
    )
    assert not done.passed
    [bad] = [each for each in done.experiments[0].agreement if not each.holds]
    assert (bad.name, bad.time) == ("theta", pytest.approx(0.98))
    assert done.changed == (FOLDER + "smoke-test-reference.csv",)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("ending", ["plant.c", "modelDescription.xml", "license.txt"])
def test_a_file_that_is_not_as_it_was_fails(made, tmp_path, ending, changed):
    with zipfile.ZipFile(made) as archive:
        [whole] = [name for name in archive.namelist() if name.endswith(ending)] or [
            archive.namelist()[-1]
        ]
    done = repeat(
        changed(made, tmp_path / "other.fmu", of(whole, lambda content: content + b"\n")),
        tmp_path / "out",
    )
    assert (done.changed, done.passed) == ((whole,), False)
    assert all(each.passed for each in done.experiments)
    unlisted = changed(
        made,
        tmp_path / "unlisted.fmu",
        lambda name, content: None if name.endswith(".sha256") else content,
    )
    assert repeat(unlisted, tmp_path / "out").changed == (FOLDER + "checksums.sha256",)
    gone = changed(
        made,
        tmp_path / "gone.fmu",
        lambda name, content: None if name.endswith("license.txt") else content,
    )
    assert repeat(gone, tmp_path / "out").changed == ("documentation/licenses/license.txt",)


@pytest.mark.sampled(4)
def test_another_fmu_fails_the_experiments_of_this_one(made, tmp_path):
    with zipfile.ZipFile(made) as archive:
        archive.extractall(
            tmp_path / "unpacked", [n for n in archive.namelist() if n.startswith(FOLDER)]
        )
    source = tmp_path / "unpacked" / FOLDER / "smoke-test.exp"
    assert repeat(made, tmp_path / "out", source).passed
    heavier = build("plant", tmp_path / "heavier.fmu", law="lugre", parameters={"J": 0.00101})
    done = repeat(heavier, tmp_path / "out", source)
    assert not done.passed
    assert not {each.name: each.holds for each in done.experiments[0].agreement}["v"]


# -- files of others -------------------------------------------------------------------------------
TIMES = 'startTime="0" stopTime="0.4" stepSize="0.01"'
FILE = """<Experiments name="all"><Experiment name="one" {old}>{new}
<Parameters source="set%201.ssv"/>
<Stimuli source="sub/in.csv"/><References source="ref.csv"/></Experiment></Experiments>"""
SET = """<ssv:ParameterSet version="1.0" name="x"
xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues">
<ssv:Parameters><ssv:Parameter name="gain"><ssv:Real value="5"/></ssv:Parameter></ssv:Parameters>
</ssv:ParameterSet>"""


def exact(time, gain=5.0):
    """theta and v of the tiny FMU with u = 2 t, by its own rule: explicit Euler."""
    v = theta = 0.0
    rows = []
    for t in time:
        rows.append((theta, v))
        theta, v = theta + 0.01 * v, v + 0.01 * (gain * 2 * t - 2 * v)
    return np.array(rows)


@pytest.fixture
def foreign(tmp_path):
    """Return a writer of a foreign file of experiments."""

    def write(
        old="",
        new=f"<TransientSimulation {TIMES}/>",
        head="\ufefftime,theta,v\n",
        rows=None,
        stimuli="t,u\n0,0\n1,2\n",
    ):
        folder = tmp_path / "theirs"
        (folder / "sub").mkdir(parents=True, exist_ok=True)
        time = 0.01 * np.arange(41)
        if rows is None:
            rows = "\n".join(
                f"{t:.4f},{a:.6f},{b:.6f}" for t, (a, b) in zip(time, exact(time), strict=True)
            )
        (folder / "case.exp").write_text(FILE.format(old=old, new=new), encoding="utf-8")
        (folder / "set 1.ssv").write_text(SET, encoding="utf-8")
        (folder / "ref.csv").write_text(head + rows, encoding="utf-8")
        (folder / "sub" / "in.csv").write_text(stimuli, encoding="utf-8")
        return folder / "case.exp"

    return write


@pytest.mark.parametrize(
    ("old", "new"),
    [("", f"<TransientSimulation {TIMES}/>"), (TIMES, "")],
    ids=["new form", "old form"],
)
def test_a_file_of_another_maker_runs(tiny_fmu, foreign, tmp_path, old, new):
    done = repeat(tiny_fmu(), tmp_path / "out", foreign(old, new))
    assert done.passed
    assert [each.name for each in done.experiments[0].agreement] == ["theta", "v"]


def test_times_that_do_not_start_at_zero_reach_the_fmu(tiny_fmu, foreign, tmp_path):
    late = foreign(new='<TransientSimulation startTime="0.3" stopTime="0.6" stepSize="0.01"/>')
    done = repeat(tiny_fmu("error"), tmp_path / "out", late)  # it ends at 0.5 s
    assert not done.passed
    assert "stopped at 0.5 s" in done.experiments[0].summary


@pytest.mark.sampled(4)
def test_a_signal_off_or_missing_fails_and_one_step_late_does_not(tiny_fmu, foreign, tmp_path):
    time = 0.01 * np.arange(41)
    rows = [f"{t:.4f},{a:.6f},{b * 1.02:.6f}" for t, (a, b) in zip(time, exact(time), strict=True)]
    done = repeat(tiny_fmu(), tmp_path / "out", foreign(rows="\n".join(rows)))
    assert [each.holds for each in done.experiments[0].agreement] == [True, False]
    late = exact(np.r_[0.0, time])[:-1]
    rows = [f"{t:.4f},{a:.6f},{b:.6f}" for t, (a, b) in zip(time, late, strict=True)]
    assert repeat(tiny_fmu(), tmp_path / "out", foreign(rows="\n".join(rows))).passed
    done = repeat(tiny_fmu(), tmp_path / "out", foreign(head="time,theta,speed\n"))
    assert [each.worst for each in done.experiments[0].agreement][1] is None
    assert not done.passed
    longer = "\n".join(f"{t:.3f},0,0" for t in np.arange(0, 0.5, 0.01))
    done = repeat(tiny_fmu(), tmp_path / "out", foreign(rows=longer))
    assert (
        done.passed,
        done.experiments[0].agreement[0].why.startswith("the reference is from 0 to 0.49 s"),
    ) == (False, True)


def test_what_is_no_result_of_a_run_is_left_out_and_said(tiny_fmu, foreign, tmp_path):
    done = repeat(tiny_fmu(), tmp_path / "out", foreign(head="time,u,v\n"))
    [one] = done.experiments
    assert one.not_compared == ("u",)
    assert "1 not compared" in one.summary


@pytest.mark.sampled(4)
def test_a_reference_without_anything_to_compare_fails(tiny_fmu, foreign, tmp_path):
    for head, rows in (("time\n", "0\n1\n"), ("time,u\n", "0,0\n0.1,1\n")):
        done = repeat(tiny_fmu(), tmp_path / "out", foreign(head=head, rows=rows))
        assert (done.passed, done.experiments[0].verdict) == (False, "fail")
    source = foreign()
    source.write_text(
        source.read_text(encoding="utf-8").replace('<References source="ref.csv"/>', ""),
        encoding="utf-8",
    )
    assert repeat(tiny_fmu(), tmp_path / "out", source).experiments[0].verdict == "ran"


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"new": "<SteadyState/>"}, "only TransientSimulation"),
        ({"new": '<TransientSimulation stepSize="0.01" stopTime="x"/>'}, "no number"),
        ({"new": '<TransientSimulation stopTime="1" stepSize="1e-9"/>'}, "steps"),
        ({"new": '<TransientSimulation stopTime="-1" stepSize="0.1"/>'}, "steps"),
        ({"rows": "0,nan,0"}, "finite"),
        ({"rows": "0,1"}, "no table"),
        ({"stimuli": "t,w\n0,0\n"}, "no Real or Boolean input 'w'"),
        ({"stimuli": ""}, "no table"),
        ({"stimuli": "t,u,u\n0,0,1\n"}, "one name"),
        ({"new": '<TransientSimulation stopTime="1" stepSize="0"/>'}, "steps"),
    ],
)
def test_what_cannot_be_run_is_one_line(tiny_fmu, foreign, tmp_path, files, message):
    with pytest.raises(BristleError, match=message) as error:
        repeat(tiny_fmu(), tmp_path / "out", foreign(**files))
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()


def test_missing_files_and_experiments_are_one_line(tiny_fmu, foreign, made, tmp_path, changed):
    with pytest.raises(BristleError, match="holds no experiments"):
        repeat(tiny_fmu(), tmp_path / "out")
    source = foreign()
    shutil.rmtree(source.parent / "sub")
    with pytest.raises(BristleError, match="check the path"):
        repeat(tiny_fmu(), tmp_path / "out", source)
    outside = foreign()
    outside.write_text(
        outside.read_text(encoding="utf-8").replace("sub/in.csv", "../in.csv"), encoding="utf-8"
    )
    with pytest.raises(BristleError, match="lies elsewhere"):
        repeat(tiny_fmu(), tmp_path / "out", outside)
    for old, new, message in [
        (b'source="smoke-test.exp"', b'source="https://example.org/a.exp"', "lies elsewhere"),
        (b'source="smoke-test.exp"', b'source="none.exp"', "holds no file"),
        (b'source="smoke-test.exp"', b"", "source of a file is missing"),
        (b"experiment/smoke-test", b"testcase", "names no experiment"),
    ]:
        bad = changed(
            made,
            tmp_path / "bad.fmu",
            of("manifest.xml", lambda content, old=old, new=new: content.replace(old, new)),
        )
        with pytest.raises(BristleError, match=message):
            repeat(bad, tmp_path / "out")
    assert not (tmp_path / "out").exists()
