"""Outlines of groups of points in an image."""

import numpy as np

from fbench.pipelines.imaging.shape import Groups
from fbench.replay.arrays import Float64
from fbench.replay.data import Rig
from fbench.replay.geometry.camera import project_body


def outlines(rig: Rig, camera: str, groups: Groups, uv_px: Float64, depth_m: Float64, margin_px: float) -> Float64:
    """Rectangles (M, 4) [px] around groups of points at (N, 2) and depths (N,) in an image, clipped to it.

    They reach down to the ground under the nearest point, and are wider than the points by a margin [px]: what is
    between two beams isn't seen. NaN where nothing of one is in the image.
    """
    begin = groups.first[:-1]
    low = np.minimum.reduceat(uv_px, begin) - margin_px
    high = np.maximum.reduceat(uv_px, begin) + margin_px
    high[:, 1] = np.fmax(high[:, 1] - margin_px, _feet(rig, camera, groups, depth_m))
    width, height = rig.cameras[camera].size_wh
    low = np.maximum(low, -0.5)
    high = np.minimum(high, [width - 0.5, height - 0.5])
    result = np.concatenate([low, high], axis=1)
    result[~np.all(high > low, axis=1)] = np.nan
    return result


def _feet(rig: Rig, camera: str, groups: Groups, depth_m: Float64) -> Float64:
    """Where the nearest point of each group meets the ground, (M,) [px] from the top; NaN where that isn't seen."""
    number = np.repeat(np.arange(len(groups)), np.diff(groups.first))
    nearest = np.lexsort((depth_m, number))[groups.first[:-1]]
    foot = groups.cloud.xyz[nearest].copy()
    if groups.cloud.plane is not None:
        foot[:, 2] = groups.cloud.plane.z_m(foot)
    uv, _ = project_body(rig, camera, foot)
    return np.asarray(uv[:, 1], np.float64)
