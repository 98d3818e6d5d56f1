"""Whatever form a log takes on the way, it comes back as it was."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
from tests.replay.logs import builders as b
from tests.replay.logs.convert.helpers import content, converted, digest, messages
from tests.replay.logs.other_forms import NO_SUMMARY, rewrite, shuffled_topics

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.messages import PointCloud, Pose, Truth
from fbench.replay.data.rig import Mount, Rig
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.open import open_container

quick = settings(max_examples=40, suppress_health_check=[HealthCheck.too_slow])
NONE = np.array([0, 0, 0, 1.0])


@pytest.fixture(scope="module")
def expected(drive):
    return messages(drive), content(drive), digest(drive)


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
@pytest.mark.parametrize("chunk_size", [4 * 1024, 1024 * 1024, 64 * 1024 * 1024])
def test_mcap_of_any_kind(tmp_path, drive, expected, compression, chunk_size):
    out = converted(drive, tmp_path / "out.mcap", compression=compression, chunk_size=chunk_size)
    assert (messages(out), content(out), digest(out)) == expected


@pytest.mark.slow
@pytest.mark.parametrize("compression", ["none", "snappy", "zstd"])
@pytest.mark.parametrize("rows", [1, 64, 4096, None])
def test_parquet_of_any_kind_and_back(tmp_path, drive, expected, compression, rows):
    there = converted(drive, tmp_path / "out.parquet", compression=compression, rows_per_group=rows)
    assert (content(there), digest(there)) == expected[1:]
    assert all(channel.encoding == "fbench" for channel in open_container(there, FaultLog()).channels.values())
    back = converted(there, tmp_path / "back.mcap")
    assert (messages(back), content(back), digest(back)) == expected


@pytest.mark.slow
@pytest.mark.parametrize(
    "how",
    [
        {"use_chunking": False},
        {"use_chunking": False, **NO_SUMMARY},
        {"compression": CompressionType.LZ4, **NO_SUMMARY},
        {"order": shuffled_topics, "chunk_size": 3000},
        {"order": shuffled_topics, "use_chunking": False, **NO_SUMMARY},
    ],
)
@pytest.mark.parametrize("name", ["out.mcap", "out.parquet"])
def test_sources_of_any_kind(tmp_path, drive, expected, how, name):
    out = converted(rewrite(drive, tmp_path / "in.mcap", **how), tmp_path / name)
    assert (content(out), digest(out)) == expected[1:]
    assert messages(converted(out, tmp_path / "back.mcap")) == expected[0]


def test_parquet_to_parquet(tmp_path, drive, expected):
    first = converted(drive, tmp_path / "first.parquet")
    second = converted(first, tmp_path / "second.parquet", rows_per_group=3, compression="snappy")
    assert messages(converted(second, tmp_path / "back.mcap")) == expected[0]


def test_equal_input_gives_equal_bytes(tmp_path, drive):
    one, two = (converted(drive, tmp_path / f"{name}.parquet") for name in ("one", "two"))
    assert [f.read_bytes() for f in sorted(one.iterdir())] == [f.read_bytes() for f in sorted(two.iterdir())]
    first, second = (converted(one, tmp_path / f"{name}.mcap") for name in ("one", "two"))
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.slow
@quick
@given(st.lists(st.one_of(b.clouds, b.scans, b.poses), max_size=4), st.lists(b.truths, max_size=3))
def test_every_field_of_every_type(items, truths):
    with tempfile.TemporaryDirectory() as folder:
        kept = _one_kind_a_sensor(items)
        path = b.write(Path(folder) / "log.mcap", [*kept, *truths])
        there = converted(path, Path(folder) / "log.parquet")
        assert messages(converted(there, Path(folder) / "back.mcap")) == messages(path)
        first, second = b.read(path)[0], b.read(there)[0]
        assert list(map(b.canonical, first.messages())) == list(map(b.canonical, second.messages()))
        assert list(map(b.canonical, first.truths())) == list(map(b.canonical, second.truths()))


@quick
@given(st.lists(b.images, max_size=3))
def test_images(items):
    with tempfile.TemporaryDirectory() as folder:
        kept = [image for image in items if image.encoding == "jpeg"]
        path = b.write(Path(folder) / "log.mcap", kept)
        there = converted(path, Path(folder) / "log.parquet")
        assert messages(converted(there, Path(folder) / "back.mcap")) == messages(path)


def _one_kind_a_sensor(items):
    """A topic holds messages of one kind."""
    kinds: dict[str, type] = {}
    return [item for item in items if kinds.setdefault(item.sensor, type(item)) is type(item)]


def test_truth_in_all_its_shapes(tmp_path):
    boxes3d = [None, Boxes3D.empty(), Boxes3D(np.ones((2, 3)), np.ones((2, 3)), np.array([np.nan, -0.0]))]
    boxes2d = [None, Boxes2D.empty(), Boxes2D(np.array(["cam", "ü"]), np.ones((2, 4)), score=np.array([0.5, 1 / 3]))]
    truths = [Truth(i, i // 2, x, y) for i, (x, y) in enumerate((x, y) for x in boxes3d for y in boxes2d)]
    path = b.write(tmp_path / "log.mcap", truths)
    there = converted(path, tmp_path / "log.parquet")
    assert list(map(b.canonical, b.read(there)[0].truths())) == list(map(b.canonical, truths))
    assert messages(converted(there, tmp_path / "back.mcap")) == messages(path)


def rig(x: float) -> Rig:
    """A rig that doesn't know what comes first in the alphabet."""
    return Rig({name: Mount("lidar", np.array([x, 1 / 3, 0]), NONE) for name in ("a", "zz")}, {})


