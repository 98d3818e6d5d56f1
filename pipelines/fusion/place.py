"""Where an object stands that a camera sees, given what LiDAR and radar say about it."""

import numpy as np

from fbench.pipelines.fusion.evidence import Evidence
from fbench.pipelines.fusion.found import Found, joined_score, radar_weight
from fbench.pipelines.fusion.lift import Sighting
from fbench.pipelines.fusion.params import FusionParams
from fbench.pipelines.points.ground import Plane
from fbench.replay.arrays import Float64
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import Source
from fbench.replay.geometry.transforms import wrap_angle

_CAR_LIKE = 0.2
_LARGE = ("truck", "bus", "trailer")
_LARGE_M = 6.0


def place(
    sighting: Sighting,
    lidar: Evidence | None,
    radar: Evidence | None,
    lidar_box: Boxes3D | None,
    radar_box: Boxes3D | None,
    plane: Plane | None,
    alone: bool,
    params: FusionParams,
) -> Found:
    """Make one object of a sighting and its evidence.

    `lidar_box` and `radar_box` hold the boxes of the clusters in the evidence: a LiDAR cluster that looks like the
    vehicle that the camera sees gives the box; moving echoes give the velocity. `alone`: no other sensor delivered,
    so that the camera needn't be confirmed.
    """
    shape = lidar_box if lidar_box is not None and _fits(lidar_box, sighting.label) else None
    if shape is not None:
        center, size, yaw = shape.center_m[0, :2], shape.size_lwh_m[0], float(shape.yaw_rad[0])
    else:
        center, yaw = _along_ray(sighting, lidar, radar)
        size = sighting.size_lwh_m
    weight = params.standing_weight if radar_box is None else radar_weight(radar_box, 0, params)
    score = joined_score(
        sighting.score if alone else params.camera_weight * sighting.score,
        params.lidar_weight * (lidar.strength if lidar else 0.0),
        weight * (radar.strength if radar else 0.0),
    )
    unknown = np.full(3, np.nan)
    return Found(
        center_m=np.array([*center, _middle_z(sighting, center, float(size[2]), plane)]),
        size_lwh_m=size,
        yaw_rad=yaw,
        velocity_mps=unknown if radar_box is None or radar_box.velocity_mps is None else radar_box.velocity_mps[0],
        label=sighting.label,
        score=score,
        sources=int(Source.C) | (int(Source.L) if lidar else 0) | (int(Source.R) if radar else 0),
    )


def _fits(box: Boxes3D, label: str) -> bool:
    """Tell whether a LiDAR cluster's box has the size of what the camera sees."""
    if label in _LARGE and box.size_lwh_m[0, 0] > _LARGE_M:
        return True
    return label not in ("pedestrian", "bicycle", "motorcycle") and box.score is not None and box.score[0] > _CAR_LIKE


def _along_ray(sighting: Sighting, lidar: Evidence | None, radar: Evidence | None) -> tuple[Float64, float]:
    """Centre (2,) [m] and heading [rad] of a typical object on the camera's ray.

    Distances are joined in logarithms, weighted by their errors. Of the two headings that look as wide, the one
    nearer to a multiple of a right angle is taken: most roads are parallel to the own one or cross it.
    """
    guesses = [(np.log(sighting.near_m), sighting.std**-2)]
    guesses += [(np.log(e.near_m), (e.near_m / e.std_m) ** 2) for e in (lidar, radar) if e is not None]
    near = np.exp(sum(log * weight for log, weight in guesses) / sum(weight for _, weight in guesses))
    bearing = sighting.bearing_rad
    seen = lidar if lidar is not None else radar
    if sighting.cut and not sighting.beside_m and seen is not None:
        bearing = seen.bearing_rad
    forward, left = np.array([np.cos(bearing), np.sin(bearing)]), np.array([-np.sin(bearing), np.cos(bearing)])
    center = sighting.eye_m[:2] + forward * (near + sighting.depth_m) + left * sighting.beside_m
    headings = wrap_angle(np.array([bearing - sighting.aspect_rad, bearing + sighting.aspect_rad]))
    return center, float(headings[int(np.argmin(np.abs(np.sin(2 * headings))))])


def _middle_z(sighting: Sighting, center: Float64, height_m: float, plane: Plane | None) -> float:
    """Height of the middle [m]: on the ground where that is known, else level with the camera's foot."""
    if plane is None:
        return float(sighting.eye_m[2])
    return float(plane.z_m(center[None])[0]) + height_m / 2
