"""A rig with one camera that looks ahead, and what its sensors see of cars on a flat road."""

import numpy as np

from fbench.pipelines.fusion.late.fuse import SensorViews
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.lidar.clusters import LidarView
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.sensors.radar.stage import RadarView
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.replay.geometry.camera import project_boxes

AHEAD = np.array([-0.5, 0.5, -0.5, 0.5])
"""Camera axes (right, down, forward) in body axes (forward, left, up)."""
K = np.array([[1000.0, 0, 640], [0, 1000, 360], [0, 0, 1]])
RIG = Rig(
    {
        "cam": Mount("camera", np.array([0.5, 0, 0]), AHEAD),
        "lidar": Mount("lidar", np.zeros(3), np.array([0, 0, 0, 1.0])),
        "radar": Mount("radar", np.zeros(3), np.array([0, 0, 0, 1.0])),
    },
    {"cam": CameraModel(K, (1280, 720))},
)
PLANE = Plane(0.0, 0.0, -1.5)


def car(x_m, y_m=0.0, size=(4.2, 1.8, 1.55), yaw=0.0) -> Boxes3D:
    """A car that stands on the road."""
    return Boxes3D(np.array([[x_m, y_m, -1.5 + size[2] / 2]]), np.array([size]), np.array([yaw]))


def outline(*cars: Boxes3D, label="car", score=0.8) -> CameraDetections:
    """What a perfect detector sees of these cars: the outline of their near sides."""
    found = []
    for box in cars:
        size = box.size_lwh_m[0]
        near = Boxes3D(box.center_m - [size[0] / 2, 0, 0], np.array([[0.01, size[1], size[2]]]), box.yaw_rad)
        found.append(project_boxes(RIG, "cam", near)[0][0])
    num = len(found)
    return CameraDetections(np.array(found).reshape(-1, 4), np.full(num, score), np.full(num, label))


def lidar_view(*cars: Boxes3D, score=0.9, plane: Plane | None = PLANE) -> LidarView:
    """30 points on the back of each car, and its whole box."""
    xyz, cluster = _points(cars, 30)
    return LidarView(plane, xyz, cluster, _boxes(cars, score, velocity=None))


def radar_view(*cars: Boxes3D, score=0.9, velocity=(3.0, 0.0, 0.0)) -> RadarView:
    """40 echoes on the back of each car, which moves away."""
    xyz, cluster = _points(cars, 40)
    return RadarView(xyz, cluster, _boxes(cars, score, velocity))


def standing_view(*cars: Boxes3D) -> RadarView:
    """40 echoes on the back of each car, which stands."""
    xyz, _ = _points(cars, 40)
    return RadarView(xyz, np.full(len(xyz), -1), Boxes3D.empty())


def seen(
    camera: CameraDetections | None, lidar: LidarView | None = None, radar: RadarView | None = None
) -> SensorViews:
    """One frame; `None`: the sensor is missing."""
    cameras = {} if camera is None else {"cam": camera}
    return SensorViews(RIG, cameras, lidar or lidar_view(), radar or radar_view())


def _points(cars, num):
    parts, cluster = [np.zeros((0, 3))], [np.zeros(0, np.int64)]
    for number, box in enumerate(cars):
        center, size = box.center_m[0], box.size_lwh_m[0]
        y, z = center[1] + size[1] * np.linspace(-0.45, 0.45, num), center[2] + 0.3 * np.sin(np.arange(num))
        parts.append(np.column_stack([np.full(num, center[0] - size[0] / 2), y, z]))
        cluster.append(np.full(num, number))
    return np.concatenate(parts), np.concatenate(cluster)


def _boxes(cars, score, velocity):
    if not cars:
        return Boxes3D.empty()
    center, size, yaw = (np.concatenate([getattr(c, n) for c in cars]) for n in ("center_m", "size_lwh_m", "yaw_rad"))
    velocities = None if velocity is None else np.tile(velocity, (len(cars), 1))
    return Boxes3D(center, size, yaw, velocity_mps=velocities, score=np.full(len(cars), score))
