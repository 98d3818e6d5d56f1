"""radar3d: moving vehicles from the echoes of all radars alone, and a tracker."""

from dataclasses import dataclass, field, replace

from fbench.pipelines.checks import require_between
from fbench.pipelines.points import radar
from fbench.pipelines.points.doppler import DopplerParams, logged_period
from fbench.pipelines.points.merged import radar_scans, require, world_T_body
from fbench.pipelines.points.radar import RadarParams
from fbench.pipelines.points.reported import reported
from fbench.pipelines.stages import StageClock
from fbench.pipelines.tracking.tracker3d import Tracker3D, Tracker3DParams
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import Frame, LogInfo, Output, Rig, Source


@dataclass(frozen=True)
class Radar3DParams:
    """Parameters of `radar3d`."""

    radar: RadarParams = field(default_factory=RadarParams)
    """Detection."""
    min_score: float = 0.65
    """Clusters with a lower score are dropped."""
    tracking: Tracker3DParams = field(default_factory=Tracker3DParams)
    """The tracker."""

    def __post_init__(self) -> None:
        require_between("min_score", self.min_score, 0.0, 1.0)


class Radar3D:
    """Boxes in 3D from all radars, with the velocity along the line of sight. They have no class."""

    def __init__(self, params: Radar3DParams = Radar3DParams()) -> None:
        self._params = params
        self._radar = params.radar
        self._tracker = Tracker3D(params.tracking)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all radars of the rig."""
        require("radar3d", ("radar",), rig, log_info)
        self._rig = rig
        self._radar = for_log(self._params.radar, log_info)
        self.reset("start")

    def reset(self, reason: str) -> None:
        """Forget all tracks."""
        self._tracker.reset()

    def step(self, frame: Frame) -> Output:
        """Detect and track; a frame without radar has no detections."""
        clock = StageClock()
        detections = self._detect(frame, clock)
        with clock.stage("track"):
            tracks = self._tracker.step(detections, frame.stamp_ns, world_T_body(self._rig, frame))
        return Output(detections, tracks, clock.stage_ns)

    def _detect(self, frame: Frame, clock: StageClock) -> Boxes3D:
        with clock.stage("calibrate"):
            scans = radar_scans(self._rig, frame)
        if scans is None:
            return reported(Boxes3D.empty(), 0.0, Source.R)
        with clock.stage("preprocess"):
            echoes = radar.compensate(scans, self._radar)
        with clock.stage("detect.radar"):
            view = radar.detect(echoes, self._radar)
        return reported(view.boxes, self._params.min_score, Source.R)


def for_log(params: RadarParams, log_info: LogInfo) -> RadarParams:
    """Take over what the log says about its radars, where the parameters leave it open."""
    if params.doppler.period_mps is not None:
        return params
    doppler: DopplerParams = replace(params.doppler, period_mps=logged_period(log_info))
    return replace(params, doppler=doppler)
