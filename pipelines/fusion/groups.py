"""Which measurements of all sensors are of one object."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.fusion import pairs
from fbench.pipelines.fusion.clusters import Clusters, Overlap, edges_for_points, overlap
from fbench.pipelines.fusion.fusion_kernels import agglomerate
from fbench.pipelines.fusion.lift import Sighting
from fbench.pipelines.fusion.params import AssociationParams
from fbench.replay.arrays import Float64, Int64
from fbench.replay.data import Rig

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
    ratio = part + pairs.by_share(inside)
    fits = part[:, : len(lidar.boxes)] > 0
    is_cut = fits & (inside[:, : len(lidar.boxes)] < params.least_inside) & (lidar.score < _LOOKS_WHOLE)
    cuts = np.argwhere(is_cut)
    size = whole + len(radar.boxes) + len(cuts)
    matrix = np.zeros((size, size))
    matrix[:num, num:whole] = np.where(is_cut, pairs.NEVER, ratio[:, : len(lidar.boxes)])
    matrix[:num, whole : size - len(cuts)] = ratio[:, len(lidar.boxes) :]
    matrix[num:whole, whole : size - len(cuts)] = pairs.between_clusters(lidar, radar, eye_m, params)
    for i, a in enumerate(seen):
        for j, b in enumerate(seen[:i]):
            matrix[j, i] = pairs.between_cameras(b, a, params)
    _add_cuts(matrix, part, cuts, [s.camera for s in seen], num, whole)
    for begin, end in ((num, whole), (whole, size - len(cuts))):
        matrix[begin:end, begin:end] = pairs.NEVER
    upper = np.triu(matrix, 1)
    return _as_groups(agglomerate(upper + upper.T), num, whole, size - len(cuts), cuts)


def _add_cuts(matrix: Float64, part: Float64, cuts: Int64, cameras: list[str], num: int, whole: int) -> None:
    """Let the part of a cluster that a sighting cuts out belong to it and to sightings of other cameras, but to nothing
    else that LiDAR sees.
    """
    begin, camera = len(matrix) - len(cuts), np.array(cameras)
    matrix[num:whole, begin:] = pairs.NEVER
    matrix[begin:, begin:] = pairs.NEVER
    for at, (s, k) in enumerate(cuts):
        matrix[:num, begin + at] = np.where(camera == camera[s], pairs.NEVER, part[:, k])
        # A little more, lest another camera takes what it cuts out of the cluster for itself.
        matrix[s, begin + at] = np.nextafter(part[s, k], np.inf)


def _camera_ratios(
    rig: Rig, seen: list[Sighting], lidar: Clusters, radar: Clusters, params: AssociationParams
) -> tuple[Float64, Float64]:
    """Ratios (S, K + M) of sightings and what is inside of all clusters, and the shares (S, K + M) that are inside."""
    num_lidar, total = len(lidar.boxes), np.concatenate([lidar.num_points, radar.num_points])
    ratio, share = np.full((len(seen), len(total)), pairs.NEVER), np.zeros((len(seen), len(total)))
    for camera in sorted({s.camera for s in seen}):
        rows = [i for i, s in enumerate(seen) if s.camera == camera]
        own = [seen[i] for i in rows]
        boxes = np.array([s.xyxy_px for s in own])
        points = overlap(rig, camera, lidar, edges_for_points(boxes))
        echoes = _beside_boxes(rig, camera, radar, boxes, params.bearing_margin_px)
        share[rows] = np.column_stack([points.num_inside, echoes.num_inside]) / np.maximum(total, 1)
        by_lidar = pairs.with_clusters(own, points, params.lidar_std_m, 0.0, params.lidar_area_m2, params)
        ratio[rows, :num_lidar] = by_lidar + pairs.by_shape(lidar)
        ratio[rows, num_lidar:] = pairs.with_clusters(
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
