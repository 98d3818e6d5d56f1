"""Parameters of the baseline, the thesis's algorithms as written."""

from dataclasses import dataclass, field
from typing import Literal

from fbench.pipelines.models.weights import resolve_settings
from fbench.pipelines.sensors.camera.detector import CameraParams
from fbench.pipelines.sensors.stereo.stage import StereoParams
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.params import CheckedParams, in_range

PlainSensor = Literal["camera", "lidar", "radar", "stereo"]
Strategy = Literal["early", "late"]


@dataclass(frozen=True)
class PlainCropParams(CheckedParams, prefix="crop"):
    """Which points take part. The thesis doesn't say how it leaves out the ground; here by height alone."""

    min_range_m: float = in_range(3.0, 0, 1e4)
    """Points nearer to the body's origin, seen from above [m], lie on the own vehicle."""
    max_range_m: float = in_range(100.0, 0.1, 1e4)  # Farther points [m] are left out.
    low_m: float = in_range(0.3, -1e3, 1e3)
    """Points lower than this over the body's origin [m] are ground: the thesis's origin is on the ground."""
    high_m: float = in_range(3.5, -1e3, 1e3)  # Higher points [m] are left out.


@dataclass(frozen=True)
class PlainClusterParams(CheckedParams, prefix="cluster"):
    """DBSCAN over x, y and z."""

    eps_m: float = in_range(1.2, 0.01, 100)  # Radius [m].
    min_points: int = in_range(5, 1, 1e6)  # Points within the radius that make a core point, itself included.


@dataclass(frozen=True)
class PlainImageParams(CheckedParams, prefix="image"):
    """DBSCAN over u, v and depth."""

    eps_px: float = in_range(20.0, 0.01, 1e4)  # Radius [px].
    min_points: int = in_range(5, 1, 1e6)  # Points within the radius that make a core point, itself included.
    depth_px_per_m: float = in_range(10.0, 0, 1e4)
    """A difference in depth of 1 m counts as a distance of this many pixels [px/m]."""


@dataclass(frozen=True)
class PlainSizeParams(CheckedParams, prefix="size"):
    """Sizes of clusters that may be vehicles, of which a sensor sees some sides. The thesis names no limits."""

    least_points: int = in_range(5, 1, 1e6)  # Clusters of fewer points are dropped.
    least_extent_m: float = in_range(1.4, 0, 1e3)
    """Least extent along the longer of the axes x and y [m]: shorter clusters are poles and people."""
    most_extent_m: float = in_range(12.0, 0, 1e3)
    """Greatest extent along the longer of the axes x and y [m]: longer clusters are walls."""
    most_width_m: float = in_range(4.0, 0, 1e3)  # Greatest extent along the shorter of the axes x and y [m].
    least_height_m: float = in_range(0.5, 0, 1e3)  # Least height between the lowest and the highest point [m].
    most_height_m: float = in_range(2.2, 0, 1e3)
    """Greatest height between them [m]: higher clusters are buildings and trees."""


@dataclass(frozen=True)
class PlainSensorParams:
    """From the points of one kind of sensor to boxes in space."""

    crop: PlainCropParams = field(default_factory=PlainCropParams)  # Which points take part.
    cluster: PlainClusterParams = field(default_factory=PlainClusterParams)  # How they are grouped in space.
    size: PlainSizeParams = field(default_factory=PlainSizeParams)  # Which clusters are dropped.


@dataclass(frozen=True)
class PlainImageSensorParams(PlainSensorParams):
    """The same, and to boxes in images."""

    image: PlainImageParams = field(default_factory=PlainImageParams)
    """How they are grouped in images, with the strategy `early`."""


@dataclass(frozen=True)
class PlainFusionParams(CheckedParams, prefix="fusion"):
    """How boxes of several sensors become one."""

    min_iou: float = in_range(0.05, 1e-6, 1)  # Boxes that overlap less than this (intersection over union) stay apart.
    label_share: float = in_range(0.5, 0, 1)
    """With early fusion in 3D: a cluster gets a camera's label where at least this share of its points carries one."""


# Large radius and few points for radar, as the thesis says; more points of its clusters.
RADAR = PlainSensorParams(cluster=PlainClusterParams(eps_m=1.5, min_points=4), size=PlainSizeParams(least_points=8))
RADAR_IMAGES = PlainImageSensorParams(
    cluster=RADAR.cluster, size=RADAR.size, image=PlainImageParams(eps_px=25.0, min_points=4, depth_px_per_m=15.0)
)


@dataclass(frozen=True)
class PlainParams(CheckedParams):
    """What the plain pipelines in images and in space share."""

    uses: tuple[PlainSensor, ...] = ("camera", "lidar", "radar")  # Kinds of sensors: camera, lidar, radar, stereo.
    strategy: Strategy = "late"  # `early`: points of all sensors are merged; `late`: boxes of each.
    camera: CameraParams = field(default_factory=CameraParams)  # Detection by camera.
    lidar: PlainSensorParams = field(default_factory=PlainSensorParams)  # Points of LiDARs.
    radar: PlainSensorParams = RADAR  # Points of radars.
    stereo: PlainSensorParams = field(default_factory=PlainSensorParams)  # Points of stereo.
    depth: StereoParams = field(default_factory=StereoParams)  # How stereo gives depth.
    fusion: PlainFusionParams = field(default_factory=PlainFusionParams)  # How boxes of several sensors become one.
    oriented: bool = True
    """Boxes in space have the heading of the rectangle that fits a cluster best, seen from above (Zhang et al., IV
    2017); else they lie along the axes. The thesis gives its boxes a yaw, but doesn't say how it finds that.
    """
    detect_every: int = in_range(1, 1)
    """Detection runs on every so many-th frame of a segment, from its first; between them tracks are predicted."""
    by_sensor: tuple[str, ...] = ()
    """Of one camera, by its name: `--set front_left.min_score=0.3` goes before `camera.min_score`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.uses or len(set(self.uses)) < len(self.uses):
            known = "camera, lidar, radar, stereo"
            raise ConfigError(f"uses: expected one or more of {known}, each once, got {','.join(self.uses)}")
        object.__setattr__(self, "by_sensor", resolve_settings(self.by_sensor))
