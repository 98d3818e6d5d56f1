"""The real keyframe: what its authors counted, and plain computations from its own file."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fbench.datasets.importing.run import import_one
from fbench.datasets.nuscenes import NuScenes
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.arrays import Array
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Image, PointCloud, Pose
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.iou import corners
from fbench.replay.logs.open import open_log

TILTED = {7: 1, 10: 2, 16: -1, 18: -16, 41: -5, 42: 1, 60: 1, 68: 2}
"""How many points more than the authors counted are in boxes that stand upright in the LiDAR's coordinates."""


@dataclass(frozen=True)
class Keyframe:
    rig: Rig
    cloud: PointCloud
    images: dict[str, Image]
    poses: dict[int, Pose]
    """By stamp."""
    boxes: Boxes3D

    @property
    def points(self) -> Array:
        """(N, 3) in body coordinates."""
        body_T_lidar = self.rig.body_T_sensor("LIDAR_TOP")
        return self.cloud.xyz @ body_T_lidar[:3, :3].T + body_T_lidar[:3, 3]


def imported(folder: Path, out: Path, sample: int = 0) -> Keyframe:
    import_one(NuScenes(), folder, out)
    faults = FaultLog()
    reader = open_log(out, faults)
    everything = list(reader.messages())
    poses = {m.stamp_ns: m for m in everything if isinstance(m, Pose)}
    messages = [m for m in everything if m.frame_number == sample]
    images = {m.sensor: m for m in messages if isinstance(m, Image)}
    cloud = next(m for m in messages if isinstance(m, PointCloud))
    boxes = next(truth.boxes3d for truth in reader.truths() if truth.frame_number == sample)
    assert not faults.counts
    return Keyframe(reader.rig, cloud, images, poses, boxes)


@pytest.fixture(scope="module")
def keyframe(real_tables, tmp_path_factory: pytest.TempPathFactory) -> Keyframe:
    return imported(real_tables.root, tmp_path_factory.mktemp("keyframe") / "one.mcap")


def counts(points: Array, centers: Array, turns: Array, sizes: Array) -> list[int]:
    """Points in each box, faces included."""
    inside = [
        np.all(np.abs((points - center) @ turn) <= size / 2, axis=1)
        for center, turn, size in zip(centers, turns, sizes, strict=True)
    ]
    return [int(rows.sum()) for rows in inside]


def turns(boxes: Boxes3D) -> Array:
    return Rotation.from_euler("ZYX", np.stack([boxes.yaw_rad, boxes.pitch_rad, boxes.roll_rad], 1)).as_matrix()


def test_points_in_boxes_are_those_that_the_authors_counted(keyframe, real_frame) -> None:
    boxes = keyframe.boxes
    told = [instance["num_lidar_pts"] for instance in real_frame.instances]
    assert boxes.num_lidar_pts.tolist() == told
    assert counts(keyframe.points, boxes.center_m, turns(boxes), boxes.size_lwh_m) == told


def test_without_the_tilt_eight_boxes_differ(keyframe, real_frame) -> None:
    """Why a plain check of the file's own boxes gives 61 of 69: these have a yaw alone, so that they stand upright in
    the LiDAR's coordinates, which lean by 1.4 degrees and more; the set's boxes are upright in the world.
    """
    own = real_frame.boxes
    upright = Rotation.from_euler("z", own[:, 6:]).as_matrix()
    found = counts(real_frame.cloud[:, :3].astype(np.float64), own[:, :3], upright, own[:, 3:6])
    differences = np.array(found) - keyframe.boxes.num_lidar_pts
    assert {i: difference for i, difference in enumerate(differences.tolist()) if difference} == TILTED


def test_eight_boxes_lean_and_so_differ(keyframe, real_frame) -> None:
    """Nothing but the tilt changes: without roll and pitch about the LiDAR's axes, the same boxes give other counts."""
    body_R_lidar = keyframe.rig.body_T_sensor("LIDAR_TOP")[:3, :3]
    in_lidar = Rotation.from_matrix(body_R_lidar.T @ turns(keyframe.boxes))
    yaw, pitch, roll = in_lidar.as_euler("ZYX").T
    assert np.cos(yaw - real_frame.boxes[:, 6]) == pytest.approx(1, abs=1e-9)
    lean_deg = np.degrees(np.hypot(pitch, roll))
    assert 1.3 < lean_deg.min() <= lean_deg.max() < 3.0
    flat = body_R_lidar @ Rotation.from_euler("z", yaw[:, None]).as_matrix()
    found = counts(keyframe.points, keyframe.boxes.center_m, flat, keyframe.boxes.size_lwh_m)
    assert sorted(np.flatnonzero(np.array(found) != keyframe.boxes.num_lidar_pts)) == sorted(TILTED)


