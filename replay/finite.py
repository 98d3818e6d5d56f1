"""Dropping points without a finite position."""

from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np

from fbench.replay.data import PointCloud, RadarScan

C = TypeVar("C", PointCloud, RadarScan)


def only_finite(cloud: C) -> C:
    """Return a cloud without the points of which a coordinate isn't finite."""
    if np.isfinite(cloud.xyz).all():
        return cloud
    good = np.isfinite(cloud.xyz).all(axis=1)
    values = {f.name: getattr(cloud, f.name) for f in fields(cloud)}
    points: dict[str, Any] = {name: v[good] for name, v in values.items() if isinstance(v, np.ndarray)}
    return replace(cloud, **points)
