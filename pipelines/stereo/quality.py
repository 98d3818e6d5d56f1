"""How far a disparity can be believed, told from the two images alone."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.checks import require_ranges
from fbench.pipelines.stereo.rectify import Rectifier
from fbench.replay.arrays import Float32
from fbench.replay.images import Pixels

_BELOW_HORIZON = 0.025
"""The ground begins this share of the image's height below the horizon: farther ground has hardly any disparity."""
_HEIGHT_M = (0.3, 4.0)
"""Cameras of vehicles are this high above the ground."""


@dataclass(frozen=True)
class QualityParams:
    """When depth is taken for noise: in rain and by night images differ by more than their texture, fog takes it."""

    min_share: float = 0.62
    """Share of the pixels below the horizon that need a sure match [0 to 1]; with fewer, stereo is left out."""
    texture: float = 1.2
    """Sure matches have at least this texture [grey levels], see `disparity.texture`."""
    mismatch: float = 0.8
    """Mean difference of the matched pixels around them, as a multiple of the texture: at most this. Divided by the
    texture, a difference in brightness is about the error of disparity [px] that it causes.
    """

    def __post_init__(self) -> None:
        ranges = {"min_share": (0.0, 1.0), "texture": (0.0, 255.0), "mismatch": (0.0, 1000.0)}
        require_ranges("stereo.quality", self, ranges)


def last_row(disparity: Float32, how: Rectifier, most_px: float) -> int:
    """Return the row [px] below which the ground is too near to be matched, the height of the image where none is.

    Takes disparities (H, W) [px] of up to `most_px`. On a level road a pixel v below the horizon has d = v B / h, with
    h the camera's height above the road; h is the median over the image.
    """
    height = len(disparity)
    first = _first_row(how, height)
    if first >= height:
        return height
    below = np.arange(first, height) - how.camera.K[1, 2]
    with np.errstate(invalid="ignore"):
        over_ground = (below * how.baseline_m)[:, None] * (how.camera.K[0, 0] / how.camera.K[1, 1]) / disparity[first:]
    known = over_ground[np.isfinite(over_ground)]
    if not len(known):
        return height
    camera_m = float(np.clip(np.median(known), *_HEIGHT_M))
    scale = how.baseline_m * how.camera.K[0, 0] / how.camera.K[1, 1] / camera_m
    return int(np.clip(how.camera.K[1, 2] + 0.95 * most_px / scale, first, height))


def sure_share(
    left: Pixels, right: Pixels, disparity: Float32, texture: Float32, how: Rectifier, end: int, params: QualityParams
) -> float:
    """Share [0 to 1] of the pixels from the horizon down to row `end` whose match is sure; 0 where none is there.

    Takes rectified grey images, disparity and texture of the left one, all (H, W).
    """
    import cv2

    begin = _first_row(how, len(left))
    if begin >= end:
        return 0.0
    rows = slice(begin, end)
    found = disparity[rows]
    known = np.isfinite(found)
    v, u = np.indices(found.shape, np.float32)
    matched = cv2.remap(right[rows], u - np.where(known, found, np.float32(0)), v, cv2.INTER_LINEAR)
    difference = cv2.boxFilter(cv2.absdiff(left[rows], matched), cv2.CV_32F, (11, 5), borderType=cv2.BORDER_REPLICATE)
    flat = texture[rows]
    sure = known & (flat >= params.texture) & (difference <= params.mismatch * flat)
    return float(np.mean(sure))


def _first_row(how: Rectifier, height: int) -> int:
    return max(0, int(np.ceil(how.camera.K[1, 2] + _BELOW_HORIZON * height)))
