"""The importer on real frames of the set."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from fbench.datasets.astyx import Astyx
from fbench.datasets.astyx.importer import VELOCITY_PERIOD_MPS
from fbench.datasets.importing.run import import_one
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Array
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Message, PointCloud, RadarScan, Truth
from fbench.replay.data.rig import Rig
from fbench.replay.logs.open import open_log

Frames = Mapping[int, Message]


@dataclass(frozen=True)
class Recording:
    summary: list[str]
    rig: Rig
    lidar: Mapping[int, PointCloud]
    radar: Mapping[int, RadarScan]
    truths: list[Truth]
    num_images: int

    def points(self, frame: int) -> Array:
        """LiDAR points (N, 3) in body coordinates."""
        body_T_lidar = self.rig.body_T_sensor("lidar_vlp16")
        return self.lidar[frame].xyz @ body_T_lidar[:3, :3].T + body_T_lidar[:3, 3]


@pytest.fixture(scope="module")
def recording(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    source = shared / "data/astyx"
    if not source.is_dir():
        pytest.skip(f"real recordings are not at {source}")
    out = tmp_path_factory.mktemp("astyx") / "astyx.mcap"
    summary = list(import_one(Astyx(), source, out).lines)
    faults = FaultLog()
    reader = open_log(out, faults)
    messages = list(reader.messages())
    truths = list(reader.truths())
    assert not faults.counts
    lidar = {m.frame_number: m for m in messages if isinstance(m, PointCloud)}
    radar = {m.frame_number: m for m in messages if isinstance(m, RadarScan)}
    return Recording(summary, reader.rig, lidar, radar, truths, len(messages) - len(lidar) - len(radar))


def test_summary(recording: Recording) -> None:
    assert recording.summary[:7] == [
        "frames: 47 in 4 stretches (parted by gaps of over 2 s), spaced by 0.10 to 1.00 s",
        "stretch: frames 57 to 68 (12), 3.7 s",
        "stretch: frames 133 to 142 (10), 1.5 s",
        "stretch: frames 155 to 167 (13), 2.3 s",
        "stretch: frames 309 to 320 (12), 4.0 s",
        "missing files: none",
        "boxes: 173 (Car 160, Bus 9, Truck 4), without track ids",
    ]


def test_numbers_of_the_readme(recording: Recording) -> None:
    numbers = [*range(57, 69), *range(133, 143), *range(155, 168), *range(309, 321)]
    assert list(recording.lidar) == list(recording.radar) == numbers
    assert [truth.frame_number for truth in recording.truths] == numbers
    assert recording.num_images == 47
    assert recording.lidar[57].stamp_ns == 566_580_241_000
    assert sum(len(cloud.xyz) for cloud in recording.lidar.values()) == 896_058 - 47
    assert sum(len(scan.xyz) for scan in recording.radar.values()) == 96_711 - 2 * 47


def test_sweeps_last_a_tenth_of_a_second(recording: Recording) -> None:
    for cloud in recording.lidar.values():
        assert cloud.offset_ns is not None
        assert cloud.offset_ns[0] == 0
        assert 99e6 < cloud.offset_ns[-1] < 101e6


def test_points_fall_into_near_boxes(recording: Recording) -> None:
    counts = []
    for truth in recording.truths:
        assert truth.boxes3d is not None
        assert truth.frame_number is not None
        xyz = recording.points(truth.frame_number)
        counts += [num_inside(truth.boxes3d, i, xyz) for i in near(truth.boxes3d)]
    assert len(counts) > 20
    assert np.median(counts) > 40


def near(boxes: Boxes3D) -> list[int]:
    """Boxes that are hidden by nothing and less than 25 m away."""
    assert boxes.occlusion is not None
    return np.flatnonzero((np.linalg.norm(boxes.center_m, axis=1) < 25) & (boxes.occlusion == 0)).tolist()


def num_inside(boxes: Boxes3D, i: int, xyz: Array) -> int:
    assert boxes.pitch_rad is not None
    assert boxes.roll_rad is not None
    body_R_box = Rotation.from_euler("ZYX", [boxes.yaw_rad[i], boxes.pitch_rad[i], boxes.roll_rad[i]])
    local = body_R_box.inv().apply(xyz - boxes.center_m[i])
    return int((np.abs(local) < boxes.size_lwh_m[i] / 2).all(axis=1).sum())


@pytest.mark.parametrize(("first", "second"), [(60, 61), (66, 67), (133, 134), (310, 311)])
def test_radar_velocity_of_standing_scenery_agrees_with_what_lidar_sees(
    recording: Recording, first: int, second: int
) -> None:
    assert speed_by_radar(recording.radar[second]) == pytest.approx(speed_by_lidar(recording, first, second), abs=0.7)


def speed_by_radar(scan: RadarScan) -> float:
    """Ego speed whose velocities of standing points, -v cos(angle to the drive), fit best modulo the period."""
    assert scan.radial_velocity_mps is not None
    cosine = scan.xyz[:, 0] / np.linalg.norm(scan.xyz, axis=1)
    speeds = np.arange(-20, 20, 0.1)
    error = scan.radial_velocity_mps + speeds[:, None] * cosine
    return float(speeds[np.cos(2 * np.pi * error / VELOCITY_PERIOD_MPS).mean(axis=1).argmax()])


def speed_by_lidar(recording: Recording, first: int, second: int) -> float:
    """Ego speed whose shift lays one sweep best upon the next."""
    before, after = (above_ground(recording.points(frame)) for frame in (first, second))
    tree = cKDTree(before)
    shifts = np.arange(-2, 2, 0.05)
    misses = (tree.query(after + np.array([shift, 0, 0]), distance_upper_bound=0.5)[0] for shift in shifts)
    fits = [np.exp(-((miss_m / 0.1) ** 2)).mean() for miss_m in misses]
    duration_s = (recording.lidar[second].stamp_ns - recording.lidar[first].stamp_ns) / 1e9
    return float(shifts[np.argmax(fits)] / duration_s)


def above_ground(xyz: Array) -> Array:
    distance = np.hypot(xyz[:, 0], xyz[:, 1])
    return xyz[(xyz[:, 2] > -0.8) & (xyz[:, 2] < 3) & (distance > 3) & (distance < 30)]
