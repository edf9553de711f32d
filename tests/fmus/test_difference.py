"""Differences between two FMUs: every kind is seen in a changed copy, and none where there is
none.
"""

import re
from zipfile import ZipFile

import pytest

from bristle.common.errors import BristleError
from bristle.fmus import difference
from bristle.fmus.difference import Change, fmu_differences
from bristle.fmus.host import Fmu

XML = "modelDescription.xml"
# a pattern in the description of the plant, what takes its place, the kind of the difference, its
# place and words
CHANGES = [
    (
        r'canSerializeFMUstate="true"',
        'canSerializeFMUstate="false"',
        Change.breaking,
        "Co-Simulation",
        "is now false",
    ),
    (
        r'(canBeInstantiatedOnlyOncePerProcess=)"false"',
        r'\1"true"',
        Change.breaking,
        "Co-Simulation",
        "only",
    ),
    (r'name="theta_enc"', 'name="angle"', Change.breaking, "output theta_enc", "is gone"),
    (r'name="theta_enc"', 'name="angle"', Change.addition, "output angle", "is new"),
    (
        r'(name="tau_load".*?unit=")N.m"',
        r'\1V"',
        Change.breaking,
        "input tau_load",
        "unit N.m became V",
    ),
    (
        r'(name="encoder.counts".*?start=")[^"]*"',
        r'\g<1>8192.0"',
        Change.default,
        "parameter encoder.counts",
        "became 8192",
    ),
    (
        r'(name="encoder.counts".*?max=")[^"]*"',
        r'\g<1>50000.0"',
        Change.breaking,
        "parameter encoder.counts",
        "to 5",
    ),
    (
        r'(name="encoder.counts".*?max=")[^"]*"',
        r'\g<1>1e12"',
        Change.addition,
        "parameter encoder.counts",
        "range",
    ),
    (
        r'(<DefaultExperiment[^>]*stopTime=")[^"]*"',
        r'\g<1>30.0"',
        Change.default,
        "default experiment",
        "20.0 became 30.0",
    ),
    (
        r'(<Item name="dahl" value=")[^"]*"',
        r'\g<1>77"',
        Change.breaking,
        "parameter law",
        "item dahl",
    ),
    (r'guid="[^"]*"', 'guid="other"', Change.note, "FMU", "token"),
]


@pytest.fixture(scope="module")
def plant(built):
    return Fmu(built("plant").path, foreign=True)


def changed(plant, folder, pattern, by, only_xml=True):
    """Return a copy with its description changed, by default without a binary."""
    path = folder / "other.fmu"
    with ZipFile(plant.path) as old, ZipFile(path, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == XML:
                text, count = re.subn(pattern, by, content.decode(), count=1, flags=re.S)
                assert count == 1
                content = text.encode()
            if name == XML or not only_xml or name.startswith("binaries/"):
                new.writestr(name, content)
    return Fmu(path)


def of_interface(first, second):
    """Return what differs beside the behaviour."""
    parts = (difference._interface, difference._variables, difference._experiment)
    return [d for part in parts for d in part(first, second)]


@pytest.mark.parametrize(
    "case", CHANGES, ids=[f"{case[3]}-{case[2]}-{k}" for k, case in enumerate(CHANGES)]
)
def test_a_change_of_the_interface_is_seen(plant, tmp_path, case):
    pattern, by, kind, place, words = case
    found = of_interface(plant, changed(plant, tmp_path, pattern, by))
    assert [d for d in found if d.change is kind and d.place == place and words in d.text], found
    assert all(d.change is kind for d in found) or by == 'name="angle"'


def test_a_parameter_that_may_no_longer_be_tuned_breaks_its_host(plant, tmp_path):
    tunable = changed(plant, tmp_path, r'(name="J"[^>]*variability=")fixed"', r'\1tunable"')
    assert [d.change for d in of_interface(tunable, plant)] == [Change.breaking]
    assert [d.change for d in of_interface(plant, tunable)] == [Change.addition]


@pytest.mark.sampled(4)
def test_an_fmu_does_not_differ_from_itself_and_other_start_values_show_in_the_outputs(
    plant, tmp_path
):
    assert fmu_differences(plant, plant) == []
    other = changed(plant, tmp_path, r'(name="J".*?start=")[^"]*"', r'\g<1>0.0004"', only_xml=False)
    # the binary starts as it did: only the file claims another value
    [default, *others] = fmu_differences(plant, other)
    assert (default.change, default.place, others) == (Change.default, "parameter J", [])


@pytest.mark.sampled(4)
def test_another_behaviour_is_named_with_its_time(built, plant):
    found = fmu_differences(plant, Fmu(built("plant", effects=("cogging",)).path, foreign=True))
    by_place = {d.place: d.text for d in found if d.change is Change.behaviour}
    assert "output F" in by_place
    assert "of its range" in by_place["output F"]
    assert not [d for d in found if d.change in (Change.breaking, Change.default)]


@pytest.mark.sampled(4)
def test_an_fmu_that_cannot_run_differs(plant, tmp_path):
    empty = tmp_path / "empty.fmu"
    with ZipFile(plant.path) as old, ZipFile(empty, "w") as new:
        new.writestr(XML, old.read(XML))
    found = fmu_differences(plant, Fmu(empty))
    assert [d.text for d in found if d.change is Change.breaking] == ["binary for linux64 is gone"]
    assert [d.place for d in found if d.change is Change.behaviour] == ["default experiment"]
    with pytest.raises(BristleError, match="no binary"):
        fmu_differences(Fmu(empty), plant)
