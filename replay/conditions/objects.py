"""Conditions of single objects: the points of each object of the truth thin out, vanish in part, or lie elsewhere than
its box. Truth stays. After the object-level corruptions of Dong et al. (CVPR 2023), whose levels they have.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

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
class _Draws:
    """Random numbers for one object."""

    site: Site
    message: PointCloud | RadarScan
    row: int
    track_id: int | None

    def lasting(self) -> np.random.Generator:
        """Those that stay the same over the log where truth has track ids."""
        return self.fresh() if self.track_id is None else self.site.rng("object", self.track_id)

    def fresh(self) -> np.random.Generator:
        """Those that are drawn anew for every message."""
        return self.site.rng_of(self.message, "object", self.row)


class _Objects:
    version: ClassVar[int] = 1
    kinds: ClassVar[Sequence[Kind]] = ("lidar", "radar")
    needs: ClassVar[Sequence[Need]] = ("truth",)

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Return the message with other points of objects; as it is where no truth is near in time."""
        if isinstance(message, Image) or site.truth is None or not len(message.xyz):
            return (message,)
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
            free[rows] = False  # of two boxes the first has the point
            track_id = None if site.truth.track_id is None else int(site.truth.track_id[row])
            draws = _Draws(site, message, row, track_id)
            eye = transform(inverse(body_T_box), body_T_sensor[None, :3, 3])[0]
            stay, elsewhere = self._change(own, half - _MARGIN_M, eye, level, draws)
            is_kept[rows] = stay
            if elsewhere is not own:
                body[rows], is_moved[rows] = transform(body_T_box, elsewhere), True
        if is_moved.any():
            xyz = np.where(is_moved[:, None], transform(inverse(body_T_sensor), body), message.xyz)
            message = move_points(message, xyz)
        return (keep_points(message, is_kept),)

    def _change(self, xyz: Float64, half_m: Array, eye_m: Array, level: Level, draws: _Draws) -> tuple[Bool, Float64]:
        """Which points of one object stay, and where they are: points (N, 3), half the size (3,) and the sensor (3,),
        all in the box's coordinates [m].
        """
        raise NotImplementedError


def _box(boxes: Boxes3D, row: int) -> tuple[Float64, Float64]:
    """Pose of a box, and half its size with a margin (3,) [m]."""
    angles = [0.0 if values is None else values[row] for values in (boxes.yaw_rad, boxes.pitch_rad, boxes.roll_rad)]
    pose = pose_matrix(boxes.center_m[row], Rotation.from_euler("ZYX", angles).as_quat())
    return pose, boxes.size_lwh_m[row] / 2 + _MARGIN_M


class Density(_Objects):
    """Each object loses a share of its points, drawn anew for every message: round(share * points), at least one."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"removed_share": (0.1, 0.2, 0.3, 0.4, 0.5)}

    def _change(self, xyz: Float64, half_m: Array, eye_m: Array, level: Level, draws: _Draws) -> tuple[Bool, Float64]:
        num = count_share(len(xyz), level["removed_share"])
        stay = np.ones(len(xyz), bool)
        stay[draws.fresh().choice(len(xyz), num, replace=False)] = False
        return stay, xyz


class Cutout(_Objects):
    """Each object loses the share of its points that is nearest to one of them: round(share * points), at least one."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"removed_share": (0.3, 0.4, 0.5, 0.6, 0.7)}

    def _change(self, xyz: Float64, half_m: Array, eye_m: Array, level: Level, draws: _Draws) -> tuple[Bool, Float64]:
        num = count_share(len(xyz), level["removed_share"])
        seed = xyz[int(draws.fresh().integers(len(xyz)))]
        stay = np.ones(len(xyz), bool)
        stay[np.argsort(((xyz - seed) ** 2).sum(axis=1), kind="stable")[:num]] = False
        return stay, xyz


class Occlusion(_Objects):
    """Something hides each object from one side, by a share of its width as the sensor sees it; the side is drawn once
    an object, where truth has track ids. Levels are fbench's own.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"hidden_share": (0.2, 0.4, 0.6, 0.8, 1.0)}

    def _change(self, xyz: Float64, half_m: Array, eye_m: Array, level: Level, draws: _Draws) -> tuple[Bool, Float64]:
        middle = np.arctan2(-eye_m[1], -eye_m[0])
        azimuth = np.arctan2(xyz[:, 1] - eye_m[1], xyz[:, 0] - eye_m[0]) - middle
        azimuth = (azimuth + np.pi) % (2 * np.pi) - np.pi
        if draws.lasting().random() < 0.5:
            azimuth = -azimuth
        first, last = float(azimuth.min()), float(azimuth.max())
        return azimuth > first + level["hidden_share"] * (last - first), xyz


class Moved(_Objects):
    """The points of each object are moved along the ground by a distance, in a direction drawn once an object where
    truth has track ids.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"moved_m": (0.2, 0.4, 0.6, 0.8, 1.0)}

    def _change(self, xyz: Float64, half_m: Array, eye_m: Array, level: Level, draws: _Draws) -> tuple[Bool, Float64]:
        angle = 2 * np.pi * draws.lasting().random()
        return np.ones(len(xyz), bool), xyz + level["moved_m"] * np.array([np.cos(angle), np.sin(angle), 0.0])


class Rotated(_Objects):
    """The points of each object are turned about the vertical axis of its box; the sense is drawn once an object where
    truth has track ids.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"rotated_deg": (1.0, 3.0, 5.0, 7.0, 9.0)}

    def _change(self, xyz: Float64, half_m: Array, eye_m: Array, level: Level, draws: _Draws) -> tuple[Bool, Float64]:
        angle = np.radians(level["rotated_deg"]) * (1 if draws.lasting().random() < 0.5 else -1)
        turn = np.eye(4)
        turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        return np.ones(len(xyz), bool), transform(turn, xyz)


class Scaled(_Objects):
    """The points of each object are spread or drawn together about the middle of its box's floor, in all directions
    alike; which of both is drawn once an object where truth has track ids.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"scale_share": (0.04, 0.08, 0.12, 0.16, 0.2)}

    def _change(self, xyz: Float64, half_m: Array, eye_m: Array, level: Level, draws: _Draws) -> tuple[Bool, Float64]:
        factor = 1 + level["scale_share"] * (1 if draws.lasting().random() < 0.5 else -1)
        floor = np.array([0.0, 0.0, -float(half_m[2])])
        return np.ones(len(xyz), bool), (xyz - floor) * factor + floor


class Sheared(_Objects):
    """The points of each object are sheared in its ground plane: x' = x + a y, y' = y + b x, with signs of a and b
    drawn once an object where truth has track ids.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"shear_share": (0.05, 0.1, 0.15, 0.2, 0.25)}

    def _change(self, xyz: Float64, half_m: Array, eye_m: Array, level: Level, draws: _Draws) -> tuple[Bool, Float64]:
        a, b = level["shear_share"] * np.where(draws.lasting().random(2) < 0.5, 1.0, -1.0)
        x, y, z = xyz.T
        return np.ones(len(xyz), bool), np.stack([x + a * y, y + b * x, z], axis=1)
