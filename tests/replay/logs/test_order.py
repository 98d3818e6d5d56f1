"""The canonical order, whatever the container and however it was written."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
from tests.replay.logs import builders as b
from tests.replay.logs.other_forms import NO_SUMMARY, rewrite, shuffled_topics

from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.messages import PointCloud, Pose, Truth

NONE = np.array([0, 0, 0, 1.0])


def content(path):
    reader, faults = b.read(path)
    return [b.canonical(m) for m in reader.messages()], [b.canonical(t) for t in reader.truths()], faults


def pose(log_ns, i=0, sensor="ego"):
    return Pose(sensor, i, log_ns, np.full(3, i), NONE)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return b.write(tmp_path_factory.mktemp("log") / "log.mcap", b.sequence(), b.the_rig(), chunk_size=4000)


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize(
    ("how", "codes"),
    [
        ({"chunk_size": 1}, {}),
        ({"chunk_size": 5000}, {}),
        ({"chunk_size": 10**8}, {}),
        ({"chunk_size": 5000, "order": shuffled_topics}, {}),
        ({"chunk_size": 5000, **NO_SUMMARY}, {"LOG003": 1}),
        ({"chunk_size": 5000, "order": shuffled_topics, **NO_SUMMARY}, {"LOG003": 1}),
        ({"chunk_size": 5000, "repeat_channels": False}, {"LOG003": 1}),
        ({"use_chunking": False}, {"LOG003": 1}),
        ({"use_chunking": False, "order": shuffled_topics, **NO_SUMMARY}, {"LOG003": 1}),
    ],
)
def test_all_containers_hold_the_same(tmp_path, plain, compression, how, codes):
    expected = content(plain)
    assert len(expected[0]) == 160
    assert len(expected[1]) == 40
    found = content(rewrite(plain, tmp_path / "other.mcap", compression=compression, **how))
    assert found[:2] == expected[:2]
    assert dict(found[2].counts) == codes


def test_rig_and_info_do_not_depend_on_the_container(tmp_path, plain):
    other = rewrite(plain, tmp_path / "log.mcap", use_chunking=False, order=shuffled_topics, **NO_SUMMARY)
    first, second = b.read(plain)[0], b.read(other)[0]
    assert first.info == second.info
    assert b.canonical(first.rig) == b.canonical(second.rig)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.sampled_from(["a", "b", "c"]), st.integers(0, 6)), max_size=30),
    st.sampled_from([1, 120, 400, 10**6]),
    st.sampled_from(["zstd", "lz4", "none"]),
)
def test_order_is_log_time_then_topic_then_position(pairs, chunk_size, compression):
    items = [PointCloud(s, i, t, np.full((1, 3), i, np.float32)) for i, (s, t) in enumerate(pairs)]
    with tempfile.TemporaryDirectory() as folder:
        path = b.write(Path(folder) / "log.mcap", items, chunk_size=chunk_size, compression=compression)
        found = list(b.read(path)[0].messages())
    expected = sorted(items, key=lambda m: (m.log_ns, f"/{m.sensor}/points", m.stamp_ns))
    assert [b.canonical(m) for m in found] == [b.canonical(m) for m in expected]


def test_equal_stamps_of_one_topic_keep_the_order_in_which_they_were_written(tmp_path):
    items = [pose(5, 3), pose(5, 1), pose(5, 2, "other"), pose(4, 9)]
    reader, _ = b.read(b.write(tmp_path / "log.mcap", items, chunk_size=1))
    assert [m.stamp_ns for m in reader.messages()] == [9, 3, 1, 2]


def test_truth_comes_in_the_order_of_its_stamps(tmp_path):
    items = [Truth(stamp, 100 - stamp, Boxes3D.empty()) for stamp in (5, 3, 9, 4)]
    reader, _ = b.read(b.write(tmp_path / "log.mcap", items))
    assert [t.stamp_ns for t in reader.truths()] == [3, 4, 5, 9]


def test_3d_and_2d_truth_of_one_stamp_come_together(tmp_path):
    both = [Truth(i, 7, Boxes3D.empty(), Boxes2D.empty() if i % 2 else None) for i in range(6)]
    reader, _ = b.read(b.write(tmp_path / "log.mcap", both))
    assert [(t.stamp_ns, t.boxes2d is not None) for t in reader.truths()] == [(i, i % 2 == 1) for i in range(6)]


def test_reading_twice_and_side_by_side_gives_the_same(plain):
    reader, faults = b.read(plain)
    pairs = zip(reader.messages(), reader.messages(), strict=True)
    assert all(b.canonical(x) == b.canonical(y) for x, y in pairs)
    assert not faults.counts
