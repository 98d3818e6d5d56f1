"""radar2d and radar3d: moving vehicles from the echoes of all radars alone, and a tracker."""

from dataclasses import dataclass, field

from fbench.pipelines.sensors.image.params import RadarImageParams, far_radar
from fbench.pipelines.sensors.image.stage import InImages, RadarInImages, SparseFrames, drop_labels, projectable
from fbench.pipelines.sensors.points.merged import report_boxes, require
from fbench.pipelines.sensors.radar.stage import RadarParams, RadarStage
from fbench.pipelines.tracking.params import Tracker2DParams, Tracker3DParams
from fbench.pipelines.tracking.stage import Detected, TrackingPipeline
from fbench.pipelines.tracking.trackers import Tracker2D, Tracker3D
from fbench.replay.contracts.params import CheckedParams, StageClock, in_range
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.boxes import Boxes2D, Boxes3D, Source
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.rig import LogInfo, Rig


@dataclass(frozen=True)
class RadarAloneParams(CheckedParams):
    """What pipelines of radars alone share."""

    radar: RadarParams = field(default_factory=RadarParams)  # Detection.
    min_score: float = in_range(0.65, 0, 1)  # Clusters with a lower score are dropped.
    detect_every: int = in_range(1, 1)
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one radar, by its name: `--set rear.max_range_m=40` goes before `radar.max_range_m`; so do min_magnitude_db
    and doppler. What acts on the echoes of all radars together can't differ.
    """


@dataclass(frozen=True)
class Radar2DParams(RadarAloneParams):
    """Parameters of `radar2d`."""

    radar: RadarParams = field(default_factory=far_radar)
    """Echoes and their velocities; clusters in space count only for sparse radars, see `radar_image.min_echoes`."""
    min_score: float = in_range(0.4, 0, 1)  # Clusters with a lower score are dropped.
    radar_image: RadarImageParams = field(default_factory=RadarImageParams)  # Detection in images.
    tracking: Tracker2DParams = field(default_factory=Tracker2DParams)  # The tracker, one per camera.


@dataclass(frozen=True)
class Radar3DParams(RadarAloneParams):
    """Parameters of `radar3d`."""

    tracking: Tracker3DParams = field(default_factory=Tracker3DParams)  # The tracker.


class Radar2D(TrackingPipeline[Boxes2D]):
    """Boxes without class, with range rate, in the images of all cameras from all radars; images aren't decoded."""

    kinds = ("radar",)

    def __init__(self, params: Radar2DParams = Radar2DParams()) -> None:
        super().__init__(Tracker2D(params.tracking), params.detect_every)
        self._params, self._sparse = params, SparseFrames()

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all radars, and cameras with a projection. Raises LogError where either is missing."""
        require("radar2d", ("radar",), rig, log_info)
        cameras, params = projectable("radar2d", rig, log_info), self._params
        echoes = RadarStage(rig, log_info, params.radar, SensorSettings(params, rig))
        self._radar = RadarInImages(rig, log_info, cameras, echoes, params.radar, params.radar_image, self._sparse)
        super().start(rig, log_info)

    def warnings(self) -> tuple[Fault, ...]:
        """Say where echoes were too few to outline anything."""
        return self._radar.warnings()

    def _detect(self, frame: Frame, clock: StageClock) -> InImages:
        return self._radar.view(frame, clock)

    def _combine(self, seen: InImages, clock: StageClock) -> Detected[Boxes2D]:
        self._radar.remember(seen)
        return Detected(drop_labels(seen.seen, self._params.min_score))


class Radar3D(TrackingPipeline[Boxes3D]):
    """Boxes in 3D from all radars, with the velocity along the line of sight. They have no class."""

    kinds = ("radar",)

    def __init__(self, params: Radar3DParams = Radar3DParams()) -> None:
        super().__init__(Tracker3D(params.tracking), params.detect_every)
        self._params = params

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all radars of the rig. Raises LogError where it has none."""
        require("radar3d", ("radar",), rig, log_info)
        self._radar = RadarStage(rig, log_info, self._params.radar, SensorSettings(self._params, rig))
        super().start(rig, log_info)

    def _detect(self, frame: Frame, clock: StageClock) -> Detected[Boxes3D]:
        return Detected(report_boxes(self._radar.view(frame, clock).boxes, self._params.min_score, Source.R))
