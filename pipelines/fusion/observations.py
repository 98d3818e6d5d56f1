"""Observations that 3D fusion works on: objects in camera images, and clusters of LiDAR points or radar echoes."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.fusion.kernels import inside_boxes
from fbench.pipelines.fusion.sizes import LONG_M, LONGEST_M, LOW_TRUCK_M, SIZES
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.sensors.points.vehicle import center_offsets
from fbench.replay.contracts.params import CheckedParams, in_range
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes3D, Source
from fbench.replay.data.rig import CameraModel, Rig
from fbench.replay.geometry.camera import project, project_body, project_boxes, rays
from fbench.replay.geometry.iou import common_areas
from fbench.replay.geometry.lenses import lens_of
from fbench.replay.geometry.transforms import inverse, transform

AT_MIN_SCORE = 0.55
"""How likely what a camera reports with its detector's least score is there, if nothing else is known."""
_EDGE_PX = 3.0
_SIDE_MARGIN = 1.3
_SIDE_SHARE = 0.95


@dataclass(frozen=True)
class AssociationParams(CheckedParams, prefix="fusion.association"):
    """Which measurements of different sensors are taken for one object.

    Each pair of them has a log-likelihood ratio: how likely their difference is for one object against for two that
    have nothing to do with each other, of which there is one in so many square meters.
    """

    lidar_area_m2: float = in_range(300.0, 0.01, 1e6)
    """Area [m²] in which one cluster of LiDAR points that is no part of the object is expected."""
    radar_area_m2: float = in_range(2000.0, 0.01, 1e6)  # The same for a cluster of radar echoes.
    camera_area_m2: float = in_range(500.0, 0.01, 1e6)  # The same for what another camera sees.
    edge_std_px: float = in_range(1.5, 0, 1000)  # Error of the edges of a camera's box [px].
    tilt_std_rad: float = in_range(0.008, 1e-6, 1)
    """Error of the ground's tilt against the camera [rad], for distances from the lower edge of a camera's box."""
    min_range_std: float = in_range(0.09, 0.001, 10)  # Least relative error of distances guessed from the image.
    bearing_std_rad: float = in_range(0.01, 1e-4, 1)
    """Error of a camera box's direction [rad], beside a share of its width."""
    lidar_std_m: float = in_range(0.4, 0.01, 100)  # Error of the near side of an object by LiDAR [m].
    radar_std_m: float = in_range(0.8, 0.01, 100)
    """Error of the near side of a moving object by radar, along the line of sight [m]."""
    radar_bearing_std_rad: float = in_range(0.03, 1e-4, 1)  # Error of a radar cluster's direction [rad].
    standing_std_m: float = in_range(1.5, 0.01, 100)  # Error of the distance of stationary objects by radar [m].
    bearing_margin_px: float = in_range(30.0, 0, 10_000)
    """Echoes this far beside a camera's box [px] may belong to it: radar is poor at angles."""
    least_inside: float = in_range(0.6, 0, 1)
    """A LiDAR cluster of which less than this share lies in a camera's box, and that doesn't look like a vehicle, is
    cut: what is inside may belong to what the camera sees, and the rest to others."""


@dataclass(frozen=True, eq=False)
class CameraObservation:
    """One object in one image: a ray and a guess of how far along it the object is."""

    camera: str
    xyxy_px: Float64  # (4,) left, top, right, bottom [px]
    label: str
    score: float  # How likely it is there by this camera alone, see `as_probability`
    is_sure: bool  # Whether the camera alone would report it; else others must confirm it
    eye_m: Float64  # (3,) position of the camera in body coordinates [m]
    bearing_rad: float  # Direction of the box's middle on the ground, in body axes [rad]
    half_rad: float  # Half of the angle that the box is wide [rad]
    near_m: float  # Guessed distance of the near side from the camera, on the ground [m]
    std: float  # Relative standard deviation of that guess
    depth_m: float  # From the near side to the object's middle [m], by how wide it looks
    aspect_rad: float
    """Angle between its heading and the line of sight, 0 to pi/2 [rad]; which of the two sides isn't known."""
    size_lwh_m: Float64  # (3,) typical size, the height as it looks at the guessed distance [m]
    beside_m: float  # How far left of the ray the middle is [m], where the image cuts the object off
    cut: bool  # Whether the left or right border of the image cuts it off


