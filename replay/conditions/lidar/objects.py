"""Labeled objects that a LiDAR sees otherwise than they are: thinned out, cut, scaled, turned, sheared or moved.

Dong et al. 2023 (CVPR), conditions of objects, for their levels. Boxes of truth stay as they are.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.replay.conditions.points import OnClouds, count_share, draw_mask, smallest, take_points
from fbench.replay.contracts.conditions import Level, Need, Site
from fbench.replay.data.arrays import Bool, Float64, Int64
from fbench.replay.data.boxes import finite
from fbench.replay.data.messages import PointCloud
from fbench.replay.geometry.transforms import chain, inverse, transform


def find_objects(cloud: PointCloud, site: Site) -> Iterator[tuple[Int64, Float64, Float64, Float64]]:
    """Yield of every labeled box that has points inside: their rows (M,) of the cloud; their coordinates (M, 3) along
    its length, width and height, from its middle; its size (3,); and `sensor_T_box` (4, 4). A point in several boxes is
    the first one's.
    """
    if site.truth is None or not len(site.truth):
        return
    boxes = site.truth[finite(site.truth)[0]]
    sensor_T_body = inverse(site.rig.body_T_sensor(cloud.sensor))
    none = np.zeros(len(boxes))
    angles = [boxes.yaw_rad, none if boxes.pitch_rad is None else boxes.pitch_rad]
    angles += [none if boxes.roll_rad is None else boxes.roll_rad]
    turns = Rotation.from_euler("ZYX", np.stack(angles, axis=1)).as_matrix()
    xyz = cloud.xyz.astype(np.float64)
    free: Bool = np.isfinite(xyz).all(axis=1)
    for center_m, size_m, turn in zip(boxes.center_m, boxes.size_lwh_m, turns, strict=True):
        body_T_box = np.eye(4)
        body_T_box[:3, :3], body_T_box[:3, 3] = turn, center_m
        sensor_T_box = chain(sensor_T_body, body_T_box)
        near = np.flatnonzero(free & (np.abs(xyz[:, 0] - sensor_T_box[0, 3]) <= np.sqrt((size_m * size_m).sum()) / 2))
        local = transform(inverse(sensor_T_box), xyz[near])
        inside = (np.abs(local) <= size_m / 2).all(axis=1)
        if inside.any():
            free[near[inside]] = False
            yield near[inside], local[inside], size_m, sensor_T_box


class _Objects(OnClouds):
    needs: ClassVar[Sequence[Need]] = ("truth",)


class ObjectDensity(_Objects):
    """Of each labeled object points are lost, drawn without replacement: round(share * points inside its box)."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"lost_share": (0.1, 0.2, 0.3, 0.4, 0.5)}

    def change(self, cloud: PointCloud, level: Level, site: Site) -> PointCloud:
        """Draw what is lost, box by box."""
        rng, keep = site.rng_of(cloud), np.ones(len(cloud.xyz), bool)
        for rows, *_ in find_objects(cloud, site):
            keep[rows[draw_mask(rng, len(rows), level["lost_share"])]] = False
        return take_points(cloud, keep)


class IncompleteEcho(ObjectDensity):
    """Of each labeled object most points give no echo, as of dark or shiny ones: round(share * points inside its box),
    drawn without replacement.

    Levels after Robo3D (Kong et al., ICCV 2023): 75, 85, 95 %.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"lost_share": (0.55, 0.65, 0.75, 0.85, 0.95)}


class ObjectCutout(_Objects):
    """Of each labeled object the points that are nearest to one of its points, drawn evenly, are lost."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"lost_share": (0.3, 0.4, 0.5, 0.6, 0.7)}

    def change(self, cloud: PointCloud, level: Level, site: Site) -> PointCloud:
        """Draw the middle of each hole."""
        rng, keep = site.rng_of(cloud), np.ones(len(cloud.xyz), bool)
        for rows, local, *_ in find_objects(cloud, site):
            away = local - local[int(rng.integers(len(rows)))]
            keep[rows[smallest((away * away).sum(axis=1), count_share(len(rows), level["lost_share"]))]] = False
        return take_points(cloud, keep)


class _Shapes(_Objects):
    def reshape(self, local: Float64, size_m: Float64, level: Level, rng: np.random.Generator) -> Float64:
        """Return where the points (M, 3) of one object are seen, in coordinates of its box of `size_m` (3,)."""
        raise NotImplementedError

    def change(self, cloud: PointCloud, level: Level, site: Site) -> PointCloud:
        """Change one object after the other."""
        rng, xyz = site.rng_of(cloud), cloud.xyz.copy()
        for rows, local, size_m, sensor_T_box in find_objects(cloud, site):
            xyz[rows] = transform(sensor_T_box, self.reshape(local, size_m, level, rng))
        return replace(cloud, xyz=xyz)


class ObjectScale(_Shapes):
    """Each labeled object is longer, wider or higher than it is, or less so, by a share; on the same ground."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"scale_share": (0.04, 0.08, 0.12, 0.16, 0.20)}

    def reshape(self, local: Float64, size_m: Float64, level: Level, rng: np.random.Generator) -> Float64:
        """Scale along one axis."""
        axis, factor = int(rng.integers(3)), 1 + level["scale_share"] * _sign(rng)
        fixed = -size_m[2] / 2 if axis == 2 else 0.0
        result = local.copy()
        result[:, axis] = fixed + (local[:, axis] - fixed) * factor
        return result


class ObjectRotation(_Shapes):
    """Each labeled object is turned about its vertical axis, to either side."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"rotation_deg": (1.0, 3.0, 5.0, 7.0, 9.0)}

    def reshape(self, local: Float64, size_m: Float64, level: Level, rng: np.random.Generator) -> Float64:
        """Turn about z."""
        angle = np.radians(level["rotation_deg"]) * _sign(rng)
        x, y, z = local.T
        return np.stack([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, z], axis=1)


class ObjectShear(_Shapes):
    """Each labeled object is sheared in the ground plane: x += s y, y += s x, to either side each."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"shear_share": (0.05, 0.10, 0.15, 0.20, 0.25)}

    def reshape(self, local: Float64, size_m: Float64, level: Level, rng: np.random.Generator) -> Float64:
        """Shear along x and y."""
        x, y, z = local.T
        return np.stack(
            [x + level["shear_share"] * _sign(rng) * y, y + level["shear_share"] * _sign(rng) * x, z], axis=1
        )


class ObjectMoved(_Shapes):
    """Each labeled object is seen farther ahead or back along its heading than it is."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"moved_m": (0.2, 0.4, 0.6, 0.8, 1.0)}

    def reshape(self, local: Float64, size_m: Float64, level: Level, rng: np.random.Generator) -> Float64:
        """Move along x."""
        return np.asarray(local + np.array([level["moved_m"] * _sign(rng), 0.0, 0.0]))


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0
