"""Axes for points and lines over numbers."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.images import Pixels
from fbench.reports.preview import draw
from fbench.reports.preview.colors import GRID, INK, QUIET, Color, Colors

_MARGIN = (58, 30, 14, 34)
"""Left, top, right and bottom [px]."""


@dataclass(frozen=True)
class Axes:
    """A rectangle of a picture that shows a range of numbers."""

    rect: tuple[int, int, int, int]
    """Left, top, width and height [px], margins for labels included."""
    x: tuple[float, float]
    y: tuple[float, float]

    def to_picture(self, xy: Float64) -> Float64:
        """Move (N, 2) numbers into the picture."""
        left, top, width, height = self._inner
        share_x = (xy[:, 0] - self.x[0]) / (self.x[1] - self.x[0])
        share_y = (xy[:, 1] - self.y[0]) / (self.y[1] - self.y[0])
        return np.stack([left + share_x * width, top + (1 - share_y) * height], axis=1)

    def draw(self, picture: Pixels, title: str, x_name: str, y_name: str) -> None:
        """Draw frame, grid, numbers and names."""
        import cv2

        left, top, width, height = self._inner
        for value in ticks(*self.x, max(3, width // 65)):
            line = self.to_picture(np.array([[value, self.y[0]], [value, self.y[1]]]))
            draw.path(picture, line, GRID)
            draw.write(
                picture, _text(value), (line[0, 0] - draw.text_size(_text(value))[0] / 2, top + height + 14), QUIET
            )
        for value in ticks(*self.y, max(2, height // 40)):
            line = self.to_picture(np.array([[self.x[0], value], [self.x[1], value]]))
            draw.path(picture, line, QUIET if value == 0 else GRID)
            draw.write(picture, _text(value), (left - 6 - draw.text_size(_text(value))[0], line[0, 1] + 4), QUIET)
        cv2.rectangle(picture, (left, top), (left + width, top + height), QUIET, 1)
        draw.write(picture, title, (left, top - 17), INK)
        draw.write(picture, y_name, (left + 4, top - 3), QUIET)
        draw.write(picture, x_name, (left + width - draw.text_size(x_name)[0], top + height + 29), QUIET)

    def line(self, picture: Pixels, xy: Float64, color: Color, thickness: int = 1) -> None:
        """Join numbers (N, 2) by a line; it is broken where one isn't finite."""
        draw.path(picture, self.to_picture(self._bounded(xy)), color, thickness)

    def dots(self, picture: Pixels, xy: Float64, colors: Colors, radius: int = 2) -> None:
        """Mark numbers (N, 2); those outside are marked at the border."""
        xy = self._bounded(xy[np.isfinite(xy).all(axis=1)])
        draw.disks(picture, self.to_picture(xy), np.full(len(xy), radius), colors)

    def _bounded(self, xy: Float64) -> Float64:
        return np.clip(xy, [self.x[0], self.y[0]], [self.x[1], self.y[1]])

    @property
    def _inner(self) -> tuple[int, int, int, int]:
        left, top, right, bottom = _MARGIN
        x, y, width, height = self.rect
        return x + left, y + top, width - left - right, height - top - bottom


def ticks(low: float, high: float, num: int) -> list[float]:
    """About `num` round numbers in a range: multiples of 1, 2 or 5 times a power of ten."""
    rough = (high - low) / num
    power = 10.0 ** np.floor(np.log10(rough))
    step = power * next(m for m in (1, 2, 5, 10) if m * power >= rough * 0.999)
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [float(round(i * step, 9)) + 0.0 for i in range(first, last + 1)]


def spanned(values: Float64, least: float) -> tuple[float, float]:
    """A range around all finite values, at least `least` wide, with a margin."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    pad = max(0.08 * (high - low), (least - (high - low)) / 2)
    return low - pad, high + pad


def _text(value: float) -> str:
    return f"{value:g}"
