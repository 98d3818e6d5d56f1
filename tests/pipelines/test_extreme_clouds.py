"""Whatever finite points arrive, boxes stay finite and scores stay in (0, 1]."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fbench.pipelines.late3d import Late3D
from fbench.pipelines.lidar3d import Lidar3D
from fbench.pipelines.radar3d import Radar3D
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import LogInfo, PointCloud, RadarScan

from .frames import frame, rig


@pytest.mark.parametrize("pipeline", [Lidar3D(), Radar3D(), Late3D()])
@settings(deadline=None, max_examples=30)
@given(
    num=st.sampled_from([0, 1, 2, 3, 20, 500]),
    scale=st.sampled_from([0.0, 1e-6, 1.0, 30.0, 1e4, 1e30]),
    step=st.sampled_from([0.0, 1.0]),
    speed=st.sampled_from([0.0, 5.0, 1e30]),
    seed=st.integers(0, 100),
)
def test_boxes_stay_finite(
    pipeline: Lidar3D | Radar3D | Late3D, num: int, scale: float, step: float, speed: float, seed: int
):
    random = np.random.default_rng(seed)
    xyz = random.normal(0, scale, (num, 3))
    xyz = (np.round(xyz) if step else xyz).astype(np.float32)
    velocity = random.normal(0, speed, num).astype(np.float32)
    pipeline.start(rig("cam", "lidar", "radar"), LogInfo("drive", "id"))
    output = pipeline.step(frame(0, PointCloud("lidar", 0, 0, xyz), RadarScan("radar", 0, 0, xyz, velocity)))
    for boxes in (output.detections, output.tracks):
        assert isinstance(boxes, Boxes3D)
        assert boxes.score is not None
        for values in (boxes.center_m, boxes.size_lwh_m, boxes.yaw_rad, boxes.score):
            assert np.isfinite(values).all()
        assert ((boxes.score > 0) & (boxes.score <= 1)).all()
