"""Disparity by semi-global matching, computed by OpenCV."""

import math
from dataclasses import dataclass

import numpy as np

from fbench.pipelines.checks import require_ranges
from fbench.replay.arrays import Float32
from fbench.replay.errors import ConfigError
from fbench.replay.images import Pixels

_STEP = 16
"""OpenCV searches a multiple of so many disparities, and gives them in units of 1/16 px."""


@dataclass(frozen=True)
class DisparityParams:
    """Semi-global block matching (Hirschmueller, PAMI 2008); all pixels are those of the shrunk images."""

    shrink: int = 2
    """Images are made smaller by this factor before they are matched: 2 is about four times as fast as 1, and depth is
    half as exact.
    """
    nearest_m: float = 3.0
    """Nearer things [m] aren't found: the disparities that are searched end at f B / nearest_m."""
    max_disparity_px: int = 192
    """No larger disparities [px] are searched, however near `nearest_m` is."""
    block_px: int = 5
    """Edge of the blocks that are compared [px], odd."""
    smoothness: tuple[int, int] = (8, 32)
    """Penalty on a step of one disparity, and on a larger one, in grey levels for each pixel of a block."""
    uniqueness: int = 10
    """By how much [%] the best match must be better than the second."""
    left_right_px: int = 1
    """By how much [px] matching from the right image may differ."""
    speckle_px: int = 60
    """Patches of like disparity with fewer pixels are dropped."""
    texture: float = 1.0
    """Mean step between horizontal neighbours [grey levels] in a block twice as wide: flatter places, such as the sky,
    can't be matched.
    """

    def __post_init__(self) -> None:
        ranges = {
            "shrink": (1, 8), "nearest_m": (0.1, 100.0), "max_disparity_px": (16, 1024), "block_px": (1, 31),
            "uniqueness": (0, 100), "left_right_px": (0, 100), "speckle_px": (0, 10_000),
            "texture": (0.0, 255.0),
        }  # fmt: skip
        require_ranges("stereo.disparity", self, ranges)
        one, more = self.smoothness
        if self.block_px % 2 == 0:
            raise ConfigError(f"stereo.disparity.block_px: expected an odd number, got {self.block_px}")
        if not 0 < one < more <= 1000:
            raise ConfigError(f"stereo.disparity.smoothness: expected 0 < first < second <= 1000, got {one},{more}")


class Matcher:
    """Matches pairs of rectified images of one size; disparities below `num_px` are searched."""

    def __init__(self, focal_px: float, baseline_m: float, width_px: int, params: DisparityParams) -> None:
        import cv2

        most = min(focal_px * baseline_m / params.nearest_m, params.max_disparity_px)
        # OpenCV fails where it isn't less than the width, which the margin doubles at most.
        self.num_px = max(1, min(math.ceil(most / _STEP), width_px // _STEP)) * _STEP
        one, more = (level * params.block_px**2 for level in params.smoothness)
        self._block, self._texture = params.block_px, params.texture
        self._sgbm = cv2.StereoSGBM.create(
            minDisparity=0, numDisparities=self.num_px, blockSize=params.block_px, P1=one, P2=more,
            disp12MaxDiff=params.left_right_px, preFilterCap=31, uniquenessRatio=params.uniqueness,
            speckleWindowSize=params.speckle_px, speckleRange=2, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )  # fmt: skip

    def disparity(self, left: Pixels, right: Pixels, texture: Float32) -> Float32:
        """Match grey images (H, W), the left one with its `texture`; NaN where nothing fits.

        Returns d = u_left - u_right (H, W) [px]. Both images get a margin on the left, because OpenCV doesn't look at
        pixels nearer to that border than the largest disparity; matches in it don't count.
        """
        import cv2

        wide = [cv2.copyMakeBorder(one, 0, 0, self.num_px, 0, cv2.BORDER_REPLICATE) for one in (left, right)]
        found = np.asarray(self._sgbm.compute(wide[0], wide[1])[:, self.num_px :], np.float32)
        disparity: Float32 = found / np.float32(_STEP)
        column = np.arange(left.shape[1], dtype=np.float32)
        disparity[(disparity <= 0) | (disparity > column) | (texture < self._texture)] = np.nan
        return disparity

    def texture(self, image: Pixels) -> Float32:
        """Mean absolute step to the right (H, W) [grey levels] around each pixel of a grey image."""
        import cv2

        step = np.zeros(image.shape, np.uint8)
        cv2.absdiff(image[:, 1:], image[:, :-1], step[:, :-1])
        size = (2 * self._block + 1, self._block)
        return np.asarray(cv2.boxFilter(step, cv2.CV_32F, size, borderType=cv2.BORDER_REPLICATE), np.float32)
