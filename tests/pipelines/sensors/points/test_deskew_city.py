"""Sweeps of a simulated LiDAR that drives on while it turns, against the same ones for which all stood still."""

import numpy as np
import pytest
from scipy.spatial import KDTree
from tests.datasets.city.city_logs import Log, simulated

from fbench.pipelines.sensors.points.merged import Deskew, Outline, lidar_points
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import Pose

OWN = Outline(4.0, 2.5, 1.1)


def last_cloud(log: Log, *, is_deskewed: bool) -> np.ndarray:
    """Points of the last sweep in body coordinates."""
    poses = [m for m in log.messages if isinstance(m, Pose)]
    deskew, found = Deskew(log.info) if is_deskewed else None, None
    for index, (ns, cloud) in enumerate(sorted(log.clouds().items())):
        pose = min(poses, key=lambda one: abs(one.stamp_ns - ns))
        frame = Frame(index, ns, 0, {"lidar": cloud, "pose": pose})
        found = lidar_points(log.rig, frame, {"lidar": (2.5, 50.0)}, OWN, deskew)
    assert found is not None
    return found


def off_surfaces(xyz: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Distance [m] of what stands above the road (N,) from the planes through the nearest exact points."""
    tall = exact[exact[:, 2] > 0.3]
    xyz = xyz[xyz[:, 2] > 0.3]
    around = tall[KDTree(tall).query(xyz, 6)[1]]
    middle = around.mean(axis=1)
    normal = np.linalg.svd(around - middle[:, None])[2][:, 2]
    return np.asarray(np.abs(np.einsum("ij,ij->i", xyz - middle, normal)))


@pytest.mark.slow
def test_standing_things_are_sharp_again(tmp_path):
    """At 4.4 m/s and 10 turns a second: the first points of a turn are half a meter off, and more where it turns."""
    options = ("--seed", 101, "--seconds", 0.5, "--sensors", "lidar", "--set", "lidar.rate_hz=10")
    finer = ("--set", "lidar.points_per_s=300000", "--set", "lidar.noise_m=0")
    still = simulated(tmp_path, "still", "urban", *options, *finer)
    moving = simulated(tmp_path, "moving", "urban", *options, *finer, "--set", "lidar.motion=true")
    exact = last_cloud(still, is_deskewed=False)
    np.testing.assert_array_equal(last_cloud(still, is_deskewed=True), exact)  # the log says that nothing moved in it
    raw, sharp = (off_surfaces(last_cloud(moving, is_deskewed=one), exact) for one in (False, True))
    assert np.median(raw) > 0.1
    assert np.median(sharp) < 0.04
    assert np.percentile(sharp, 75) < 0.2 * np.percentile(raw, 75)
