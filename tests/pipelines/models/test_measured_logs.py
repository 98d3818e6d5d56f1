"""Images of logs with the points in them."""

import numpy as np
import pytest

from fbench.pipelines.models.measured_logs import rgbd_samples
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, PointCloud, Truth
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.logs.containers.mcap.write import McapWriter

FORWARD = np.array([-0.5, 0.5, -0.5, 0.5])  # Camera axes in body axes
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
