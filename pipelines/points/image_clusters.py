"""Clusters of points in the image, where objects behind each other are told apart by their depth."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.checks import require_ranges
from fbench.pipelines.points.clustering import Grouping
from fbench.replay.arrays import Float64, Int64


@dataclass(frozen=True)
class ImageClusterParams:
    """Clustering of projected points, over u, v and depth."""

    method: str = "dbscan"
    """DBSCAN, or one of scikit-learn's: agglomerative, birch, hdbscan, meanshift, optics."""
    eps_px: float = 20.0
    """Radius [px]."""
    min_points: int = 5
    """Points within the radius that make a core point, itself included."""
    with_depth: bool = True
    """Whether depth counts; if not, points are grouped by their place in the image alone."""
    depth_px_per_m: float = 15.0
    """A difference in depth of 1 m counts as a distance of this many pixels [px/m]."""

    def __post_init__(self) -> None:
        ranges = {"eps_px": (0.01, 1e4), "min_points": (1, 1e6), "depth_px_per_m": (0.0, 1e4)}
        require_ranges("cluster", self, ranges)
        Grouping(self.method, self.eps_px, self.min_points).check("cluster")


def cluster_in_image(uv_px: Float64, depth_m: Float64, params: ImageClusterParams) -> Int64:
    """Cluster points at places (N, 2) [px] and depths (N,) [m] along the optical axis; -1 for noise, see `Grouping`."""
    features = np.column_stack([uv_px, depth_m * params.depth_px_per_m]) if params.with_depth else uv_px
    return Grouping(params.method, params.eps_px, params.min_points).clusters(features, depth_m)
