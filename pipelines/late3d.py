"""late3d: cameras, LiDARs and radars detect on their own; their boxes are merged in 3D and tracked."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from fbench.pipelines.camera.detector import CameraDetections, CameraParams
from fbench.pipelines.camera.detectors import CameraDetectors
from fbench.pipelines.camera.look import look
from fbench.pipelines.fusion.late import Seen, fuse
from fbench.pipelines.fusion.params import FusionParams
from fbench.pipelines.points.lidar import LidarParams
from fbench.pipelines.points.lidar_stage import LidarStage
from fbench.pipelines.points.merged import require, world_T_body
from fbench.pipelines.points.radar import RadarParams
from fbench.pipelines.points.radar_stage import RadarStage
from fbench.pipelines.stages import StageClock
from fbench.pipelines.tracking.tracker3d import Tracker3D, Tracker3DParams
from fbench.pipelines.weights.named import resolve_settings
from fbench.replay.data import Fault, Frame, Image, LogInfo, Output, Rig
from fbench.replay.geometry.camera import require_projection
from fbench.replay.sensor_settings import SensorSettings


@dataclass(frozen=True)
class Late3DParams:
    """Parameters of `late3d`."""

    camera: CameraParams = field(default_factory=CameraParams)
    """Detection by camera; without weights those of fbench work on simulated logs; on others it counts as
    missing.
    """
    lidar: LidarParams = field(default_factory=LidarParams)
    """Detection by LiDAR."""
    radar: RadarParams = field(default_factory=RadarParams)
    """Detection by radar."""
    fusion: FusionParams = field(default_factory=FusionParams)
    """How the sensors' objects become one."""
    tracking: Tracker3DParams = field(default_factory=Tracker3DParams)
    """The tracker."""
    by_sensor: tuple[str, ...] = ()
    """Of one sensor, by its name: `--set front_left.min_score=0.3` goes before `camera.min_score`. Cameras may differ
    in everything, LiDARs in min_range_m and max_range_m, radars in max_range_m, min_magnitude_db and doppler.
    """

    def __post_init__(self) -> None:
        object.__setattr__(self, "by_sensor", resolve_settings(self.by_sensor))


class Late3D:
    """Labelled boxes in 3D from any of cameras, LiDARs and radars; at least one LiDAR or radar must be there.

    Objects without a camera's label are called cars, or trucks where they are long.
    """

    def __init__(self, params: Late3DParams = Late3DParams()) -> None:
        self._params = params
        self._detectors = CameraDetectors(params.camera)
        self._tracker = Tracker3D(params.tracking)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all sensors of the rig.

        Raises:
            LogError: where it has no LiDAR or radar, or a camera that is to be used can't be projected into.
        """
        require("late3d", ("lidar", "radar"), rig, log_info)
        settings = SensorSettings(self._params, rig)
        self._detectors.assign(settings.own("camera", self._params.camera), log_info)
        for name in rig.sensors("camera"):
            if self._detectors.of(name) is not None:
                require_projection(rig, name)
        self._rig = rig
        self._lidar = LidarStage(rig, self._params.lidar, settings)
        self._radar = RadarStage(rig, log_info, self._params.radar, settings)
        self.reset("start")

    def identity(self) -> Mapping[str, object]:
        """Which weights are used, where no parameter names them."""
        return self._detectors.identity

    def reset(self, reason: str) -> None:
        """Forget all tracks, and how the ground lies."""
        self._tracker.reset()
        self._lidar.reset()

    def step(self, frame: Frame) -> Output:
        """Detect with each sensor that delivered, merge and track; a corrupt image counts as missing."""
        clock, faults = StageClock(), list[Fault]()
        cameras = self._cameras(frame, clock, faults)
        blind = [name for name in self._rig.sensors("camera") if self._detectors.of(name) is None]
        seen = Seen(self._rig, cameras, self._lidar.view(frame, clock), self._radar.view(frame, clock))
        with clock.stage("fuse"):
            detections = fuse(seen, self._params.fusion)
        with clock.stage("track"):
            tracks = self._tracker.step(detections, frame.stamp_ns, world_T_body(self._rig, frame))
        return Output(detections, tracks, clock.stage_ns, tuple(faults), dict.fromkeys(blind, "no weights"))

    def _cameras(self, frame: Frame, clock: StageClock, faults: list[Fault]) -> dict[str, CameraDetections]:
        found: dict[str, CameraDetections] = {}
        for name in self._rig.sensors("camera"):
            image, detector = frame.messages.get(name), self._detectors.of(name)
            if detector is None or not isinstance(image, Image):
                continue
            seen = look(detector, image, clock, faults)
            if seen is not None:
                found[name] = seen
        return found
