"""What must never reach a pipeline: points that aren't finite."""

from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np

from fbench.replay.data import Message, PointCloud, RadarScan
from fbench.replay.faults import FaultLog

C = TypeVar("C", PointCloud, RadarScan)

MAX_LOST_SHARE = 0.5
"""A cloud with a larger share of non-finite points is skipped whole."""


def clean(message: Message, faults: FaultLog) -> Message | None:
    """Drop points with a non-finite coordinate, and clouds that consist mostly of them; count both."""
    if isinstance(message, PointCloud):
        return _clean_cloud(message, faults)
    if isinstance(message, RadarScan):
        return _clean_cloud(message, faults)
    return message


def _clean_cloud(cloud: C, faults: FaultLog) -> C | None:
    where = f"{cloud.sensor} at {cloud.stamp_ns} ns"
    num = len(cloud.xyz)
    if num == 0:
        faults.add("DAT002", where)
        return cloud
    good = np.isfinite(cloud.xyz).all(axis=1)
    lost = num - int(np.count_nonzero(good))
    if lost == 0:
        return cloud
    if lost > MAX_LOST_SHARE * num:
        faults.add("DAT001", f"{where}: {lost} of {num} points")
        return None
    faults.add("DAT004", f"{where}: {lost} of {num} points")
    values = {f.name: getattr(cloud, f.name) for f in fields(cloud)}
    points: dict[str, Any] = {name: v[good] for name, v in values.items() if isinstance(v, np.ndarray)}
    return replace(cloud, **points)
