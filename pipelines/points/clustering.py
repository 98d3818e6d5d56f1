"""Grouping of points by a method chosen by name."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.checks import require_between
from fbench.pipelines.points.clusterers import CLUSTERERS, cluster_by_name
from fbench.pipelines.points.dbscan import dbscan
from fbench.replay.arrays import Float64, Int64
from fbench.replay.errors import ConfigError
from fbench.replay.names import did_you_mean

METHODS = ("dbscan", *CLUSTERERS)
"""Names of all methods."""


@dataclass(frozen=True)
class Grouping:
    """How points of a sensor are grouped."""

    method: str
    """One of `METHODS`."""
    eps: float
    """Radius, in the unit of the points."""
    min_points: int
    """Points within the radius that make a core point, itself included."""
    adaptive_from_m: float | None = None
    """Beyond this distance from the vehicle [m] the radius of DBSCAN grows in proportion to it; none: it doesn't."""

    def check(self, prefix: str) -> None:
        """Refuse unknown methods and distances that make no sense; `prefix` is what precedes the names.

        Raises:
            ConfigError: naming the parameter.
        """
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
        """Cluster points (N, D) at distances (N,) [m] from the vehicle; returns cluster numbers (N,), -1 for noise.

        See `dbscan` and `cluster_by_name` for how clusters are numbered; the order of points never changes them.
        """
        if self.method != "dbscan":
            return cluster_by_name(features, self.method, self.eps, self.min_points)
        return dbscan(features, self.eps if self.adaptive_from_m is None else self.radii(range_m), self.min_points)