def observe_camera(
    rig: Rig, camera: str, found: CameraDetections, plane: Plane | None, params: AssociationParams
) -> list[CameraObservation]:
    """Lift finite boxes of one image whose label has a typical size, and that a ray leads to."""
    finite = np.isfinite(found.xyxy_px).all(axis=1) & np.isfinite(found.score)
    rows = [i for i in np.flatnonzero(finite) if str(found.label[i]) in SIZES]
    lifted = [_lift(rig, camera, found, int(i), plane, params) for i in rows]
    return [one for one in lifted if one is not None]


def as_probability(score: float, min_score: float) -> float:
    """Probability that a box with this score shows something, by what its detector's `min_score` stands for.

    Scores of different detectors mean different things; what they recommend to report from on means about the same.
    Their odds are scaled so that `min_score` gives `AT_MIN_SCORE`. Without one scores are taken as they are.
    """
    if not (0.0 < min_score < 1.0 and 0.0 < score < 1.0):
        return score
    odds = score / (1 - score) * (1 - min_score) / min_score * AT_MIN_SCORE / (1 - AT_MIN_SCORE)
    return odds / (1 + odds)


def undistort_box(rig: Rig, camera: str, xyxy_px: Float64) -> tuple[Float64, Float64] | None:
    """Return a box (4,) [px] as a pinhole camera with the same `K` at the same place shows it, by the middles of its
    edges, and the pose (4, 4) of that camera in body coordinates; `None` where it sees no such box.

    A camera that may see what is beside and behind it is turned toward the box first, about its vertical axis.
    """
    model, body_T_camera = rig.cameras[camera], rig.body_T_sensor(camera)
    lens = lens_of(model)
    if lens is None:
        return xyxy_px, body_T_camera
    left, top, right, bottom = (float(value) for value in xyxy_px)
    x, y = (left + right) / 2, (top + bottom) / 2
    directions = rays(model, np.array([[left, y], [x, top], [right, y], [x, bottom], [x, y]]))
    camera_T_view = np.eye(4)
    if lens.is_wide:
        angle = np.arctan2(directions[4, 0], directions[4, 2])
        camera_T_view[0, 0] = camera_T_view[2, 2] = np.cos(angle)
        camera_T_view[0, 2], camera_T_view[2, 0] = np.sin(angle), -np.sin(angle)
    flat, _ = project(CameraModel(model.K, model.size_wh), transform(inverse(camera_T_view), directions[:4]))
    box = np.array([flat[0, 0], flat[1, 1], flat[2, 0], flat[3, 1]])
    if not (np.isfinite(box).all() and box[0] < box[2] and box[1] < box[3]):
        return None
    return box, body_T_camera @ camera_T_view


