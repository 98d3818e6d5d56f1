"""Association: which observations of all sensors are of one object, by log-likelihood ratios."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.fusion import observations
from fbench.pipelines.fusion.joint import camera_ratios
from fbench.pipelines.fusion.kernels import agglomerate
from fbench.pipelines.fusion.observations import AT_MIN_SCORE, AssociationParams, CameraObservation, Clusters, Overlap
from fbench.replay.data.arrays import Bool, Float64
from fbench.replay.data.boxes import VEHICLES
from fbench.replay.data.rig import Rig

NEVER = -np.inf
FEWEST = 3  # With fewer points of a cluster in its box a camera and the cluster have nothing to do with each other
_LEAST_SHARE = 0.05
TAILS = 3.0  # Degrees of freedom of the errors of distances guessed from images
_SHAPELESS, _SHAPELY = 0.5, 10.0
_UNLIKE = float(np.log(_SHAPELESS))
_LOOKS_WHOLE = 0.3


@dataclass(frozen=True)
class Association:
    """The observations of one object: at most one of each camera, of LiDAR and of radar."""

    cameras: tuple[int, ...]  # Rows of the cameras' observations, in order
    lidar: int = -1  # Row of the LiDAR cluster, -1: none
    is_cut: bool = False  # Whether only what the camera's box holds of that cluster belongs to the object
    radar: int = -1  # Row of the radar cluster, -1: none


def associate(
    rig: Rig, seen: list[CameraObservation], lidar: Clusters, radar: Clusters, eye_m: Float64, params: AssociationParams
) -> list[Association]:
    """Associate all observations at once: see `agglomerate`. What no other sensor sees is an object of its own.

    Observations of cameras are in an order that doesn't depend on how they were listed, as clusters are. `eye_m` (2,)
    [m] is where radars look from.
    """
    num, whole = len(seen), len(seen) + len(lidar.boxes)
    part, inside = _camera_ratios(rig, seen, lidar, radar, params)
    # What reaches far beyond a camera's box is something else.
    ratio = part + np.log(np.clip(inside, _LEAST_SHARE, 1.0))
    fits = part[:, : len(lidar.boxes)] > 0
    is_cut = fits & (inside[:, : len(lidar.boxes)] < params.least_inside) & (lidar.score < _LOOKS_WHOLE)
    cuts = np.argwhere(is_cut)
    size = whole + len(radar.boxes) + len(cuts)
    cut = size - len(cuts)
    matrix = np.zeros((size, size))
    matrix[:num, num:whole] = np.where(is_cut, NEVER, ratio[:, : len(lidar.boxes)])
    matrix[:num, whole:cut] = ratio[:, len(lidar.boxes) :]
    matrix[num:whole, whole:cut] = _cluster_ratios(lidar, radar, eye_m, params)
    matrix[:num, :num] = camera_ratios(seen, params)
    # A part that a camera cuts out of a cluster may be seen by other cameras, too, but not by LiDAR a second time.
    matrix[num:whole, cut:] = NEVER
    matrix[cut:, cut:] = NEVER
    camera = np.array([s.camera for s in seen])
    for at, (s, k) in enumerate(cuts):
        matrix[:num, cut + at] = np.where(camera == camera[s], NEVER, part[:, k])
        # A little more, lest another camera takes what it cuts out of the cluster for itself.
        matrix[s, cut + at] = np.nextafter(part[s, k], np.inf)
    matrix[num:whole, num:whole] = NEVER
    matrix[whole:cut, whole:cut] = NEVER
    upper = np.triu(matrix, 1)
    members: dict[int, list[int]] = {}
    for row, group in enumerate(agglomerate(upper + upper.T).tolist()):
        members.setdefault(group, []).append(row)
    result = []
    for rows in members.values():
        cameras = tuple(row for row in rows if row < num)
        of_lidar = [row - num for row in rows if num <= row < whole]
        echoes = [row - whole for row in rows if whole <= row < cut]
        parts = [int(cuts[row - cut, 1]) for row in rows if row >= cut]
        if cameras or of_lidar or echoes:  # else it is a part that no camera took
            result.append(Association(cameras, (of_lidar or parts or [-1])[0], bool(parts), (echoes or [-1])[0]))
    return result


def _camera_ratios(
    rig: Rig, seen: list[CameraObservation], lidar: Clusters, radar: Clusters, params: AssociationParams
) -> tuple[Float64, Float64]:
    """Ratios (S, K + M) of camera boxes and all clusters' parts inside, and the shares (S, K + M) of these parts."""
    num_lidar, total = len(lidar.boxes), np.concatenate([lidar.num_points, radar.num_points])
    ratio, share = np.full((len(seen), len(total)), NEVER), np.zeros((len(seen), len(total)))
    for camera in sorted({s.camera for s in seen}):
        rows = [i for i, s in enumerate(seen) if s.camera == camera]
        own = [seen[i] for i in rows]
        boxes = np.array([s.xyxy_px for s in own])
        points = observations.measure_overlap(rig, camera, lidar, observations.edges_for_points(boxes))
        # Radar heights are too poor to be used.
        margin = np.maximum(params.bearing_margin_px, 0.1 * (boxes[:, 2] - boxes[:, 0]))
        endless = np.full(len(boxes), np.inf)
        beside = np.column_stack([boxes[:, 0] - margin, -endless, boxes[:, 2] + margin, endless])
        echoes = observations.measure_overlap(rig, camera, radar, beside)
        share[rows] = np.column_stack([points.num_inside, echoes.num_inside]) / np.maximum(total, 1)
        by_lidar = _near_side_ratios(own, points, params.lidar_std_m, 0.0, params.lidar_area_m2, params)
        # Most points where the camera sees something are of that.
        fitting = np.where(by_lidar > 0, points.num_inside, 1.0)
        by_lidar += np.log(
            np.clip(points.num_inside / fitting.max(axis=1, keepdims=True, initial=1.0), _LEAST_SHARE, 1)
        )
        ratio[rows, :num_lidar] = by_lidar + np.where(_are_of_one_kind(own, lidar), _shape_ratios(lidar), _UNLIKE)
        ratio[rows, num_lidar:] = _near_side_ratios(
            own, echoes, params.radar_std_m, params.radar_bearing_std_rad, params.radar_area_m2, params
        )
    return ratio, share


