"""Bags of ROS 1, and of ROS 2 as a folder or as the database in it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from bristle.common.columns import Columns
from bristle.common.errors import BristleError
from bristle.records.logs.topics import Message, from_messages, needed

METADATA = "metadata.yaml"  # makes a folder a bag


def is_bag(path: Path) -> bool:
    """Return whether a folder is a bag of ROS 2."""
    return (path / METADATA).is_file()


def read_ros_bag(path: Path) -> Columns:
    """Return the fields of all topics of which the types of messages are known."""
    with needed(path, "a ROS bag", "rosbags"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    bag = path.parent if path.suffix.lower() == ".db3" else path
    if path.suffix.lower() == ".db3" and not is_bag(bag):
        raise BristleError(
            f"record {path}: no {METADATA} beside it; give the folder of the bag, or record it anew"
            " with ros2 bag reindex"
        )
    unusable: dict[str, str] = {}

    def messages(reader: AnyReader) -> Iterator[Message]:
        known = [each for each in reader.connections if each.msgtype in reader.typestore.fielddefs]
        unusable.update(
            {
                each.topic: f"messages of type {each.msgtype}, which is not defined in it"
                for each in reader.connections
                if each not in known
            }
        )
        for connection, time, data in reader.messages(known):
            yield connection.topic, 1e-9 * time, reader.deserialize(data, connection.msgtype)

    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        return from_messages(path, messages(reader), unusable)
