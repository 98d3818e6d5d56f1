"""Recordings written by the library `rosbags`, which is also the oracle for reading."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Reader as Reader2
from rosbags.rosbag2 import Writer as Writer2

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.container import Container

START_NS = 1_700_000_000_000_000_000
TYPES = ("std_msgs/msg/String", "sensor_msgs/msg/Imu")
TOPICS = (("/b", TYPES[0]), ("/a", TYPES[1]), ("/b", TYPES[0]), ("/c", TYPES[0]))
DEFINITION = "string data\n"
Row = tuple[int, int, bytes]


def rows(num: int = 300, seed: int = 3) -> list[Row]:
    """Shuffled messages (connection, log_ns, payload) with many equal stamps; every payload is another."""
    rng = np.random.Generator(np.random.Philox(seed))
    return [
        (int(rng.integers(len(TOPICS))), START_NS + int(rng.integers(num // 3)) * 1_000_000, b"%d:" % i + rng.bytes(20))
        for i in range(num)
    ]


def write_bag1(path: Path, messages: Sequence[Row], compression: str = "none", chunk_bytes: int = 1000) -> Path:
    writer = Writer1(path)
    writer.chunk_threshold = chunk_bytes
    if compression != "none":
        writer.set_compression(Writer1.CompressionFormat[compression.upper()])
    with writer:
        connections = [
            writer.add_connection(topic, kind, msgdef=DEFINITION, md5sum="0" * 32, callerid=f"/node{i}")
            for i, (topic, kind) in enumerate(TOPICS)
        ]
        for number, log_ns, data in messages:
            writer.write(connections[number], log_ns, data)
    return path


def read_bag1(path: Path) -> list[tuple[int, str, int, bytes]]:
    """What `rosbags` reads: (log_ns, topic, connection, payload), in canonical order but for equal stamps of one."""
    with Reader1(path) as reader:
        return sorted((t, c.topic, c.id, bytes(data)) for c, t, data in reader.messages())


def write_bag2(
    folder: Path, messages: Sequence[Row], version: int = 9, mode: str = "none", storage: str = "sqlite3"
) -> Path:  # fmt: skip
    writer = Writer2(folder, version=version, storage_plugin=StoragePlugin[storage.upper()])
    writer.set_compression(CompressionMode[mode.upper()], CompressionFormat.ZSTD)
    with writer:
        topics = dict.fromkeys(TOPICS)
        connections = {
            key: writer.add_connection(key[0], key[1], msgdef=DEFINITION, rihs01="RIHS01_0") for key in topics
        }
        for number, log_ns, data in messages:
            writer.write(connections[TOPICS[number]], log_ns, data)
    return folder


def read_bag2(path: Path) -> list[tuple[int, str, bytes]]:
    with Reader2(path) as reader:
        return sorted((t, c.topic, bytes(data)) for c, t, data in reader.messages())


def everything(container: Container) -> list[tuple[int, str, int, bytes]]:
    """All messages, with their order checked."""
    entries = list(container.entries(frozenset(container.channels)))
    keys = [entry[:5] for entry in entries]
    assert keys == sorted(keys)
    assert len(set(keys)) == len(keys)
    assert all(entry.publish_ns == entry.log_ns and entry.sequence == 0 and entry.part == 0 for entry in entries)
    return [(entry.log_ns, entry.topic, entry.channel, bytes(entry.data)) for entry in entries]


def counted(faults: FaultLog) -> dict[str, int]:
    """Faults but for the missing checksums, which every recording has."""
    return {code: num for code, num in sorted(faults.counts.items()) if num and code != "LOG006"}
