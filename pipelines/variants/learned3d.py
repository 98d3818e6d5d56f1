"""learned3d: road users by a bird's-eye network on the points of LiDARs, radars or both, and a tracker."""

from dataclasses import dataclass, field

from fbench.pipelines.sensors.bev.detector import (
    BevParams,
    LidarNetworkParams,
    describe_weights,
    open_detector,
    warn_of_other_world,
)
from fbench.pipelines.sensors.bev.stage import KINDS, BevStage, BevView
from fbench.pipelines.sensors.lidar.clusters import LidarParams
from fbench.pipelines.sensors.radar.stage import RadarParams
from fbench.pipelines.tracking.params import Tracker3DParams, steady_tracking
from fbench.pipelines.tracking.stage import Detected, TrackingPipeline
from fbench.pipelines.tracking.trackers import Tracker3D
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.params import CheckedParams, StageClock, in_range
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.rig import LogInfo, Rig


@dataclass(frozen=True)
class Learned3DParams(CheckedParams):
    """Parameters of `learned3d`."""

    network: BevParams = field(default_factory=BevParams)  # The detector.
    lidar: LidarParams = field(default_factory=LidarParams)
    """How LiDARs are prepared: ranges, the own vehicle, motion in a sweep, ground. Nothing is clustered."""
    radar: RadarParams = field(default_factory=RadarParams)
    """How echoes are prepared: ranges, magnitudes, ego motion. Nothing is clustered."""
    tracking: Tracker3DParams = field(default_factory=steady_tracking)  # The tracker.
    detect_every: int = in_range(1, 1)
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one sensor, by its name: `--set top.min_range_m=1` goes before `lidar.min_range_m`; see `late3d`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.lidar.detector == "learned" or self.lidar.network != LidarNetworkParams():
            raise ConfigError("lidar.detector and lidar.network: learned3d has a network of its own, set network")


class Learned3D(TrackingPipeline[Boxes3D]):
    """Labeled boxes in 3D from all LiDARs and radars together, or from one kind alone; with velocity where an echo
    tells.
    """

    def __init__(self, params: Learned3DParams = Learned3DParams()) -> None:
        super().__init__(Tracker3D(params.tracking), params.detect_every)
        self._detector = open_detector(params.network)
        self._params = params
        self.kinds = KINDS[self._detector.sensors]
        self.weights = describe_weights(params.network)

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Take all LiDARs and radars of the rig, or those of one kind. Raises LogError where it has none."""
        params, settings = self._params, SensorSettings(self._params, rig)
        self._stage = BevStage(rig, log_info, params.network, params.lidar, params.radar, settings, self._detector)
        self._remember(self._stage)
        self._warned = warn_of_other_world(params.network, log_info)
        super().start(rig, log_info)

    def warnings(self) -> tuple[Fault, ...]:
        """Say where the built-in network looks at a log that isn't simulated."""
        return self._warned

    def _detect(self, frame: Frame, clock: StageClock) -> BevView:
        return self._stage.view(frame, clock)

    def _combine(self, seen: BevView, clock: StageClock) -> Detected[Boxes3D]:
        return Detected(self._stage.detect(seen, clock))
