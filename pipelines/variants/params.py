"""Parameters that several pipelines share; `--set` knows them by the same names everywhere."""

from dataclasses import dataclass, field

from fbench.pipelines.models.weights import resolve_settings
from fbench.pipelines.params import require_between
from fbench.pipelines.sensors.camera.detector import CameraParams
from fbench.pipelines.sensors.lidar.lidar import LidarParams
from fbench.pipelines.sensors.radar.radar import RadarParams


@dataclass(frozen=True)
class AllSensorsParams:
    """What pipelines of cameras, LiDARs and radars share."""

    camera: CameraParams = field(default_factory=CameraParams)
    """Detection by camera; without weights those of fbench work on simulated logs; on others it counts as
    missing.
    """
    lidar: LidarParams = field(default_factory=LidarParams)
    """Detection by LiDAR."""
    radar: RadarParams = field(default_factory=RadarParams)
    """Detection by radar."""
    detect_every: int = 1
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one sensor, by its name: `--set front_left.min_score=0.3` goes before `camera.min_score`. Cameras may differ
    in everything, LiDARs in min_range_m and max_range_m, radars in max_range_m, min_magnitude_db and doppler.
    """

    def __post_init__(self) -> None:
        require_between("detect_every", self.detect_every, 1)
        object.__setattr__(self, "by_sensor", resolve_settings(self.by_sensor))


@dataclass(frozen=True)
class LidarAloneParams:
    """What pipelines of LiDARs alone share."""

    lidar: LidarParams = field(default_factory=LidarParams)
    """Detection."""
    min_score: float = 0.5
    """Clusters with a lower score are dropped."""
    detect_every: int = 1
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one LiDAR, by its name: `--set top.min_range_m=1` goes before `lidar.min_range_m`; so does max_range_m. What
    acts on the points of all LiDARs together can't differ.
    """

    def __post_init__(self) -> None:
        require_alone(self.min_score, self.detect_every)


@dataclass(frozen=True)
class RadarAloneParams:
    """What pipelines of radars alone share."""

    radar: RadarParams = field(default_factory=RadarParams)
    """Detection."""
    min_score: float = 0.65
    """Clusters with a lower score are dropped."""
    detect_every: int = 1
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one radar, by its name: `--set rear.max_range_m=40` goes before `radar.max_range_m`; so do min_magnitude_db
    and doppler. What acts on the echoes of all radars together can't differ.
    """

    def __post_init__(self) -> None:
        require_alone(self.min_score, self.detect_every)


def require_alone(min_score: float, detect_every: int) -> None:
    """Refuse a score that is no share, and a rhythm without detection, in a pipeline of one kind of sensor.

    Raises:
        ConfigError: naming the parameter.
    """
    require_between("min_score", min_score, 0.0, 1.0)
    require_between("detect_every", detect_every, 1)