def _near_side_ratios(
    seen: list[CameraObservation],
    inside: Overlap,
    std_m: float,
    bearing_std_rad: float,
    area_m2: float,
    params: AssociationParams,
) -> Float64:
    """Ratios (S, K) of what one camera sees and clusters, by the near sides of what lies in its boxes.

    Directions are normally distributed, the logarithms of distances as Student's t: guesses from images are far off
    now and then. Of weak boxes there are many more that show nothing: they mustn't take what surer ones may have.
    """
    near = np.array([s.near_m for s in seen])[:, None]
    std = np.hypot(np.array([s.std for s in seen])[:, None], std_m / near)
    half = np.array([s.half_rad for s in seen])[:, None]
    aside = np.hypot(half / 2, np.hypot(params.bearing_std_rad, bearing_std_rad))
    off = np.log(np.maximum(inside.near_m, 0.1) / near) / std
    # Minus twice the logarithm of Student's density with `TAILS` degrees of freedom, 0 at its middle.
    heavy = np.asarray((TAILS + 1) * np.log1p(off**2 / TAILS), np.float64)
    square = heavy + (inside.bearing_rad / aside) ** 2
    odds = [AT_MIN_SCORE / (1 - AT_MIN_SCORE) * (1 - s.score) / max(s.score, 1e-6) for s in seen]
    weakness = [0.0 if s.is_sure else max(0.0, float(np.log(o))) for s, o in zip(seen, odds, strict=True)]
    ratio = np.log(area_m2 / (near**2 * 2 * np.pi * std * aside)) - square / 2 - np.array(weakness)[:, None]
    return np.where(inside.num_inside >= FEWEST, ratio, NEVER)


def _shape_ratios(lidar: Clusters) -> Float64:
    """What shapes (K,) add to ratios of LiDAR clusters: few other things look like road users, which don't all do."""
    return np.asarray(np.log(_SHAPELESS + _SHAPELY * np.clip(lidar.score, 0.0, 1.0)), np.float64)


def _are_of_one_kind(seen: list[CameraObservation], lidar: Clusters) -> Bool:
    """Whether labels (S, K) of what a camera sees and of clusters are both of vehicles, or both of others; true where
    LiDAR gives none. A pedestrian's shape in front of a bus says nothing of the bus.
    """
    is_vehicle = np.array([s.label in VEHICLES for s in seen])[:, None]
    if lidar.boxes.label is None:
        return np.ones((len(seen), len(lidar.boxes)), np.bool_)
    labels = lidar.boxes.label
    return np.asarray((is_vehicle == np.isin(labels, list(VEHICLES))) | (labels == ""), np.bool_)


def _cluster_ratios(lidar: Clusters, radar: Clusters, eye_m: Float64, params: AssociationParams) -> Float64:
    """Ratios (K, M) of LiDAR and radar clusters by their middles, seen from `eye_m` (2,). Of long vehicles radar sees
    some part, so that its error along the line of sight grows with the vehicle.
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
    return np.asarray(ratio + _shape_ratios(lidar)[:, None], np.float64)