def _lift(
    rig: Rig, camera: str, found: CameraDetections, row: int, plane: Plane | None, params: AssociationParams
) -> CameraObservation | None:
    """Lift one box: borders of the image cut it as recorded, all else is seen without lens distortion."""
    flat = undistort_box(rig, camera, found.xyxy_px[row])
    if flat is None:
        return None
    (left, top, right, bottom), body_T_camera = (float(value) for value in flat[0]), flat[1]
    model, label = rig.cameras[camera], str(found.label[row])
    edges = found.xyxy_px[row].tolist()
    is_left, is_high = edges[0] < _EDGE_PX, edges[1] < _EDGE_PX
    is_right, is_low = (edges[2 + axis] > model.size_wh[axis] - 1 - _EDGE_PX for axis in (0, 1))
    middle = ((left + right) / 2 - model.K[0, 2]) / model.K[0, 0]
    low = np.array([middle, (bottom - model.K[1, 2]) / model.K[1, 1], 1.0])
    ray = (body_T_camera[:3, :3] * low).sum(axis=1)
    eye = body_T_camera[:3, 3]
    (length, width, height), spread = SIZES[label].lwh_m, SIZES[label].height_spread
    high_px = max(bottom - top, 1.0)
    height_std = 0.3 if is_low or is_high else float(np.hypot(spread, params.edge_std_px / high_px))
    depth, std = model.K[1, 1] * height / high_px, height_std
    if plane is not None and not is_low:
        tilt_std_rad = params.tilt_std_rad + params.edge_std_px / model.K[1, 1]
        depth, std = _join_ground((depth, std), ray, eye, plane, tilt_std_rad)
    tall = (bottom - top) * depth / model.K[1, 1]
    if label in ("truck", "bus") and tall < LOW_TRUCK_M:
        length, width = SIZES["van"].lwh_m[:2]
    wide = (right - left) * depth / model.K[0, 0]
    if length > LONG_M:
        length = min(max(length, wide), LONGEST_M)
    hidden = max(0.0, length - wide) / 2 if wide > _SIDE_MARGIN * width else 0.0
    # A rectangle turned by the aspect a against the line of sight looks l sin(a) + w cos(a) wide. What looks about as
    # wide as it is long is taken to be seen from its side.
    aspect = np.pi / 2
    if not (hidden and is_left != is_right) and wide < _SIDE_SHARE * length:
        aspect = max(0.0, np.arcsin(wide / np.hypot(length, width)) - np.arctan2(width, length))
    return CameraObservation(
        camera=camera,
        xyxy_px=found.xyxy_px[row],
        label=label,
        score=as_probability(float(found.score[row]), found.min_score),
        is_sure=bool(found.score[row] >= found.min_score),
        eye_m=eye,
        bearing_rad=float(np.arctan2(ray[1], ray[0])),
        half_rad=(right - left) / 2 / float(model.K[0, 0]),
        near_m=depth * float(np.hypot(ray[0], ray[1])),
        std=max(std, params.min_range_std),
        depth_m=float(length * np.cos(aspect) + width * np.sin(aspect)) / 2,
        aspect_rad=float(aspect),
        size_lwh_m=np.array([length, width, tall if spread > 0.3 else height]),
        beside_m=hidden * (int(is_left) - int(is_right)),
        cut=is_left or is_right,
    )


def _join_ground(
    by_height: tuple[float, float], ray: Float64, eye: Float64, plane: Plane, tilt_std_rad: float
) -> tuple[float, float]:
    """Mean of two depths, by height and where the ray meets the ground, weighted by their relative errors; that on the
    ground is distance times tilt over height. Where they contradict, heights count less.
    """
    above = float(eye[2] - plane.slope_x * eye[0] - plane.slope_y * eye[1] - plane.height_m)
    fall = float(plane.slope_x * ray[0] + plane.slope_y * ray[1] - ray[2])
    if above <= 0 or fall <= 0.005:
        return by_height
    depth = above / fall
    std = float(np.hypot(0.04, depth * tilt_std_rad / above))
    weight_h, weight_g = by_height[1] ** -2, std**-2
    if abs(np.log(depth / by_height[0])) > 3 * np.hypot(std, by_height[1]):
        weight_h *= 0.1
    log = (weight_h * np.log(by_height[0]) + weight_g * np.log(depth)) / (weight_h + weight_g)
    return float(np.exp(log)), float((weight_h + weight_g) ** -0.5)


def outline_overlaps(rig: Rig, camera: str, boxes: Boxes3D, xyxy_px: Float64) -> Float64:
    """IoU (N,) of projected boxes (N) in body coordinates with rectangles (N, 4); 0 for those that don't project."""
    outlines, _ = project_boxes(rig, camera, boxes)
    sides = np.minimum(outlines[:, 2:], xyxy_px[:, 2:]) - np.maximum(outlines[:, :2], xyxy_px[:, :2])
    common = np.maximum(sides, 0.0).prod(axis=1)
    areas = [(part[:, 2:] - part[:, :2]).prod(axis=1) for part in (outlines, xyxy_px)]
    return np.asarray(np.nan_to_num(common / np.maximum(sum(areas) - common, 1e-9)), np.float64)


def inside_shares(a: Float64, b: Float64) -> Float64:
    """Share of each rectangle of `a` (N, 4) that lies in each of `b` (M, 4): (N, M)."""
    area = np.prod(a[:, 2:] - a[:, :2], axis=1)
    return np.asarray(common_areas(a, b) / np.maximum(area, 1e-9)[:, None], np.float64)


def are_one(boxes: Boxes3D, merge_m: float | Float64) -> Bool:
    """Which pairs (N, N) of boxes are one object: their centers are nearer than `merge_m`, which may differ by pair, or
    that of one lies in the other: of long vehicles radar shows only the near end.
    """
    along, across = center_offsets(boxes)
    half = boxes.size_lwh_m[:, None, :2] / 2
    holds = (along <= half[..., 0]) & (across <= half[..., 1])
    offset = boxes.center_m[None, :, :2] - boxes.center_m[:, None, :2]
    return np.asarray((np.hypot(offset[..., 0], offset[..., 1]) < merge_m) | holds | holds.T, np.bool_)


