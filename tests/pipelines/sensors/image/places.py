"""Scenes in front of one camera: boxes of points at known places, and what lies behind them."""

import numpy as np

from fbench.pipelines.sensors.image.objects import Cloud
from fbench.pipelines.sensors.points.ground import Plane
from fbench.replay.data.rig import CameraModel, Mount, Rig

AHEAD = np.array([-0.5, 0.5, -0.5, 0.5])
CAMERA = CameraModel(np.array([[400.0, 0, 399.5], [0, 400, 299.5], [0, 0, 1]]), (800, 600))
RIG = Rig({"cam": Mount("camera", np.array([0.0, 0, 1.0]), AHEAD)}, {"cam": CAMERA})
"""A camera 1 m over the body's origin that looks ahead; the ground is at z = 0."""


def back(x_m, y_m=0.0, width_m=1.8, top_m=1.4, step_m=0.15):
    """Points on the back of something that stands `x_m` ahead."""
    y, z = np.meshgrid(np.arange(-width_m / 2, width_m / 2 + 1e-9, step_m), np.arange(0.3, top_m + 1e-9, step_m))
    return np.column_stack([np.full(y.size, float(x_m)), y.ravel() + y_m, z.ravel()])


def wall(x_m=50.0):
    """A facade across the view."""
    return back(x_m, width_m=40.0, top_m=4.0, step_m=0.4)


def cloud(*parts, rate_mps=None, own_mps=10.0, order=None):
    """Points over flat ground; with `rate_mps` over ground those of a radar that drives at `own_mps` towards them."""
    xyz = np.concatenate([np.zeros((0, 3)), *parts])
    xyz = xyz if order is None else xyz[order.permutation(len(xyz))]
    num = len(xyz)
    rate = np.full(num, np.nan if rate_mps is None else rate_mps)
    own = np.full(num, np.nan if rate_mps is None else own_mps)
    moves = np.abs(rate) > 0.3
    return Cloud(Plane(0, 0, 0), xyz, xyz[:, 2], np.zeros((0, 3)), np.zeros(3), moves, rate, own, np.zeros(num))
