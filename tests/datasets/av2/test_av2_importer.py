"""Logs of Argoverse 2 become logs of fbench: what they hold, by hand."""

from pathlib import Path

import numpy as np
from tests.datasets.av2.conftest import FIRST_NS, NAME, STAMPS, STEP_NS, change
from tests.program import fbench

from fbench.datasets.av2 import Av2
from fbench.datasets.av2.importer import Av2Params
from fbench.datasets.importing.run import import_one
from fbench.metrics.profiles.catalog import profile_of
from fbench.metrics.profiles.choose import run_sequence
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.importing import BadInput, FrameRange, ImportRequest
from fbench.replay.contracts.testing import check_importer
from fbench.replay.data.messages import Image, PointCloud, Pose
from fbench.replay.data.metadata import inside, regions_of
from fbench.replay.logs.open import open_log
from fbench.replay.runs.folder import Run


def read(folder: Path, asked: ImportRequest | None = None, params: Av2Params | None = None):
    out = folder.parent / "out.mcap"
    imported = import_one(Av2(params or Av2Params()), folder, out, asked)
    reader = open_log(out, FaultLog())
    messages = list(reader.messages())
    return reader.info, reader.rig, messages, list(reader.truths()), imported


def test_measurements_and_poses(log: Path) -> None:
    info, rig, messages, truths, _ = read(log)
    assert (info.metadata["reference"], info.metadata["av2.log"]) == ("lidar", NAME)
    clouds = [m for m in messages if isinstance(m, PointCloud)]
    assert [(m.stamp_ns, m.frame_number) for m in clouds] == [(stamp, i) for i, stamp in enumerate(STAMPS)]
    # Points in the file are the ego's; the sensor sits at (1.35, 0, 1.64) and has the body's axes.
    np.testing.assert_allclose(clouds[0].xyz, [[8.65, 0, -1.14], [6.65, 2, -0.64]], atol=1e-6)
    assert clouds[1].ring.tolist() == [31, 63]
    assert clouds[1].offset_ns.tolist() == [0, 5001]
    assert info.metadata["lidar.lidar.motion"] == "frozen at the stamp"
    images = [m for m in messages if isinstance(m, Image)]
    assert [m.stamp_ns for m in images] == [stamp + 20_000_000 for stamp in STAMPS[:2]]
    assert rig.cameras["ring_front_center"].K.tolist() == [[20, 0, 15.5], [0, 20, 11.5], [0, 0, 1]]
    assert rig.cameras["ring_front_center"].distortion_model == ""  # images are undistorted
    np.testing.assert_allclose(rig.mounts["ring_front_center"].rotation_xyzw, [-0.5, 0.5, -0.5, 0.5])
    poses = [m for m in messages if isinstance(m, Pose)]
    assert len(poses) == 6
    np.testing.assert_allclose(poses[2].translation_m, [100, 1, 0])
    assert [t.frame_number for t in truths] == [0, 1, 2]


def test_truth(log: Path) -> None:
    change(
        log / "annotations.feather",
        lambda columns: columns.update(category=["REGULAR_VEHICLE", "DRAGON"] + 2 * ["BUS"]),
    )
    *_, truths, imported = read(log)
    boxes = truths[0].boxes3d
    np.testing.assert_allclose(boxes.center_m, [[30, 0, 0], [5, 2, 0]])
    np.testing.assert_allclose(boxes.size_lwh_m[0], [4.5, 2, 1.5])
    assert boxes.label.tolist() == ["car", "other"]
    assert boxes.source_label.tolist() == ["REGULAR_VEHICLE", "DRAGON"]
    assert boxes.track_id.tolist() == [1, 2]  # by appearance, whatever their names are
    assert truths[2].boxes3d.track_id.tolist() == [1]
    assert boxes.num_lidar_pts.tolist() == [9, 0]
    assert boxes.velocity_mps is None
    lines = imported.lines
    assert "boxes: 4 (BUS 2, DRAGON 1, REGULAR_VEHICLE 1), 2 tracks in the log, without velocities" in lines
    assert "categories that Argoverse 2 lacks, taken as 'other': DRAGON" in lines


