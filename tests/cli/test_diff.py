"""`bristle diff`: exit code, last line, file."""

import json

import pytest

from bristle.fmus import obtain


@pytest.mark.sampled(4)
def test_the_command_says_whether_one_may_take_the_others_place(call, tmp_path):
    first, second = obtain("plant"), obtain("plant", effects=("cogging",))
    assert call("diff", first, first)[:2] == (0, "no difference\n")
    code, out, _ = call("diff", first, second, "--json", tmp_path / "d.json")
    assert code == 1
    assert "that a user of" in out.splitlines()[-1]
    rows = json.loads((tmp_path / "d.json").read_text())["differences"]
    assert {row["kind"] for row in rows} >= {"addition", "behaviour", "note"}
    kinds = [line.split()[0] for line in out.splitlines()[:-1]]
    assert kinds == [row["kind"] for row in rows]
    code, _, err = call("diff", first, tmp_path / "none.fmu")
    assert (code, len(err.splitlines())) == (2, 1)
    code, _, err = call("diff", first, second, "--json", tmp_path / "no" / "d.json")
    assert (code, len(err.splitlines())) == (2, 1)


def test_an_fmu_is_not_replaced_by_the_file(call, tmp_path):
    copy = tmp_path / "copy.fmu"
    copy.write_bytes(obtain("plant").read_bytes())
    code, _, err = call("diff", copy, copy, "--json", copy)
    assert (code, "would be replaced" in err) == (2, True)
    assert copy.read_bytes() == obtain("plant").read_bytes()
