"""Place, size and motion of an object, by all observations of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fbench.pipelines.fusion.late.association import FEWEST, TAILS, Association
from fbench.pipelines.fusion.observations import AssociationParams, CameraObservation, Clusters, edges_for_points
from fbench.pipelines.fusion.sizes import HIGH_VAN_M, LONG_CAR_M, LONG_M, SIZES
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.sensors.points.vehicle import HEADINGS_RAD, NEAR_M, VehicleSize, complete, fit_rectangles
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import VEHICLES, Boxes3D
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.camera import project_body
from fbench.replay.geometry.transforms import wrap_angle

_ENOUGH = 300
_TELLING_M = 2.2
_SURE_M = 0.15
_MISSING_SHARE = 0.1
_MOST_STRETCH = 2.0


@dataclass(frozen=True, eq=False)
class Observations:
    """Observations of all sensors in one frame."""

    rig: Rig
    working: tuple[str, ...]  # Cameras that worked
    cameras: list[CameraObservation]
    lidar: Clusters
    radar: Clusters
    plane: Plane | None
    learned: bool  # Whether a network detected in the LiDAR's points
    with_echoes: bool  # Whether that network got the radars' echoes, too, and reports all that it sees
    lidar_eye_m: Float64  # (2,) where the LiDARs look from [m]
    radar_eye_m: Float64  # (2,) where the radars do [m]
    standing_m: list[float]
    """Distance of the near side of each of `cameras` by stationary echoes [m]; NaN where there are none."""
    obstacle_m: list[float]  # The same by LiDAR points over the ground, whatever cluster they belong to


@dataclass(frozen=True, eq=False)
class FusedObject:
    """One object in body coordinates."""

    center_m: Float64  # (3,) [m]
    size_lwh_m: Float64  # (3,) length, width, height [m]
    yaw_rad: float  # Heading [rad]
    velocity_mps: Float64  # (3,) over ground [m/s]; NaN where no radar measured it
    label: str  # One of `LABELS`


class _Shape(NamedTuple):
    xy_m: Float64  # (2,) middle [m]
    size_lwh_m: Float64
    yaw_rad: float
    std_m: Float64  # (2,) error of the middle along and across the heading [m], a share of what isn't seen of the size
    has_heading: bool  # Whether enough of a side is seen


def place(group: Association, seen: Observations, params: AssociationParams) -> FusedObject:
    """Join what sensors measured of one object, each weighted by the inverse of its covariance.

    Cameras are good in direction and poor in distance, LiDAR is good in both, radar good in distance. The label is the
    camera's unless LiDAR shows something larger, else LiDAR's, else by size; typical sizes complete what LiDAR sees.
    A radial speed is taken as the share of the speed along the heading where LiDAR shows that, unless nearly nothing of
    it points to the radar.
    """
    cameras = [seen.cameras[i] for i in group.cameras]
    sums: dict[str, float] = {}
    for s in sorted(cameras, key=lambda s: s.label):
        sums[s.label] = sums.get(s.label, 0.0) + s.score
    label = max(sums, key=lambda name: sums[name]) if sums else ""  # the first by name on ties
    shape, radar_box = None, None if group.radar < 0 else seen.radar.boxes[np.array([group.radar])]
    if group.lidar >= 0:
        label = label if group.is_cut else _label_with_lidar(label, cameras, seen, group.lidar)
        shape = _lidar_shape(group, seen, cameras, label)
    estimates = [] if shape is None else [_estimate(shape.xy_m, shape.yaw_rad, *shape.std_m.tolist())]
    alone = group.lidar < 0 and group.radar < 0
    known = [xy for xy, _ in estimates] + ([] if radar_box is None else [radar_box.center_m[0, :2]])
    for i, s in zip(group.cameras, cameras, strict=True):
        measured = [] if group.lidar >= 0 else [(seen.obstacle_m[i], params.lidar_std_m)]
        measured += [(seen.standing_m[i], params.standing_std_m)] if alone else []
        estimates.append(_camera_estimate(_doubt_distance(s, known), measured, params))
    size, yaw = _size_and_yaw(shape, cameras, radar_box)
    if radar_box is not None:
        # Only LiDAR's class says how long it is: what cameras call a truck may be a van.
        own = _lidar_label(seen.lidar, group.lidar) if group.lidar >= 0 else ""
        is_known = bool(own) and (label == own or min(SIZES[name].length_m for name in (label, own)) > LONG_M)
        estimates.append(_radar_estimate(radar_box, size if is_known else radar_box.size_lwh_m[0], yaw, params))
    total = sum((weight for _, weight in estimates), np.zeros((2, 2)))
    x, y = sum((weight[:, 0] * xy[0] + weight[:, 1] * xy[1] for xy, weight in estimates), np.zeros(2))
    determinant = total[0, 0] * total[1, 1] - total[0, 1] * total[1, 0]
    xy = np.array([total[1, 1] * x - total[0, 1] * y, total[0, 0] * y - total[1, 0] * x]) / determinant
    if not label:
        label = "truck" if size[0] > LONG_M else "van" if size[0] > LONG_CAR_M and size[2] > HIGH_VAN_M else "car"
    velocity = np.full(3, np.nan)
    if radar_box is not None and radar_box.velocity_mps is not None:
        velocity = radar_box.velocity_mps[0]
        speed, bearing = float(np.hypot(*velocity[:2])), float(np.arctan2(velocity[1], velocity[0]))
        share = float(np.cos(yaw - bearing))  # NaN stays
        is_told = shape is not None and shape.has_heading and np.isfinite(speed) and speed != 0.0
        if is_told and abs(share) * _MOST_STRETCH >= 1.0:
            velocity = np.array([np.cos(yaw), np.sin(yaw), 0.0]) * speed / share
    return FusedObject(np.array([*xy, _middle_z(seen, group, xy, float(size[2]))]), size, yaw, velocity, label)


def _lidar_label(lidar: Clusters, at: int) -> str:
    label = "" if lidar.boxes.label is None else str(lidar.boxes.label[at])
    return label if label in SIZES else ""


def _label_with_lidar(label: str, cameras: list[CameraObservation], seen: Observations, at: int) -> str:
    """Label by camera, which knows classes better, unless LiDAR, which knows sizes, shows that it is larger. Where a
    network detected in the LiDAR's points, the surer of both labels.
    """
    own = _lidar_label(seen.lidar, at)
    if not own or not label:
        return own or label
    is_surer = float(seen.lidar.score[at]) > max(s.score for s in cameras)
    is_longer = label in VEHICLES and own in VEHICLES and SIZES[own].length_m > SIZES[label].length_m
    points, yaw, most = seen.lidar.points(at), float(seen.lidar.boxes.yaw_rad[at]), SIZES[label]
    along = points[:, 0] * np.cos(yaw) + points[:, 1] * np.sin(yaw)
    if seen.lidar.is_of_echoes(at):
        return own if is_surer else label
    is_too_large = bool(len(points)) and bool(np.ptp(along) > most.longest_m)
    if seen.plane is not None:
        is_too_large |= bool((points[:, 2] - seen.plane.z_m(points[:, :2]) > most.highest_m).any())
    return own if is_too_large or (is_surer and (is_longer or seen.learned)) else label


def _lidar_shape(group: Association, seen: Observations, cameras: list[CameraObservation], label: str) -> _Shape | None:
    """Complete the points of a cluster to the size of their class; `None` where so little is cut out of it that it says
    nothing.

    The detector's box is taken as it is where it means the same class (a car, where it knows none), unless the points
    are only a part of its cluster. Of one that it knows by echoes alone, place and heading are taken.
    """
    points, box = seen.lidar.points(group.lidar), seen.lidar.boxes[np.array([group.lidar])]
    if group.is_cut:
        points = _cut_out(points, seen.rig, cameras)
        if len(points) < FEWEST:
            return None
    meant = "car" if box.label is None else str(box.label[0])
    by_echoes = seen.lidar.is_of_echoes(group.lidar)
    if by_echoes or len(points) < 2 or (label in ("", meant) and not group.is_cut):
        center, size, yaw = box.center_m[0, :2], box.size_lwh_m[0], float(box.yaw_rad[0])
        if by_echoes and label not in ("", meant):
            size = np.array([SIZES[label].length_m, SIZES[label].width_m, SIZES[label].height_m])
    else:
        typical = SIZES[label or "car"]
        xy = np.ascontiguousarray(points[:: 1 + len(points) // _ENOUGH, :2])
        rectangle = fit_rectangles(xy, np.array([0, len(xy)]), HEADINGS_RAD, NEAR_M)
        length = max([typical.length_m, *(float(s.size_lwh_m[0]) for s in cameras if s.label == label)])
        whole = complete(rectangle, seen.lidar_eye_m, VehicleSize(length, typical.width_m, typical.height_m))
        high = max(float(box.size_lwh_m[0, 2]), typical.height_m) if typical.height_spread > 0.3 else typical.height_m
        center, size, yaw = whole.center_m[0], np.array([*whole.size_lw_m[0], high]), float(whole.yaw_rad[0])
    seen_m = np.zeros(2)
    if len(points):
        cos, sin = np.cos(yaw), np.sin(yaw)
        along, across = points[:, 0] * cos + points[:, 1] * sin, points[:, 1] * cos - points[:, 0] * sin
        seen_m = np.array([np.ptp(along), np.ptp(across)])
    std = _SURE_M + np.maximum(size[:2] - seen_m, 0.0) * _MISSING_SHARE
    return _Shape(center, size, yaw, std, bool(max(seen_m) > _TELLING_M))


def _cut_out(points: Float64, rig: Rig, cameras: list[CameraObservation]) -> Float64:
    """Points in the box of the surest camera, from the nearest of them on as far as such an object reaches."""
    surest = max(cameras, key=lambda s: (s.score, s.camera))
    uv, _ = project_body(rig, surest.camera, points)
    left, top, right, bottom = edges_for_points(surest.xyxy_px[None])[0]
    with np.errstate(invalid="ignore"):  # what is beside the camera has no pixel
        inside = (uv[:, 0] > left) & (uv[:, 0] < right) & (uv[:, 1] > top) & (uv[:, 1] < bottom)
    if not inside.any():
        return points[:0]
    reach = np.hypot(*(points[:, :2] - surest.eye_m[:2]).T)
    near = np.sort(reach[inside])[int(inside.sum()) // 10]
    return np.asarray(points[inside & (reach < near + 2 * surest.depth_m + 0.5)], np.float64)


def _size_and_yaw(
    shape: _Shape | None, cameras: list[CameraObservation], radar_box: Boxes3D | None
) -> tuple[Float64, float]:
    """Of LiDAR where it shows them, else the camera's typical ones, else radar's.

    Of the two headings that look as wide to a camera, the one nearer to a multiple of a right angle is taken: most
    roads are parallel to the own one or cross it.
    """
    if shape is not None and (shape.has_heading or not cameras):
        return shape.size_lwh_m, shape.yaw_rad
    if cameras:
        best = max(cameras, key=lambda s: (not s.cut, s.score, s.camera))
        size = best.size_lwh_m if shape is None else shape.size_lwh_m
        yaws = wrap_angle(np.array([best.bearing_rad - best.aspect_rad, best.bearing_rad + best.aspect_rad]))
        return size, float(yaws[int(np.argmin(np.abs(np.sin(2 * yaws))))])
    if radar_box is None:
        raise ValueError("an object without observations")
    return radar_box.size_lwh_m[0], float(radar_box.yaw_rad[0])


_Estimate = tuple[Float64, Float64]
"""Middle (2,) of an object on the ground [m] by one sensor, and the inverse (2, 2) of its covariance [1/m²]."""


def _camera_estimate(
    s: CameraObservation, measured: Sequence[tuple[float, float]], params: AssociationParams
) -> _Estimate:
    """On the ray, at the distance guessed, or its mean in logarithms with those measured in its direction, each with
    its error [m]; NaN where there is none.
    """
    forward, left = _axes(s.bearing_rad)
    guesses = [(np.log(s.near_m), s.std**-2)]
    guesses += [(np.log(m), (m / std_m) ** 2) for m, std_m in measured if np.isfinite(m)]
    total = float(sum(weight for _, weight in guesses))
    near, std = float(np.exp(sum(log * weight for log, weight in guesses) / total)), total**-0.5
    reach = near + s.depth_m
    aside = float(np.hypot(params.bearing_std_rad * reach, 0.1 * s.size_lwh_m[1]))
    if s.cut:  # what lies beyond the image's border is guessed
        aside = float(np.hypot(aside, s.size_lwh_m[0] / 3))
    xy = s.eye_m[:2] + forward * reach + left * s.beside_m
    return _estimate(xy, s.bearing_rad, float(np.hypot(std * near, 0.1 * s.size_lwh_m[0])), aside)


def _doubt_distance(s: CameraObservation, known: Sequence[Float64]) -> CameraObservation:
    """The same with an error of its guessed distance that fits the middles (2,) [m] of what LiDAR and radar see.

    Guesses are far off now and then, so they weigh as in a mean of Student's t (Lange et al., JASA 84, 1989).
    """
    if not known:
        return s
    reach = float(np.mean([np.hypot(*(xy - s.eye_m[:2])) for xy in known]))
    off = np.log(max(reach - s.depth_m, 0.1) / s.near_m) / s.std
    return replace(s, std=s.std * max(1.0, float((TAILS + off**2) / (TAILS + 1))) ** 0.5)


def _radar_estimate(box: Boxes3D, size: Float64, yaw_rad: float, params: AssociationParams) -> _Estimate:
    """As far behind the side that radar sees as the object's size says, where radar took it for a shorter one."""
    xy, own = box.center_m[0, :2], box.size_lwh_m[0]
    reach, bearing = float(np.hypot(*xy)), float(np.arctan2(xy[1], xy[0]))
    cos, sin = abs(np.cos(yaw_rad - bearing)), abs(np.sin(yaw_rad - bearing))
    depth, own_depth = (float(lwh[0] * cos + lwh[1] * sin) / 2 for lwh in (size, own))
    std = float(np.hypot(params.radar_std_m, max(own[0], size[0]) / 10))
    xy = xy + max(0.0, depth - own_depth) * _axes(bearing)[0]
    return _estimate(xy, bearing, std, 0.3 + params.radar_bearing_std_rad * reach)


def _estimate(xy: Float64, axis_rad: float, std_along_m: float, std_across_m: float) -> _Estimate:
    forward, left = _axes(axis_rad)
    return xy, np.outer(forward, forward) / std_along_m**2 + np.outer(left, left) / std_across_m**2


def _middle_z(seen: Observations, group: Association, xy: Float64, height_m: float) -> float:
    """On the ground where that is known; else as LiDAR or radar measured it, else level with the camera's foot."""
    if seen.plane is not None:
        return float(seen.plane.z_m(xy[None])[0]) + height_m / 2
    if group.lidar >= 0:
        return float(seen.lidar.boxes.center_m[group.lidar, 2])
    if group.radar >= 0:
        return float(seen.radar.boxes.center_m[group.radar, 2])
    return float(seen.cameras[group.cameras[0]].eye_m[2])


def _axes(angle_rad: float) -> tuple[Float64, Float64]:
    cos, sin = float(np.cos(angle_rad)), float(np.sin(angle_rad))
    return np.array([cos, sin]), np.array([-sin, cos])
