"""Conditions of single objects: the points of each object of the truth thin out, vanish in part, or lie elsewhere than
its box. Truth stays. After the object-level corruptions of Dong et al. (CVPR 2023), whose levels they have.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from typing import ClassVar, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.replay.conditions.points import count_share, keep_points, move_points
from fbench.replay.contracts.conditions import Level, Measurement, Need, Site
from fbench.replay.data.arrays import Array, Bool, Float64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Image, PointCloud, RadarScan
from fbench.replay.data.rig import Kind
from fbench.replay.geometry.transforms import inverse, pose_matrix, transform

_MARGIN_M = 0.1  # Points so far outside of a box are still its object's


@dataclass(frozen=True, eq=False)
class ObjectPoints:
    """Points of one object, in its box's coordinates [m]."""

    xyz: Float64  # (N, 3)
    half_m: Array  # (3,) half the size of the box
    eye_m: Array  # (3,) where the sensor is
    site: Site
    message: PointCloud | RadarScan
    row: int  # Of the truth
    track_id: int | None

    def lasting(self) -> np.random.Generator:
        """Return random numbers that stay the same over the log where truth has track ids."""
        return self.fresh() if self.track_id is None else self.site.rng("object", self.track_id)

    def fresh(self) -> np.random.Generator:
        """Return those that are drawn anew for every message."""
        return self.site.rng_of(self.message, "object", self.row)


C = TypeVar("C")


class OnObjects:
    """What conditions of objects have in common."""

    version: ClassVar[int] = 1
    kinds: ClassVar[Sequence[Kind]] = ("lidar", "radar")
    needs: ClassVar[Sequence[Need]] = ("truth",)


def for_objects(
    change: Callable[[C, ObjectPoints, Level], tuple[Bool, Float64]],
) -> Callable[[C, Measurement, Level, Site], Sequence[Measurement]]:
    """Make `Condition.disturb` of a method that says which points (N,) of an object stay, and where (N, 3) they are;
    messages stay where no truth is near in time.
    """

    @wraps(change)
    def disturb(condition: C, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        return (change_objects(message, site, lambda points: change(condition, points, level)),)

    return disturb


def change_objects(
    message: Measurement, site: Site, change: Callable[[ObjectPoints], tuple[Bool, Float64]]
) -> Measurement:
    """Return the message with other points of each object; of two boxes the first has the points in both."""
    if isinstance(message, Image) or site.truth is None or not len(message.xyz):
        return message
    body_T_sensor = site.rig.body_T_sensor(site.sensor)
    body = transform(body_T_sensor, message.xyz)
    is_kept, is_moved = np.ones(len(body), bool), np.zeros(len(body), bool)
    free: Bool = np.asarray(np.isfinite(body).all(axis=1))
    for row in range(len(site.truth)):
        body_T_box, half = _box(site.truth, row)
        rows = np.flatnonzero(free & (np.abs(body - body_T_box[:3, 3]).max(axis=1) <= np.sqrt((half**2).sum())))
        own = transform(inverse(body_T_box), body[rows])
        is_inside = (np.abs(own) <= half).all(axis=1)
        rows, own = rows[is_inside], own[is_inside]
        if not len(rows):
            continue
        free[rows] = False
        track_id = None if site.truth.track_id is None else int(site.truth.track_id[row])
        eye = transform(inverse(body_T_box), body_T_sensor[None, :3, 3])[0]
        stay, elsewhere = change(ObjectPoints(own, half - _MARGIN_M, eye, site, message, row, track_id))
        is_kept[rows] = stay
        if elsewhere is not own:
            body[rows], is_moved[rows] = transform(body_T_box, elsewhere), True
    if is_moved.any():
        xyz = np.where(is_moved[:, None], transform(inverse(body_T_sensor), body), message.xyz)
        message = move_points(message, xyz)
    return keep_points(message, is_kept)


def _box(boxes: Boxes3D, row: int) -> tuple[Float64, Float64]:
    """Pose of a box, and half its size with a margin (3,) [m]."""
    angles = [0.0 if values is None else values[row] for values in (boxes.yaw_rad, boxes.pitch_rad, boxes.roll_rad)]
    pose = pose_matrix(boxes.center_m[row], Rotation.from_euler("ZYX", angles).as_quat())
    return pose, boxes.size_lwh_m[row] / 2 + _MARGIN_M


class Density(OnObjects):
    """Each object loses a share of its points, drawn anew for every message: round(share * points), at least one."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"removed_share": (0.1, 0.2, 0.3, 0.4, 0.5)}

    @for_objects
    def disturb(self, points: ObjectPoints, level: Level) -> tuple[Bool, Float64]:
        """Draw what is lost."""
        num = count_share(len(points.xyz), level["removed_share"])
        stay = np.ones(len(points.xyz), bool)
        stay[points.fresh().choice(len(points.xyz), num, replace=False)] = False
        return stay, points.xyz


class Cutout(OnObjects):
    """Each object loses the share of its points that is nearest to one of them: round(share * points), at least one."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"removed_share": (0.3, 0.4, 0.5, 0.6, 0.7)}

    @for_objects
    def disturb(self, points: ObjectPoints, level: Level) -> tuple[Bool, Float64]:
        """Cut around one of the points."""
        num = count_share(len(points.xyz), level["removed_share"])
        seed = points.xyz[int(points.fresh().integers(len(points.xyz)))]
        stay = np.ones(len(points.xyz), bool)
        stay[np.argsort(((points.xyz - seed) ** 2).sum(axis=1), kind="stable")[:num]] = False
        return stay, points.xyz


class Occlusion(OnObjects):
    """Something hides each object from one side, by a share of its width as the sensor sees it; the side is drawn once
    an object, where truth has track ids. Levels are fbench's own.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"hidden_share": (0.2, 0.4, 0.6, 0.8, 1.0)}

    @for_objects
    def disturb(self, points: ObjectPoints, level: Level) -> tuple[Bool, Float64]:
        """Hide one side."""
        middle = np.arctan2(-points.eye_m[1], -points.eye_m[0])
        azimuth = np.arctan2(points.xyz[:, 1] - points.eye_m[1], points.xyz[:, 0] - points.eye_m[0]) - middle
        azimuth = (azimuth + np.pi) % (2 * np.pi) - np.pi
        if points.lasting().random() < 0.5:
            azimuth = -azimuth
        first, last = float(azimuth.min()), float(azimuth.max())
        return azimuth > first + level["hidden_share"] * (last - first), points.xyz


class Moved(OnObjects):
    """The points of each object are moved along the ground by a distance, in a direction drawn once an object where
    truth has track ids.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"moved_m": (0.2, 0.4, 0.6, 0.8, 1.0)}

    @for_objects
    def disturb(self, points: ObjectPoints, level: Level) -> tuple[Bool, Float64]:
        """Move all points."""
        angle = 2 * np.pi * points.lasting().random()
        return np.ones(len(points.xyz), bool), points.xyz + level["moved_m"] * np.array(
            [np.cos(angle), np.sin(angle), 0.0]
        )


