import numpy as np

from fbench.replay.clean import clean
from fbench.replay.data import Image, PointCloud, RadarScan
from fbench.replay.faults import FaultLog


def cloud(num_bad, num=4):
    xyz = np.arange(num * 3, dtype=np.float32).reshape(num, 3)
    xyz[:num_bad, 1] = np.nan
    return PointCloud("lidar", 5, 6, xyz, intensity=np.arange(num, dtype=np.float32))


def test_finite_cloud_passes_untouched():
    faults, whole = FaultLog(), cloud(0)
    assert clean(whole, faults) is whole
    assert not faults.counts


def test_non_finite_points_are_dropped_in_all_fields_and_counted():
    faults = FaultLog()
    left = clean(cloud(2), faults)
    assert left.intensity.tolist() == [2, 3]
    assert faults.counts == {"DAT004": 1}
    assert faults.places["DAT004"] == ["lidar at 5 ns: 2 of 4 points"]
    assert faults.lost == 0


def test_cloud_that_is_mostly_non_finite_is_lost():
    faults = FaultLog()
    assert clean(cloud(3), faults) is None
    assert faults.lost == 1


def test_infinite_radar_points_are_dropped():
    scan = RadarScan("radar", 0, 0, np.array([[1, 2, np.inf], [1, 2, 3]], np.float32), np.array([1, 2], np.float32))
    assert clean(scan, FaultLog()).radial_velocity_mps.tolist() == [2]


def test_empty_cloud_is_delivered_and_flagged():
    faults = FaultLog()
    empty = PointCloud("lidar", 0, 0, np.zeros((0, 3), np.float32))
    assert clean(empty, faults) is empty
    assert faults.counts == {"DAT002": 1}
    assert faults.lost == 0


def test_images_pass():
    image = Image("cam", 0, 0, b"", "jpeg", (1, 1))
    assert clean(image, FaultLog()) is image
