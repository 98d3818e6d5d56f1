"""Boxes in images as a camera without lens distortion would show them."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.data import CameraModel, Rig
from fbench.replay.geometry.camera import project, rays
from fbench.replay.geometry.distortion import lens_of
from fbench.replay.geometry.transforms import inverse, transform


@dataclass(frozen=True, eq=False)
class FlatView:
    """A box in the image of a pinhole camera with the same `K`."""

    xyxy_px: Float64
    """(4,) left, top, right, bottom [px]."""
    body_T_view: Float64
    """(4, 4) from that camera's to body coordinates."""


def flat_view(rig: Rig, camera: str, xyxy_px: Float64) -> FlatView | None:
    """Return a box (4,) as a pinhole camera at the same place shows it, by the middles of its edges; `None` where that
    sees no such box.

    A camera that may see what is beside and behind it is turned towards the box first, about its vertical axis.
    """
    model, body_T_camera = rig.cameras[camera], rig.body_T_sensor(camera)
    lens = lens_of(model)
    if lens is None:
        return FlatView(xyxy_px, body_T_camera)
    left, top, right, bottom = (float(value) for value in xyxy_px)
    x, y = (left + right) / 2, (top + bottom) / 2
    directions = rays(model, np.array([[left, y], [x, top], [right, y], [x, bottom], [x, y]]))
    camera_T_view = _turned(directions[4]) if lens.is_wide else np.eye(4)
    flat, _ = project(CameraModel(model.K, model.size_wh), transform(inverse(camera_T_view), directions[:4]))
    box = np.array([flat[0, 0], flat[1, 1], flat[2, 0], flat[3, 1]])
    if not (np.isfinite(box).all() and box[0] < box[2] and box[1] < box[3]):
        return None
    return FlatView(box, body_T_camera @ camera_T_view)


def _turned(ray: Float64) -> Float64:
    """Pose (4, 4) in a camera's coordinates of one that is turned about the vertical axis to have a ray ahead."""
    angle = np.arctan2(ray[0], ray[2])
    turned = np.eye(4)
    turned[0, 0] = turned[2, 2] = np.cos(angle)
    turned[0, 2], turned[2, 0] = np.sin(angle), -np.sin(angle)
    return turned
