"""Clouds made by hand."""

import numpy as np

from fbench.pipelines.fusion.early.cloud import FusedCloud
from fbench.replay.data.boxes import Source

L, R, S = int(Source.L), int(Source.R), int(Source.S)


def points(source, places, rate_mps=np.nan, period_mps=0.0, own_mps=np.nan):
    """Rows (x, y, z) of one sensor, all with one radial velocity; those that move have one other than 0."""
    xyz = np.asarray(places, np.float64).reshape(-1, 3)
    num = len(xyz)
    rate = np.full(num, rate_mps, np.float64)
    return FusedCloud(
        xyz,
        np.full(num, source, np.uint8),
        rate,
        np.full(num, period_mps),
        np.abs(rate) > 0.3,
        xyz[:, 2],
        np.full(num, own_mps),
        np.ones(num),
    )


def joined(*parts):
    """One cloud of several."""
    names = ("xyz", "source", "range_rate_mps", "period_mps", "is_moving", "height_m", "own_mps", "exactness")
    return FusedCloud(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def row(num, step_m, x_m=10.0, y_m=0.0):
    """Places one beside the other along y."""
    return np.column_stack([np.full(num, x_m), y_m + step_m * np.arange(num), np.zeros(num)])
