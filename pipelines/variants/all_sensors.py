"""Parameters, branches and stereo pair that pipelines of cameras, LiDARs and radars have in common."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

from fbench.pipelines.models.weights import resolve_settings
from fbench.pipelines.sensors.camera.detector import CameraParams, CameraStage
from fbench.pipelines.sensors.lidar.clusters import LidarParams
from fbench.pipelines.sensors.parallel import Branches
from fbench.pipelines.sensors.points.merged import require
from fbench.pipelines.sensors.radar.stage import RadarParams
from fbench.pipelines.sensors.stereo.stage import StereoParams, StereoStage
from fbench.pipelines.tracking.stage import TrackingPipeline
from fbench.pipelines.tracking.trackers import B, Tracker
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.params import CheckedParams, StageClock, in_range
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.frames import Frame
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.geometry.stereo_pairs import pairs


@dataclass(frozen=True)
class AllSensorsParams(CheckedParams):
    """What pipelines of cameras, LiDARs and radars share."""

    camera: CameraParams = field(default_factory=CameraParams)
    """Detection by camera; without weights those of fbench work on simulated logs; on others it counts as
    missing.
    """
    lidar: LidarParams = field(default_factory=LidarParams)  # Detection by LiDAR.
    radar: RadarParams = field(default_factory=RadarParams)  # Detection by radar.
    detect_every: int = in_range(1, 1)
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one sensor, by its name: `--set front_left.min_score=0.3` goes before `camera.min_score`. Cameras may differ
    in everything, LiDARs in min_range_m and max_range_m, radars in max_range_m, min_magnitude_db and doppler.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "by_sensor", resolve_settings(self.by_sensor))


class FusionPipeline(TrackingPipeline[B]):
    """Cameras and two other kinds of sensors, whose branches run in parallel."""

    kinds = ("camera", "lidar", "radar")

    def __init__(self, params: AllSensorsParams, camera_share: float, tracker: Tracker[B, Any]) -> None:
        super().__init__(tracker, params.detect_every)
        self._cameras, self._branches = CameraStage(params.camera, camera_share), Branches()

    def _start_cameras(self, rig: Rig, log_info: LogInfo, settings: SensorSettings) -> None:
        """Take all cameras of the rig. Raises LogError where one that is used can't be projected into."""
        self._cameras.start(rig, log_info, settings)
        self._cameras.require_projections()
        self.missing, self.weights = self._cameras.missing, self._cameras.identity

    def _run(self, frame: Frame, clock: StageClock, *views: Callable[[Frame, StageClock], Any]) -> tuple[Any, ...]:
        """Return what cameras and others see, each in a branch of its own."""
        return self._branches.run(clock, *(partial(view, frame) for view in views))

    def _note(self, clock: StageClock, *seen: Any) -> tuple[Any, ...]:
        """Return what each of the `kinds` has seen, and keep it for the run."""
        for kind, view in zip(self.kinds, seen, strict=True):
            clock.note(kind, view)
        return seen


StereoPair = Literal["auto", "on", "off"]


def take_pair(
    pipeline: str, wanted: StereoPair, params: StereoParams, rig: Rig, log_info: LogInfo
) -> StereoStage | None:
    """Take the stereo pair of a rig, if it is to be used: `auto`, where the rig has one that gives depth, and no LiDAR.
    Raises ConfigError where a camera that is named isn't there. Raises LogError where the pair must be there and isn't,
    or where nothing else measures depth.
    """
    is_auto = wanted == "auto" and not rig.sensors("lidar") and bool(pairs(rig))
    if wanted == "on" or is_auto:
        try:
            return StereoStage(rig, log_info.name, params)
        except LogError:
            if wanted == "on" or not rig.sensors("radar"):
                raise
    require(pipeline, ("lidar", "radar"), rig, log_info, "a LiDAR, a radar or a stereo pair of cameras")
    return None
