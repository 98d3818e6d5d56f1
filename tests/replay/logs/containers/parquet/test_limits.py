"""Memory is bounded: for long logs, for many streams, for what files claim to need."""

import subprocess
import sys
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from tests.replay.logs import builders as b
from tests.replay.logs.containers.parquet import logs
from tests.replay.logs.containers.parquet.test_foreign import LIDAR, all_of, clouds, foreign

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.messages import PointCloud
from fbench.replay.logs.containers.parquet import groups, write
from fbench.replay.logs.containers.parquet import groups as pages

ROOT = Path(__file__).resolve().parents[5]
READ = """
import resource, sys
from pathlib import Path
import numpy, pyarrow.parquet
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.open import open_log

base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
faults = FaultLog()
try:
    print(sum(1 for _ in open_log(Path(sys.argv[1]), faults).messages()), dict(faults.counts))
except LogError as error:
    print(error)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base) // 1024)
"""


def read_elsewhere(path):
    """Read a log in another process; returns what it said and how many MiB it took."""
    result = subprocess.run([sys.executable, "-c", READ, str(path)], capture_output=True, text=True, timeout=60)
    assert result.returncode == 0, result.stderr
    said, size = result.stdout.splitlines()
    return said, int(size)


def varint(value):
    value <<= 1
    data = b""
    while value > 127:
        data += bytes([value & 127 | 128])
        value >>= 7
    return data + bytes([value])


def claim(path, unpacked, num_values=1):
    """Let the page of `xyz` claim other sizes than it has, all checksums being right."""
    file = path / "top.points.parquet"
    data = bytearray(file.read_bytes())
    column = next(
        c for c in map(pq.read_metadata(file).row_group(0).column, range(9)) if c.path_in_schema == "xyz"
    )  # fmt: skip
    start, length = column.data_page_offset, column.total_compressed_size

    def header(stored):
        inner = b"\x15" + varint(num_values) + b"\x15\x00\x15\x06\x15\x06\x00"
        return b"\x15\x00\x15" + varint(unpacked) + b"\x15" + varint(stored) + b"\x2c" + inner + b"\x00"

    head = header(length - len(header(length)))
    data[start : start + len(head)] = head
    file.write_bytes(data)

    def change(log):
        sums = log["streams"][0]["checksums"]["row_groups"]
        sums["crc32"] = [zlib.crc32(data[sums["offset"][0] : sums["offset"][0] + sums["length"][0]])]

    return logs.edit(path, change)


@pytest.mark.slow
@pytest.mark.parametrize(("unpacked", "num_values"), [(2**31 - 1, 1), (300 * 2**20, 1), (100, 2**30)])
def test_a_page_that_claims_gigabytes_is_refused(tmp_path, unpacked, num_values):
    xyz = np.random.Generator(np.random.Philox(1)).normal(size=(20_000, 3)).astype(np.float32)
    path = claim(logs.write(tmp_path / "a", [PointCloud("top", 1, 1, xyz)]), unpacked, num_values)
    said, size = read_elsewhere(path)
    assert "column 'xyz': a page takes" in said
    assert "the limit is 268435456; write smaller row groups" in said
    assert size < 100


@pytest.mark.slow
def test_values_that_a_dictionary_multiplies_are_read_in_pieces(tmp_path):
    xyz = pa.DictionaryArray.from_arrays(pa.array([0] * 700, pa.int32()), pa.array([bytes(12 * 87_000)]))
    path = foreign(
        tmp_path / "a", (LIDAR, clouds(700, xyz=xyz), {"dictionary_pagesize_limit": 2**21, "store_schema": False})
    )
    assert (path / "0.parquet").stat().st_size < 2**21
    said, size = read_elsewhere(path)
    assert said.startswith("700 {")
    assert size < 400


def test_a_footer_with_too_many_parts_is_refused(tmp_path):
    path = foreign(tmp_path / "a", (LIDAR, clouds()))
    tail = bytes(500_000)
    (path / "0.parquet").write_bytes(b"PAR1" + tail + len(tail).to_bytes(4, "little") + b"PAR1")
    with pytest.raises(LogError, match=r"its footer is too large to be read safely; write larger row groups"):
        logs.read(path)