def test_positions(keyframe, real_frame) -> None:
    ego_T_lidar, own = real_frame.ego_T_lidar, real_frame.boxes
    centers = own[:, :3] @ ego_T_lidar[:3, :3].T + ego_T_lidar[:3, 3]
    assert keyframe.boxes.center_m == pytest.approx(centers, abs=1e-9)
    assert keyframe.boxes.size_lwh_m == pytest.approx(own[:, 3:6], abs=1e-12)
    assert np.isnan(keyframe.boxes.velocity_mps).all()


def test_velocities(real_neighbors, real_frame, tmp_path: Path) -> None:
    boxes = imported(real_neighbors.root, tmp_path / "three.mcap", sample=1).boxes
    velocity = np.array([[*instance["velocity"], 0] for instance in real_frame.instances])
    told = np.isfinite(velocity).all(axis=1)
    assert told.sum() == 67
    assert np.isfinite(boxes.velocity_mps).all(axis=1).tolist() == told.tolist()
    expected = velocity @ real_frame.ego_T_lidar[:3, :3].T
    assert boxes.velocity_mps[told] == pytest.approx(expected[told], abs=1e-9)


def test_rig_and_cloud(keyframe, real_frame) -> None:
    assert keyframe.rig.body_T_sensor("LIDAR_TOP") == pytest.approx(real_frame.ego_T_lidar, abs=1e-12)
    assert np.array_equal(keyframe.cloud.xyz, real_frame.cloud[:, :3])
    assert np.array_equal(keyframe.cloud.intensity, real_frame.cloud[:, 3])
    assert np.array_equal(keyframe.cloud.ring, real_frame.cloud[:, 4])
    assert len(keyframe.images) == 6
    assert all(image.size_wh == (1600, 900) for image in keyframe.images.values())


def test_projections_into_six_cameras(keyframe, real_frame) -> None:
    """By the file's own matrices, and by the log's rig and the poses at the stamps of the sweep and of the images."""
    world_T_body = keyframe.poses[keyframe.cloud.stamp_ns].world_T_body
    world_R_lidar = (real_frame.world_T_ego @ real_frame.ego_T_lidar)[:3, :3]
    upright = world_R_lidar.T @ Rotation.from_euler("z", real_frame.world_yaw[:, None]).as_matrix()
    signs = np.array([[x, y, z] for z in (0.5, -0.5) for y in (0.5, -0.5) for x in (0.5, -0.5)])
    own = real_frame.boxes
    in_lidar = np.einsum("nij,nkj->nki", upright, signs[None] * own[:, None, 3:6]) + own[:, None, :3]
    num_seen = {}
    for name, camera in real_frame.content["images"].items():
        expected, ahead = projected(in_lidar, np.array(camera["lidar2cam"]), np.array(camera["cam2img"]))
        world_T_there = keyframe.poses[keyframe.images[name].stamp_ns].world_T_body
        camera_T_body = np.linalg.inv(world_T_there @ keyframe.rig.body_T_sensor(name)) @ world_T_body
        found, _ = projected(corners(keyframe.boxes), camera_T_body, keyframe.rig.cameras[name].K)
        assert found[ahead] == pytest.approx(expected[ahead], rel=1e-6, abs=1e-3)
        inside = (expected > 0).all(axis=(1, 2)) & (expected < [1600, 900]).all(axis=(1, 2))
        num_seen[name] = int((ahead & inside).sum())
    assert num_seen == {
        "CAM_FRONT": 45, "CAM_FRONT_RIGHT": 14, "CAM_FRONT_LEFT": 1, "CAM_BACK": 10, "CAM_BACK_LEFT": 2,
        "CAM_BACK_RIGHT": 4,
    }  # fmt: skip


def projected(xyz: Array, camera_T_src: Array, K: Array) -> tuple[Array, Array]:
    """Pixels (N, 8, 2) of corners (N, 8, 3), and which boxes (N,) have all corners over 1 m ahead."""
    p = xyz @ camera_T_src[:3, :3].T + camera_T_src[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = (p @ K.T)[..., :2] / p[..., 2:]
    return pixels, np.all(p[..., 2] > 1, axis=1)


def test_whoever_moves_the_boxes_notices(keyframe) -> None:
    """Boxes 20 cm higher hold other points: the counts above would tell."""
    raised = replace(keyframe.boxes, center_m=keyframe.boxes.center_m + np.array([0, 0, 0.2]))
    found = counts(keyframe.points, raised.center_m, turns(raised), raised.size_lwh_m)
    assert (np.array(found) != keyframe.boxes.num_lidar_pts).sum() > 20