@dataclass(frozen=True, eq=False)
class Clusters:
    """K clusters of one sensor kind, in the order of their places, and N points."""

    boxes: Boxes3D  # (K) one for each
    xyz: Float64  # (N, 3) [m] points of the clusters in body coordinates, sorted by cluster
    first: Int64  # (K + 1,) rows of `xyz` where clusters begin
    loose: Float64  # (M, 3) [m] points of no cluster

    @property
    def num_points(self) -> Float64:
        """(K,) of each cluster."""
        return np.diff(self.first).astype(np.float64)

    @property
    def score(self) -> Float64:
        """(K,) 0 where the sensor gives none."""
        return np.zeros(len(self.boxes)) if self.boxes.score is None else self.boxes.score

    @property
    def all_xyz(self) -> Float64:
        """(N + M, 3) [m] points, in clusters or not."""
        return np.concatenate([self.xyz, self.loose])

    @property
    def measured_xyz(self) -> Float64:
        """(N + M, 3) [m] `all_xyz` without those that stand for boxes in which this sensor measured nothing."""
        if self.boxes.sources is None:
            return self.all_xyz
        by_lidar = np.repeat((self.boxes.sources & int(Source.L)) > 0, np.diff(self.first))
        return np.concatenate([self.xyz[by_lidar], self.loose])

    def is_of_echoes(self, at: int) -> bool:
        """Whether a network knows of a cluster by echoes alone, so that its points say only where its box is."""
        return self.boxes.sources is not None and int(self.boxes.sources[at]) == int(Source.R)

    def points(self, at: int) -> Float64:
        """Return the points of one cluster."""
        return self.xyz[self.first[at] : self.first[at + 1]]


def sort_clusters(xyz: Float64, number: Int64, boxes: Boxes3D) -> Clusters:
    """Sort points (N, 3) by their clusters (N,), rows of `boxes` or -1, and those by place."""
    order = np.lexsort((*boxes.size_lwh_m.T[::-1], *boxes.center_m.T[::-1]))
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    member = number >= 0
    ranks = rank[number[member]]
    by_rank = np.argsort(ranks, kind="stable")
    first = np.searchsorted(ranks[by_rank], np.arange(len(order) + 1)).astype(np.int64)
    return Clusters(boxes[order], np.ascontiguousarray(xyz[member][by_rank]), first, xyz[~member])


@dataclass(frozen=True, eq=False)
class Overlap:
    """Parts of K clusters in S boxes of one camera."""

    num_inside: Float64  # (S, K) points
    near_m: Float64  # (S, K) distance of the near side of what is inside, from the camera, on the ground [m]
    bearing_rad: Float64  # (S, K) direction of its middle, against that of the box's middle [rad], positive to the left


def edges_for_points(xyxy_px: Float64) -> Float64:
    """Edges (S, 4) in which points count as those of camera boxes (S, 4): a little narrower, since what is beside an
    object is seen at its left and right edges, and a little higher, since boxes end where points still are.
    """
    inset = 0.05 * (xyxy_px[:, 2] - xyxy_px[:, 0])
    left, top, right, bottom = xyxy_px.T
    return np.column_stack([left + inset, top - 5, right - inset, bottom + 5])


def measure_overlap(rig: Rig, camera: str, found: Clusters, xyxy_px: Float64) -> Overlap:
    """Count the points of clusters in boxes (S, 4) of a camera."""
    uv, _ = project_body(rig, camera, found.xyz)
    eye = rig.body_T_sensor(camera)[:3, 3]
    distance = np.hypot(found.xyz[:, 0] - eye[0], found.xyz[:, 1] - eye[1])
    inside = inside_boxes(uv, distance, found.first, np.ascontiguousarray(xyxy_px, np.float64))
    aside = (xyxy_px[:, 0] + xyxy_px[:, 2])[:, None] / 2 - inside[:, :, 2]
    return Overlap(inside[:, :, 0], inside[:, :, 1], aside / rig.cameras[camera].K[0, 0])
