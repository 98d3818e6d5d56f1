"""early2d: LiDAR and radar points in the images are merged with the cameras' boxes there, and tracked."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from fbench.pipelines.branches import Branches
from fbench.pipelines.camera.cameras_stage import CameraStage
from fbench.pipelines.camera.detector import CameraParams
from fbench.pipelines.checks import require_between
from fbench.pipelines.imaging.cameras import projectable
from fbench.pipelines.imaging.fusion_params import ImageFusionParams
from fbench.pipelines.imaging.params import LidarImageParams, RadarImageParams, far_radar, whole_vehicles
from fbench.pipelines.imaging.sensors import LidarInImages, RadarInImages
from fbench.pipelines.imaging.together import ImageFusion
from fbench.pipelines.points.lidar import LidarParams
from fbench.pipelines.points.lidar_stage import LidarStage
from fbench.pipelines.points.merged import require
from fbench.pipelines.points.radar import RadarParams
from fbench.pipelines.points.radar_stage import RadarStage
from fbench.pipelines.rhythm import Rhythm, predicted
from fbench.pipelines.stages import StageClock
from fbench.pipelines.tracking.tracker2d import Tracker2D, Tracker2DParams
from fbench.pipelines.weights.named import resolve_settings
from fbench.replay.data import Fault, Frame, LogInfo, Output, Rig
from fbench.replay.sensor_settings import SensorSettings


@dataclass(frozen=True)
class Early2DParams:
    """Parameters of `early2d`."""

    camera: CameraParams = field(default_factory=CameraParams)
    """Detection by camera; without weights those of fbench work on simulated logs; on others it counts as
    missing.
    """
    lidar: LidarParams = field(default_factory=whole_vehicles)
    """Points and ground; of `lidar.cluster` only max_height_m counts here."""
    lidar_image: LidarImageParams = field(default_factory=LidarImageParams)
    """Detection by LiDAR in images."""
    radar: RadarParams = field(default_factory=far_radar)
    """Echoes and their velocities; clusters in space count only for sparse radars, see `radar_image.min_echoes`."""
    radar_image: RadarImageParams = field(default_factory=RadarImageParams)
    """Detection by radar in images."""
    fusion: ImageFusionParams = field(default_factory=ImageFusionParams)
    """How the sensors' boxes become one."""
    tracking: Tracker2DParams = field(default_factory=Tracker2DParams)
    """The tracker, one per camera."""
    detect_every: int = 1
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one sensor, by its name: `--set front_left.min_score=0.3` goes before `camera.min_score`. Cameras may differ
    in everything, LiDARs in min_range_m and max_range_m, radars in max_range_m, min_magnitude_db and doppler.
    """

    def __post_init__(self) -> None:
        require_between("detect_every", self.detect_every, 1)
        object.__setattr__(self, "by_sensor", resolve_settings(self.by_sensor))


class Early2D:
    """Labelled boxes in the images of all cameras, with distance and range rate; at least one LiDAR or radar must be
    there.

    Objects without a camera's label are called cars, or trucks where they are long.
    """

    def __init__(self, params: Early2DParams = Early2DParams()) -> None:
        self._params, self._branches = params, Branches()
        self._cameras = CameraStage(params.camera)
        self._tracker, self._rhythm = Tracker2D(params.tracking), Rhythm(params.detect_every)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all sensors of the rig.

        Raises:
            LogError: where it has no LiDAR or radar, or no camera that can be projected into, or one that is to be used
                can't.
        """
        require("early2d", ("lidar", "radar"), rig, log_info)
        params, settings = self._params, SensorSettings(self._params, rig)
        names = projectable("early2d", rig, log_info)
        self._cameras.start(rig, log_info, settings)
        self._cameras.require_projections()
        self._fusion = ImageFusion(rig, names, params.fusion)
        self._points = LidarStage(rig, log_info, params.lidar, settings)
        self._lidar = LidarInImages(rig, names, self._points, params.lidar_image)
        echoes = RadarStage(rig, log_info, params.radar, settings)
        self._radar = RadarInImages(rig, names, echoes, params.radar, params.radar_image)
        self.reset("start")

    def identity(self) -> Mapping[str, object]:
        """Which weights are used, where no parameter names them."""
        return self._cameras.identity

    def reset(self, reason: str) -> None:
        """Forget all tracks, and how the ground lies."""
        self._tracker.reset()
        self._rhythm.reset()
        self._fusion.reset()
        self._points.reset()

    def step(self, frame: Frame) -> Output:
        """Detect with each sensor that delivered, merge and track; a corrupt image counts as missing."""
        if not self._rhythm.due():
            return predicted(lambda: self._tracker.predict(frame.stamp_ns), self._cameras.missing)
        clock, faults = StageClock(), list[Fault]()
        seen = self._branches.run(
            clock,
            lambda clock: self._cameras.view(frame, clock, faults),
            lambda clock: self._lidar.view(frame, clock),
            lambda clock: self._radar.view(frame, clock),
        )
        with clock.stage("fuse"):
            detections = self._fusion.merge(*seen)
        with clock.stage("track"):
            tracks = self._tracker.step(detections, frame.stamp_ns)
        return Output(detections, tracks, clock.stage_ns, tuple(faults), self._cameras.missing)
