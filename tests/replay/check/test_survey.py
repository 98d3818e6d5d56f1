"""What a log holds, from its index."""

from dataclasses import replace

import pytest
from tests.replay.logs.builders import sequence, the_rig, write
from tests.replay.logs.other_forms import NO_SUMMARY, chunks, rewrite

from fbench.replay.check.survey import survey
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import Truth
from fbench.replay.data.rig import Rig
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.logs.open import open_log

MS = 1_000_000


def surveyed(path, **params):
    faults = FaultLog()
    return survey(open_log(path, faults), SyncParams(**params)), faults


@pytest.fixture
def log(tmp_path):
    return write(tmp_path / "log.mcap", sequence(), the_rig(), chunk_size=3000)


def test_streams_truth_and_times(log):
    result, faults = surveyed(log)
    assert [(s.sensor, s.kind, s.num_messages, s.rate_hz) for s in result.streams] == [
        ("cam", "camera", 40, 20.0),
        ("front", "radar", 40, 20.0),
        ("gnss", "pose", 40, 20.0),
        ("top", "lidar", 40, 20.0),
    ]
    assert (result.num_truths, result.num_frames, result.reference, result.breaks) == (40, 40, "top", ())
    assert result.span_ns == (1_000_000_000, 1_000_000_000 + 39 * 50 * MS + 5)
    assert (result.storage.form, result.storage.compression, result.storage.is_indexed) == ("MCAP", ("zstd",), True)
    assert result.storage.num_bytes == log.stat().st_size
    assert faults.num_lost == 0


def test_no_chunk_but_the_first_is_needed(log):
    good, _ = surveyed(log)
    data = bytearray(log.read_bytes())
    for at, length in chunks(bytes(data))[1:]:
        data[at + 60 : at + length] = bytes(length - 60)
    log.write_bytes(data)
    result, faults = surveyed(log)
    assert result.streams == good.streams
    assert result.breaks == good.breaks
    assert sum(faults.counts.values()) == 0


@pytest.mark.parametrize("how", [{}, NO_SUMMARY, {"use_chunking": False}])
def test_other_containers_say_the_same(log, tmp_path, how):
    first, _ = surveyed(log)
    other, _ = surveyed(rewrite(log, tmp_path / "other.mcap", **how))
    assert other.storage.is_indexed == (how == {})
    assert (other.streams, other.breaks, other.num_truths, other.span_ns, other.info.log_id) == (
        first.streams, first.breaks, first.num_truths, first.span_ns, first.info.log_id,
    )  # fmt: skip


def test_gap_of_the_reference_is_a_segment(tmp_path):
    items = [
        replace(m, stamp_ns=m.stamp_ns + 3_000 * MS, log_ns=m.log_ns + 3_000 * MS) if m.stamp_ns >= 2_000_000_000 else m
        for m in sequence()
    ]
    result, _ = surveyed(write(tmp_path / "gap.mcap", items, the_rig()))
    assert result.breaks == ("gap of 3.050 s before frame 20",)
    assert surveyed(tmp_path / "gap.mcap", max_gap_ns=5_000 * MS)[0].breaks == ()
    assert result.streams[0].rate_hz == 20.0


def test_times_too_large_to_read_leave_rates_from_counts(log, monkeypatch):
    monkeypatch.setattr("fbench.replay.logs.containers.mcap.file.SMALL", 0)
    result, _ = surveyed(log)
    assert result.breaks is None
    assert result.streams[0].first_log_ns is None
    assert [s.rate_hz for s in result.streams] == pytest.approx([20.0] * 4, rel=1e-6)


def test_camera_without_calibration_is_told(tmp_path):
    rig = the_rig()
    result, _ = surveyed(write(tmp_path / "log.mcap", sequence(), Rig(rig.mounts, {})))
    assert list(result.known.problems) == ["cam"]
    assert result.known.problems["cam"].startswith("camera 'cam' has no calibration")
    assert sorted(result.known.rig.mounts) == ["front", "top"]
    assert (result.reference, result.num_frames) == ("top", 40)


def test_sensor_without_transform_is_told_and_its_camera_shown(tmp_path):
    rig = the_rig()
    mounts = {name: mount for name, mount in rig.mounts.items() if name != "cam"}
    result, _ = surveyed(write(tmp_path / "log.mcap", sequence(), Rig(mounts, rig.cameras)))
    assert list(result.known.problems) == ["cam"]
    assert "no transform to the body" in result.known.problems["cam"]
    assert result.known.rig.cameras["cam"].size_wh == (640, 400)


def test_in_a_log_of_truth_alone_boxes_are_the_reference(tmp_path):
    items = [Truth(i, i) for i in range(3)]
    result, _ = surveyed(write(tmp_path / "log.mcap", items))
    assert (result.reference, result.num_frames, result.num_truths, result.streams) == ("boxes", 3, 3, ())


def test_empty_log(tmp_path):
    result, _ = surveyed(write(tmp_path / "log.mcap", []))
    assert (result.reference, result.streams, result.num_truths) == (None, (), 0)


def test_topics_of_all_parts_are_counted_together(tmp_path):
    (tmp_path / "parts").mkdir()
    items = sequence()
    half = len(items) // 2
    for i, part in enumerate((items[:half], items[half:])):
        write(tmp_path / "parts" / f"log_{i}.mcap", part, the_rig())
    whole, _ = surveyed(write(tmp_path / "log.mcap", items, the_rig()))
    split, _ = surveyed(tmp_path / "parts")
    assert [(t.topic, t.num_messages) for t in split.topics if t.kind in ("camera", "lidar", "radar")] == [
        (t.topic, t.num_messages) for t in whole.topics if t.kind in ("camera", "lidar", "radar")
    ]
