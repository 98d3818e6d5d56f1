"""Removing and moving the points of clouds and radar scans, all fields of a point alike."""

from dataclasses import fields, replace
from typing import Any, TypeAlias

import numpy as np

from fbench.replay.data.arrays import Array, Bool, Float32
from fbench.replay.data.messages import PointCloud, RadarScan

Points: TypeAlias = PointCloud | RadarScan


def keep_points(message: Points, is_kept: Bool) -> Points:
    """Return a message with the points of a mask (N,), in their order; the message itself where all are kept."""
    if is_kept.all():
        return message
    named = ((f.name, getattr(message, f.name)) for f in fields(message))
    kept: dict[str, Any] = {name: value[is_kept] for name, value in named if isinstance(value, np.ndarray)}
    return replace(message, **kept)


def move_points(message: Points, xyz: Array) -> Points:
    """Return a message with other coordinates (N, 3) [m] of its points; ranges and angles of a radar that gives them
    follow where a point moved. Everything else stays.
    """
    moved: Float32 = np.asarray(xyz, np.float32)
    if isinstance(message, PointCloud):
        return replace(message, xyz=moved)
    changed = (moved != message.xyz).any(axis=1)
    x, y, z = moved.astype(np.float64).T
    polar = {
        "range_m": np.sqrt(x * x + y * y + z * z),
        "azimuth_rad": np.arctan2(y, x),
        "altitude_rad": np.arctan2(z, np.sqrt(x * x + y * y)),
    }
    given = {name: old for name in polar if (old := getattr(message, name)) is not None}
    follow: dict[str, Any] = {n: np.where(changed, polar[n], old).astype(np.float32) for n, old in given.items()}
    return replace(message, xyz=moved, **follow)
