"""late3d: cameras, LiDARs and radars detect on their own; their boxes are merged in 3D and tracked."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from fbench.pipelines.fusion.late.late import LateFusion, Seen
from fbench.pipelines.fusion.late.params import FusionParams
from fbench.pipelines.params import StageClock
from fbench.pipelines.sensors.camera.stage import CameraStage
from fbench.pipelines.sensors.lidar.stage import LidarStage
from fbench.pipelines.sensors.parallel import SideBySide
from fbench.pipelines.sensors.points.merged import require
from fbench.pipelines.sensors.radar.radar import RadarStage
from fbench.pipelines.tracking.params import Tracker3DParams, steady_tracking
from fbench.pipelines.tracking.stage import Detected, Tracked3D
from fbench.pipelines.variants.params import AllSensorsParams
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Fault, Frame, Output
from fbench.replay.data.rig import LogInfo, Rig


@dataclass(frozen=True)
class Late3DParams(AllSensorsParams):
    """Parameters of `late3d`."""

    fusion: FusionParams = field(default_factory=FusionParams)
    """How the sensors' objects become one."""
    tracking: Tracker3DParams = field(default_factory=steady_tracking)
    """The tracker."""


class Late3D:
    """Labelled boxes in 3D from any of cameras, LiDARs and radars; at least one LiDAR or radar must be there.

    Objects without a camera's label are called cars, or trucks where they are long.
    """

    def __init__(self, params: Late3DParams = Late3DParams()) -> None:
        self._params, self._fusion = params, LateFusion(params.fusion)
        self._sensors = SideBySide(CameraStage(params.camera, params.fusion.camera_share))
        self._tracked = Tracked3D(params.tracking, params.detect_every)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all sensors of the rig.

        Raises:
            LogError: where it has no LiDAR or radar, or a camera that is to be used can't be projected into.
        """
        require("late3d", ("lidar", "radar"), rig, log_info)
        settings = SensorSettings(self._params, rig)
        self._sensors.start(rig, log_info, settings)
        self._tracked.start(rig)
        self._rig = rig
        self._lidar = LidarStage(rig, log_info, self._params.lidar, settings)
        self._radar = RadarStage(rig, log_info, self._params.radar, settings)
        self.reset("start")

    def identity(self) -> Mapping[str, object]:
        """Which weights are used, where no parameter names them."""
        return self._sensors.identity

    def reset(self, reason: str) -> None:
        """Forget all tracks, how the ground lies, and how well the sensors work."""
        self._tracked.reset()
        self._fusion.reset()
        self._lidar.reset()

    def step(self, frame: Frame) -> Output:
        """Detect with each sensor that delivered, merge and track; a corrupt image counts as missing."""
        return self._tracked.step(frame, self._detected, self._sensors.missing)

    def _detected(self, frame: Frame, clock: StageClock) -> Detected[Boxes3D]:
        faults = list[Fault]()
        seen = Seen(self._rig, *self._sensors.view(frame, clock, faults, self._lidar.view, self._radar.view))
        with clock.stage("fuse"):
            return Detected(self._fusion.step(seen), tuple(faults))
