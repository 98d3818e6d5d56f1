"""Points of logs, and images with the points in them."""

from pathlib import Path

import numpy as np
import pytest

from fbench.pipelines.models.bev_samples import bev_samples
from fbench.pipelines.models.measured_logs import rgbd_samples
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, PointCloud, Truth
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.logs.containers.mcap.write import McapWriter

FORWARD = np.array([-0.5, 0.5, -0.5, 0.5])  # Camera axes in body axes
UPRIGHT = np.array([0, 0, 0, 1.0])
K = np.array([[160.0, 0, 159.5], [0, 160.0, 119.5], [0, 0, 1]])


@pytest.mark.parametrize("ahead_m", [10.0, -10.0])
def test_points_beside_the_images_teach_nothing(tmp_path, ahead_m):
    mounts = {
        "front": Mount("camera", np.array([0, 0, 1.5]), FORWARD),
        "lidar": Mount("lidar", np.array([0, 0, 1.8]), np.array([0, 0, 0, 1.0])),
    }
    random = np.random.default_rng(0)
    ground = np.column_stack([random.uniform(-20, 20, (2000, 2)), np.full(2000, -1.8)])
    car = np.column_stack([random.uniform(ahead_m, ahead_m + 1, 50), random.uniform(-1, 1, 50), np.full(50, -0.8)])
    box = Boxes2D(np.array(["front"]), np.array([[100.0, 100, 200, 150]]), label=np.array(["car"]))
    pixels = np.full((240, 320, 3), 90, np.uint8)
    with McapWriter(
        tmp_path / "a.mcap", LogInfo("a", log_id="a-1"), Rig(mounts, {"front": CameraModel(K, (320, 240))})
    ) as log:
        log.write(Image("front", 100, 100, encode_jpeg(pixels), "jpeg", (320, 240)))
        log.write(PointCloud("lidar", 100, 100, np.concatenate([ground, car]).astype(np.float32)))
        log.write(Truth(100, 100, boxes2d=box))
    if ahead_m > 0:
        [sample] = rgbd_samples([tmp_path / "a.mcap"], 1, FaultLog())
        assert len(sample.points.lidar) == 50
        assert np.sort(sample.points.lidar[:, 2]) == pytest.approx(np.sort(car[:, 0]), abs=1e-4)
        return
    with pytest.raises(LogError, match="no point or echo lies in any image of these logs"):
        rgbd_samples([tmp_path / "a.mcap"], 1, FaultLog())


def write_recalibrated(path: Path) -> None:
    """A log in which, from its second frame on, the LiDAR is 0.5 m higher and 1 m farther ahead, and the camera's
    focal length twice as long; the scene around the vehicle stays.
    """
    random = np.random.default_rng(0)
    ground = np.column_stack([random.uniform(-20, 20, (2000, 2)), np.zeros(2000)])
    car = np.column_stack([random.uniform(10, 11, 50), random.uniform(-1, 1, 50), np.full(50, 1.0)])
    scene, front = np.concatenate([ground, car]), Mount("camera", np.array([0, 0, 1.5]), FORWARD)
    rigs = [
        (
            Rig(
                {"front": front, "lidar": Mount("lidar", np.array(at), UPRIGHT)}, {"front": CameraModel(k, (320, 240))}
            ),
            at,
        )
        for k, at in ((K, [0, 0, 1.8]), (K * [[2, 1, 1], [1, 2, 1], [1, 1, 1]], [1.0, 0, 2.3]))
    ]
    boxes3d = Boxes3D(np.array([[10.5, 0, 0.75]]), np.array([[1.0, 2, 1.5]]), np.zeros(1), label=np.array(["car"]))
    boxes2d = Boxes2D(np.array(["front"]), np.array([[100.0, 100, 200, 150]]), label=np.array(["car"]))
    with McapWriter(path, LogInfo("a", log_id="a-1"), rigs[0][0]) as log:
        for number, (rig, at) in enumerate(rigs):
            stamp = 100 + number * 100_000_000
            if number:
                log.write_rig(stamp, rig)
            log.write(
                Image("front", stamp, stamp, encode_jpeg(np.full((240, 320, 3), 90, np.uint8)), "jpeg", (320, 240))
            )
            log.write(PointCloud("lidar", stamp, stamp, (scene - at).astype(np.float32)))
            log.write(Truth(stamp, stamp, boxes3d=boxes3d, boxes2d=boxes2d))


def test_each_frame_is_measured_with_the_calibration_of_its_time(tmp_path):
    write_recalibrated(tmp_path / "a.mcap")
    faults = FaultLog()
    before, after = bev_samples([tmp_path / "a.mcap"], 1, faults)
    assert {row["code"]: row["count"] for row in faults.rows()}["CAL002"] == 1
    assert before.eye == pytest.approx([0, 0, 1.8], abs=0.02)
    assert after.eye == pytest.approx([1, 0, 2.3], abs=0.02)
    for sample in (before, after):
        inside = sample.points.lidar[sample.points.lidar[:, 2] > 0.8]
        assert len(inside) == 50
        assert inside.mean(axis=0) == pytest.approx([10.5, 0, 1.0], abs=0.2)
        assert sample.boxes[0, :3] == pytest.approx([10.5, 0, 0.75], abs=0.02)


def test_points_lie_in_images_as_the_camera_was_calibrated_then(tmp_path):
    write_recalibrated(tmp_path / "a.mcap")
    before, after = rgbd_samples([tmp_path / "a.mcap"], 1, FaultLog())
    assert len(before.points.lidar) == len(after.points.lidar) == 50
    assert np.sort(after.points.lidar[:, 2]) == pytest.approx(np.sort(before.points.lidar[:, 2]), abs=1e-4)
    (low, high), (low_after, high_after) = ((p.min(0), p.max(0)) for p in (before.points.lidar, after.points.lidar))
    assert high_after[0] - low_after[0] == pytest.approx(2 * (high[0] - low[0]), abs=1e-2)
    assert after.points.focal_px == 2 * before.points.focal_px == 320


def test_the_network_that_lacks_sensors_is_named(tmp_path):
    front = Rig({"front": Mount("camera", np.zeros(3), FORWARD)}, {"front": CameraModel(K, (320, 240))})
    with McapWriter(tmp_path / "a.mcap", LogInfo("a", log_id="a-1"), front) as log:
        log.write(Image("front", 100, 100, encode_jpeg(np.full((240, 320, 3), 90, np.uint8)), "jpeg", (320, 240)))
    for read, name in ((rgbd_samples, "detector=rgbd"), (bev_samples, "learned3d")):
        with pytest.raises(LogError, match=f"log 'a': {name} needs a LiDAR or a radar; the log has: camera front"):
            read([tmp_path / "a.mcap"], 1, FaultLog())
