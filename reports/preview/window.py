"""Which part of an image is drawn, and how large."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.images import Pixels

MAX_WIDTH_PX = 1280
_MIN_WIDTH_PX = 960


@dataclass(frozen=True)
class Window:
    """A rectangle of an image, scaled."""

    left: int
    top: int
    width: int
    height: int
    scale: float
    """Pixels of the picture per pixel of the image."""

    @property
    def size_wh(self) -> tuple[int, int]:
        """Of the picture [px]."""
        return max(1, round(self.width * self.scale)), max(1, round(self.height * self.scale))

    def picture(self, pixels: Pixels) -> Pixels:
        """Cut and scale an image (H, W, 3)."""
        import cv2

        part = pixels[self.top : self.top + self.height, self.left : self.left + self.width]
        how = cv2.INTER_AREA if self.scale < 1 else cv2.INTER_LINEAR
        return np.ascontiguousarray(cv2.resize(part, self.size_wh, interpolation=how), np.uint8)

    def to_picture(self, uv: Float64) -> Float64:
        """Move pixels (N, 2) of the image into the picture; pixel centres are at integers in both."""
        return (uv - [self.left - 0.5, self.top - 0.5]) * self.scale - 0.5


def whole(size_wh: tuple[int, int]) -> Window:
    """Show a whole image: at most 1280 px wide, small ones enlarged."""
    width, height = size_wh
    scale = MAX_WIDTH_PX / width if width > MAX_WIDTH_PX else max(1, _MIN_WIDTH_PX // width)
    return Window(0, 0, width, height, scale)


def around(size_wh: tuple[int, int], rect: Float64, width_px: int) -> Window:
    """Show what is around a rectangle (left, top, right, bottom), in a picture of 5:3 that is `width_px` wide."""
    width, height = size_wh
    side = max(float(rect[2] - rect[0]) * 1.5, float(rect[3] - rect[1]) * 1.5 * 5 / 3, width / 12)
    w = max(1, min(round(side), width, round(height * 5 / 3)))
    h = max(1, min(round(w * 3 / 5), height))
    left = round(float(rect[0] + rect[2]) / 2 - w / 2)
    top = round(float(rect[1] + rect[3]) / 2 - h / 2)
    return Window(min(max(left, 0), width - w), min(max(top, 0), height - h), w, h, width_px / w)
