"""What the writer refuses, and that it never leaves half a log."""

import errno
import os

import numpy as np
import pytest
from tests.replay.logs import builders as b
from tests.replay.logs.containers.parquet import logs

from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Image, PointCloud, Pose, Truth
from fbench.replay.data.rig import LogInfo, Mount, Rig
from fbench.replay.logs.containers.parquet.write import ParquetWriter

XYZ = np.zeros((1, 3), np.float32)


def test_options(tmp_path):
    with pytest.raises(ConfigError, match=r"compression 'lz5': choose one of zstd, snappy, none"):
        logs.write(tmp_path / "a", [], compression="lz5")
    with pytest.raises(ConfigError, match=r"rows_per_group 0: must be at least 1"):
        logs.write(tmp_path / "a", [], rows_per_group=0)
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=r"can't be written .Not a directory"):
        logs.write(tmp_path / "file" / "a", [])


@pytest.mark.parametrize(
    ("message", "match"),
    [
        (PointCloud("top", -1, 0, XYZ), "PointCloud at -1: stamp_ns -1 is outside 0 to"),
        (PointCloud("top", 0, 2**63, XYZ), "log_ns 9223372036854775808 is outside"),
        (PointCloud("top", 0, 0, XYZ, frame_number=2**32), "frame_number 4294967296 is outside"),
        (Image("cam", 5, 5, b"", "\ud800", (1, 1)), "Image at 5 can't be stored .*surrogates"),
        (PointCloud("\ud800", 5, 5, XYZ), "PointCloud at 5 can't be stored"),
        (Truth(5, 5, Boxes3D(XYZ, XYZ, np.zeros(1), label=np.array(["\ud800"]))), "Truth at 5 can't be"),
        (Image("cam", 5, 5, bytes(113 * 1024 * 1024), "rgb8", (1, 1)), r"has \d+ bytes, the limit is 117440512"),
        (Image("cam", 5, 5, b"", "rgb8", (2**63, 1)), "Image at 5 can't be stored"),
    ],
)
def test_messages_that_cannot_be_stored_are_refused_whole(tmp_path, message, match):
    with ParquetWriter(tmp_path / "a", b.INFO, b.NO_RIG) as writer:
        writer.write(Pose("ego", 1, 1, np.zeros(3), np.array([0, 0, 0, 1.0])))
        with pytest.raises(LogError, match=match):
            writer.write(message)
    reader, faults = logs.read(tmp_path / "a")
    assert [type(m) for m in reader.messages()] == [Pose]
    assert not list(reader.truths())
    assert not faults.counts


@pytest.mark.parametrize("info", [LogInfo("a", "\ud800"), LogInfo("a", "x", {"\ud800": ""})])
def test_metadata_that_are_not_unicode(tmp_path, info):
    with pytest.raises(LogError, match=r"its description can't be stored"):
        logs.write(tmp_path / "a", [], info=info)
    assert not list(tmp_path.iterdir())


def test_a_rig_with_nan(tmp_path):
    rig = Rig({"top": Mount("lidar", np.array([np.nan, 0, 0]), np.array([0, 0, 0, 1.0]))}, {})
    with pytest.raises(LogError, match=r"its description can't be stored"):
        logs.write(tmp_path / "a", [], rig)


def test_nothing_is_there_before_it_is_whole(tmp_path):
    with ParquetWriter(tmp_path / "a", b.INFO, b.NO_RIG, rows_per_group=1) as writer:
        for item in b.sequence(3):
            writer.write(item)
        assert not (tmp_path / "a").exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a"]


def test_nothing_is_left_after_an_error(tmp_path):
    def failing():
        yield from b.sequence(2)
        raise RuntimeError("no more")

    with pytest.raises(RuntimeError):
        logs.write(tmp_path / "a", failing())
    assert not list(tmp_path.iterdir())


def test_only_logs_are_replaced(tmp_path):
    path = logs.write(tmp_path / "a", b.sequence(3))
    logs.write(path, b.sequence(1))
    assert len(list(logs.read(path)[0].messages())) == 4
    (path / "notes.txt").write_text("mine")
    for other in (path, tmp_path):
        with pytest.raises(ConfigError, match=r"exists and isn't a Parquet log, so it isn't replaced"):
            logs.write(other, [])
    assert (path / "notes.txt").exists()


def test_closing_twice_is_harmless(tmp_path):
    with ParquetWriter(tmp_path / "a", b.INFO, b.NO_RIG) as writer:
        writer.close()
    assert not list(logs.read(tmp_path / "a")[0].messages())


def test_a_full_disk_is_one_line(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with ParquetWriter(tmp_path / "a", b.INFO, b.NO_RIG, rows_per_group=1) as writer:
        writer.write(PointCloud("top", 0, 0, XYZ))
        monkeypatch.setattr("fbench.replay.logs.containers.parquet.stream_write._Sink.write", full)
        with pytest.raises(ConfigError, match=r"a: can't be written .*No space left on device"):
            writer.write(PointCloud("top", 1, 1, XYZ))
        monkeypatch.undo()
        writer.discard()
    assert not list(tmp_path.iterdir())


def test_file_names_are_plain_and_differ_even_without_case(tmp_path):
    names = ["top", "Top", "../up", "a b", "ü", ".", "x" * 300, "con/../..", "-"]
    path = logs.write(tmp_path / "a", [PointCloud(name, 0, 0, XYZ) for name in names])
    files = [file.name for file in path.iterdir()]
    assert len({file.lower() for file in files}) == len(names) + 1
    assert all(file.isascii() and file[0] not in ".-" and len(file) < 100 and "/" not in file for file in files)
    reader, _ = logs.read(path)
    assert {m.sensor for m in reader.messages()} == set(names)
