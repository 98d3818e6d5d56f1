"""Whole vehicles from the sides of them that a sensor sees."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.fusion.sizes import SIZES
from fbench.replay.contracts.params import require_between
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.geometry.kernels import kernel


@dataclass(frozen=True)
class VehicleSize:
    """Size of a typical car, to which partly seen vehicles are completed."""

    length_m: float = SIZES["car"].lidar_lwh_m[0]  # Length [m].
    width_m: float = SIZES["car"].lidar_lwh_m[1]  # Width [m].
    height_m: float = SIZES["car"].lidar_lwh_m[2]  # Height [m].

    def check(self, prefix: str) -> None:
        """Refuse sizes that no vehicle has. Raises ConfigError naming the parameter below `prefix`, a dotted name."""
        for name, value in vars(self).items():
            require_between(f"{prefix}.{name}", value, 0.1, 50.0)


@dataclass(frozen=True)
class OtherSizes:
    """Sizes of typical road users that are no cars."""

    van: VehicleSize = VehicleSize(*SIZES["van"].lidar_lwh_m)  # Van
    truck: VehicleSize = VehicleSize(*SIZES["truck"].lidar_lwh_m)  # Truck or bus
    motorcycle: VehicleSize = VehicleSize(*SIZES["motorcycle"].lidar_lwh_m)
    """Motorcycle with its rider."""
    bicycle: VehicleSize = VehicleSize(*SIZES["bicycle"].lidar_lwh_m)
    """Bicycle with its rider."""
    pedestrian: VehicleSize = VehicleSize(*SIZES["pedestrian"].lidar_lwh_m)
    """Person on foot."""


@dataclass(frozen=True, eq=False)
class Footprints:
    """Rectangles on the ground in body coordinates."""

    center_m: Float64  # (N, 2) [m]
    size_lw_m: Float64  # (N, 2) length and width [m]
    yaw_rad: Float64  # (N,) heading [rad] in [-pi/2, pi/2): front and back look the same


def complete(rectangles: Float64, viewpoint: Float64, size: VehicleSize) -> Footprints:
    """Complete visible rectangles (N, 5 or more) to vehicles that lie behind their visible edges.

    Rows hold heading [rad], low and high along the heading, low and high across it [m]. Where one edge is longer
    than a car is wide it is the vehicle's side, else the edge that looks longer from where the sensor is is its front
    or back: an edge seen at a grazing angle is seldom seen to its end. The corner that the sensor at `viewpoint` (2 or
    3,) sees stays where it is; along an axis in which the sensor is beside the rectangle, its middle does.
    """
    extent = rectangles[:, [2, 4]] - rectangles[:, [1, 3]]
    # How far edges, along the heading and across it, are turned towards the viewpoint: 0 to 1.
    heading = rectangles[:, 0]
    eye = np.stack([_unit(heading) @ viewpoint[:2], _unit(heading + np.pi / 2) @ viewpoint[:2]], axis=1)
    middle = (rectangles[:, [1, 3]] + rectangles[:, [2, 4]]) / 2 - eye
    away = np.maximum(np.hypot(middle[:, 0], middle[:, 1]), 1e-9)
    apparent = extent * (np.abs(middle[:, ::-1]) / away[:, None])
    is_side = extent.max(axis=1) > 1.25 * size.width_m
    along_first = np.where(is_side, extent[:, 0] > extent[:, 1], apparent[:, 0] <= apparent[:, 1])
    return complete_known(rectangles, along_first, viewpoint, np.array([size.length_m, size.width_m]))


def complete_known(rectangles: Float64, along_first: Bool, viewpoint: Float64, length_width_m: Float64) -> Footprints:
    """Complete visible rectangles (N, 5 or more), see `complete`, knowing which edges are the sides.

    `along_first` (N,): whether vehicles are long along the rectangle's heading. `length_width_m`, (2,) or (N, 2) [m]:
    how large they are at least.
    """
    heading = rectangles[:, 0]
    low, high = rectangles[:, [1, 3]], rectangles[:, [2, 4]]
    axes = np.stack([_unit(heading), _unit(heading + np.pi / 2)], axis=1)
    eye = axes[:, :, 0] * viewpoint[0] + axes[:, :, 1] * viewpoint[1]
    typical = np.broadcast_to(length_width_m, low.shape)
    typical = np.where(along_first[:, None], typical, typical[:, ::-1])
    full = np.maximum(high - low, typical)
    middle = np.where(eye < low, low + full / 2, np.where(eye > high, high - full / 2, (low + high) / 2))
    center = middle[:, :1] * axes[:, 0] + middle[:, 1:] * axes[:, 1]
    yaw = half_turn(heading + np.where(along_first, 0.0, np.pi / 2))
    return Footprints(center, np.where(along_first[:, None], full, full[:, ::-1]), yaw)


def half_turn(angle_rad: Float64) -> Float64:
    """Wrap headings [rad] to [-pi/2, pi/2)."""
    return (angle_rad + np.pi / 2) % np.pi - np.pi / 2


def center_offsets(boxes: Boxes3D) -> tuple[Float64, Float64]:
    """How far (N, N) [m] the center of each box, by column, lies from that of each, by row, along and across that."""
    offset = boxes.center_m[None, :, :2] - boxes.center_m[:, None, :2]
    cos, sin = np.cos(boxes.yaw_rad)[:, None], np.sin(boxes.yaw_rad)[:, None]
    along, across = offset[..., 0] * cos + offset[..., 1] * sin, offset[..., 1] * cos - offset[..., 0] * sin
    return np.abs(along), np.abs(across)


def fade(value: Array, good: float, bad: float) -> Float64:
    """Return 1 where values are at `good` or beyond, 0 at `bad` or beyond, linear between."""
    return np.clip((bad - np.asarray(value, np.float64)) / (bad - good), 0.0, 1.0)


def _unit(angle_rad: Float64) -> Float64:
    return np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=1)


HEADINGS_RAD = np.radians(np.arange(0.0, 90.0, 2.0))
"""Headings of rectangles in space that are tried; by then a rectangle looks as at the first again [rad]."""
NEAR_M = 0.05  # Distances from an edge below this [m] are noise


@kernel
def fit_rectangles(xy: Float64, first: Int64, headings_rad: Float64, near_m: float) -> Float64:
    """Fit one rectangle to each cluster; points (N, 2) sorted by cluster, `first` (M + 1,) rows where clusters begin.

    Headings are searched for the largest closeness (Zhang et al., "Efficient L-shape fitting for vehicle detection
    using laser scanners", IV 2017, algorithm 4): the sum over points of 1 / distance to the nearest edge, distances
    below `near_m` counting as that. The first of equal headings wins.

    Returns (M, 6): heading [rad], low and high along the heading, low and high across it [m], and the mean distance
    of the points from the rectangle [m].
    """
    result = np.zeros((len(first) - 1, 6))
    for m in range(len(first) - 1):
        best = -1.0
        for heading in headings_rad:
            c, s = np.cos(heading), np.sin(heading)
            low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
            for i in range(first[m], first[m + 1]):
                u, v = xy[i, 0] * c + xy[i, 1] * s, xy[i, 1] * c - xy[i, 0] * s
                low_u, high_u = min(low_u, u), max(high_u, u)
                low_v, high_v = min(low_v, v), max(high_v, v)
            closeness = 0.0
            distance = 0.0
            for i in range(first[m], first[m + 1]):
                u, v = xy[i, 0] * c + xy[i, 1] * s, xy[i, 1] * c - xy[i, 0] * s
                d = min(u - low_u, high_u - u, v - low_v, high_v - v)
                closeness += 1.0 / max(d, near_m)
                distance += d
            if closeness > best:
                best = closeness
                num = first[m + 1] - first[m]
                result[m, 0] = heading
                result[m, 1], result[m, 2], result[m, 3], result[m, 4] = low_u, high_u, low_v, high_v
                result[m, 5] = distance / num
    return result
