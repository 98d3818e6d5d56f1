"""Parameters that the plain pipelines have in common."""

from dataclasses import dataclass, field

from fbench.pipelines.camera.detector import CameraParams
from fbench.pipelines.plain.params import (
    MORE_POINTS,
    RADAR,
    PlainFusionParams,
    PlainSensor,
    PlainSensorParams,
    Strategy,
    require_uses,
)
from fbench.pipelines.stereo.params import StereoParams
from fbench.pipelines.weights.named import resolve_settings


def radar_params() -> PlainSensorParams:
    """Parameters for clusters of radar in space."""
    return PlainSensorParams(cluster=RADAR, size=MORE_POINTS)


@dataclass(frozen=True)
class PlainParams:
    """What the plain pipelines in images and in space share."""

    uses: tuple[PlainSensor, ...] = ("camera", "lidar", "radar")
    """Kinds of sensors: camera, lidar, radar, stereo."""
    strategy: Strategy = "late"
    """`early`: points of all sensors are merged; `late`: boxes of each."""
    camera: CameraParams = field(default_factory=CameraParams)
    """Detection by camera."""
    lidar: PlainSensorParams = field(default_factory=PlainSensorParams)
    """Points of LiDARs."""
    radar: PlainSensorParams = field(default_factory=radar_params)
    """Points of radars."""
    stereo: PlainSensorParams = field(default_factory=PlainSensorParams)
    """Points of stereo."""
    depth: StereoParams = field(default_factory=StereoParams)
    """How stereo gives depth."""
    fusion: PlainFusionParams = field(default_factory=PlainFusionParams)
    """How boxes of several sensors become one."""
    detect_every: int = 1
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one camera, by its name: `--set front_left.min_score=0.3` goes before `camera.min_score`."""

    def __post_init__(self) -> None:
        require_uses(self.uses, self.detect_every)
        object.__setattr__(self, "by_sensor", resolve_settings(self.by_sensor))
