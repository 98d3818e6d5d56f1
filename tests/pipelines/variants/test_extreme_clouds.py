"""Whatever finite points arrive, boxes stay finite and scores stay in (0, 1]."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.pipelines.frames import frame, rig

from fbench.pipelines.sensors.stereo.stage import ObjectParams, detect
from fbench.pipelines.variants.early import Early3D
from fbench.pipelines.variants.late import Late3D
from fbench.pipelines.variants.lidar import Lidar3D
from fbench.pipelines.variants.radar import Radar3D
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import PointCloud, RadarScan
from fbench.replay.data.rig import LogInfo


@pytest.mark.parametrize("pipeline", [Lidar3D(), Radar3D(), Early3D(), Late3D()])
@settings(deadline=None, max_examples=30)
@given(
    num=st.sampled_from([0, 1, 2, 3, 20, 500]),
    scale=st.sampled_from([0.0, 1e-6, 1.0, 30.0, 1e4, 1e30]),
    step=st.sampled_from([0.0, 1.0]),
    speed=st.sampled_from([0.0, 5.0, 1e30]),
    seed=st.integers(0, 100),
)
def test_boxes_stay_finite(
    pipeline: Lidar3D | Radar3D | Early3D | Late3D, num: int, scale: float, step: float, speed: float, seed: int
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


def _many(kind: str, num: int) -> np.ndarray:
    rng = np.random.Generator(np.random.Philox(7))
    if kind == "equal":
        return np.full((num, 3), 7.25, np.float32)
    if kind == "line":
        return np.linspace([-50, 3, 0], [50, 3, 0], num).astype(np.float32)
    if kind == "heap":
        return rng.normal([10, 0, 0], 0.3, (num, 3)).astype(np.float32)
    return rng.uniform([-60, -60, -2], [60, 60, 4], (num, 3)).astype(np.float32)


KINDS = ("equal", "line", "heap", "everywhere")


def _require_sound(boxes: object) -> None:
    assert isinstance(boxes, Boxes3D)
    for values in (boxes.center_m, boxes.size_lwh_m, boxes.yaw_rad, boxes.score):
        assert values is None or np.isfinite(values).all()


@pytest.mark.parametrize("num", [0, 1, 1000, pytest.param(1_000_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("make", [Lidar3D, Radar3D, Early3D])
def test_from_no_point_to_a_million(make: type[Lidar3D | Radar3D | Early3D], kind: str, num: int):
    xyz = _many(kind, num)
    pipeline = make()
    pipeline.start(rig("lidar", "radar"), LogInfo("drive", "id"))
    output = pipeline.step(frame(0, PointCloud("lidar", 0, 0, xyz), RadarScan("radar", 0, 0, xyz, xyz[:, 0])))
    _require_sound(output.detections)
    _require_sound(output.tracks)


@pytest.mark.parametrize("num", [0, 1, 1000, pytest.param(1_000_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
def test_from_no_point_of_stereo_to_a_million(kind: str, num: int):
    xyz = _many(kind, num).astype(np.float64)
    found = detect(xyz[np.lexsort(xyz.T[::-1])], np.zeros(3), 80.0, ObjectParams())
    _require_sound(found.boxes)
