"""Boxes from what the bird's-eye network says of each cell."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.sensors.bev.grid import CELL_M, REACH_M
from fbench.pipelines.sensors.rows import suppress
from fbench.replay.data.arrays import Float32, Int64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.geometry.iou import iou_bev

CLASSES = ("car", "van", "truck", "bus", "motorcycle", "bicycle", "pedestrian")
"""Labels that the network tells apart, in the order of its outputs."""
STRIDE = 4  # Cells of the input along the edge of a cell of the output
OUT_CELL_M = CELL_M * STRIDE
SCORE, KINDS = 0, slice(1, 1 + len(CLASSES))
OFFSET, HEIGHT, SIZE, AXIS, FORWARD, SPEED, KNOWN = (
    slice(8, 10), 10, slice(11, 14), slice(14, 16), 16, slice(17, 19), 19
)  # fmt: skip
"""Rows of the output: probability of a center; logits of classes; the center's distance from the cell's middle [cells];
its height above ground [m]; logarithms of length, width, height [m]; sine and cosine of twice the heading; logit of the
heading that points to x > 0; velocity [10 m/s]; logit of its being known.
"""
NUM_OUTPUTS = 20
MAX_PEAKS = 300  # Of one frame; the surest count
_LARGEST = 3.2  # Of the logarithm of a size: 25 m


@dataclass(frozen=True)
class DecodingParams:
    """Which cells become boxes."""

    min_score: float
    max_iou: float  # Of two boxes that overlap more, seen from above, the surer one stays


def decode(output: Float32, params: DecodingParams) -> Boxes3D:
    """Turn an output (`NUM_OUTPUTS`, H, W) into labeled boxes by falling score, whose z is above ground [m].

    Cells that are surer than their eight neighbors become boxes; of equally sure ones the first along x, then y.
    Velocities are NaN where they aren't known.
    """
    rows = _peaks(output[SCORE], params.min_score)
    found = np.asarray(output[:, *np.divmod(rows, output.shape[2])], np.float64)
    place = np.stack(np.divmod(rows, output.shape[2])) + 0.5 + found[OFFSET]
    x, y = place * OUT_CELL_M - REACH_M
    axis = np.arctan2(found[AXIS][0], found[AXIS][1]) / 2  # -pi/2 to pi/2, so that it points to x > 0
    yaw = np.where(found[FORWARD] >= 0, axis, np.where(axis > 0, axis - np.pi, axis + np.pi))
    velocity = np.column_stack([*(10 * found[SPEED]), np.zeros(len(rows))])
    velocity[found[KNOWN] < 0] = np.nan
    boxes = Boxes3D(
        np.column_stack([x, y, found[HEIGHT]]), np.exp(np.clip(found[SIZE], -_LARGEST, _LARGEST)).T, yaw,
        velocity_mps=velocity, label=np.array(CLASSES)[found[KINDS].argmax(axis=0)], score=found[SCORE],
    )  # fmt: skip
    return boxes[suppress(iou_bev(boxes, boxes) > params.max_iou)]


def _peaks(score: Float32, least: float) -> Int64:
    """Flat indices of the cells (H, W) that are surer than their neighbors, by falling score."""
    height, width = score.shape
    padded = np.full((height + 2, width + 2), -np.inf, np.float32)
    padded[1:-1, 1:-1] = score
    is_peak = score >= max(least, float(np.finfo(np.float32).tiny))
    for row in range(3):
        for column in range(3):
            beside = padded[row : row + height, column : column + width]
            is_peak &= (score > beside) if (row, column) < (1, 1) else (score >= beside)
    rows = np.flatnonzero(is_peak)
    return rows[np.argsort(-score.ravel()[rows], kind="stable")[:MAX_PEAKS]]
