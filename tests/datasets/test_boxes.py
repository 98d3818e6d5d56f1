import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from fbench.datasets.boxes import write_boxes_log
from fbench.replay.arrays import Array, Bool
from fbench.replay.data import Boxes3D, PointCloud, Pose, RadarScan, Rig, Truth
from fbench.replay.errors import ConfigError
from fbench.replay.faults import FaultLog
from fbench.replay.logs.open import open_log

EGO_MPS = np.array([8.0, 0, 0])
LIDAR_3_SIGMA_M, RADAR_3_SIGMA_M, RADAR_3_SIGMA_MPS = 0.03, 0.3, 0.3
FLOAT32_M = 1e-4


@dataclass(frozen=True)
class Log:
    summary: list[str]
    rig: Rig
    sweeps: list[PointCloud]
    scans: list[RadarScan]
    poses: list[Pose]
    truths: list[Truth]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    out = tmp_path_factory.mktemp("boxes") / "boxes.mcap"
    summary = write_boxes_log(out, seconds=6)
    faults = FaultLog()
    reader = open_log(out, faults)
    messages = list(reader.messages())
    truths = list(reader.truths())
    assert not faults.counts
    return Log(
        summary,
        reader.rig,
        [m for m in messages if isinstance(m, PointCloud)],
        [m for m in messages if isinstance(m, RadarScan)],
        [m for m in messages if isinstance(m, Pose)],
        truths,
    )


def boxes_of(truth: Truth) -> Boxes3D:
    assert truth.boxes3d is not None
    return truth.boxes3d


def inside(boxes: Boxes3D, i: int, xyz: Array, margin_m: float, later_s: float = 0) -> Bool:
    """Which points lie in box `i`, grown by a margin and moved on relative to the ego."""
    velocity = boxes.velocity_mps
    assert velocity is not None
    x, y, z = (xyz - boxes.center_m[i] - (velocity[i] - EGO_MPS) * later_s).T
    cos, sin = np.cos(boxes.yaw_rad[i]), np.sin(boxes.yaw_rad[i])
    local = np.abs(np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=1))
    return np.asarray((local <= boxes.size_lwh_m[i] / 2 + margin_m + FLOAT32_M).all(axis=1))


def test_truth_counts_the_lidar_points_in_each_box(log: Log) -> None:
    sweeps = {sweep.stamp_ns: sweep for sweep in log.sweeps}
    assert len(log.truths) == len(sweeps) == 60
    for truth in log.truths:
        xyz = sweeps[truth.stamp_ns].xyz + log.rig.mounts["lidar"].translation_m
        boxes = boxes_of(truth)
        counted = [int(inside(boxes, i, xyz, LIDAR_3_SIGMA_M).sum()) for i in range(len(boxes))]
        assert boxes.num_lidar_pts is not None
        assert boxes.num_lidar_pts.tolist() == counted


def test_truth_counts_the_radar_points_in_each_box_of_the_scan_next_to_it(log: Log) -> None:
    scans = {scan.stamp_ns: scan for scan in log.scans}
    for truth in log.truths:
        boxes = boxes_of(truth)
        assert boxes.num_radar_pts is not None
        scan = scans.get(truth.stamp_ns + 7_000_000)
        counted = (
            [0] * len(boxes) if scan is None else [int(on_box(log, boxes, i, scan).sum()) for i in range(len(boxes))]
        )
        assert boxes.num_radar_pts.tolist() == counted


def on_box(log: Log, boxes: Boxes3D, i: int, scan: RadarScan) -> Bool:
    """Points in box `i` that aren't clutter, which is weak."""
    assert scan.rcs_dbsm is not None
    xyz = scan.xyz + log.rig.mounts["radar"].translation_m
    return inside(boxes, i, xyz, RADAR_3_SIGMA_M, 0.007) & (scan.rcs_dbsm > -5)


def test_radar_speed_is_the_relative_velocity_along_the_ray(log: Log) -> None:
    scans = {scan.stamp_ns: scan for scan in log.scans}
    approaching = 0
    for truth in log.truths:
        scan, boxes = scans.get(truth.stamp_ns + 7_000_000), boxes_of(truth)
        if scan is None:
            continue
        assert boxes.velocity_mps is not None
        assert scan.radial_velocity_mps is not None
        for i in range(len(boxes)):
            on = on_box(log, boxes, i, scan)
            ray = scan.xyz[on] / np.linalg.norm(scan.xyz[on], axis=1)[:, None]
            expected = ((boxes.velocity_mps[i] - EGO_MPS) * ray).sum(axis=1)
            np.testing.assert_allclose(scan.radial_velocity_mps[on], expected, atol=RADAR_3_SIGMA_MPS + 1e-3)
            approaching += (expected < -10).sum()
    assert approaching > 100


