"""Bit flips and cuts anywhere: never wrong data, never less without a fault, never another error."""

import shutil
from contextlib import suppress

import numpy as np
import pytest
from tests.replay.logs import builders as b
from tests.replay.logs.containers.parquet import logs

from fbench.replay.contracts.errors import FbenchError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.containers.parquet.folder import ParquetFolder

KINDS = {
    "none": {"compression": "none"},
    "snappy": {"compression": "snappy"},
    "zstd": {"compression": "zstd"},
    "small": {"rows_per_group": 2},
}


@pytest.fixture(scope="module", params=sorted(KINDS))
def log(request, tmp_path_factory):
    """A log, and all that is in it."""
    items = b.sequence(8, points=10)
    path = logs.write(tmp_path_factory.mktemp("log") / "a", items, b.the_rig(), **KINDS[request.param])
    return path, whole(path)


def whole(path):
    reader, faults = logs.read(path)
    return logs.counted(logs.content(reader)), (reader.info, b.canonical(reader.rig)), faults.counts


def check(path, expected):
    """Whatever was done to the log: it is refused, or what is left is right and what is lost was counted."""
    with suppress(FbenchError):
        found, about, faults = whole(path)
        assert about == expected[1]
        assert not found - expected[0]
        assert faults or found == expected[0]
        assert not set(faults) - {"PQ002"}


def flips(path, num, seed):
    """Files with one bit changed, spread over all bytes of the log."""
    rng = np.random.Generator(np.random.Philox(seed))
    files = sorted(path.iterdir())
    contents = [file.read_bytes() for file in files]
    ends = np.cumsum([len(data) for data in contents])
    for at, bit in zip(rng.integers(0, ends[-1], num).tolist(), rng.integers(0, 8, num).tolist(), strict=True):
        which = int(np.searchsorted(ends, at, "right"))
        data = bytearray(contents[which])
        data[at - int(ends[which])] ^= 1 << bit
        files[which].write_bytes(data)
        yield
        files[which].write_bytes(contents[which])


@pytest.mark.slow
def test_bit_flips(log):
    path, expected = log
    for _ in flips(path, 150, 1):
        check(path, expected)


@pytest.mark.slow
def test_many_bit_flips(log):
    path, expected = log
    for _ in flips(path, 500, 2):
        check(path, expected)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.7, 0.99, 0.999])
def test_truncated_files_are_refused_by_name(log, tmp_path, share):
    for file in sorted(log[0].iterdir()):
        path = shutil.copytree(log[0], tmp_path / f"{file.name}-{share}")
        data = file.read_bytes()
        (path / file.name).write_bytes(data[: int(len(data) * share)])
        with pytest.raises(LogError, match=file.name):
            logs.read(path)


def test_missing_files_are_refused_by_name(log, tmp_path):
    for file in sorted(log[0].iterdir()):
        path = shutil.copytree(log[0], tmp_path / file.name)
        (path / file.name).unlink()
        with pytest.raises(LogError, match=f"{file.name}: is missing"):
            logs.read(path)


def test_a_damaged_row_group_is_skipped_and_counted_once(tmp_path):
    path = logs.write(tmp_path / "a", b.sequence(20), rows_per_group=5)
    offset = ParquetFolder(path, FaultLog())._streams[0].groups.sums.offset[2]
    file = path / "cam.image.parquet"
    data = bytearray(file.read_bytes())
    data[offset + 300] ^= 1
    file.write_bytes(data)
    reader, faults = logs.read(path)
    for _ in range(2):
        stamps = [m.stamp_ns for m in reader.messages() if m.sensor == "cam"]
        assert stamps == [1_000_000_000 + i * 50_000_000 for i in (*range(10), *range(15, 20))]
    reader.container.log_times()
    assert dict(faults.counts) == {"PQ002": 1}
    assert faults.places["PQ002"] == ["a: cam.image.parquet: row group 2: checksum doesn't match"]


def test_swapped_files_are_refused(tmp_path):
    path = logs.write(tmp_path / "a", b.sequence(4))
    a, c = path / "top.points.parquet", path / "front.points.parquet"
    data = a.read_bytes()
    a.write_bytes(c.read_bytes())
    c.write_bytes(data)
    with pytest.raises(LogError, match=r"points.parquet: (truncated|changed), it has \d+ bytes instead of \d+"):
        logs.read(path)


def test_changed_description_is_refused(tmp_path):
    path = logs.write(tmp_path / "a", b.sequence(4), b.the_rig())
    file = path / "log.json"
    file.write_text(file.read_text().replace('"place": "Köln"', '"place": "Bonn"'))
    with pytest.raises(LogError, match=r"log.json: damaged, its digest doesn't match; who edits it removes the key"):
        logs.read(path)


def test_edited_description_without_digest_is_unverified(tmp_path):
    path = logs.edit(logs.write(tmp_path / "a", b.sequence(4)), lambda log: log["metadata"].update(place="Bonn"))
    reader, faults = logs.read(path)
    assert reader.info.metadata == {"place": "Bonn"}
    assert dict(faults.counts) == {"LOG006": 1}
