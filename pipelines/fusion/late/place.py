"""Place, size and motion of an object, by all that sensors measured of it."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.fusion.late.association import FEWEST, Group
from fbench.pipelines.fusion.late.params import AssociationParams
from fbench.pipelines.fusion.observations import SIZES, Clusters, Sighting, edges_for_points
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


@dataclass(frozen=True, eq=False)
class Shape:
    """Box on the ground by LiDAR."""

    xy_m: Float64
    """(2,) middle [m]."""
    size_lwh_m: Float64
    """(3,) [m]."""
    yaw_rad: float
    std_along_m: float
    """Error of the middle along the heading [m], a share of what isn't seen of the length."""
    std_across_m: float
    """The same across it."""
    tells_heading: bool
    """Whether enough of a side is seen."""


def lidar_shape(points: Float64, box: Boxes3D, label: str, eye_m: Float64, is_part: bool) -> Shape:
    """Complete points (N, 3) of one object, seen from `eye_m` (2,), to the size of its class; `box`: the detector's.

    The detector's box is taken as it is where it means the same class (a car, where it knows none), unless the points
    are only a part of its cluster.
    """
    meant = "car" if box.label is None else str(box.label[0])
    if len(points) < 2 or (label in ("", meant) and not is_part):
        center, size, yaw = box.center_m[0, :2], box.size_lwh_m[0], float(box.yaw_rad[0])
    else:
        center, size, yaw = _completed(points, label, eye_m, float(box.size_lwh_m[0, 2]))
    seen_m = _extents(points, yaw)
    missing = np.maximum(size[:2] - seen_m, 0.0) * _MISSING_SHARE
    tells = bool(max(seen_m) > _TELLING_M)
    return Shape(center, size, yaw, float(_SURE_M + missing[0]), float(_SURE_M + missing[1]), tells)


