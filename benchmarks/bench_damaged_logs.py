"""Damaged copies of one recording, read by rosbags, the mcap package and fbench: see docs/dependencies.md."""

import random
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import cast

from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.rosbag1 import Reader as BagReader
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.open import open_container

NUM_MESSAGES, NUM_COPIES, CHUNK = 300, 300, 16384
Messages = list[tuple[int, bytes]]
Read = Callable[[Path], tuple[Messages, int]]  # Messages, and the number of faults that were reported


def write_bag(path: Path) -> None:
    types = get_typestore(Stores.ROS1_NOETIC)
    string = types.types["std_msgs/msg/String"]
    with BagWriter(path) as bag:
        bag.chunk_threshold = CHUNK
        connection = bag.add_connection("/a", string.__msgtype__, typestore=types)
        for i in range(NUM_MESSAGES):
            content = types.serialize_ros1(string(data=f"{i:05d}" * 200), string.__msgtype__)
            bag.write(connection, 10**9 + i * 10**7, content)


def write_mcap(path: Path) -> None:
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK)
        writer.start()
        channel = writer.register_channel("/a", "x", writer.register_schema("s", "", b""))
        for i in range(NUM_MESSAGES):
            data = f"{i:05d}".encode() * 200 + i.to_bytes(4, "big") * 50
            writer.add_message(channel, 10**9 + i * 10**7, data, 10**9, i)
        writer.finish()  # type: ignore[no-untyped-call]


def read_by_rosbags(path: Path) -> tuple[Messages, int]:
    with BagReader(path) as bag:
        return [(stamp_ns, bytes(data)) for _, stamp_ns, data in bag.messages()], 0


def read_by_mcap(path: Path) -> tuple[Messages, int]:
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return [(message.log_time, bytes(message.data)) for _, _, message in reader.iter_messages()], 0


def read_by_fbench(path: Path) -> tuple[Messages, int]:
    faults = FaultLog()
    container = open_container(path, faults)
    entries = container.entries(frozenset(container.channels))
    messages = [(entry.log_ns, bytes(cast("memoryview", entry.data))) for entry in entries]
    return messages, sum(faults.counts.values())


def damage(content: bytes, rng: random.Random) -> bytes:
    damaged, how = bytearray(content), rng.randrange(3)
    if how == 0:
        return bytes(damaged[: rng.randrange(len(damaged))])
    if how == 1:
        for _ in range(3):
            damaged[rng.randrange(len(damaged))] ^= 1 << rng.randrange(8)
    else:
        at = rng.randrange(len(damaged) - 64)
        damaged[at : at + 64] = bytes(64)
    return bytes(damaged)


def try_copies(path: Path, read: Read, name: str) -> None:
    whole, usual = read(path)
    content, copy, rng = path.read_bytes(), path.with_name(f"copy{path.suffix}"), random.Random(1)
    counts: Counter[str] = Counter()
    for _ in range(NUM_COPIES):
        copy.write_bytes(damage(content, rng))
        try:
            messages, faults = read(copy)
        except Exception as error:  # noqa: BLE001 (other readers raise anything)
            counts[f"nothing read ({type(error).__name__})"] += 1
            continue
        counts["read"] += len(messages)
        counts["not reported"] += messages != whole and faults <= usual
    shares = f"{counts.pop('read') / (NUM_COPIES * NUM_MESSAGES):.0%} of messages read"
    print(f"{name:16} {shares}; {', '.join(f'{what} {num}' for what, num in sorted(counts.items()))}")


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        bag, mcap = Path(folder, "whole.bag"), Path(folder, "whole.mcap")
        write_bag(bag)
        write_mcap(mcap)
        try_copies(bag, read_by_rosbags, "bag, rosbags")
        try_copies(bag, read_by_fbench, "bag, fbench")
        try_copies(mcap, read_by_mcap, "MCAP, mcap")
        try_copies(mcap, read_by_fbench, "MCAP, fbench")


if __name__ == "__main__":
    main()
