"""Clustering of points by a method chosen by name; results don't depend on the order of the points."""

import warnings
from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np

from fbench.pipelines.sensors.points.dbscan import dbscan
from fbench.replay.contracts.errors import ConfigError, did_you_mean
from fbench.replay.contracts.params import CheckedParams, in_range, require_between
from fbench.replay.data.arrays import Array, Float64, Int64

_QUIET = Lock()
METHODS = ("dbscan", "agglomerative", "birch", "hdbscan", "meanshift", "optics")  # Names of all methods


def _make_clusterer(method: str, points: Float64, eps: float, min_points: int) -> Any:
    """scikit-learn's clusterer of a name, made for points (N, D) from a length and a number of points."""
    from sklearn import cluster

    match method:
        case "agglomerative":  # other linkages need memory for all pairs of points
            return cluster.AgglomerativeClustering(n_clusters=None, distance_threshold=eps, linkage="single")
        case "birch":
            return cluster.Birch(threshold=eps, n_clusters=None)
        case "hdbscan":
            return cluster.HDBSCAN(
                min_cluster_size=max(2, min_points), min_samples=min_points, cluster_selection_epsilon=eps,
                allow_single_cluster=True, copy=True,
            )  # fmt: skip
        case "meanshift":
            seeds = np.unique(np.floor(points / eps), axis=0, return_index=True)[1]
            return cluster.MeanShift(bandwidth=eps, seeds=points[seeds], cluster_all=False)
    # With the default xi of 0.05, chance differences in density split evenly filled objects.
    return cluster.OPTICS(min_samples=max(2, min_points), max_eps=eps, cluster_method="xi", xi=0.2)


def cluster_by_name(points: Array, method: str, eps: float, min_points: int) -> Int64:
    """Cluster points (N, D) by a method of `METHODS` but DBSCAN; returns cluster numbers (N,), -1 for noise.

    Points are given in lexicographic order. Clusters of fewer than `min_points` points are noise. Equal points are in
    the same cluster: of several, in that of the smallest point. Clusters are numbered by their lexicographically
    smallest point. Points that aren't finite are noise.
    """
    result = np.full(len(points), -1)
    usable = np.flatnonzero(np.isfinite(points).all(axis=1))
    if len(usable) < max(2, min_points):  # which some of them refuse
        result[usable] = 0 if len(usable) >= min_points else -1
        return result
    order = usable[np.lexsort(points[usable].T[::-1])]
    given = np.ascontiguousarray(points[order], np.float64)
    # OPTICS divides by reachabilities, which are 0 where points are equal, and warns where all points are noise.
    # Warnings are silenced for one thread at a time: their filters are the process's, and a thread that puts back what
    # it found while another is at work would leave them wrong for good.
    with np.errstate(all="ignore"), _QUIET, warnings.catch_warnings(action="ignore", category=UserWarning):
        found = np.asarray(_make_clusterer(method, given, eps, min_points).fit_predict(given), np.int64)
    is_new = np.any(np.diff(given, axis=0, prepend=np.nan) != 0, axis=1)
    found, place = _by_appearance(found), np.cumsum(is_new) - 1
    lowest = np.full(place[-1] + 1, len(found))
    np.minimum.at(lowest, place, np.where(found < 0, len(found), found))
    joined = np.where(lowest[place] < len(found), lowest[place], -1)  # the same for points of one place
    members = np.bincount(joined + 1, minlength=2)
    result[order] = _by_appearance(np.where(members[joined + 1] >= min_points, joined, -1))
    return result


def _by_appearance(label: Int64) -> Int64:
    """Number labels (N,) by where they appear first; negative ones become -1."""
    kinds, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    first[kinds < 0] = -1
    rank = np.empty(len(kinds), np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(len(kinds)) - np.count_nonzero(kinds < 0)
    return np.maximum(rank, -1)[inverse]


@dataclass(frozen=True)
class Grouping:
    """How points of a sensor are grouped."""

    method: str  # One of `METHODS`
    eps: float  # Radius, in the unit of the points
    min_points: int  # Points within the radius that make a core point, itself included
    adaptive_from_m: float | None = None
    """Beyond this distance from the vehicle [m] the radius of DBSCAN grows in proportion to it; none: it doesn't."""

    def check(self, prefix: str) -> None:
        """Refuse unknown methods and senseless distances. Raises ConfigError naming the parameter below `prefix`."""
        if self.method not in METHODS:
            raise ConfigError(f"{prefix}.method: there is no '{self.method}'{did_you_mean(self.method, METHODS)}")
        if self.adaptive_from_m is not None:
            require_between(f"{prefix}.adaptive_from_m", self.adaptive_from_m, 1.0, 10_000.0)

    def radii(self, range_m: Float64) -> Float64:
        """Radius of each point (N,), by its distance from the vehicle: the spacing of beams grows with it."""
        from_m = self.adaptive_from_m
        growth = np.ones(len(range_m)) if from_m is None else np.maximum(1.0, range_m / from_m)
        return np.asarray(self.eps * growth, np.float64)

    def clusters(self, features: Float64, range_m: Float64) -> Int64:
        """Cluster points (N, D) at distances (N,) [m] from the vehicle; returns cluster numbers (N,), -1 for noise. See
        `dbscan` and `cluster_by_name` for how clusters are numbered; the order of points never changes them.
        """
        if self.method != "dbscan":
            return cluster_by_name(features, self.method, self.eps, self.min_points)
        return dbscan(features, self.eps if self.adaptive_from_m is None else self.radii(range_m), self.min_points)


@dataclass(frozen=True)
class ClusterParams(CheckedParams):
    """Clustering of the points of a sensor in space."""

    method: str = "dbscan"
    """DBSCAN, or one of scikit-learn's: agglomerative, birch, hdbscan, meanshift, optics."""
    eps_m: float = in_range(0.6, 0.01, 100)  # Radius [m].
    min_points: int = in_range(3, 1, 1e6)  # Points within the radius that make a core point, itself included.
    adaptive_from_m: float | None = 25.0
    """Beyond this distance from the body's origin [m] the radius of DBSCAN grows in proportion to it, as the spacing of
    beams does; none: it is the same everywhere."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.grouping.check(self._prefix.rstrip("."))

    @property
    def grouping(self) -> Grouping:
        """What of this tells how points are grouped."""
        return Grouping(self.method, self.eps_m, self.min_points, self.adaptive_from_m)