class Rotated(OnObjects):
    """The points of each object are turned about the vertical axis of its box; the sense is drawn once an object where
    truth has track ids.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"rotated_deg": (1.0, 3.0, 5.0, 7.0, 9.0)}

    @for_objects
    def disturb(self, points: ObjectPoints, level: Level) -> tuple[Bool, Float64]:
        """Turn all points."""
        angle = np.radians(level["rotated_deg"]) * (1 if points.lasting().random() < 0.5 else -1)
        turn = np.eye(4)
        turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        return np.ones(len(points.xyz), bool), transform(turn, points.xyz)


class Scaled(OnObjects):
    """The points of each object are spread or drawn together about the middle of its box's floor, in all directions
    alike; which of both is drawn once an object where truth has track ids.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"scale_share": (0.04, 0.08, 0.12, 0.16, 0.2)}

    @for_objects
    def disturb(self, points: ObjectPoints, level: Level) -> tuple[Bool, Float64]:
        """Scale all points."""
        factor = 1 + level["scale_share"] * (1 if points.lasting().random() < 0.5 else -1)
        floor = np.array([0.0, 0.0, -float(points.half_m[2])])
        return np.ones(len(points.xyz), bool), (points.xyz - floor) * factor + floor


class Sheared(OnObjects):
    """The points of each object are sheared in its ground plane: x' = x + a y, y' = y + b x, with signs of a and b
    drawn once an object where truth has track ids.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"shear_share": (0.05, 0.1, 0.15, 0.2, 0.25)}

    @for_objects
    def disturb(self, points: ObjectPoints, level: Level) -> tuple[Bool, Float64]:
        """Shear all points."""
        a, b = level["shear_share"] * np.where(points.lasting().random(2) < 0.5, 1.0, -1.0)
        x, y, z = points.xyz.T
        return np.ones(len(points.xyz), bool), np.stack([x + a * y, y + b * x, z], axis=1)
