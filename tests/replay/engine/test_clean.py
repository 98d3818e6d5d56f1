from dataclasses import replace

import numpy as np
import pytest

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import Image, PointCloud, Pose, RadarScan
from fbench.replay.data.rig import CameraModel, Rig
from fbench.replay.engine.cleaning import Skipped, clean

RIG = Rig({}, {"cam": CameraModel(np.eye(3), (8, 6))})


def cloud(num_bad, num=4):
    xyz = np.arange(num * 3, dtype=np.float32).reshape(num, 3)
    xyz[:num_bad, 1] = np.nan
    return PointCloud("lidar", 5, 6, xyz, intensity=np.arange(num, dtype=np.float32))


def test_finite_cloud_passes_untouched():
    faults, whole = FaultLog(), cloud(0)
    assert clean(whole, RIG, faults) is whole
    assert not faults.counts


def test_non_finite_points_are_dropped_in_all_fields_and_counted():
    faults = FaultLog()
    left = clean(cloud(2), RIG, faults)
    assert left.intensity.tolist() == [2, 3]
    assert faults.counts == {"DAT004": 1}
    assert faults.places["DAT004"] == ["lidar at 5 ns: 2 of 4 points"]
    assert faults.num_lost == 0


def test_cloud_that_is_mostly_non_finite_is_lost():
    faults = FaultLog()
    assert clean(cloud(3), RIG, faults) == Skipped("lidar", 5, None, "mostly non-finite points")
    assert faults.num_lost == 1


def test_infinite_radar_points_are_dropped():
    scan = RadarScan("radar", 0, 0, np.array([[1, 2, np.inf], [1, 2, 3]], np.float32), np.array([1, 2], np.float32))
    assert clean(scan, RIG, FaultLog()).radial_velocity_mps.tolist() == [2]


def test_empty_cloud_is_delivered_and_flagged():
    faults = FaultLog()
    empty = PointCloud("lidar", 0, 0, np.zeros((0, 3), np.float32))
    assert clean(empty, RIG, faults) is empty
    assert faults.counts == {"DAT002": 1}
    assert faults.num_lost == 0


@pytest.mark.parametrize(
    ("position", "rotation", "why"),
    [
        ((0, np.nan, 0), (0, 0, 0, 1), "isn't finite"),
        ((0, np.inf, 0), (0, 0, 0, 1), "isn't finite"),
        ((0, 0, 0), (0, 0, 0, 0), "has no valid rotation"),
        ((0, 0, 0), (0, 0, np.nan, 1), "has no valid rotation"),
    ],
)
def test_poses_that_are_none_are_lost(position, rotation, why):
    good = Pose("gnss", 5, 6, np.zeros(3), np.array([0, 0, 0, 1.0]))
    assert clean(good, RIG, FaultLog()) is good
    faults = FaultLog()
    bad = replace(good, translation_m=np.array(position, float), rotation_xyzw=np.array(rotation, float))
    assert clean(bad, RIG, faults) == Skipped("gnss", 5, None, f"pose {why}")
    assert faults.places["DAT005"] == [f"gnss at 5 ns: {why}"]
    assert faults.num_lost == 1


def test_images_must_fit_their_calibration():
    image = Image("cam", 5, 6, b"", "jpeg", (8, 6))
    assert clean(image, RIG, FaultLog()) is image
    faults = FaultLog()
    assert clean(replace(image, size_wh=(4, 3)), RIG, faults).reason == "4x3, but calibrated for 8x6"
    assert faults.num_lost == 1
    other = replace(image, sensor="other", size_wh=(4, 3))
    assert clean(other, RIG, FaultLog()) is other
