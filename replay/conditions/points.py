"""Drawing, removing and moving the points of clouds and radar scans, all fields of a point alike."""

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import wraps
from math import floor
from typing import Any, ClassVar, TypeVar

import numpy as np

from fbench.replay.contracts.conditions import Level, Measurement, Site
from fbench.replay.data.arrays import Array, Bool, Float32, Float64, Int64
from fbench.replay.data.messages import PointCloud, RadarScan
from fbench.replay.data.rig import Kind

C = TypeVar("C")
P = TypeVar("P", bound=PointCloud | RadarScan)


def keep_points(message: P, is_kept: Bool) -> P:
    """Return a message with the points of a mask (N,), in their order; the message itself where all are kept."""
    if is_kept.all():
        return message
    named, rows = ((f.name, getattr(message, f.name)) for f in fields(message)), np.flatnonzero(is_kept)
    kept: dict[str, Any] = {name: a.take(rows, axis=0) for name, a in named if isinstance(a, np.ndarray)}
    return replace(message, **kept)


def move_points(message: P, xyz: Array) -> P:
    """Return a message with other coordinates (N, 3) [m] of its points; ranges and angles of a radar that gives them
    follow where a point moved. Everything else stays.
    """
    moved: Float32 = np.asarray(xyz, np.float32)
    if isinstance(message, PointCloud):
        return replace(message, xyz=moved)
    changed = (moved != message.xyz).any(axis=1)
    named = dict(zip(("range_m", "azimuth_rad", "altitude_rad"), polar(moved), strict=True))
    given = {name: old for name in named if (old := getattr(message, name)) is not None}
    follow: dict[str, Any] = {n: np.where(changed, named[n], old).astype(np.float32) for n, old in given.items()}
    return replace(message, xyz=moved, **follow)


def polar(xyz: Array) -> tuple[Float64, Float64, Float64]:
    """Return range [m], azimuth from x towards y and altitude [rad] (N,) of points (N, 3)."""
    x, y, z = np.asarray(xyz, np.float64).T
    flat = np.sqrt(x * x + y * y)
    return np.sqrt(flat * flat + z * z), np.arctan2(y, x), np.arctan2(z, flat)


def count_share(num: int, share: float) -> int:
    """Return a share of points, to the nearest, but never none of some."""
    return min(num, max(1, floor(num * share + 0.5))) if share > 0 else 0


def draw_rows(rng: np.random.Generator, num: int, share: float) -> Int64:
    """Return the rows of a share of `num` points, drawn without replacement, ascending."""
    return np.sort(rng.choice(num, count_share(num, share), replace=False, shuffle=False))


def draw_mask(rng: np.random.Generator, num: int, share: float) -> Bool:
    """Return the same as a mask (num,)."""
    mask = np.zeros(num, bool)
    mask[draw_rows(rng, num, share)] = True
    return mask


def smallest(values: Float64, num: int) -> Int64:
    """Rows of the `num` smallest values, of equal ones the first."""
    limit = np.partition(values, num - 1)[num - 1]
    below = np.flatnonzero(values < limit)
    return np.sort(np.concatenate([below, np.flatnonzero(values == limit)[: num - len(below)]]))


class OnClouds:
    """What conditions of LiDARs have in common."""

    version: ClassVar[int] = 1
    kinds: ClassVar[Sequence[Kind]] = ("lidar",)


class OnScans:
    """What conditions of radars have in common."""

    version: ClassVar[int] = 1
    kinds: ClassVar[Sequence[Kind]] = ("radar",)


def for_clouds(
    change: Callable[[C, PointCloud, Level, Site], PointCloud],
) -> Callable[[C, Measurement, Level, Site], Sequence[Measurement]]:
    """Make `Condition.disturb` of a method that changes clouds; those without points stay."""

    @wraps(change)
    def disturb(condition: C, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        if isinstance(message, PointCloud) and len(message.xyz):
            return (change(condition, message, level, site),)
        return (message,)

    return disturb


def for_scans(
    change: Callable[[C, RadarScan, Level, Site], RadarScan],
) -> Callable[[C, Measurement, Level, Site], Sequence[Measurement]]:
    """Make `Condition.disturb` of a method that changes radar scans; those without echoes stay."""

    @wraps(change)
    def disturb(condition: C, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        if isinstance(message, RadarScan) and len(message.xyz):
            return (change(condition, message, level, site),)
        return (message,)

    return disturb
