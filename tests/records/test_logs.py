"""Logs of robots: written by each format's own library, read with their topics and times."""

import gc
import json
import struct

import numpy as np
import pytest

from bristle.common.errors import BristleError
from bristle.records.formats.reading import read_columns
from bristle.records.intake import read_record
from bristle.records.layout import Column, Layout

N = 400
T = 0.005 * np.arange(N)
EPOCH = 1_700_000_000 * 10**9  # ns
U, Q = np.sin(3 * T), 1.0 - np.cos(3 * T)
STAMPS = [EPOCH + 5_000_000 * k for k in range(N)]  # ns
LATE = 3_000_000  # ns: between a measurement and its entry in the log


def ros_types(store):
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(getattr(Stores, store))
    return types, *(
        types.types[name]
        for name in (
            "sensor_msgs/msg/JointState",
            "std_msgs/msg/Header",
            "builtin_interfaces/msg/Time",
            "std_msgs/msg/Float64",
        )
    )


def ros2_bag(path, plugin):
    """Two joints with stamps, and a command that comes 2 ms before each of them."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    types, state, header, time, number = ros_types("ROS2_HUMBLE")
    with Writer(path, version=9, storage_plugin=getattr(StoragePlugin, plugin)) as bag:
        joints = bag.add_connection("/joint_states", state.__msgtype__, typestore=types)
        command = bag.add_connection("/effort_command", number.__msgtype__, typestore=types)
        for k, stamp in enumerate(STAMPS):
            said = types.serialize_cdr(number(float(U[k])), number.__msgtype__)
            bag.write(command, stamp - 2_000_000, said)
            of = header(time(stamp // 10**9, stamp % 10**9), "")
            rows = [np.array([x[k], float(k)]) for x in (Q, U, U)]
            seen = types.serialize_cdr(state(of, ["pan", "tilt"], *rows), state.__msgtype__)
            bag.write(joints, stamp + LATE, seen)
    return path


def ros1_bag(path):
    from rosbags.rosbag1 import Writer

    types, state, header, time, _ = ros_types("ROS1_NOETIC")
    with Writer(path) as bag:
        joints = bag.add_connection("/joint_states", state.__msgtype__, typestore=types)
        for k, stamp in enumerate(STAMPS):
            of = header(k, time(stamp // 10**9, stamp % 10**9), "")
            rows = [np.array([x[k]]) for x in (Q, U, U)]
            seen = types.serialize_ros1(state(of, ["pan"], *rows), state.__msgtype__)
            bag.write(joints, stamp + LATE, seen)
    return path


def json_mcap(path, chunk=1024 * 1024):
    from mcap.writer import Writer

    with path.open("wb") as stream:
        log = Writer(stream, chunk_size=chunk)
        log.start()
        schema = log.register_schema("servo", "jsonschema", b'{"type": "object"}')
        servo = log.register_channel("/servo", "json", schema)
        other = log.register_channel("/unknown", "cbor", schema)
        log.add_message(other, EPOCH, b"\x00", EPOCH)
        for k, stamp in enumerate(STAMPS):
            sample = {"effort": U[k], "position": Q[k], "image": [0] * 1000, "mode": "on"}
            log.add_message(servo, stamp, json.dumps(sample).encode(), stamp)
        log.finish()
    return path


def protobuf_mcap(path):
    from google.protobuf.wrappers_pb2 import DoubleValue
    from mcap_protobuf.writer import Writer

    with path.open("wb") as stream, Writer(stream) as log:
        for k, stamp in enumerate(STAMPS):
            for topic, x in (("/effort", U), ("/position", Q)):
                log.write_message(topic, DoubleValue(value=x[k]), stamp, stamp)
    return path


def tdms(path):
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(path) as file:
        facts = {"wf_increment": 0.005, "wf_start_offset": 0.0}
        columns = (("Torque", U, "Nm"), ("Angle", Q, "rad"))
        file.write_segment(
            [
                ChannelObject("Drive", name, x, properties=facts | {"unit_string": unit})
                for name, x, unit in columns
            ]
        )
    return path


def mdf(path):
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.append(
            [Signal(U, T, name="Torque", unit="Nm"), Signal(Q, T, name="Angle", unit="rad")]
        )
        file.append([Signal(T[::100], T[::100], name="Temp", unit="degC")])
        file.save(path, overwrite=True)
    return path


def ulog(path):
    """By the format's description: header, one format, one subscription, its data."""

    def message(kind, body):
        return struct.pack("<HB", len(body), ord(kind)) + body

    text = b"servo:uint64_t timestamp;double effort;double position;"
    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0), message("B", bytes(40))]
    parts += [message("F", text), message("A", struct.pack("<BH", 0, 0) + b"servo")]
    parts += [
        message("D", struct.pack("<HQdd", 0, round(1e6 * T[k]), U[k], Q[k])) for k in range(N)
    ]
    path.write_bytes(b"".join(parts))
    return path


def wpilog(path):
    """By the format's description: header, a record that begins each entry, its values."""

    def record(entry, time, body):
        return struct.pack("<BIIQ", 0x7F, entry, len(body), time) + body

    def text(value):
        return struct.pack("<I", len(value)) + value

    parts = [b"WPILOG\x00\x01" + text(b"")]
    for entry, name in ((1, b"effort"), (2, b"position")):
        start = struct.pack("<BI", 0, entry) + text(name) + text(b"double") + text(b"")
        parts.append(record(0, 0, start))
    for k in range(N):
        for entry, x in ((1, U), (2, Q)):
            parts.append(record(entry, round(1e6 * T[k]), struct.pack("<d", x[k])))
    path.write_bytes(b"".join(parts))
    return path


