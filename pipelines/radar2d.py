"""radar2d: vehicles in images from the echoes of all radars alone, and a tracker."""

from dataclasses import dataclass, field

from fbench.pipelines.checks import require_between
from fbench.pipelines.imaging.cameras import projectable
from fbench.pipelines.imaging.params import RadarImageParams, far_radar
from fbench.pipelines.imaging.reported import unlabelled
from fbench.pipelines.imaging.sensors import RadarInImages
from fbench.pipelines.points.merged import require
from fbench.pipelines.points.radar import RadarParams
from fbench.pipelines.points.radar_stage import RadarStage
from fbench.pipelines.rhythm import Rhythm, predicted
from fbench.pipelines.stages import StageClock
from fbench.pipelines.tracking.tracker2d import Tracker2D, Tracker2DParams
from fbench.replay.data import Frame, LogInfo, Output, Rig
from fbench.replay.sensor_settings import SensorSettings


@dataclass(frozen=True)
class Radar2DParams:
    """Parameters of `radar2d`."""

    radar: RadarParams = field(default_factory=far_radar)
    """Echoes and their velocities; clusters in space count only for sparse radars, see `radar_image.min_echoes`."""
    radar_image: RadarImageParams = field(default_factory=RadarImageParams)
    """Detection in images."""
    min_score: float = 0.4
    """Clusters with a lower score are dropped."""
    tracking: Tracker2DParams = field(default_factory=Tracker2DParams)
    """The tracker, one per camera."""
    detect_every: int = 1
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one radar, by its name: `--set rear.max_range_m=40` goes before `radar.max_range_m`; so do min_magnitude_db
    and doppler. What acts on the echoes of all radars together can't differ.
    """

    def __post_init__(self) -> None:
        require_between("min_score", self.min_score, 0.0, 1.0)
        require_between("detect_every", self.detect_every, 1)


class Radar2D:
    """Boxes in the images of all cameras from all radars, with their range rate; images aren't looked at. They have no
    class.
    """

    def __init__(self, params: Radar2DParams = Radar2DParams()) -> None:
        self._params = params
        self._tracker, self._rhythm = Tracker2D(params.tracking), Rhythm(params.detect_every)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all radars of the rig, and the cameras that can be projected into.

        Raises:
            LogError: where it has no radar, or no such camera.
        """
        require("radar2d", ("radar",), rig, log_info)
        cameras = projectable("radar2d", rig, log_info)
        params = self._params
        stage = RadarStage(rig, log_info, params.radar, SensorSettings(params, rig))
        self._radar = RadarInImages(rig, cameras, stage, params.radar, params.radar_image)
        self.reset("start")

    def reset(self, reason: str) -> None:
        """Forget all tracks."""
        self._tracker.reset()
        self._rhythm.reset()

    def step(self, frame: Frame) -> Output:
        """Detect and track; a frame without radar has no detections."""
        if not self._rhythm.due():
            return predicted(lambda: self._tracker.predict(frame.stamp_ns))
        clock = StageClock()
        detections = unlabelled(self._radar.view(frame, clock).seen, self._params.min_score)
        with clock.stage("track"):
            tracks = self._tracker.step(detections, frame.stamp_ns)
        return Output(detections, tracks, clock.stage_ns)
