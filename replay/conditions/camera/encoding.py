"""Losses of compressed images: JPEG blocks, lower resolution, fewer gray levels."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import cv2
import numpy as np

from fbench.replay.conditions.camera.image_condition import ImageCondition, for_images
from fbench.replay.contracts.conditions import Level, Site
from fbench.replay.data.images import Pixels, encode_jpeg
from fbench.replay.data.messages import Image


class JpegArtifacts(ImageCondition):
    """Encoded as JPEG of a low quality.

    Levels of Hendrycks and Dietterich (ICLR 2019).
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"quality": (25.0, 18.0, 15.0, 10.0, 7.0)}

    @for_images
    def disturb(self, pixels: Pixels, level: Level, image: Image, site: Site) -> Pixels:
        """Encode and decode."""
        data = np.frombuffer(encode_jpeg(pixels, round(level["quality"])), np.uint8)
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


class Pixelation(ImageCondition):
    """Scaled down by means over areas, and up again in squares.

    Levels of Hendrycks and Dietterich (ICLR 2019).
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"scale_share": (0.6, 0.5, 0.4, 0.3, 0.25)}

    @for_images
    def disturb(self, pixels: Pixels, level: Level, image: Image, site: Site) -> Pixels:
        """Scale down and up."""
        height, width = pixels.shape[:2]
        size = (max(1, int(width * level["scale_share"])), max(1, int(height * level["scale_share"])))
        small = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_NEAREST_EXACT), np.uint8)


class Quantization(ImageCondition):
    """Of each value only some bits are left: the nearest of 2^bits values from black to white.

    RoboBEV (Xie et al. 2023) has 5 - s bits, none at all at severity 5.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"bits": (5.0, 4.0, 3.0, 2.0, 1.0)}

    @for_images
    def disturb(self, pixels: Pixels, level: Level, image: Image, site: Site) -> Pixels:
        """Round."""
        most = 2 ** round(level["bits"]) - 1
        step = (np.arange(256) * 2 * most + 255) // 510
        return np.asarray(cv2.LUT(pixels, ((step * 510 + most) // (2 * most)).astype(np.uint8)), np.uint8)