LOGS = {
    "bag": (ros1_bag, "/joint_states.effort.pan", "/joint_states.position.pan", 1e-9 * EPOCH),
    "mcap": (json_mcap, "/servo.effort", "/servo.position", 1e-9 * EPOCH),
    "tdms": (tdms, "Drive.Torque", "Drive.Angle", 0.0),
    "mf4": (mdf, "group 1.Torque", "group 1.Angle", 0.0),
    "ulg": (ulog, "servo.effort", "servo.position", 0.0),
}


@pytest.mark.parametrize("suffix", LOGS)
def test_a_log_gives_its_numbers_and_their_time(suffix, tmp_path):
    write, effort, position, begin = LOGS[suffix]
    columns = read_columns(write(tmp_path / f"log.{suffix}"))
    np.testing.assert_array_equal(columns[effort], U)
    np.testing.assert_array_equal(columns[position], Q)
    time = columns.times[position]
    assert columns.times[effort] == time
    np.testing.assert_allclose(columns[time] - begin, T, atol=1e-6)


@pytest.mark.parametrize("write", [wpilog, protobuf_mcap])
def test_entries_with_a_time_each(write, tmp_path):
    columns = read_columns(write(tmp_path / f"log.{write.__name__.removeprefix('protobuf_')}"))
    effort, position = (
        next(n for n in columns if w in n and ".value" in n) for w in ("effort", "position")
    )
    np.testing.assert_array_equal(columns[effort], U)
    np.testing.assert_array_equal(columns[position], Q)
    assert columns.times[effort] != columns.times[position]
    together = columns.at(columns.times[position])
    np.testing.assert_array_equal(together[effort], U)


@pytest.mark.parametrize("plugin", ["SQLITE3", "MCAP"])
def test_a_bag_of_ros_2_as_folder_and_as_file(plugin, tmp_path):
    bag = ros2_bag(tmp_path / "bag", plugin)
    [inside] = [each for each in bag.iterdir() if each.suffix != ".yaml"]
    for path in (bag, inside):
        columns = read_columns(path)
        time = columns.times["/joint_states.position.pan"]
        np.testing.assert_array_equal(columns["/joint_states.position.pan"], Q)
        np.testing.assert_array_equal(columns["/joint_states.position.tilt"], np.arange(N))
        # the stamp of the measurement, not of the log
        np.testing.assert_allclose(columns[time] - 1e-9 * EPOCH, T, atol=1e-6)


def test_the_command_of_another_topic_is_what_was_last_known(tmp_path):
    """It comes 2 ms before the measurement: the record has the command of the same sample."""
    bag = ros2_bag(tmp_path / "bag", "SQLITE3")
    layout = Layout(
        time=Column(column="/joint_states.time", unit="s"),
        input=Column(column="/effort_command.data", unit="N.m"),
        input_kind="torque",
        output=Column(column="/joint_states.position.pan", unit="rad"),
        output_kind="position",
    )
    record = read_record(layout, bag)
    assert len(record) == N
    np.testing.assert_array_equal(record.u, U)
    np.testing.assert_allclose(record.y, Q, atol=1e-12)


def test_what_cannot_be_decoded_is_named(tmp_path):
    columns = read_columns(json_mcap(tmp_path / "log.mcap"))
    assert columns.unusable["/unknown"] == "messages in 'cbor'"
    assert columns.unusable["/servo.mode"] == '"on"'
    assert not any("image" in name for name in columns)


@pytest.mark.parametrize("share", [0.3, 0.7, 0.98])
def test_of_a_log_that_breaks_off_what_is_before_is_read(share, tmp_path):
    """As a robot leaves it that loses its power: without the end, which says where all is."""
    path = json_mcap(tmp_path / "log.mcap", chunk=4096)
    whole = path.read_bytes()
    path.write_bytes(whole[: round(share * len(whole))])
    columns = read_columns(path)
    count = len(columns["/servo.position"])
    assert 0.5 * share * N < count <= N
    np.testing.assert_array_equal(columns["/servo.position"], Q[:count])
    assert columns.findings == ("the log breaks off; read up to there",)
    # nothing of it is no log
    path.write_bytes(b"nothing of it")
    with pytest.raises(BristleError, match=r"log\.mcap"):
        read_columns(path)


def test_no_mdf_file_is_one_line_and_nothing_else(tmp_path, capfd):
    path = tmp_path / "log.mf4"
    path.write_bytes(b"nothing of it" * 100)
    with pytest.raises(BristleError, match="is no MDF file"):
        read_columns(path)
    gc.collect()
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("module", ["mcap", "rosbags", "nptdms", "asammdf", "pyulog", "wpiutil"])
def test_a_format_without_its_library_says_what_to_install(module, tmp_path, monkeypatch):
    import sys

    for name in [name for name in sys.modules if name.split(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    suffix = dict(
        mcap="mcap", rosbags="bag", nptdms="tdms", asammdf="mf4", pyulog="ulg", wpiutil="wpilog"
    )[module]
    path = tmp_path / f"log.{suffix}"
    path.write_bytes(b"x")
    with pytest.raises(BristleError, match=r"pip install 'bristle\[logs\]'"):
        read_columns(path)


def test_an_mdf_file_that_breaks_off_is_one_line(tmp_path, capfd):
    whole = tmp_path / "whole.mf4"
    from asammdf import MDF, Signal

    with MDF() as file:
        file.append([Signal(samples=U, timestamps=T, name="u")])
        file.save(whole)
    (tmp_path / "part.mf4").write_bytes(whole.read_bytes()[:200])
    with pytest.raises(BristleError, match=r"cannot be read: .*; check the file"):
        read_columns(tmp_path / "part.mf4")
    gc.collect()
    assert capfd.readouterr().err == ""