def test_polar_and_cartesian_radar_values_agree(log: Log) -> None:
    scan = log.scans[0]
    assert scan.range_m is not None
    assert scan.azimuth_rad is not None
    np.testing.assert_allclose(np.linalg.norm(scan.xyz, axis=1), scan.range_m, rtol=1e-5)
    np.testing.assert_allclose(np.arctan2(scan.xyz[:, 1], scan.xyz[:, 0]), scan.azimuth_rad, atol=1e-5)


def test_tracks_move_with_their_velocity(log: Log) -> None:
    for before, after in zip(log.truths[:-1], log.truths[1:], strict=True):
        old, new = boxes_of(before), boxes_of(after)
        assert old.track_id is not None
        assert new.track_id is not None
        assert new.velocity_mps is not None
        assert len(set(new.track_id.tolist())) == len(new) >= 4
        both, a, b = np.intersect1d(old.track_id, new.track_id, return_indices=True)
        assert len(both) >= 4
        moved = new.center_m[b] + EGO_MPS * 0.1 - old.center_m[a]
        np.testing.assert_allclose(moved, new.velocity_mps[b] * 0.1, atol=1e-6)


def test_poses_follow_the_drive(log: Log) -> None:
    np.testing.assert_allclose([p.translation_m for p in log.poses], [[0.8 * i, 0, 0] for i in range(60)], atol=1e-6)


def test_ground_is_level(log: Log) -> None:
    sweep = log.sweeps[0]
    height = sweep.xyz[:, 2] + log.rig.mounts["lidar"].translation_m[2]
    assert height.min() > -LIDAR_3_SIGMA_M
    assert (np.abs(height) < LIDAR_3_SIGMA_M).mean() > 0.3


def test_nothing_is_seen_beyond_its_range(log: Log) -> None:
    for sweep in log.sweeps:
        assert np.linalg.norm(sweep.xyz, axis=1).max() < 80 + LIDAR_3_SIGMA_M + FLOAT32_M


def test_sensors_arrive_late_one_sweep_very_late_and_radar_scans_get_lost(log: Log) -> None:
    lidar = sorted(sweep.log_ns - sweep.stamp_ns for sweep in log.sweeps)
    radar = sorted(scan.log_ns - scan.stamp_ns for scan in log.scans)
    assert 10e6 <= lidar[0] < lidar[-2] < 12e6
    assert 70e6 <= lidar[-1] < 72e6
    assert 5e6 <= radar[0] < radar[-1] < 7e6
    lost = 120 - len(log.scans)
    assert 0 < lost < 12
    assert log.summary == [
        f"simulated: 6 s with 6 vehicles, 60 LiDAR sweeps, {len(log.scans)} radar scans",
        f"seed 0, faults on purpose: {lost} radar scans lost, one LiDAR sweep 60 ms late",
    ]


def digest(path: Path, seed: int) -> str:
    path.parent.mkdir()
    write_boxes_log(path, 0.5, seed)
    return hashlib.blake2b(path.read_bytes()).hexdigest()


def test_the_seed_decides_every_byte(tmp_path: Path) -> None:
    first, again, other = (digest(tmp_path / name / "x.mcap", seed) for name, seed in (("a", 3), ("b", 3), ("c", 4)))
    assert first == again != other


def test_a_shorter_log_is_the_beginning_of_a_longer_one(tmp_path: Path) -> None:
    for name, seconds in (("short", 0.3), ("long", 0.8)):
        write_boxes_log(tmp_path / f"{name}.mcap", seconds)
    short, long = (
        [m for m in open_log(tmp_path / f"{name}.mcap", FaultLog()).messages() if isinstance(m, RadarScan)]
        for name in ("short", "long")
    )
    assert [m.xyz.tolist() for m in short] == [m.xyz.tolist() for m in long[: len(short)]]


@pytest.mark.parametrize("seconds", [0, -1, 0.04, float("nan"), float("inf")])
def test_a_log_without_a_sweep_is_refused(tmp_path: Path, seconds: float) -> None:
    with pytest.raises(ConfigError, match=r"seconds: expected at least 0\.1, got"):
        write_boxes_log(tmp_path / "x.mcap", seconds)
