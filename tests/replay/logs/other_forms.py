"""Other containers with the same messages: unchunked, without summary or checksums, damaged."""

import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer

NO_SUMMARY = {
    "index_types": IndexType.NONE, "repeat_channels": False, "repeat_schemas": False, "use_statistics": False,
    "use_summary_offsets": False,
}  # fmt: skip
HEAD = struct.Struct("<BQ")


Stream = tuple[str, str, str, list[bytes]]


def rewrite(
    source: Path,
    target: Path,
    order: Callable[[list[Message]], list[Message]] = list,
    extra: Sequence[Stream] = (),
    **how: Any,
) -> Path:
    """Write the records of `source` in another way; `order` changes the order of the messages.

    `extra` are more streams: topic, schema, encoding and payloads, which go to the end.
    """
    with source.open("rb") as file:
        records = list(StreamReader(file).records)
    options = {"enable_data_crcs": True, "compression": CompressionType.NONE, **how}
    with target.open("wb") as file:
        writer = Writer(file, **options)
        writer.start()
        for record in records:
            if isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
        seen: list[Any] = []
        for record in records:
            if isinstance(record, Schema) and ("s", record.id) not in seen:
                seen.append(("s", record.id))
                writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, Channel) and ("c", record.id) not in seen:
                seen.append(("c", record.id))
                writer.register_channel(record.topic, record.message_encoding, record.schema_id, record.metadata)
        for m in order([r for r in records if isinstance(r, Message)]):
            writer.add_message(m.channel_id, m.log_time, m.data, m.publish_time, m.sequence)
        last = max(r.log_time for r in records if isinstance(r, Message))
        for topic, schema, encoding, payloads in extra:
            channel = writer.register_channel(topic, encoding, writer.register_schema(schema, "x", b""))
            for payload in payloads:
                writer.add_message(channel, last, payload, last)
        writer.finish()
    return target


def shuffled_topics(messages: list[Message]) -> list[Message]:
    """Shuffle, but keep the order within each channel and stamp: that order is content."""
    rng = np.random.Generator(np.random.Philox(3))
    mixed = [messages[i] for i in rng.permutation(len(messages))]
    streams: dict[Any, list[Message]] = {}
    for m in messages:
        streams.setdefault((m.channel_id, m.log_time), []).append(m)
    slots = {key: iter(stream) for key, stream in streams.items()}
    return [next(slots[m.channel_id, m.log_time]) for m in mixed]


def layout(data: bytes) -> list[tuple[int, int, int]]:
    """Opcode, offset and total length of each record of a file."""
    found, at = [], 8
    while at < len(data) - 8:
        opcode, length = HEAD.unpack_from(data, at)
        found.append((opcode, at, HEAD.size + length))
        at += HEAD.size + length
    return found


def chunks(data: bytes) -> list[tuple[int, int]]:
    """Offset and length of each chunk record."""
    return [(at, length) for opcode, at, length in layout(data) if opcode == Opcode.CHUNK]