def test_drivable_areas_are_regions_counter_clockwise(log: Path) -> None:
    info, *_ = read(log)
    (region,) = regions_of(info.metadata)
    x, y = region.points_m.T
    assert region.kind == "road"
    assert float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2 == 1000.0  # positive: counter-clockwise
    assert inside([region], np.array([[100.0, 30.0], [80.0, 30.0]])).tolist() == [True, False]
    info, *_ = read(log, params=Av2Params(map=False))
    assert regions_of(info.metadata) == ()


def test_names_of_splits_and_chosen_frames(log: Path) -> None:
    root = log.parent
    assert Av2().names(root) == (NAME,)
    (root / "val").mkdir()
    log.rename(root / "val" / NAME)
    assert Av2().names(root) == (f"val/{NAME}",)
    _, _, messages, truths, imported = read(root / "val" / NAME, ImportRequest((NAME,), FrameRange(1, 2)))
    assert [m.stamp_ns for m in messages if isinstance(m, PointCloud)] == [STAMPS[1]]
    assert [t.stamp_ns for t in truths] == [STAMPS[1]]
    near = [m.stamp_ns for m in messages if isinstance(m, Pose)]
    assert near == [FIRST_NS + i * STEP_NS // 2 for i in range(4)]  # 100 ms around, the last stamp not included
    assert imported.lines[0] == "frames: 1 of 3 sweeps, 0.0 s"


def test_logs_without_annotations_or_without_sensors(log: Path) -> None:
    (log / "annotations.feather").rename(log.parent / "kept")
    *_, truths, imported = read(log)
    assert truths == []
    assert imported.lines[-1] == "boxes: none, the log isn't labeled"
    (log.parent / "kept").rename(log / "annotations.feather")
    (log / "sensors").rename(log.parent / "sensors")
    (log / "calibration").rename(log.parent / "calibration")
    info, rig, _, truths, imported = read(log)
    assert "reference" not in info.metadata
    assert not rig.mounts
    assert [t.frame_number for t in truths] == [0, 1, 2]
    assert imported.lines[0] == "frames: 3 of 3 annotated instants, 0.2 s"


def test_unusable_files_are_skipped_where_that_is_asked_for(log: Path) -> None:
    (log / f"sensors/lidar/{STAMPS[1]}.feather").write_bytes(b"ARROW1 and no more")
    bad = BadInput(skip=True)
    _, _, messages, truths, _ = read(log, ImportRequest((NAME,), bad=bad))
    assert [m.stamp_ns for m in messages if isinstance(m, PointCloud)] == [STAMPS[0], STAMPS[2]]
    assert len(truths) == 3
    assert bad.num == 1


def test_runs_are_scored_by_the_names_of_the_challenge(log: Path) -> None:
    read(log)
    out = log.parent / "run"
    assert fbench("replay", log.parent / "out.mcap", "-p", "lidar3d", "-o", out) == 0
    found = run_sequence(Run(out), profile_of("av2"))
    assert sorted(found.truth.label.tolist()) == ["bicyclist", *3 * ["regular_vehicle"]]
    assert found.truth.num_points is not None
    assert fbench("score", out, "--profile", "av2") == 0
    assert fbench("score", out, "--profile", "av2-tracking") == 0


def test_the_id_knows_calibration_and_map(log: Path) -> None:
    def log_id(has_map: bool = True) -> str:
        (recording,) = Av2(Av2Params(map=has_map)).recordings(log, ImportRequest((NAME,)))
        return str(recording.info.log_id)

    first, bare = log_id(), log_id(has_map=False)
    found = {first}
    change(log / "calibration/egovehicle_SE3_sensor.feather", lambda columns: columns.update(tx_m=[1.35, 1.7]))
    found.add(log_id())
    change(log / "calibration/intrinsics.feather", lambda columns: columns.update(fx_px=[21.0]))
    found.add(log_id())
    assert log_id(has_map=False) != bare
    bare = log_id(has_map=False)
    (path,) = (log / "map").iterdir()
    path.write_text(path.read_text().replace("110", "120"))
    found.add(log_id())
    assert len(found) == 4
    assert log_id(has_map=False) == bare  # a map that isn't imported changes nothing


def test_a_map_with_one_area_is_counted_in_english(log: Path) -> None:
    assert "map: 1 drivable area, as regions 'road'" in read(log)[-1].lines


def test_protocol(log: Path) -> None:
    check_importer(Av2, log)
