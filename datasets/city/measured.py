"""What one message says of the bodies that it shows, for the truth."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Array, Float64, Int64
from fbench.replay.data import Image, PointCloud, RadarScan


@dataclass(frozen=True, eq=False)
class Seen2D:
    """Bodies in one image, B of them, in ascending order."""

    body: Int64
    """(B,) indices of actors."""
    full_px: Float64
    """(B, 4) rectangles around all pixels that show the body or would, if nothing were in front of it."""
    visible_px: Float64
    """(B, 4) those around the pixels that do show it; equal to `full_px` where none does."""
    num_full: Int64
    """(B,) pixels."""
    num_visible: Int64


@dataclass(frozen=True, eq=False)
class Measured:
    """One message and what it hit."""

    message: Image | PointCloud | RadarScan
    num_points: Int64
    """(A,) points or echoes of each actor; zeros of an image."""
    seen: Seen2D | None = None
    """Of an image."""


def counted(body: Array, num_actors: int) -> Int64:
    """Count how often each actor was hit (A,)."""
    return np.bincount(body[body >= 0], minlength=num_actors).astype(np.int64)


def seen_bodies(body: Array, alone: tuple[tuple[int, Int64], ...]) -> Seen2D:
    """Outline bodies in an image.

    Args:
        body: (H, W) what each pixel shows: an actor's index, negative for anything else.
        alone: Of every actor the ascending indices of pixels, row by row, that would show it if it were alone.
    """
    width = body.shape[1]
    flat = body.ravel()
    full = [_rectangle(pixels, width) for _, pixels in alone]
    shown = [pixels[flat[pixels] == i] for i, pixels in alone]
    visible = [_rectangle(px, width) if len(px) else box for px, box in zip(shown, full, strict=True)]
    return Seen2D(
        np.array([i for i, _ in alone], np.int64),
        np.array(full, np.float64).reshape(-1, 4),
        np.array(visible, np.float64).reshape(-1, 4),
        np.array([len(pixels) for _, pixels in alone], np.int64),
        np.array([len(pixels) for pixels in shown], np.int64),
    )


def _rectangle(pixels: Int64, width: int) -> tuple[float, float, float, float]:
    """Left, top, right, bottom of pixels, each a unit square around its centre."""
    u, v = pixels % width, pixels // width
    return float(u.min()) - 0.5, float(v.min()) - 0.5, float(u.max()) + 0.5, float(v.max()) + 0.5
