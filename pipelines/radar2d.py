"""radar2d: vehicles in images from the echoes of all radars alone, and a tracker."""

from dataclasses import dataclass, field

from fbench.pipelines.common_params import RadarAloneParams
from fbench.pipelines.imaging.cameras import projectable
from fbench.pipelines.imaging.params import RadarImageParams, far_radar
from fbench.pipelines.imaging.reported import unlabelled
from fbench.pipelines.imaging.sensors import RadarInImages
from fbench.pipelines.points.merged import require
from fbench.pipelines.points.radar import RadarParams
from fbench.pipelines.points.radar_stage import RadarStage
from fbench.pipelines.stages import StageClock
from fbench.pipelines.tracked import Detected, Tracked2D
from fbench.pipelines.tracking.tracker2d import Tracker2DParams
from fbench.replay.boxes import Boxes2D
from fbench.replay.data import Frame, LogInfo, Output, Rig
from fbench.replay.sensor_settings import SensorSettings


@dataclass(frozen=True)
class Radar2DParams(RadarAloneParams):
    """Parameters of `radar2d`."""

    radar: RadarParams = field(default_factory=far_radar)
    """Echoes and their velocities; clusters in space count only for sparse radars, see `radar_image.min_echoes`."""
    min_score: float = 0.4
    """Clusters with a lower score are dropped."""
    radar_image: RadarImageParams = field(default_factory=RadarImageParams)
    """Detection in images."""
    tracking: Tracker2DParams = field(default_factory=Tracker2DParams)
    """The tracker, one per camera."""


class Radar2D:
    """Boxes in the images of all cameras from all radars, with their range rate; images aren't looked at. They have no
    class.
    """

    def __init__(self, params: Radar2DParams = Radar2DParams()) -> None:
        self._params, self._tracked = params, Tracked2D(params.tracking, params.detect_every)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all radars of the rig, and the cameras that can be projected into.

        Raises:
            LogError: where it has no radar, or no such camera.
        """
        require("radar2d", ("radar",), rig, log_info)
        cameras = projectable("radar2d", rig, log_info)
        params = self._params
        echoes = RadarStage(rig, log_info, params.radar, SensorSettings(params, rig))
        self._radar = RadarInImages(rig, cameras, echoes, params.radar, params.radar_image)
        self.reset("start")

    def reset(self, reason: str) -> None:
        """Forget all tracks."""
        self._tracked.reset()

    def step(self, frame: Frame) -> Output:
        """Detect and track; a frame without radar has no detections."""
        return self._tracked.step(frame, self._detected)

    def _detected(self, frame: Frame, clock: StageClock) -> Detected[Boxes2D]:
        return Detected(unlabelled(self._radar.view(frame, clock).seen, self._params.min_score))
