"""Wrong calibrations: rotations that stay rotations, of the given size, constant over the log."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fbench.replay.conditions.rig import Extrinsic, Intrinsic
from fbench.replay.contracts.conditions import Site
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.street import Street
from fbench.replay.data.rig import Mount, Rig
from fbench.replay.geometry.transforms import inverse

RIG = Street().rig


def site(sensor, seed=0):
    return Site((seed, "x@1:3", "log", sensor), RIG, sensor, RIG.kinds[sensor], 0, 10**9)


@pytest.mark.parametrize("sensor", ["camera", "lidar", "radar"])
@pytest.mark.parametrize("severity", range(5))
def test_mounts_are_off_by_exactly_so_much(sensor, severity):
    level = {name: values[severity] for name, values in Extrinsic.levels.items()}
    axes = []
    for seed in range(20):
        rig = Extrinsic().disturb_rig(RIG, level, site(sensor, seed))
        matrix = rig.body_T_sensor(sensor)
        assert np.abs(matrix[:3, :3].T @ matrix[:3, :3] - np.eye(3)).max() < 1e-12
        assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1, abs=1e-12)
        off = inverse(RIG.body_T_sensor(sensor)) @ matrix
        vector = Rotation.from_matrix(off[:3, :3]).as_rotvec(degrees=True)
        assert np.linalg.norm(vector) == pytest.approx(level["rotated_deg"], rel=1e-9)
        assert np.linalg.norm(off[:3, 3]) == pytest.approx(level["shifted_m"], rel=1e-9)
        axes.append(vector / np.linalg.norm(vector))
        assert rig.list_changes(RIG) == (sensor,)
    assert np.abs(np.mean(axes, axis=0)).max() < 0.6  # no direction is preferred


def test_a_mount_as_given_may_be_no_unit_quaternion():
    long = Rig({"lidar": Mount("lidar", np.zeros(3), np.array([0.0, 0, 0, 7]))}, {})
    rig = Extrinsic().disturb_rig(long, {"rotated_deg": 1.0, "shifted_m": 0.1}, replace(site("lidar"), rig=long))
    matrix = rig.body_T_sensor("lidar")
    assert np.degrees(Rotation.from_matrix(matrix[:3, :3]).magnitude()) == pytest.approx(1)


def test_a_camera_without_a_mount_cant_be_moved():
    bare = Rig({}, {}, frozenset({"camera"}))
    with pytest.raises(LogError, match="nothing says where 'camera' is mounted") as found:
        Extrinsic().disturb_rig(bare, {"rotated_deg": 1.0, "shifted_m": 0.1}, site("camera"))
    assert found.value.code == "COR002"


def test_camera_matrix():
    signs = set()
    for seed in range(20):
        rig = Intrinsic().disturb_rig(RIG, {"focal_share": 0.02, "center_px": 5.0}, site("camera", seed))
        old, new = RIG.cameras["camera"].K, rig.cameras["camera"].K
        share = new[0, 0] / old[0, 0] - 1
        assert abs(share) == pytest.approx(0.02)
        assert new[1, 1] / old[1, 1] - 1 == pytest.approx(share)
        assert np.hypot(*(new - old)[:2, 2]) == pytest.approx(5.0)
        assert (new[0, 1], new[1, 0], *new[2]) == (0, 0, 0, 0, 1)
        signs.add(np.sign(share))
    assert signs == {-1, 1}
    assert RIG.cameras["camera"].K[0, 0] == 120.0
