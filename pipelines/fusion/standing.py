"""Stationary radar echoes at the places of objects."""

import numpy as np

from fbench.pipelines.fusion.clusters import Clusters
from fbench.pipelines.fusion.fusion_kernels import count_near
from fbench.pipelines.fusion.lift import Sighting
from fbench.pipelines.fusion.params import AssociationParams
from fbench.replay.arrays import Float64
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import Rig
from fbench.replay.geometry.camera import project_body

_MARGIN_M = 0.5
_FEWEST = 4
_DEPTH_M = 3.0
_GATE = 2.5


def standing_echoes(radar: Clusters, targets: Boxes3D) -> Float64:
    """Number (N,) of echoes of no moving cluster about each object; 0 where it is a handful."""
    reach = np.hypot(targets.size_lwh_m[:, 0], targets.size_lwh_m[:, 1]) / 2 + _MARGIN_M
    xy = np.ascontiguousarray(radar.loose[:, :2]), np.ascontiguousarray(targets.center_m[:, :2])
    num = count_near(*xy, reach).astype(np.float64)
    return np.where(num >= _FEWEST, num, 0.0)


def standing_near_m(rig: Rig, seen: list[Sighting], loose: Float64, params: AssociationParams) -> list[float]:
    """Distance of the near side [m] of what each sighting shows, by the stationary echoes (M, 3) in its direction; NaN
    where they tell nothing: that at which most of them lie within some metres, by how likely the image makes it.
    """
    result = []
    for camera in dict.fromkeys(s.camera for s in seen):
        uv, _ = project_body(rig, camera, loose)
        eye = rig.body_T_sensor(camera)[:2, 3]
        reach = np.hypot(loose[:, 0] - eye[0], loose[:, 1] - eye[1])
        result += [_near(s, uv[:, 0], reach) for s in seen if s.camera == camera]
    return result


def _near(s: Sighting, u_px: Float64, reach_m: Float64) -> float:
    rows = np.flatnonzero((u_px > s.xyxy_px[0]) & (u_px < s.xyxy_px[2]))
    deviation = np.log(np.maximum(reach_m[rows], 0.1) / s.near_m) / s.std
    inside = np.abs(deviation) < _GATE
    if np.count_nonzero(inside) <= _FEWEST:
        return float("nan")
    order = np.argsort(reach_m[rows[inside]], kind="stable")
    distance, likelihood = reach_m[rows[inside]][order], np.exp(-(deviation[inside][order] ** 2) / 2)
    stop = np.searchsorted(distance, distance + _DEPTH_M)
    begin = int(np.argmax((stop - np.arange(len(distance))) * likelihood))
    num = int(stop[begin]) - begin
    return float(distance[begin + num // 10]) if num > _FEWEST else float("nan")
