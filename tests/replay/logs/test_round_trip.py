"""Everything that is written is read back bit for bit."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.replay.logs import builders as b

from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.messages import Pose, Truth
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.runs.secrets import clean_mapping

quick = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def kept(item):
    """Write one message or truth and return what is read."""
    with tempfile.TemporaryDirectory() as folder:
        reader, faults = b.read(b.write(Path(folder) / "log.mcap", [item]))
        found = list(reader.truths()) if isinstance(item, Truth) else list(reader.messages())
        other = list(reader.messages()) if isinstance(item, Truth) else list(reader.truths())
    assert not faults.counts
    assert not other
    return found


@quick
@given(st.one_of(b.images, b.clouds, b.scans, b.poses))
def test_messages(message):
    assert [b.canonical(m) for m in kept(message)] == [b.canonical(message)]


@pytest.mark.slow
@quick
@given(b.truths)
def test_truth(truth):
    assert [b.canonical(t) for t in kept(truth)] == [b.canonical(truth)]


@pytest.mark.parametrize(
    ("boxes3d", "boxes2d"),
    [(None, None), (Boxes3D.empty(), None), (None, Boxes2D.empty()), (Boxes3D.empty(), Boxes2D.empty())],
)
def test_not_labeled_is_not_the_same_as_empty(boxes3d, boxes2d):
    truth = Truth(5, 6, boxes3d, boxes2d)
    assert [b.canonical(t) for t in kept(truth)] == [b.canonical(truth)]


def test_bits_of_nan_and_the_sign_of_zero_are_kept():
    odd = np.array([0x7FF8000000000001, 0xFFF8000000000000, 0x8000000000000000], np.uint64).view(np.float64)
    truth = Truth(0, 0, Boxes3D(odd[None], odd[None], odd[:1]))
    [found] = kept(truth)
    assert found.boxes3d.center_m.tobytes() == odd.tobytes()


def test_last_stamp_of_an_int64_is_kept():
    last = 2**63 - 1
    [pose] = kept(Pose("ego", last, last, np.zeros(3), np.array([0, 0, 0, 1.0])))
    assert (pose.stamp_ns, pose.log_ns) == (last, last)


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
        reader, faults = b.read(b.write(Path(folder) / "log.mcap", [], rig, info))
        assert reader.info == LogInfo("log", log_id, clean_mapping(metadata))
        assert b.canonical(reader.rig.mounts) == b.canonical(mounts)
        assert b.canonical(reader.rig.cameras) == b.canonical(cameras)
    assert not faults.counts


def test_rig_of_a_drive(tmp_path):
    path = b.write(tmp_path / "drive.mcap", b.sequence(3), b.the_rig())
    reader, faults = b.read(path)
    assert b.canonical(reader.rig) == b.canonical(b.the_rig())
    assert reader.info == LogInfo("drive", "id-1", {"place": "Köln"})
    assert not faults.counts


def test_a_sensor_in_the_rig_need_not_have_messages(tmp_path):
    rig = Rig({"spare": Mount("radar", np.ones(3), np.array([0, 0, 0, 1.0]))}, {})
    reader, _ = b.read(b.write(tmp_path / "log.mcap", [], rig))
    assert reader.rig.sensors("radar") == ("spare",)


def test_two_cameras_of_different_encoding_and_frame_numbers(tmp_path):
    items = [m for m in b.sequence(4) if not isinstance(m, Truth)]
    path = b.write(tmp_path / "log.mcap", items)
    reader, _ = b.read(path)
    assert sorted(map(repr, map(b.canonical, reader.messages()))) == sorted(map(repr, map(b.canonical, items)))


def test_equal_input_gives_equal_bytes(tmp_path):
    for name in ("a", "b"):
        b.write(tmp_path / name, b.sequence(10), b.the_rig())
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
