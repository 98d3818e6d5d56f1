"""Fusion in images: what cameras, LiDARs and radars see there, merged and tracked."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from fbench.pipelines.fusion.image import ImageFusion
from fbench.pipelines.fusion.image_reliability import ImageFusionParams
from fbench.pipelines.params import StageClock
from fbench.pipelines.sensors.camera.stage import CameraStage
from fbench.pipelines.sensors.image.params import LidarImageParams, RadarImageParams, far_radar, whole_vehicles
from fbench.pipelines.sensors.image.stage import InImages, projectable
from fbench.pipelines.sensors.lidar.lidar import LidarParams
from fbench.pipelines.sensors.parallel import SideBySide
from fbench.pipelines.sensors.radar.radar import RadarParams
from fbench.pipelines.tracking.params import Tracker2DParams
from fbench.pipelines.tracking.stage import Detected, Tracked2D
from fbench.pipelines.variants.params import AllSensorsParams
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.frames import Fault, Frame, Output
from fbench.replay.data.rig import LogInfo, Rig

SeeInImages = Callable[[Frame, StageClock], InImages]
"""What sensors of one kind see in the images of one frame."""


@dataclass(frozen=True)
class FusedImagesParams(AllSensorsParams):
    """What `early2d` and `late2d` have in common."""

    lidar: LidarParams = field(default_factory=whole_vehicles)
    """Points and ground; of `lidar.cluster` only max_height_m counts here."""
    radar: RadarParams = field(default_factory=far_radar)
    """Echoes and their velocities; clusters in space count only for sparse radars, see `radar_image.min_echoes`."""
    lidar_image: LidarImageParams = field(default_factory=LidarImageParams)
    """Detection by LiDAR in images."""
    radar_image: RadarImageParams = field(default_factory=RadarImageParams)
    """Detection by radar in images."""
    fusion: ImageFusionParams = field(default_factory=ImageFusionParams)
    """How the sensors' boxes become one."""
    tracking: Tracker2DParams = field(default_factory=Tracker2DParams)
    """The tracker, one per camera."""


class FusedImages:
    """Merges in each image what its camera sees and what LiDARs and radars see there; how these see is left open."""

    def __init__(self, cameras: CameraStage, fusion: ImageFusionParams, tracked: Tracked2D) -> None:
        self._sensors, self._params, self._tracked = SideBySide(cameras), fusion, tracked

    @property
    def identity(self) -> Mapping[str, object]:
        """Which weights are used, where no parameter names them."""
        return self._sensors.identity

    def start(self, pipeline: str, rig: Rig, log_info: LogInfo, settings: SensorSettings) -> tuple[str, ...]:
        """Take all cameras of the rig, and return the names of those that can be projected into.

        Raises:
            LogError: where there is none, or one that has weights isn't among them.
        """
        cameras = projectable(pipeline, rig, log_info)
        self._sensors.start(rig, log_info, settings)
        self._fusion = ImageFusion(rig, cameras, self._params)
        return cameras

    def reset(self) -> None:
        """Forget all tracks, and how well the cameras see."""
        self._tracked.reset()
        self._fusion.reset()

    def step(self, frame: Frame, lidar: SeeInImages, radar: SeeInImages) -> Output:
        """Detect with each sensor that delivered, merge and track; a corrupt image counts as missing."""

        def merged(frame: Frame, clock: StageClock) -> Detected[Boxes2D]:
            faults = list[Fault]()
            seen = self._sensors.view(frame, clock, faults, lidar, radar)
            with clock.stage("fuse"):
                return Detected(self._fusion.merge(*seen), tuple(faults))

        return self._tracked.step(frame, merged, self._sensors.missing)
