"""How an image is fitted into the input of a model."""

from dataclasses import dataclass

import cv2
import numpy as np

from fbench.pipelines.camera.candidates import Candidates
from fbench.replay.images import Pixels

PAD_VALUE = 114
"""Grey of the border, as YOLO models are trained."""


@dataclass(frozen=True)
class Placement:
    """Where an image lies in the input: input = scale * image + offset, in pixels from the upper left corner."""

    scale: tuple[float, float]
    offset: tuple[float, float]

    def back(self, boxes: Candidates) -> Candidates:
        """Move boxes from the input to the image."""
        (sx, sy), (x, y) = self.scale, self.offset
        return boxes.moved((1 / sx, 1 / sy), (-x / sx, -y / sy))


def squash(size_wh: tuple[int, int], input_wh: tuple[int, int]) -> Placement:
    """Fill the whole input and let the aspect ratio go."""
    return Placement((input_wh[0] / size_wh[0], input_wh[1] / size_wh[1]), (0.0, 0.0))


def letterbox(size_wh: tuple[int, int], input_wh: tuple[int, int], *, centred: bool) -> Placement:
    """Keep the aspect ratio (to a rounded pixel); the border is on both sides or at right and bottom."""
    ratio = min(input_wh[0] / size_wh[0], input_wh[1] / size_wh[1])
    inner = [max(1, round(size * ratio)) for size in size_wh]
    space = [outer - size for outer, size in zip(input_wh, inner, strict=True)]
    x, y = (float(s // 2) if centred else 0.0 for s in space)
    return Placement((inner[0] / size_wh[0], inner[1] / size_wh[1]), (x, y))


def place(pixels: Pixels, placement: Placement, input_wh: tuple[int, int]) -> Pixels:
    """Scale `pixels` (H, W, 3) and paste them into an input-sized image with a grey border."""
    height, width = pixels.shape[:2]
    inner = (round(width * placement.scale[0]), round(height * placement.scale[1]))
    shrinks = inner[0] < width or inner[1] < height
    scaled = cv2.resize(pixels, inner, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    if inner == input_wh:
        return np.asarray(scaled, np.uint8)
    canvas = np.full((input_wh[1], input_wh[0], 3), PAD_VALUE, np.uint8)
    x, y = int(placement.offset[0]), int(placement.offset[1])
    canvas[y : y + inner[1], x : x + inner[0]] = scaled
    return canvas


def planes(images: list[Pixels], *, rgb: bool, unit: bool) -> np.ndarray:
    """Stack images (H, W, 3) BGR to (B, 3, H, W) float32, as RGB if asked, scaled to 0..1 if asked."""
    height, width = images[0].shape[:2]
    values = np.empty((len(images), 3, height, width), np.float32)
    factor = np.float32(1 / 255 if unit else 1)
    for image, own in zip(images, values, strict=True):
        channels = cv2.split(image)
        for channel, plane in zip(channels[::-1] if rgb else channels, own, strict=True):
            np.multiply(channel, factor, out=plane)
    return values
