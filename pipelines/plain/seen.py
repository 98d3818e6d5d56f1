"""All that a plain pipeline works on, timed: from a frame to what its cameras detect and the points of the others."""

from collections.abc import Mapping
from dataclasses import dataclass

from fbench.pipelines.camera.cameras_stage import CameraStage
from fbench.pipelines.camera.detector import CameraDetections
from fbench.pipelines.plain.clusters import Cloud
from fbench.pipelines.plain.params import PlainSensor
from fbench.pipelines.plain.pipeline_params import PlainParams
from fbench.pipelines.plain.sensors import KINDS, Crops, PointSensors
from fbench.pipelines.stages import StageClock
from fbench.replay.data import Fault, Frame, LogInfo, Rig
from fbench.replay.sensor_settings import SensorSettings


@dataclass(frozen=True, eq=False)
class PlainSeen:
    """What the sensors of one frame gave."""

    cameras: Mapping[str, CameraDetections]
    """By camera name; a camera that failed isn't in it."""
    clouds: Mapping[PlainSensor, Cloud]
    """By kind of sensor, in the order LiDAR, radar, stereo."""
    faults: tuple[Fault, ...]
    missing: Mapping[str, str]
    """Cameras whose depth is noise."""


class PlainSensors:
    """The sensors that the parameters name.

    Raises:
        ConfigError: where the file with the camera's weights is missing.
        ModelError: where these weights can't be used.
    """

    def __init__(self, params: PlainParams) -> None:
        self._params, self.cameras = params, CameraStage(params.camera)
        self.with_camera = "camera" in params.uses
        """Whether boxes have labels."""

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take the sensors of the rig.

        Raises:
            ConfigError: where a setting by sensor isn't one of a camera.
            LogError: where stereo is used and the rig has no pair.
        """
        params, settings = self._params, SensorSettings(self._params, rig)
        for kind in KINDS:  # whose points have common parameters
            settings.own(kind, getattr(params, kind), ())
        if self.with_camera:
            self.cameras.start(rig, log_info, settings)
        crops = Crops(params.lidar.crop, params.radar.crop, params.stereo.crop)
        self._points = PointSensors(rig, log_info, params.uses, crops, params.depth)

    def view(self, frame: Frame, clock: StageClock) -> PlainSeen:
        """Return what is seen in one frame; what a missing sensor would have given isn't there."""
        faults, missing = list[Fault](), dict[str, str]()
        cameras = self.cameras.view(frame, clock, faults)
        clouds = self._points.clouds(frame, clock, faults, missing)
        return PlainSeen(cameras, clouds, tuple(faults), missing)
