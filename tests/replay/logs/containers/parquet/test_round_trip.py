"""Everything that is written is read back bit for bit, and is the same as from MCAP."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.replay.logs import builders as b
from tests.replay.logs.containers.parquet import logs

from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.messages import PointCloud, Pose, Truth
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.logs.containers.parquet.write import ParquetWriter
from fbench.replay.runs.secrets import clean_mapping

quick = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
compressions = st.sampled_from(["none", "snappy", "zstd"])


def kept(items, **how):
    """Write messages and truth, return what is read and what MCAP gives."""
    with tempfile.TemporaryDirectory() as folder:
        reader, faults = logs.read(logs.write(Path(folder) / "log.parquetlog", items, **how))
        found = logs.content(reader)
        other, _ = b.read(b.write(Path(folder) / "log.mcap", items))
        expected = logs.content(other)
    assert not faults.counts
    assert found == expected
    return found


@pytest.mark.slow
@quick
@given(st.one_of(b.images, b.clouds, b.scans, b.poses, b.truths), compressions)
def test_one(item, compression):
    assert kept([item], compression=compression) == [b.canonical(item)]


@pytest.mark.slow
@quick
@given(st.lists(st.one_of(b.clouds, b.poses, b.truths), max_size=6), st.none() | st.integers(1, 3))
def test_several_in_the_order_of_mcap(items, rows_per_group):
    kept(items, rows_per_group=rows_per_group)


@pytest.mark.slow
@pytest.mark.parametrize("compression", ["none", "snappy", "zstd"])
@pytest.mark.parametrize("rows_per_group", [None, 1, 64, 4096])
def test_a_drive(tmp_path, compression, rows_per_group):
    items = b.sequence(80)
    path = logs.write(tmp_path / "a", items, b.the_rig(), compression=compression, rows_per_group=rows_per_group)
    reader, faults = logs.read(path)
    expected, _ = b.read(b.write(tmp_path / "a.mcap", items, b.the_rig()))
    assert logs.content(reader) == logs.content(expected)
    assert b.canonical(reader.rig) == b.canonical(b.the_rig())
    assert reader.info == LogInfo("a", "id-1", {"place": "Köln"})
    assert reader.num_messages == expected.num_messages
    assert not faults.counts


@pytest.mark.parametrize(
    ("boxes3d", "boxes2d"),
    [(None, None), (Boxes3D.empty(), None), (None, Boxes2D.empty()), (Boxes3D.empty(), Boxes2D.empty())],
)
def test_not_labeled_is_not_the_same_as_empty(boxes3d, boxes2d):
    truth = Truth(5, 6, boxes3d, boxes2d)
    assert kept([truth]) == [b.canonical(truth)]


def test_bits_of_nan_and_the_sign_of_zero_are_kept():
    odd = np.array([0x7FF8000000000001, 0xFFF8000000000000, 0x8000000000000000], np.uint64).view(np.float64)
    single = np.array([0x7FC00001, 0xFFC00000, 0x80000000], np.uint32).view(np.float32)
    truth = Truth(0, 0, Boxes3D(odd[None], odd[None], odd[:1]))
    kept([truth, PointCloud("top", 0, 0, single[None], single[:1]), Pose("ego", 0, 0, odd, np.append(odd, 1.0))])


def test_points_are_views_of_one_buffer(tmp_path):
    clouds = [m for m in b.sequence(5) if isinstance(m, PointCloud)]
    reader, _ = logs.read(logs.write(tmp_path / "a", clouds))
    found = [m.xyz for m in reader.messages()]
    assert not any(xyz.flags.writeable or xyz.flags.owndata for xyz in found)
    assert all(xyz.flags.aligned for xyz in found)


def test_two_streams_on_one_topic_keep_their_order(tmp_path):
    upright = np.array([0, 0, 0, 1.0])
    poses = [Pose("gnss" if i % 3 else "odometry", i, 7, np.full(3, float(i)), upright) for i in range(20)]
    path = logs.write(tmp_path / "a", poses, rows_per_group=4)
    reader, _ = logs.read(path)
    assert [m.stamp_ns for m in reader.messages()] == list(range(20))


def test_written_in_any_order(tmp_path):
    items = [m for m in b.sequence(30) if not isinstance(m, Truth)]
    mixed = [items[i] for i in np.random.Generator(np.random.Philox(3)).permutation(len(items))]
    for rows_per_group in (1, 7, None):
        path = logs.write(tmp_path / f"{rows_per_group}", mixed, rows_per_group=rows_per_group)
        a, _ = logs.read(logs.write(tmp_path / "sorted", items))
        c, _ = logs.read(path)
        assert logs.content(a) == logs.content(c)


@pytest.mark.slow
@quick
@given(
    st.dictionaries(b.names, b.mounts, max_size=4),
    st.dictionaries(b.names, b.cameras, max_size=3),
    st.dictionaries(b.texts, b.texts),
    b.texts,
)
def test_rig_and_info(mounts, cameras, metadata, log_id):
    cameras |= {
        name: CameraModel(np.eye(3), (4, 3)) for name, m in mounts.items() if m.kind == "camera" and name not in cameras
    }
    rig, info = Rig(mounts, cameras), LogInfo("log", log_id, metadata)
    with tempfile.TemporaryDirectory() as folder:
        reader, faults = logs.read(logs.write(Path(folder) / "log", [], rig, info))
        assert reader.info == LogInfo("log", log_id, clean_mapping(metadata))  # a word may happen to name a secret
        assert b.canonical(reader.rig.mounts) == b.canonical(mounts)
        assert b.canonical(reader.rig.cameras) == b.canonical(cameras)
    assert not faults.counts


def test_rig_that_changes(tmp_path):
    turned = Rig({"top": Mount("lidar", np.ones(3), np.array([0, 0, 1.0, 0]))}, {})
    first = Rig({"top": Mount("lidar", np.zeros(3), np.array([0, 0, 0, 1.0]))}, {})
    with ParquetWriter(tmp_path / "a", b.INFO, first) as writer:
        for i in range(4):
            writer.write(PointCloud("top", i, i, np.zeros((1, 3), np.float32)))
        writer.write_rig(2, turned)
    reader, _ = logs.read(tmp_path / "a")
    assert [(log_ns, b.canonical(rig)) for log_ns, rig in reader.container.rigs] == [
        (0, b.canonical(first)),
        (2, b.canonical(turned)),
    ]
    assert [type(m).__name__ for m in reader.messages()].index("RigChange") == 2


def test_equal_input_gives_equal_bytes(tmp_path):
    for name in ("a", "b"):
        logs.write(tmp_path / name, b.sequence(20), b.the_rig(), rows_per_group=8)
    files = sorted(file.name for file in (tmp_path / "a").iterdir())
    assert len(files) == 6
    assert all((tmp_path / "a" / f).read_bytes() == (tmp_path / "b" / f).read_bytes() for f in files)


def test_index_tells_times_and_counts(tmp_path):
    reader, _ = logs.read(logs.write(tmp_path / "a", b.sequence(30), rows_per_group=7))
    container = reader.container
    expected = {id_: [] for id_ in container.channels}
    for entry in container.entries(frozenset(container.channels)):
        expected[entry.channel].append(entry.log_ns)
    assert {id_: times.tolist() for id_, times in container.log_times().items()} == expected
    assert dict(container.counts) == {id_: len(times) for id_, times in expected.items()}
    assert container.header.log_id == "id-1"