def changing(path: Path) -> Path:
    """Two changes of the rig, at the very log time of a message."""
    with McapWriter(path, b.INFO, rig(0)) as writer:
        for i in range(12):
            if i in (5, 8):
                writer.write_rig(i * 10, rig(i))
            for name in ("a", "zz"):
                writer.write(PointCloud(name, i, i * 10, np.full((2, 3), i, np.float32)))
    return path


def test_changes_of_the_rig(tmp_path):
    path = changing(tmp_path / "log.mcap")
    there = converted(path, tmp_path / "log.parquet")
    assert [log_ns for log_ns, _ in open_container(there, FaultLog()).rigs] == [0, 50, 80]
    assert (content(there), digest(there)) == (content(path), digest(path))
    kinds = [item[0] for item in content(path)[-1]]
    assert [i for i, kind in enumerate(kinds) if kind == "RigChange"] == [10, 17]
    assert messages(converted(there, tmp_path / "back.mcap")) == messages(path)


def test_a_parquet_log_that_begins_with_its_rig(tmp_path):
    """Its rig has no times: in MCAP it comes with the first message."""
    from fbench.replay.logs.containers.parquet.write import ParquetWriter

    with ParquetWriter(tmp_path / "log.parquet", b.INFO, rig(1)) as writer:
        for i in range(3):
            writer.write(Pose("ego", 7 + i, 9 + i, np.zeros(3), NONE))
        writer.write_rig(10, rig(2))
    path = converted(tmp_path / "log.parquet", tmp_path / "log.mcap")
    assert content(path) == content(tmp_path / "log.parquet")
    transforms = [(log_ns, stamp_ns) for channel, log_ns, stamp_ns, *_ in messages(path) if channel.topic == "/tf"]
    assert transforms == [(9, 7)] * 2 + [(10, 10)] * 2


@pytest.mark.parametrize("name", ["out.mcap", "out.parquet"])
def test_sensors_without_messages_and_logs_without_any(tmp_path, name):
    path = b.write(tmp_path / "log.mcap", [], b.the_rig())
    assert content(converted(path, tmp_path / name)) == content(path)
    empty = b.write(tmp_path / "empty.mcap", [])
    assert content(converted(empty, tmp_path / f"empty-{name}")) == content(empty)


@pytest.mark.slow
def test_the_real_recording(tmp_path, shared):
    path = shared / "data" / "mcap" / "kitti_raw_12frames_ros2.mcap"
    there = converted(path, tmp_path / "kitti.parquet")
    back = converted(there, tmp_path / "kitti.mcap")
    assert messages(path) == messages(there) == messages(back)
    assert digest(path) == digest(there) == digest(back)
    assert content(path) == content(there) == content(back)
