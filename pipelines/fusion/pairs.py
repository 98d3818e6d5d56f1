"""Log-likelihood ratios of pairs: do two sensors see one object, or two that have nothing to do with each other?"""

import numpy as np

from fbench.pipelines.fusion.clusters import Clusters, Overlap
from fbench.pipelines.fusion.lift import AT_MIN_SCORE, Sighting
from fbench.pipelines.fusion.params import AssociationParams
from fbench.replay.arrays import Float64
from fbench.replay.data import VEHICLES
from fbench.replay.geometry.transforms import wrap_angle

NEVER = -np.inf
FEWEST = 3
"""With fewer points of a cluster in its box a camera and the cluster have nothing to do with each other."""
_LEAST_SHARE = 0.05
_TAILS = 3.0
_SHAPELESS, _SHAPELY = 0.5, 10.0


def with_clusters(
    seen: list[Sighting], inside: Overlap, std_m: float, bearing_std_rad: float, area_m2: float,
    params: AssociationParams,
) -> Float64:  # fmt: skip
    """Ratios (S, K) of what one camera sees and clusters, by the near sides of what lies in its boxes.

    Directions are normally distributed, the logarithms of distances as Student's t: guesses from images are far off
    now and then.
    """
    near = np.array([s.near_m for s in seen])[:, None]
    std = np.hypot(np.array([s.std for s in seen])[:, None], std_m / near)
    half = np.array([s.half_rad for s in seen])[:, None]
    aside = np.hypot(half / 2, np.hypot(params.bearing_std_rad, bearing_std_rad))
    off = np.log(np.maximum(inside.near_m, 0.1) / near) / std
    square = _heavy(off**2) + (inside.bearing_rad / aside) ** 2
    doubt = np.array([_doubt(s) for s in seen])[:, None]
    ratio = np.log(area_m2 / (near**2 * 2 * np.pi * std * aside)) - square / 2 - doubt
    return np.where(inside.num_inside >= FEWEST, ratio, NEVER)


def by_share(share: Float64) -> Float64:
    """What the share of a whole cluster that is in a camera's box adds to their ratio: what reaches far beyond the box
    is something else.
    """
    return np.asarray(np.log(np.clip(share, _LEAST_SHARE, 1.0)), np.float64)


def between_clusters(lidar: Clusters, radar: Clusters, eye_m: Float64, params: AssociationParams) -> Float64:
    """Ratios (K, M) of LiDAR and radar clusters by their middles, seen from `eye_m` (2,).

    Of long vehicles radar sees some part, so that its error along the line of sight grows with the vehicle.
    """
    a, b = lidar.boxes.center_m[:, None, :2] - eye_m, radar.boxes.center_m[None, :, :2] - eye_m
    reach = np.maximum(np.hypot(b[..., 0], b[..., 1]), 0.1)
    off = a - b
    along, across = (off * b).sum(axis=2) / reach, (off[..., 1] * b[..., 0] - off[..., 0] * b[..., 1]) / reach
    longest = np.maximum(lidar.boxes.size_lwh_m[:, None, 0], radar.boxes.size_lwh_m[None, :, 0])
    std_along = np.hypot(np.hypot(params.radar_std_m, params.lidar_std_m), longest / 5)
    std_across = np.hypot(params.lidar_std_m, params.radar_bearing_std_rad * reach) + longest / 10
    square = (along / std_along) ** 2 + (across / std_across) ** 2
    ratio = np.log(params.lidar_area_m2 / (2 * np.pi * std_along * std_across)) - square / 2
    return np.asarray(ratio + by_shape(lidar)[:, None], np.float64)


def by_shape(lidar: Clusters) -> Float64:
    """What looks (K,) add to the ratios of LiDAR clusters: nearly nothing else looks like a road user, but of those
    not all do.
    """
    return np.asarray(np.log(_SHAPELESS + _SHAPELY * np.clip(lidar.score, 0.0, 1.0)), np.float64)


def between_cameras(a: Sighting, b: Sighting, params: AssociationParams) -> float:
    """Ratio of what two cameras see, as the first of them sees it: directions are sure, distances aren't."""
    if a.camera == b.camera or not alike(a.label, b.label):
        return NEVER
    middle = b.eye_m[:2] + _ray(b.bearing_rad) * (b.near_m + b.depth_m) - a.eye_m[:2]
    reach, bearing = max(float(np.hypot(*middle)), 0.1), float(np.arctan2(middle[1], middle[0]))
    std = float(np.hypot(a.std, b.std))
    aside = a.half_rad / 2 + 2 * params.bearing_std_rad
    off = np.log(reach / (a.near_m + a.depth_m)) / std
    square = off**2 + (float(wrap_angle(np.array([bearing - a.bearing_rad]))[0]) / aside) ** 2
    return float(np.log(params.camera_area_m2 / (reach**2 * 2 * np.pi * std * aside)) - square / 2)


def alike(label: str, other: str) -> bool:
    """Tell whether two detectors may mean one object: vehicles are easily taken for each other."""
    return label == other or (label in VEHICLES and other in VEHICLES)


def _doubt(s: Sighting) -> float:
    """Of weak boxes there are many more that show nothing: they mustn't take what surer ones may have."""
    return (
        0.0
        if s.is_sure
        else max(0.0, float(np.log(AT_MIN_SCORE / (1 - AT_MIN_SCORE) * (1 - s.score) / max(s.score, 1e-6))))
    )


def _heavy(square: Float64) -> Float64:
    """Minus twice the logarithm of Student's density with `_TAILS` degrees of freedom, 0 at its middle."""
    return np.asarray((_TAILS + 1) * np.log1p(square / _TAILS), np.float64)


def _ray(bearing_rad: float) -> Float64:
    return np.array([np.cos(bearing_rad), np.sin(bearing_rad)])