def test_growing_encodings_are_refused(tmp_path):
    how = {"use_dictionary": False, "column_encoding": {"xyz": "DELTA_BYTE_ARRAY"}}
    with pytest.raises(LogError, match=r"'xyz': encoding DELTA_BYTE_ARRAY can't be bounded in memory; write"):
        all_of(foreign(tmp_path / "a", (LIDAR, clouds(), how)))


@pytest.fixture
def small_limit(monkeypatch):
    for module in (groups, pages):
        monkeypatch.setattr(module, "MAX_DECODED", 200_000)
    monkeypatch.setattr(groups, "_PART", 50_000)


def big(order):
    rng = np.random.Generator(np.random.Philox(1))
    xyz = [rng.normal(size=(100, 3)).astype(np.float32).tobytes() for _ in order]
    return {"log_ns": list(order), "stamp_ns": list(order), "xyz": xyz}


@pytest.mark.parametrize(
    "how", [{"dictionary_pagesize_limit": 20_000}, {"use_dictionary": False, "compression": "none"}]
)
def test_large_row_groups_are_read_in_pieces(tmp_path, small_limit, how):
    how = {"write_batch_size": 8, "data_page_size": 20_000, **how}
    path = foreign(tmp_path / "a", (LIDAR, big(range(400)), how))
    found, faults = all_of(path)
    assert [m.stamp_ns for m in found] == list(range(400))
    assert [m.xyz.tobytes() for m in found] == big(range(400))["xyz"]
    assert set(faults.counts) == {"LOG006"}


def test_large_row_groups_in_no_order_are_refused(tmp_path, small_limit):
    how = {"write_batch_size": 8, "data_page_size": 20_000, "use_dictionary": False}
    path = foreign(tmp_path / "a", (LIDAR, big([*range(399), 0]), how))
    with pytest.raises(LogError, match=r"row group 0 takes more than .* and isn't in the order of log_ns; sort it"):
        all_of(path)


def test_large_row_groups_of_lists_are_refused(tmp_path, small_limit):
    rows = {"log_ns": range(4000), "stamp_ns": range(4000), "translation_m": [[1.0, 2, 3]] * 4000}
    columns = {**rows, "rotation_xyzw": [[0.0, 0, 0, 1]] * 4000}
    path = foreign(tmp_path / "a", ({"kind": "pose", "sensor": "ego"}, columns))
    with pytest.raises(LogError, match=r"write smaller row groups"):
        all_of(path)


def sweeps(num, sensors=1):
    rng = np.random.Generator(np.random.Philox(0))
    for i in range(num):
        yield PointCloud(f"top{i % sensors}", i, i, rng.normal(size=(20_000, 3)).astype(np.float32))


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_reading_holds_few_row_groups(tmp_path, compression):
    path = logs.write(tmp_path / "a", sweeps(100), compression=compression, rows_per_group=4)
    reader, _ = logs.read(path)
    before, most, num = pa.total_allocated_bytes(), 0, 0
    tracemalloc.start()
    for _ in reader.messages():
        most, num = max(most, pa.total_allocated_bytes() - before), num + 1
    _, traced = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert num == 100
    assert most < 4_000_000
    assert traced < 4_000_000


@pytest.mark.slow
def test_writing_many_streams_holds_little(tmp_path, monkeypatch):
    monkeypatch.setattr(write, "_MAX_PENDING", 2_000_000)
    tracemalloc.start()
    path = logs.write(tmp_path / "a", sweeps(200, sensors=50))
    _, traced = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert traced < 6_000_000
    reader, faults = logs.read(path)
    assert [m.stamp_ns for m in reader.messages()] == list(range(200))
    assert not faults.counts


def test_more_row_groups_than_can_be_read_are_not_written(tmp_path, monkeypatch):
    monkeypatch.setattr("fbench.replay.logs.containers.parquet.stream_write.MAX_ZEROS", 1000)
    with pytest.raises(LogError, match=r"parquet: more row groups than can be read; write more rows a group"):
        logs.write(tmp_path / "a", b.sequence(40), rows_per_group=1)
    assert not list(tmp_path.iterdir())