def _completed(points: Float64, label: str, eye_m: Float64, top_m: float) -> tuple[Float64, Float64, float]:
    length, width, height, spread = SIZES[label or "car"]
    xy = np.ascontiguousarray(points[:: 1 + len(points) // _ENOUGH, :2])
    rectangle = fit_rectangles(xy, np.array([0, len(xy)]), HEADINGS_RAD, NEAR_M)
    whole = complete(rectangle, eye_m, VehicleSize(length, width, height))
    high = max(top_m, height) if spread > 0.3 else height
    return whole.center_m[0], np.array([*whole.size_lw_m[0], high]), float(whole.yaw_rad[0])


def _extents(points: Float64, yaw_rad: float) -> Float64:
    """Length and width (2,) of what is seen [m]."""
    if not len(points):
        return np.zeros(2)
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    along, across = points[:, 0] * cos + points[:, 1] * sin, points[:, 1] * cos - points[:, 0] * sin
    return np.array([np.ptp(along), np.ptp(across)])


_MOST_STRETCH = 2.0
LONG_CAR_M, LONG_VAN_M, HIGH_VAN_M = 5.6, 7.0, 1.95
"""Objects without a camera's label are called trucks where they are longer than a van [m], vans where they are longer
and higher than a car, else cars."""
_LARGEST_M = {"car": (LONG_CAR_M, 2.1), "van": (LONG_VAN_M, 2.8)}
"""No car is longer or higher, and no van [m]; cameras mistake one for the other, and trucks for both."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """Middle of an object on the ground and its covariance, by one sensor."""

    xy_m: Float64
    """(2,) [m]."""
    weight: Float64
    """(2, 2) inverse of the covariance [1/m²]."""


@dataclass(frozen=True, eq=False)
class Placed:
    """One object in body coordinates."""

    center_m: Float64
    """(3,) [m]."""
    size_lwh_m: Float64
    """(3,) [m]."""
    yaw_rad: float
    velocity_mps: Float64
    """(3,) over ground [m/s]; NaN where no radar measured it."""
    label: str


@dataclass(frozen=True, eq=False)
class Scene:
    """All measurements of a frame."""

    rig: Rig
    sightings: list[Sighting]
    lidar: Clusters
    radar: Clusters
    plane: Plane | None
    lidar_eye_m: Float64
    """(2,) where the LiDARs look from [m]."""
    standing_m: list[float]
    """Distance of the near side of each sighting by stationary echoes [m]; NaN where they tell none."""


def place(group: Group, scene: Scene, params: AssociationParams) -> Placed:
    """Join what sensors measured of one object, each weighted by the inverse of its covariance.

    Cameras are good in direction and poor in distance, LiDAR is good in both, radar good in distance. The label is the
    camera's unless LiDAR shows something larger, else LiDAR's, else by size; typical sizes complete what LiDAR sees.
    A radial speed is taken as the share of the speed along the heading where LiDAR shows that, unless nearly nothing of
    it points to the radar.
    """
    seen = [scene.sightings[i] for i in group.sightings]
    label = _label(seen)
    shape = None
    if group.lidar >= 0:
        label = label if group.is_cut else _with_lidar(label, seen, scene, group.lidar)
        shape = _shape(group, scene, seen, label)
    radar_box = None if group.radar < 0 else scene.radar.boxes[np.array([group.radar])]
    estimates = [] if shape is None else [_by_shape(shape)]
    alone = group.lidar < 0 and group.radar < 0
    estimates += [
        _by_camera(scene.sightings[i], scene.standing_m[i] if alone else np.nan, params) for i in group.sightings
    ]
    size, yaw = _size_and_yaw(shape, seen, radar_box)
    if radar_box is not None:
        # Only LiDAR's class tells how long it is: what cameras call a truck may be a van.
        is_known = group.lidar >= 0 and label == _lidar_label(scene.lidar, group.lidar)
        estimates.append(_by_radar(radar_box, size if is_known else radar_box.size_lwh_m[0], yaw, params))
    xy = _joined(estimates)
    if not label:
        label = _by_size(size)
    velocity = np.full(3, np.nan)
    if radar_box is not None and radar_box.velocity_mps is not None:
        velocity = _along(radar_box.velocity_mps[0], yaw if shape is not None and shape.tells_heading else None)
    z = _middle_z(scene, group, xy, float(size[2]))
    return Placed(np.array([*xy, z]), size, yaw, velocity, label)


def boxes_of(placed: list[Placed]) -> Boxes3D:
    """Boxes of one or more objects."""
    center, size = np.array([p.center_m for p in placed]), np.array([p.size_lwh_m for p in placed])
    return Boxes3D(center, size, np.array([p.yaw_rad for p in placed]))


def _label(seen: list[Sighting]) -> str:
    """Label with the largest sum of scores, the first by name on ties."""
    sums: dict[str, float] = {}
    for s in sorted(seen, key=lambda s: s.label):
        sums[s.label] = sums.get(s.label, 0.0) + s.score
    return max(sums, key=lambda name: sums[name]) if sums else ""


def _lidar_label(lidar: Clusters, at: int) -> str:
    label = "" if lidar.boxes.label is None else str(lidar.boxes.label[at])
    return label if label in SIZES else ""


def _with_lidar(label: str, seen: list[Sighting], scene: Scene, at: int) -> str:
    """Label by camera and LiDAR: cameras know classes better, LiDAR sizes, so that it decides where an object is larger
    than what the camera takes it for.
    """
    own = _lidar_label(scene.lidar, at)
    if not own or not label:
        return own or label
    is_surer = float(scene.lidar.score[at]) > max(s.score for s in seen)
    is_longer = label in VEHICLES and own in VEHICLES and SIZES[own][0] > SIZES[label][0]
    return own if _is_too_large(scene, at, label) or (is_longer and is_surer) else label


def _is_too_large(scene: Scene, lidar: int, label: str) -> bool:
    """Tell whether points lie higher over the ground or farther apart than what a camera takes an object for allows."""
    if label not in _LARGEST_M:
        return False
    longest_m, highest_m = _LARGEST_M[label]
    points, yaw = scene.lidar.points(lidar), float(scene.lidar.boxes.yaw_rad[lidar])
    along = points[:, 0] * np.cos(yaw) + points[:, 1] * np.sin(yaw)
    if np.ptp(along) > longest_m:
        return True
    return scene.plane is not None and bool((points[:, 2] - scene.plane.z_m(points[:, :2]) > highest_m).any())


def _by_size(size: Float64) -> str:
    if size[0] > LONG_VAN_M:
        return "truck"
    return "van" if size[0] > LONG_CAR_M and size[2] > HIGH_VAN_M else "car"


def _shape(group: Group, scene: Scene, seen: list[Sighting], label: str) -> Shape | None:
    """By LiDAR; `None` where so little is cut out of a cluster that it tells nothing."""
    points, box = scene.lidar.points(group.lidar), scene.lidar.boxes[np.array([group.lidar])]
    if not group.is_cut:
        return lidar_shape(points, box, label, scene.lidar_eye_m, False)
    part = _cut_out(points, scene.rig, seen)
    return None if len(part) < FEWEST else lidar_shape(part, box, label, scene.lidar_eye_m, True)


def _cut_out(points: Float64, rig: Rig, seen: list[Sighting]) -> Float64:
    """Points in the box of the surest sighting, from the nearest of them on as far as such an object reaches."""
    surest = max(seen, key=lambda s: (s.score, s.camera))
    uv, _ = project_body(rig, surest.camera, points)
    left, top, right, bottom = edges_for_points(surest.xyxy_px[None])[0]
    with np.errstate(invalid="ignore"):  # what is beside the camera has no pixel
        inside = (uv[:, 0] > left) & (uv[:, 0] < right) & (uv[:, 1] > top) & (uv[:, 1] < bottom)
    if not inside.any():
        return points[:0]
    reach = np.hypot(*(points[:, :2] - surest.eye_m[:2]).T)
    near = np.sort(reach[inside])[int(inside.sum()) // 10]
    return np.asarray(points[inside & (reach < near + 2 * surest.depth_m + 0.5)], np.float64)


def _by_shape(shape: Shape) -> Estimate:
    return _estimate(shape.xy_m, shape.yaw_rad, shape.std_along_m, shape.std_across_m)


def _by_camera(s: Sighting, standing_m: float, params: AssociationParams) -> Estimate:
    """On the ray, at the distance guessed, or its mean in logarithms with that of stationary echoes."""
    forward, left = _axes(s.bearing_rad)
    near, std = s.near_m, s.std
    if np.isfinite(standing_m):
        weights = s.std**-2, (standing_m / params.standing_std_m) ** 2
        near = float(np.exp((weights[0] * np.log(near) + weights[1] * np.log(standing_m)) / sum(weights)))
        std = float(sum(weights)) ** -0.5
    reach = near + s.depth_m
    aside = float(np.hypot(params.bearing_std_rad * reach, 0.1 * s.size_lwh_m[1]))
    if s.cut:  # what lies beyond the image's border is guessed
        aside = float(np.hypot(aside, s.size_lwh_m[0] / 3))
    xy = s.eye_m[:2] + forward * reach + left * s.beside_m
    return _estimate(xy, s.bearing_rad, float(np.hypot(std * near, 0.1 * s.size_lwh_m[0])), aside)


def _by_radar(box: Boxes3D, size: Float64, yaw_rad: float, params: AssociationParams) -> Estimate:
    """As far behind the side that radar sees as the object's size says, where radar took it for a shorter one."""
    xy, own = box.center_m[0, :2], box.size_lwh_m[0]
    reach, bearing = float(np.hypot(*xy)), float(np.arctan2(xy[1], xy[0]))
    farther = max(0.0, _depth_m(size, yaw_rad - bearing) - _depth_m(own, yaw_rad - bearing))
    std = float(np.hypot(params.radar_std_m, max(own[0], size[0]) / 10))
    return _estimate(xy + farther * _axes(bearing)[0], bearing, std, 0.3 + params.radar_bearing_std_rad * reach)


def _depth_m(size: Float64, angle_rad: float) -> float:
    """How far a rectangle reaches from its middle along an axis at an angle to its length."""
    return float(size[0] * abs(np.cos(angle_rad)) + size[1] * abs(np.sin(angle_rad))) / 2


def _estimate(xy: Float64, axis_rad: float, std_along_m: float, std_across_m: float) -> Estimate:
    forward, left = _axes(axis_rad)
    weight = np.outer(forward, forward) / std_along_m**2 + np.outer(left, left) / std_across_m**2
    return Estimate(xy, weight)


def _joined(estimates: list[Estimate]) -> Float64:
    """Mean (2,) [m]."""
    total = sum((e.weight for e in estimates), np.zeros((2, 2)))
    x, y = sum((e.weight[:, 0] * e.xy_m[0] + e.weight[:, 1] * e.xy_m[1] for e in estimates), np.zeros(2))
    determinant = total[0, 0] * total[1, 1] - total[0, 1] * total[1, 0]
    xy = np.array([total[1, 1] * x - total[0, 1] * y, total[0, 0] * y - total[1, 0] * x])
    return np.asarray(xy / determinant, np.float64)


def _size_and_yaw(shape: Shape | None, seen: list[Sighting], radar_box: Boxes3D | None) -> tuple[Float64, float]:
    """Of LiDAR where it shows them, else the camera's typical ones, else radar's."""
    if shape is not None and (shape.tells_heading or not seen):
        return shape.size_lwh_m, shape.yaw_rad
    if seen:
        best = max(seen, key=lambda s: (not s.cut, s.score, s.camera))
        size = best.size_lwh_m if shape is None else shape.size_lwh_m
        return size, _heading(best)
    if radar_box is None:
        raise ValueError("a group without measurements")
    return radar_box.size_lwh_m[0], float(radar_box.yaw_rad[0])


def _heading(s: Sighting) -> float:
    """Of the two headings that look as wide, the one nearer to a multiple of a right angle: most roads are parallel to
    the own one or cross it.
    """
    headings = wrap_angle(np.array([s.bearing_rad - s.aspect_rad, s.bearing_rad + s.aspect_rad]))
    return float(headings[int(np.argmin(np.abs(np.sin(2 * headings))))])


def _along(radial_mps: Float64, yaw_rad: float | None) -> Float64:
    """Velocity (3,) whose part along the line of sight is that measured; NaN stays."""
    speed, bearing = float(np.hypot(*radial_mps[:2])), float(np.arctan2(radial_mps[1], radial_mps[0]))
    if yaw_rad is None or not np.isfinite(speed) or speed == 0.0:
        return radial_mps
    share = float(np.cos(yaw_rad - bearing))
    if abs(share) * _MOST_STRETCH < 1.0:
        return radial_mps
    return np.array([np.cos(yaw_rad), np.sin(yaw_rad), 0.0]) * speed / share


def _middle_z(scene: Scene, group: Group, xy: Float64, height_m: float) -> float:
    """On the ground where that is known; else as LiDAR or radar measured it, else level with the camera's foot."""
    if scene.plane is not None:
        return float(scene.plane.z_m(xy[None])[0]) + height_m / 2
    if group.lidar >= 0:
        return float(scene.lidar.boxes.center_m[group.lidar, 2])
    if group.radar >= 0:
        return float(scene.radar.boxes.center_m[group.radar, 2])
    return float(scene.sightings[group.sightings[0]].eye_m[2])


def _axes(angle_rad: float) -> tuple[Float64, Float64]:
    cos, sin = float(np.cos(angle_rad)), float(np.sin(angle_rad))
    return np.array([cos, sin]), np.array([-sin, cos])
