"""Blurred images."""

from collections.abc import Mapping, Sequence
from math import cos, radians, sin
from typing import ClassVar

import cv2
import numpy as np

from fbench.replay.conditions.camera.image_condition import ImageCondition, for_images
from fbench.replay.contracts.conditions import Level, Site
from fbench.replay.data.arrays import Array, Float64
from fbench.replay.data.images import Pixels
from fbench.replay.data.messages import Image


class MotionBlur(ImageCondition):
    """The camera moves while it exposes: half a Gaussian of sigma along a line of 2 r + 1 px, at an angle of up to 45
    degrees that is drawn for every image.

    Formula and levels of Hendrycks and Dietterich (ICLR 2019).
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {
        "radius_px": (10.0, 15.0, 15.0, 15.0, 20.0), "sigma_px": (3.0, 5.0, 8.0, 12.0, 15.0),
    }  # fmt: skip

    @for_images
    def disturb(self, pixels: Pixels, level: Level, image: Image, site: Site) -> Pixels:
        """Blur along the line."""
        angle_deg = site.rng_of(image).uniform(-45, 45)
        return blur_along(pixels, round(level["radius_px"]), level["sigma_px"], angle_deg)


class Defocus(ImageCondition):
    """The lens isn't focused: each point becomes a disc of a radius, softened at its edge.

    Formula and levels of Hendrycks and Dietterich (ICLR 2019).
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {
        "radius_px": (3.0, 4.0, 6.0, 8.0, 10.0), "soft_px": (0.1, 0.5, 0.5, 0.5, 0.5),
    }  # fmt: skip

    @for_images
    def disturb(self, pixels: Pixels, level: Level, image: Image, site: Site) -> Pixels:
        """Blur all around."""
        return filter_image(pixels, disc(level["radius_px"], level["soft_px"]))


def blur_along(pixels: Pixels, radius: int, sigma: float, angle_deg: float) -> Pixels:
    """Blur (H, W) or (H, W, 3) along a line of 2 `radius` + 1 px that begins at each pixel; 90 degrees is down."""
    side = 2 * radius
    line = np.zeros((2 * side + 1, 2 * side + 1))
    away = np.arange(side + 1)
    weights = np.exp(-0.5 * (away / max(sigma, 1e-9)) ** 2)
    rows = side + np.rint(away * sin(radians(angle_deg))).astype(np.int64)
    columns = side + np.rint(away * cos(radians(angle_deg))).astype(np.int64)
    np.add.at(line, (rows, columns), weights / weights.sum())
    return filter_image(pixels, line)


def disc(radius: float, soft: float) -> Float64:
    """Return a disc of a radius [px] whose sum is 1, blurred by a Gaussian of `soft` px."""
    side = int(np.ceil(radius)) + 2
    across = np.arange(-side, side + 1)
    flat = (across**2 + across[:, None] ** 2 <= radius * radius).astype(np.float64)
    return np.asarray(cv2.GaussianBlur(flat / flat.sum(), (5, 5), soft, borderType=cv2.BORDER_CONSTANT), np.float64)


def filter_image(pixels: Pixels, weights: Float64) -> Pixels:
    """Replace each pixel by the sum of those around it with weights (odd, odd); the border goes on outside."""
    blurred: Array = cv2.filter2D(pixels, -1, weights.astype(np.float32), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(blurred, np.uint8)
