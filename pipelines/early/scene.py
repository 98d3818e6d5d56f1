"""What is known of one frame before its points are put together."""

from collections.abc import Mapping
from dataclasses import dataclass

from fbench.pipelines.camera.detector import CameraDetections
from fbench.pipelines.early.cloud import Cloud
from fbench.pipelines.points.ground import Plane
from fbench.pipelines.points.lidar import LidarParams
from fbench.replay.arrays import Float64
from fbench.replay.data import Rig


@dataclass(frozen=True, eq=False)
class Scene:
    """One frame."""

    rig: Rig
    cameras: Mapping[str, CameraDetections]
    """By camera name; a camera that failed isn't in it."""
    cloud: Cloud
    plane: Plane | None
    """The ground, where it is known."""
    tall: Float64
    """(K, 3) LiDAR points above the height of cars [m]."""
    eye_m: Float64
    """(2,) from where the cloud is seen [m]."""
    lidar: LidarParams
    """How shapes are judged, and what partly seen cars are completed to."""
