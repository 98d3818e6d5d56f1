"""lidar2d: vehicles in images from the points of all LiDARs alone, and a tracker."""

from dataclasses import dataclass, field

from fbench.pipelines.checks import require_between
from fbench.pipelines.imaging.cameras import projectable
from fbench.pipelines.imaging.params import LidarImageParams, whole_vehicles
from fbench.pipelines.imaging.reported import unlabelled
from fbench.pipelines.imaging.sensors import LidarInImages
from fbench.pipelines.points.lidar import LidarParams
from fbench.pipelines.points.lidar_stage import LidarStage
from fbench.pipelines.points.merged import require
from fbench.pipelines.rhythm import Rhythm, predicted
from fbench.pipelines.stages import StageClock
from fbench.pipelines.tracking.tracker2d import Tracker2D, Tracker2DParams
from fbench.replay.data import Frame, LogInfo, Output, Rig
from fbench.replay.sensor_settings import SensorSettings


@dataclass(frozen=True)
class Lidar2DParams:
    """Parameters of `lidar2d`."""

    lidar: LidarParams = field(default_factory=whole_vehicles)
    """Points and ground; of `lidar.cluster` only max_height_m counts here."""
    lidar_image: LidarImageParams = field(default_factory=LidarImageParams)
    """Detection in images."""
    min_score: float = 0.4
    """Clusters that look less like a vehicle than this are dropped."""
    tracking: Tracker2DParams = field(default_factory=Tracker2DParams)
    """The tracker, one per camera."""
    detect_every: int = 1
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one LiDAR, by its name: `--set top.min_range_m=1` goes before `lidar.min_range_m`; so does max_range_m. What
    acts on the points of all LiDARs together can't differ.
    """

    def __post_init__(self) -> None:
        require_between("min_score", self.min_score, 0.0, 1.0)
        require_between("detect_every", self.detect_every, 1)


class Lidar2D:
    """Boxes in the images of all cameras from all LiDARs; images aren't looked at. They have no class."""

    def __init__(self, params: Lidar2DParams = Lidar2DParams()) -> None:
        self._params = params
        self._tracker, self._rhythm = Tracker2D(params.tracking), Rhythm(params.detect_every)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all LiDARs of the rig, and the cameras that can be projected into.

        Raises:
            LogError: where it has no LiDAR, or no such camera.
        """
        require("lidar2d", ("lidar",), rig, log_info)
        cameras = projectable("lidar2d", rig, log_info)
        self._stage = LidarStage(rig, log_info, self._params.lidar, SensorSettings(self._params, rig))
        self._lidar = LidarInImages(rig, cameras, self._stage, self._params.lidar_image)
        self.reset("start")

    def reset(self, reason: str) -> None:
        """Forget all tracks, and how the ground lies."""
        self._tracker.reset()
        self._rhythm.reset()
        self._stage.reset()

    def step(self, frame: Frame) -> Output:
        """Detect and track; a frame without LiDAR has no detections."""
        if not self._rhythm.due():
            return predicted(lambda: self._tracker.predict(frame.stamp_ns))
        clock = StageClock()
        detections = unlabelled(self._lidar.view(frame, clock).seen, self._params.min_score)
        with clock.stage("track"):
            tracks = self._tracker.step(detections, frame.stamp_ns)
        return Output(detections, tracks, clock.stage_ns)
