"""Conditions of clouds and scans: taking some of their points, with all that belongs to each."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from math import floor
from typing import Any, ClassVar, TypeVar

import numpy as np

from fbench.replay.contracts.conditions import Level, Measurement, Site
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.messages import PointCloud, RadarScan
from fbench.replay.data.rig import Kind

P = TypeVar("P", PointCloud, RadarScan)


def take_points(message: P, rows: Array) -> P:
    """Return the points of a mask (N,), or of rows (M,), with all that is known of each."""
    rows = np.flatnonzero(rows) if rows.dtype == bool else rows
    named = ((field.name, getattr(message, field.name)) for field in fields(message))
    taken: dict[str, Any] = {name: value.take(rows, axis=0) for name, value in named if isinstance(value, np.ndarray)}
    return replace(message, **taken)


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
    levels: ClassVar[Mapping[str, Sequence[float]]]

    def change(self, cloud: PointCloud, level: Level, site: Site) -> PointCloud:
        """Return what becomes of a cloud."""
        raise NotImplementedError

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Change the cloud, unless it is empty."""
        if isinstance(message, PointCloud) and len(message.xyz):
            return (self.change(message, level, site),)
        return (message,)


class OnScans:
    """What conditions of radars have in common."""

    version: ClassVar[int] = 1
    kinds: ClassVar[Sequence[Kind]] = ("radar",)
    levels: ClassVar[Mapping[str, Sequence[float]]]

    def change(self, scan: RadarScan, level: Level, site: Site) -> RadarScan:
        """Return what becomes of a scan."""
        raise NotImplementedError

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Change the scan, unless it is empty."""
        if isinstance(message, RadarScan) and len(message.xyz):
            return (self.change(message, level, site),)
        return (message,)
