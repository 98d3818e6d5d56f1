"""What stands on the ground, as the points of one kind of sensor tell it."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.imaging.params import RadarImageParams
from fbench.pipelines.points.ground import Plane, fit_plane, height_above_ground, lowest_points, surroundings
from fbench.pipelines.points.lidar import Obstacles
from fbench.pipelines.points.ordering import lexicographic_order
from fbench.pipelines.points.radar import Compensated
from fbench.replay.arrays import Array, Bool, Float64
from fbench.replay.data import Rig

_TALL = 2.5
"""Points up to so many times the height of vehicles tell what goes on above it."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of all sensors of a kind that are no ground."""

    plane: Plane | None
    """The ground; `None` where too few points tell."""
    xyz: Float64
    """(N, 3) [m] in body coordinates."""
    height_m: Float64
    """(N,) above ground [m]."""
    tall: Float64
    """(K, 3) [m] points above the height of vehicles."""
    viewpoint: Float64
    """(2,) where the sensors look from [m] in body coordinates."""
    moves: Bool
    """(N,) whether a point is known to move over ground."""
    over_ground_mps: Float64
    """(N,) radial velocity over ground [m/s], positive when receding; NaN where it isn't measured."""
    own_mps: Float64
    """(N,) the sensor's own velocity towards the points [m/s]; NaN where that isn't known."""
    period_mps: Float64
    """(N,) velocities alias with this period [m/s]; 0: unambiguous."""

    def rows(self, rows: Array) -> "Cloud":
        """Select points by mask or index array."""
        at = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
        return Cloud(
            self.plane, self.xyz.take(at, axis=0), self.height_m.take(at), self.tall, self.viewpoint,
            self.moves.take(at), self.over_ground_mps.take(at), self.own_mps.take(at), self.period_mps.take(at),
        )  # fmt: skip


def empty_cloud() -> Cloud:
    """Return a cloud without points, over ground that isn't known."""
    none = np.zeros(0)
    return Cloud(None, np.zeros((0, 3)), none, np.zeros((0, 3)), np.zeros(2), none > 0, none, none, none)


def of_lidar(found: Obstacles | None, viewpoint: Float64) -> Cloud:
    """Cloud of what LiDARs at `viewpoint` (2,) [m] measured."""
    if found is None:
        return empty_cloud()
    unknown = np.full(len(found.xyz), np.nan)
    return Cloud(
        found.plane, found.xyz, found.height_m, found.tall, viewpoint, unknown > 0, unknown, unknown, 0 * found.height_m
    )  # fmt: skip


def of_radar(echoes: Compensated | None, viewpoint: Float64, min_speed_mps: float, params: RadarImageParams) -> Cloud:
    """Cloud of what radars at `viewpoint` (2,) [m] measured; no points where they are too few to tell the ground.

    The order of echoes doesn't matter.
    """
    if echoes is None or len(echoes.xyz) < max(params.min_echoes, 1):
        return empty_cloud()
    order = lexicographic_order(*echoes.xyz.T, echoes.range_rate_mps)
    xyz = echoes.xyz.take(order, axis=0)
    around = surroundings(xyz, params.ground)
    lowest, near = lowest_points(around, params.ground), around.is_near
    plane = fit_plane(lowest, params.ground)
    if plane is None:
        return empty_cloud()
    height = height_above_ground(around, lowest, plane, params.ground)
    tall = near & (height >= params.max_height_m) & (height < _TALL * params.max_height_m)
    rate = echoes.range_rate_mps[order]
    whole = Cloud(
        plane, xyz, height, xyz[tall], viewpoint, np.abs(rate) >= min_speed_mps, rate, echoes.own_mps[order],
        echoes.period_mps[order],
    )  # fmt: skip
    return whole.rows(near & (height > params.ground.tolerance_m) & (height < params.max_height_m))


def viewpoint(rig: Rig, kind: str) -> Float64:
    """Where the sensors of a kind look from, (2,) [m] in body coordinates: the middle between them."""
    places = [rig.body_T_sensor(name)[:2, 3] for name, mount in sorted(rig.mounts.items()) if mount.kind == kind]
    return np.mean(places, axis=0) if places else np.zeros(2)
