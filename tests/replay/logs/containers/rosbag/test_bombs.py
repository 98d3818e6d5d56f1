"""Small files that unpack to much: refused or counted at once, within bounded memory; each runs in its own process."""

import bz2
import subprocess
import sys

import lz4.frame
import pytest
import zstandard
from tests.replay.logs.containers.rosbag import builders as b
from tests.replay.logs.containers.rosbag.test_bag1 import bag_header, chunk, connection, message
from tests.replay.logs.containers.rosbag.test_sqlite import written

from fbench.replay.logs.containers.mcap.records import MAX_RECORD

CHILD = """
import re, sys, time
from pathlib import Path
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.containers.rosbag.bag1 import Ros1Bag
from fbench.replay.logs.containers.rosbag.sqlite import Db3File
import bz2, lz4.frame, numpy, zstandard

def peak():
    return int(re.search(r"VmHWM:\\s+([0-9]+)", Path("/proc/self/status").read_text())[1]) / 1024

base, start, faults = peak(), time.process_time(), FaultLog()
try:
    path = Path(sys.argv[1])
    file = Ros1Bag(path, faults) if path.suffix == ".bag" else Db3File(path, faults, "zstd")
    num = sum(1 for _ in file.entries(frozenset(file.channels)))
    print(f"{num} messages,", *[place for places in faults.places.values() for place in places])
except LogError as error:
    print(error)
print(peak() - base, time.process_time() - start)
"""
ZEROS = bytes(64 * 1024 * 1024)


def outcome(path):
    """What was said, and how much memory [MiB] and time [s] it took beyond the start."""
    run = subprocess.run([sys.executable, "-c", CHILD, str(path)], capture_output=True, text=True, check=True)
    text, numbers = run.stdout.strip().rsplit("\n", 1)
    mib, seconds = map(float, numbers.split())
    return text, mib, seconds


def packed(compression, num=20):
    """More than a GiB in some KiB."""
    if compression == "bz2":
        return bz2.compress(ZEROS)
    compressor = lz4.frame.LZ4FrameCompressor()
    return b"".join([compressor.begin(), *(compressor.compress(ZEROS) for _ in range(num)), compressor.flush()])


@pytest.mark.slow
@pytest.mark.parametrize("compression", ["bz2", "lz4"])
@pytest.mark.parametrize(("size", "match"), [(1000, "declares 1000 unpacked bytes and has more"), (2**32 - 1, "limit")])
def test_chunks_that_unpack_to_more(tmp_path, compression, size, match):
    path = tmp_path / "a.bag"
    good = chunk(connection(7) + message(7, 1))
    path.write_bytes(bag_header() + good + chunk(packed(compression), compression.encode(), size))
    text, mib, seconds = outcome(path)
    assert match in text
    assert mib < 100
    assert seconds < 1


@pytest.mark.slow
def test_chunk_of_the_largest_size_that_holds_garbage(tmp_path):
    path = tmp_path / "a.bag"
    path.write_bytes(bag_header() + chunk(packed("lz4", 5), b"lz4", MAX_RECORD))
    text, mib, seconds = outcome(path)
    assert f"declares {MAX_RECORD} unpacked bytes and has more" in text
    assert mib < 400
    assert seconds < 1


@pytest.mark.slow
def test_chunk_of_very_many_messages(tmp_path):
    content = message(7, 1, b"") * 1_000_000
    path = tmp_path / "a.bag"
    path.write_bytes(bag_header() + chunk(lz4.frame.compress(content), b"lz4", len(content)))
    text, mib, _ = outcome(path)
    assert "holds more than the limit of 262144 records" in text
    assert mib < 300


@pytest.mark.slow
def test_header_of_very_many_fields(tmp_path):
    path = tmp_path / "a.bag"
    path.write_bytes(bag_header()[:-4] + b"\0\0\0\0" + (10_000_000).to_bytes(4, "little") + b"\2\0\0\0a=" * 2_000_000)
    text, mib, _ = outcome(path)
    assert "0 messages" in text
    assert mib < 100


@pytest.mark.slow
@pytest.mark.parametrize("tells_size", [True, False])
def test_messages_that_unpack_to_more(tmp_path, tells_size):
    compressor = zstandard.ZstdCompressor(write_content_size=tells_size).compressobj(
        size=20 * len(ZEROS) if tells_size else -1
    )
    data = b"".join([*(compressor.compress(ZEROS) for _ in range(20)), compressor.flush()])
    assert len(data) < 200_000
    path = written(tmp_path, [(0, 1, data), (0, 2, zstandard.compress(b"x"))])
    text, mib, seconds = outcome(path)
    assert text.startswith("1 messages,")
    assert "unpacked bytes" in text
    assert mib < 512
    assert seconds < 1


@pytest.mark.slow
def test_recordings_of_others_cost_little(tmp_path):
    _, mib, _ = outcome(b.write_bag1(tmp_path / "a.bag", b.rows()))
    assert mib < 50
