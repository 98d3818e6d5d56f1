"""Association: which measurements of all sensors are of one object, by log-likelihood ratios."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.fusion.kernels import agglomerate
from fbench.pipelines.fusion.late.params import AssociationParams
from fbench.pipelines.fusion.observations import AT_MIN_SCORE, Clusters, Overlap, Sighting, edges_for_points, overlap
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.boxes import VEHICLES
from fbench.replay.data.rig import Rig
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


_LOOKS_WHOLE = 0.3


@dataclass(frozen=True)
class Group:
    """What the sensors see of one object; at most one measurement of each camera, of LiDAR and of radar."""

    sightings: tuple[int, ...]
    """Rows of the sightings, in order."""
    lidar: int = -1
    """Row of the LiDAR cluster, -1: none."""
    is_cut: bool = False
    """Whether only what the camera's box holds of that cluster belongs to the object."""
    radar: int = -1
    """Row of the radar cluster, -1: none."""


def groups(
    rig: Rig, seen: list[Sighting], lidar: Clusters, radar: Clusters, eye_m: Float64, params: AssociationParams
) -> list[Group]:
    """Put all measurements into groups at once: see `agglomerate`. What no other sensor sees is a group of its own.

    Sightings are in an order that doesn't depend on how they were listed, as clusters are.
    """
    num, whole = len(seen), len(seen) + len(lidar.boxes)
    part, inside = _camera_ratios(rig, seen, lidar, radar, params)
    ratio = part + by_share(inside)
    fits = part[:, : len(lidar.boxes)] > 0
    is_cut = fits & (inside[:, : len(lidar.boxes)] < params.least_inside) & (lidar.score < _LOOKS_WHOLE)
    cuts = np.argwhere(is_cut)
    size = whole + len(radar.boxes) + len(cuts)
    matrix = np.zeros((size, size))
    matrix[:num, num:whole] = np.where(is_cut, NEVER, ratio[:, : len(lidar.boxes)])
    matrix[:num, whole : size - len(cuts)] = ratio[:, len(lidar.boxes) :]
    matrix[num:whole, whole : size - len(cuts)] = between_clusters(lidar, radar, eye_m, params)
    for i, a in enumerate(seen):
        for j, b in enumerate(seen[:i]):
            matrix[j, i] = between_cameras(b, a, params)
    _add_cuts(matrix, part, cuts, [s.camera for s in seen], num, whole)
    for begin, end in ((num, whole), (whole, size - len(cuts))):
        matrix[begin:end, begin:end] = NEVER
    upper = np.triu(matrix, 1)
    return _as_groups(agglomerate(upper + upper.T), num, whole, size - len(cuts), cuts)


def _add_cuts(matrix: Float64, part: Float64, cuts: Int64, cameras: list[str], num: int, whole: int) -> None:
    """Let the part of a cluster that a sighting cuts out belong to it and to sightings of other cameras, but to nothing
    else that LiDAR sees.
    """
    begin, camera = len(matrix) - len(cuts), np.array(cameras)
    matrix[num:whole, begin:] = NEVER
    matrix[begin:, begin:] = NEVER
    for at, (s, k) in enumerate(cuts):
        matrix[:num, begin + at] = np.where(camera == camera[s], NEVER, part[:, k])
        # A little more, lest another camera takes what it cuts out of the cluster for itself.
        matrix[s, begin + at] = np.nextafter(part[s, k], np.inf)


def _camera_ratios(
    rig: Rig, seen: list[Sighting], lidar: Clusters, radar: Clusters, params: AssociationParams
) -> tuple[Float64, Float64]:
    """Ratios (S, K + M) of sightings and what is inside of all clusters, and the shares (S, K + M) that are inside."""
    num_lidar, total = len(lidar.boxes), np.concatenate([lidar.num_points, radar.num_points])
    ratio, share = np.full((len(seen), len(total)), NEVER), np.zeros((len(seen), len(total)))
    for camera in sorted({s.camera for s in seen}):
        rows = [i for i, s in enumerate(seen) if s.camera == camera]
        own = [seen[i] for i in rows]
        boxes = np.array([s.xyxy_px for s in own])
        points = overlap(rig, camera, lidar, edges_for_points(boxes))
        echoes = _beside_boxes(rig, camera, radar, boxes, params.bearing_margin_px)
        share[rows] = np.column_stack([points.num_inside, echoes.num_inside]) / np.maximum(total, 1)
        by_lidar = with_clusters(own, points, params.lidar_std_m, 0.0, params.lidar_area_m2, params)
        ratio[rows, :num_lidar] = by_lidar + by_shape(lidar)
        ratio[rows, num_lidar:] = with_clusters(
            own, echoes, params.radar_std_m, params.radar_bearing_std_rad, params.radar_area_m2, params
        )
    return ratio, share


def _beside_boxes(rig: Rig, camera: str, radar: Clusters, xyxy: Float64, margin_px: float) -> Overlap:
    """Radar heights are too poor to be used."""
    margin = np.maximum(margin_px, 0.1 * (xyxy[:, 2] - xyxy[:, 0]))
    endless = np.full(len(xyxy), np.inf)
    return overlap(rig, camera, radar, np.column_stack([xyxy[:, 0] - margin, -endless, xyxy[:, 2] + margin, endless]))


def _as_groups(number: Int64, num: int, whole: int, cut: int, cuts: Int64) -> list[Group]:
    """Groups in the order of their first measurements; a part of a cluster that no sighting took is none."""
    members: dict[int, list[int]] = {}
    for row, one in enumerate(number.tolist()):
        members.setdefault(one, []).append(row)
    result = []
    for rows in members.values():
        sightings = tuple(row for row in rows if row < num)
        lidar = [row - num for row in rows if num <= row < whole]
        echoes = [row - whole for row in rows if whole <= row < cut]
        parts = [int(cuts[row - cut, 1]) for row in rows if row >= cut]
        if sightings or lidar or echoes:
            result.append(Group(sightings, (lidar or parts or [-1])[0], bool(parts), (echoes or [-1])[0]))
    return result
