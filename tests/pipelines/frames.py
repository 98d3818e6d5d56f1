"""Frames of a small drive: a road, one car ahead that moves away, stationary things around."""

import numpy as np
from tests.pipelines.scenes import car_back, echoes, radial, road, surroundings

from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Frame
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, PointCloud, RadarScan
from fbench.replay.data.rig import CameraModel, Mount, Rig

UPRIGHT = np.array([0, 0, 0, 1.0])
AHEAD = np.array([-0.5, 0.5, -0.5, 0.5])
MOUNTS = {
    "cam": Mount("camera", np.zeros(3), AHEAD),
    "lidar": Mount("lidar", np.zeros(3), UPRIGHT),
    "radar": Mount("radar", np.zeros(3), UPRIGHT),
}
# The detector of the fixture `one_car` reports a car at 9.5 to 49.5, 19.5 to 59.5 px: here 20 m away, 1.6 m high.
CAMERA = CameraModel(np.array([[500.0, 0, 29.5], [0, 500, 19.5], [0, 0, 1]]), (120, 100))
JPEG = encode_jpeg(np.zeros((100, 120, 3), np.uint8))
STEP_NS = 100_000_000


def rig(*names: str) -> Rig:
    cameras = {"cam": CAMERA} if "cam" in names else {}
    return Rig({name: MOUNTS[name] for name in names}, cameras)


def cloud(order=None) -> PointCloud:
    xyz = np.concatenate([road(), car_back(20.0, 0.0)]).astype(np.float32)
    return PointCloud("lidar", 0, 0, xyz if order is None else xyz[order.permutation(len(xyz))])


def scan(order=None) -> RadarScan:
    car, rest = echoes(20.0, 0.0), surroundings()
    xyz = np.concatenate([car, rest])
    velocity = np.concatenate([radial(car, 8.0, 3.0), radial(rest, 8.0)])
    rows = np.arange(len(xyz)) if order is None else order.permutation(len(xyz))
    magnitude = np.full(len(xyz), 60, np.float32)
    return RadarScan("radar", 0, 0, xyz[rows].astype(np.float32), velocity[rows].astype(np.float32), magnitude)


def image(data: bytes = JPEG) -> Image:
    return Image("cam", 0, 0, data, "jpeg", (120, 100))


def frame(index: int, *messages: PointCloud | RadarScan | Image) -> Frame:
    return Frame(index, index * STEP_NS, 0, {m.sensor: m for m in messages})


def fields(boxes: object) -> dict[str, str]:
    """Names and dtype kinds of the fields that are there."""
    assert isinstance(boxes, Boxes3D)
    return {name: value.dtype.kind for name, value in boxes.arrays().items()}


def assert_equal(a: object, b: object) -> None:
    assert isinstance(a, Boxes3D)
    assert isinstance(b, Boxes3D)
    assert fields(a) == fields(b)
    for name, value in a.arrays().items():
        np.testing.assert_array_equal(value, b.arrays()[name])
