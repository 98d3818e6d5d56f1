"""Parameters of objects that LiDAR and radar see in images, and clusters of points there."""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from fbench.pipelines.sensors.lidar.clusters import LidarParams
from fbench.pipelines.sensors.points.clustering import Grouping
from fbench.pipelines.sensors.points.ground import GroundParams
from fbench.pipelines.sensors.radar.stage import RadarParams
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.params import CheckedParams, in_range, require_between
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.metadata import SIMULATED
from fbench.replay.data.rig import LogInfo


@dataclass(frozen=True)
class ImageClusterParams(CheckedParams, prefix="cluster"):
    """Clustering of projected points, over u, v and depth."""

    method: str = "dbscan"  # DBSCAN, or one of scikit-learn's: agglomerative, birch, hdbscan, meanshift, optics.
    eps_px: float = in_range(20.0, 0.01, 1e4)  # Radius [px].
    min_points: int = in_range(5, 1, 1e6)  # Points within the radius that make a core point, itself included.
    with_depth: bool = True  # Whether depth counts; if not, points are grouped by their place in the image alone.
    depth_px_per_m: float = in_range(15.0, 0, 1e4)
    """A difference in depth of 1 m counts as a distance of this many pixels [px/m]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        Grouping(self.method, self.eps_px, self.min_points).check("cluster")


def cluster_in_image(uv_px: Float64, depth_m: Float64, params: ImageClusterParams) -> Int64:
    """Cluster points at places (N, 2) [px] and depths (N,) [m] along the optical axis; -1 for noise, see `Grouping`."""
    features = np.column_stack([uv_px, depth_m * params.depth_px_per_m]) if params.with_depth else uv_px
    return Grouping(params.method, params.eps_px, params.min_points).clusters(features, depth_m)


FOCAL_PX = 400.0
"""Pixels in these parameters are those of a camera with this focal length; other images are scaled to it, so that
spacings of beams, which are angles, stay what they are."""
_LEAST_STEP = 1e-6


@dataclass(frozen=True)
class ShapeParams(CheckedParams, prefix="shape"):
    """What a vehicle looks like; in each pair, values from the first on are fine, from the second on impossible."""

    bottom_m: tuple[float, float] = (0.75, 1.1)  # Height above ground of the lowest point [m].
    top_m: tuple[float, float] = (3.8, 4.6)  # Height of the highest point [m].
    least_top_m: tuple[float, float] = (1.0, 0.85)
    """The same, where it is too low: guard rails and kerbs. It counts for what is narrower than `thin_m` only."""
    thin_m: float = in_range(0.4, 0, 100)  # Shorter edge [m] below which something may be a rail or a wall.
    least_extent_m: tuple[float, float] = (1.3, 0.8)  # Longer edge [m].
    most_length_m: tuple[float, float] = (9.0, 14.0)  # Longer edge [m].
    most_width_m: tuple[float, float] = (2.8, 3.2)  # Shorter edge [m].
    filling_m: tuple[float, float] = (0.15, 0.35)
    """Mean distance of the points from the nearest edge [m]: vegetation fills its rectangle."""
    num_points: tuple[float, float] = (8.0, 3.0)  # Number of points: a handful is too few to tell.
    num_over: tuple[float, float] = (0.0, 4.0)
    """Number of points above the height of vehicles: poles, walls and trees go on."""
    still: float = in_range(1.0, 0, 1)  # Factor on the score of what isn't known to move [0 to 1].

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, value in vars(self).items():
            if isinstance(value, tuple):
                for part in value:
                    require_between(f"shape.{name}", part, 0.0)
                if abs(value[0] - value[1]) < _LEAST_STEP:
                    raise ConfigError(f"shape.{name}: expected two different values, got {value[0]:g},{value[1]:g}")


_CLUSTERS = ImageClusterParams(eps_px=20.0, min_points=4, depth_px_per_m=12.0)
_RADAR_GROUND = GroundParams(tolerance_m=0.3)
_RADAR_SHAPE = ShapeParams(
    bottom_m=(1.0, 1.5), top_m=(4.0, 5.0), least_top_m=(1.3, 1.0), thin_m=0.8, filling_m=(0.4, 0.8),
    num_points=(6.0, 2.0), still=0.6,
)  # fmt: skip


@dataclass(frozen=True)
class LidarImageParams(CheckedParams, prefix="lidar_image"):
    """How LiDAR points become boxes in images. Pixels are those of a camera with a focal length of 400 px."""

    grouping: Literal["image", "space"] | None = None
    """Where points are grouped: `image`, over u, v and depth, or `space`, as `lidar3d` does, whose vehicles are then
    projected; none: in the image in simulated logs, else in space. A few beams outline less than a vehicle. In the
    image, `lidar.cluster`, `judge`, `size`, `sizes`, and `shape` mean nothing; in space, the other parameters
    here do.
    """
    max_height_m: float = in_range(4.5, 0.1, 100)
    """Points higher above the ground [m] are left out where they are grouped in the image."""
    cluster: ImageClusterParams = _CLUSTERS  # How points are grouped in the image.
    shape: ShapeParams = field(default_factory=ShapeParams)  # What a group in the image must look like.
    margin_px: float = in_range(3.0, 0, 1000)
    """By so much outlines are wider than their points on each side [px]: half of the spacing of beams."""


@dataclass(frozen=True)
class RadarImageParams(CheckedParams, prefix="radar_image"):
    """How radar echoes become boxes in images. Pixels are those of a camera with a focal length of 400 px."""

    cluster: ImageClusterParams = _CLUSTERS
    """How echoes are grouped; those that move apart from those that stand still."""
    ground: GroundParams = _RADAR_GROUND  # How the ground is found.
    max_height_m: float = in_range(4.5, 0.1, 100)  # Echoes higher above the ground [m] are left out.
    min_echoes: int | None = in_range(None, 0, 1e9)
    """With fewer echoes in a frame nothing tells where the ground is, nor what shape things have: clusters are found
    as in `radar3d`, completed to vehicles and projected; none: 1,000 in simulated logs, whose radars are exact about
    heights, else 5,000."""
    shape: ShapeParams = _RADAR_SHAPE
    """What a group must look like; of one that moves, only how large it is and of how many echoes."""
    margin_px: float = in_range(2.5, 0, 1000)  # By so much outlines are wider than their echoes on each side [px].


def resolve_min_echoes(asked: int | None, log_info: LogInfo) -> int:
    """From how many echoes in a frame on a radar of this log shows the ground and shapes."""
    if asked is not None:
        return asked
    return 1000 if SIMULATED in log_info.metadata else 5000


def resolve_grouping(
    lidar: LidarParams, image: LidarImageParams, log_info: LogInfo
) -> tuple[LidarParams, LidarImageParams]:
    """Return parameters that say where the points of this log are grouped, and keep those that are needed there. Raises
    ConfigError where a network would detect in space, but points are grouped in the image.
    """
    where = image.grouping or ("image" if SIMULATED in log_info.metadata else "space")
    if where == "image":
        if lidar.detector == "learned":
            raise ConfigError("lidar.detector=learned: detects in space; it needs lidar_image.grouping=space")
        lidar = replace(lidar, cluster=replace(lidar.cluster, max_height_m=image.max_height_m))
    return lidar, replace(image, grouping=where)


def far_radar() -> RadarParams:
    """Parameters of a radar whose echoes are kept a little beyond the range that is scored."""
    return RadarParams(max_range_m=70.0)
