"""How well boxes in space, projected into an image, cover what a camera sees there."""

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.boxes import Boxes3D
from fbench.replay.data import Rig
from fbench.replay.geometry.camera import project_boxes


def outline_overlaps(rig: Rig, camera: str, boxes: Boxes3D, xyxy_px: Float64) -> Float64:
    """IoU (N,) of boxes (N) in body coordinates, projected, with rectangles (N, 4) in the image of a camera; 0 for
    those that can't be projected.
    """
    outlines, _ = project_boxes(rig, camera, boxes)
    sides = np.minimum(outlines[:, 2:], xyxy_px[:, 2:]) - np.maximum(outlines[:, :2], xyxy_px[:, :2])
    common = np.maximum(sides, 0.0).prod(axis=1)
    areas = [(part[:, 2:] - part[:, :2]).prod(axis=1) for part in (outlines, xyxy_px)]
    return np.asarray(np.nan_to_num(common / np.maximum(sum(areas) - common, 1e-9)), np.float64)
