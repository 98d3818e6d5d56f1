"""Which points of LiDAR and radar belong to an object that a camera sees."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.fusion.lift import Sighting
from fbench.pipelines.fusion.params import FusionParams
from fbench.replay.arrays import Bool, Float64, Int64
from fbench.replay.geometry.transforms import wrap_angle

LIDAR_FULL = 10.0
RADAR_FULL = 20.0
STANDING_DEPTH_M = 3.0


@dataclass(frozen=True, eq=False)
class Points:
    """The points of one sensor kind, as one camera sees them."""

    xyz: Float64
    """(N, 3) [m] in body coordinates."""
    uv: Float64
    """(N, 2) [px], NaN behind the camera."""
    distance_m: Float64
    """(N,) from the camera, on the ground [m]."""
    cluster: Int64
    """(N,) number of the cluster, -1: none."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Points that belong to a sighting."""

    rows: Bool
    """(N,) which."""
    near_m: float
    """Distance of their near side from the camera [m]."""
    std_m: float
    """Error of that distance [m]."""
    strength: float
    """How much there is of it, 0 to 1."""
    bearing_rad: float
    """Direction of their middle from the camera, in body axes [rad]."""
    cluster: int
    """Number of the cluster, -1: none."""


def by_lidar(sighting: Sighting, points: Points, free: Bool, params: FusionParams) -> Evidence | None:
    """Find the LiDAR cluster that a sighting shows: inside its box, at about its distance, most points."""
    left, top, right, bottom = sighting.xyxy_px
    inset = 0.05 * (right - left)
    inside = _between(points.uv[:, 0], left + inset, right - inset) & _between(points.uv[:, 1], top - 5, bottom + 5)
    likelihood = _likelihood(sighting, points.distance_m, params)
    rows = _best_cluster(free & inside, likelihood, points.cluster, 3)
    if rows is None:
        return None
    return _evidence(sighting, points, rows, params.lidar_std_m, 1 - np.exp(-int(rows.sum()) / LIDAR_FULL))


def by_moving(sighting: Sighting, points: Points, free: Bool, params: FusionParams) -> Evidence | None:
    """Find the cluster of moving echoes that a sighting shows; radar heights are too poor to be used."""
    left, _, right, _ = sighting.xyxy_px
    margin = max(params.bearing_margin_px, 0.1 * (right - left))
    inside = free & _between(points.uv[:, 0], left - margin, right + margin)
    rows = _best_cluster(inside, _likelihood(sighting, points.distance_m, params), points.cluster, 4)
    if rows is None:
        return None
    return _evidence(sighting, points, rows, params.radar_std_m, 1 - np.exp(-int(rows.sum()) / RADAR_FULL))


def by_standing(sighting: Sighting, points: Points, free: Bool, params: FusionParams) -> Evidence | None:
    """Find the distance at which most stationary echoes lie in the direction of a sighting."""
    left, _, right, _ = sighting.xyxy_px
    likelihood = _likelihood(sighting, points.distance_m, params)
    candidates = np.flatnonzero(free & (points.cluster < 0) & (likelihood > 0) & _between(points.uv[:, 0], left, right))
    if len(candidates) < 5:
        return None
    candidates = candidates[np.argsort(points.distance_m[candidates], kind="stable")]
    distance = points.distance_m[candidates]
    stop = np.searchsorted(distance, distance + STANDING_DEPTH_M)
    begin = int(np.argmax((stop - np.arange(len(distance))) * likelihood[candidates]))
    rows = np.zeros(len(points.xyz), np.bool_)
    rows[candidates[begin : stop[begin]]] = True
    return _evidence(sighting, points, rows, params.standing_std_m, 1 - np.exp(-int(rows.sum()) / RADAR_FULL))


def _between(values: Float64, low: float, high: float) -> Bool:
    inside: Bool = (values > low) & (values < high)
    return inside


def _likelihood(sighting: Sighting, distance_m: Float64, params: FusionParams) -> Float64:
    """Likelihood (N,) of distances under the guess from the image, log-normal; 0 outside the gate."""
    deviation = np.log(np.maximum(distance_m, 0.1) / sighting.near_m) / sighting.std
    return np.where(np.abs(deviation) < params.gate, np.exp(-0.5 * deviation**2), 0.0)


def _best_cluster(candidates: Bool, likelihood: Float64, cluster: Int64, least: int) -> Bool | None:
    """Rows of the cluster with the largest sum of likelihoods, the lowest number on ties."""
    rows = candidates & (likelihood > 0) & (cluster >= 0)
    if not rows.any():
        return None
    best = int(np.argmax(np.bincount(cluster[rows], weights=likelihood[rows])))
    rows &= cluster == best
    return rows if rows.sum() >= least else None


def _evidence(sighting: Sighting, points: Points, rows: Bool, std_m: float, strength: float) -> Evidence:
    distance = np.sort(points.distance_m[rows])
    xyz = points.xyz[rows] - sighting.eye_m
    aside = wrap_angle(np.arctan2(xyz[:, 1], xyz[:, 0]) - sighting.bearing_rad)
    return Evidence(
        rows=rows,
        near_m=float(distance[len(distance) // 10]),
        std_m=std_m,
        strength=float(strength),
        bearing_rad=sighting.bearing_rad + float(np.median(aside)),
        cluster=int(points.cluster[rows][0]),
    )
