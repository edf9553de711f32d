"""MCAP: messages in JSON, in the CDR of ROS 2, or as Protocol Buffers."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from bristle.common.columns import Columns
from bristle.records.logs.topics import Message, from_messages, needed


def read_mcap(path: Path) -> Columns:
    """Return the fields of all topics that can be decoded."""
    with needed(path, "MCAP", "mcap, mcap-ros2-support, mcap-protobuf-support"):
        from mcap.reader import make_reader
        from mcap_protobuf.decoder import DecoderFactory as Protobuf
        from mcap_ros2.decoder import DecoderFactory as Ros2
    unusable: dict[str, str] = {}
    broken: list[str] = []
    factories = (Ros2(), Protobuf())
    decoders: dict[int, Callable[[bytes], Any] | None] = {}

    def decoder(schema: Any, channel: Any) -> Callable[[bytes], Any] | None:
        if channel.message_encoding == "json":
            return json.loads
        return next(
            filter(None, (f.decoder_for(channel.message_encoding, schema) for f in factories)), None
        )

    def messages(stream: Any) -> Iterator[Message]:
        for schema, channel, message in _records(make_reader, stream, broken):
            if channel.id not in decoders:
                decoders[channel.id] = decoder(schema, channel)
            decode = decoders[channel.id]
            if decode is None:
                unusable[channel.topic] = f"messages in '{channel.message_encoding}'"
                continue
            yield channel.topic, 1e-9 * message.log_time, decode(message.data)

    with path.open("rb") as stream:
        columns = from_messages(path, messages(stream), unusable)
    columns.findings += tuple(broken)
    return columns


def _records(make_reader: Callable[[Any], Any], stream: Any, broken: list[str]) -> Iterator[Any]:
    """Give what a log holds; of one that breaks off what is before the break, which is said."""
    from mcap.exceptions import McapError
    from mcap.reader import NonSeekingReader

    fails = (McapError, OSError, ValueError, struct.error)
    try:
        reader = make_reader(stream)
        reader.get_summary()
    except fails:
        stream.seek(0)
    else:
        yield from reader.iter_messages()
        return
    count = 0
    try:
        for each in NonSeekingReader(stream).iter_messages(log_time_order=False):
            yield each
            count += 1
    except fails:
        if not count:
            raise
    broken.append("the log breaks off; read up to there")
