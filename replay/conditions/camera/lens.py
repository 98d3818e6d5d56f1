"""Glare and dirt on a lens, at the same place all through a log."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import cv2
import numpy as np

from fbench.replay.conditions.camera.image_condition import ImageCondition, for_images, hide
from fbench.replay.contracts.conditions import Level, Site
from fbench.replay.data.arrays import Float32
from fbench.replay.data.images import Pixels
from fbench.replay.data.messages import Image

_WIDTH_PX = 1600  # Of the images that glare is given for
_MUD, _SUN = (52.0, 66.0, 78.0), (235.0, 248.0, 255.0)  # Blue, green, red
_OPAQUE, _SPOTS = 0.92, 14  # Of mud, and how many spots fit side by side into an image


class SunGlare(ImageCondition):
    """The sun in the image: a white disc at u from .25 to .75 of the width and v from .30 to .45 of the height, with
    light around that falls with the square of the angle. It stays over the log; the radius is that in images 1600 px
    wide.

    Levels of Dong et al. (CVPR 2023).
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"radius_px": (30.0, 40.0, 50.0, 60.0, 70.0)}

    @for_images
    def disturb(self, pixels: Pixels, level: Level, image: Image, site: Site) -> Pixels:
        """Add the disc and its halo."""
        height, width = pixels.shape[:2]
        right, down = site.rng_of_place("sun").uniform((0.25, 0.30), (0.75, 0.45))
        u, v = np.arange(width) - right * (width - 1), np.arange(height) - down * (height - 1)
        away = (u * u + (v * v)[:, None]).astype(np.float32)
        radius = max(level["radius_px"] * width / _WIDTH_PX, 1.0)
        layer = np.minimum(np.float32(radius * radius) / np.maximum(away, 1), 1)
        return hide(pixels, layer, _SUN)


class LensDirt(ImageCondition):
    """Mud on the lens: spots over a share of the image that let hardly anything through, soft at their edges. They stay
    over the log.

    Masks as of Yu et al. (2023, lidar-camera-robust-benchmark); shares by eye.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"dirty_share": (0.02, 0.05, 0.10, 0.20, 0.30)}

    @for_images
    def disturb(self, pixels: Pixels, level: Level, image: Image, site: Site) -> Pixels:
        """Cover the spots."""
        height, width = pixels.shape[:2]
        return hide(pixels, dirt(site.rng_of_place("dirt"), (width, height), level["dirty_share"]), _MUD)


def dirt(rng: np.random.Generator, size_wh: tuple[int, int], share: float) -> Float32:
    """Return the opacity (H, W) of spots on this share of the pixels."""
    width, height = size_wh
    noise = np.zeros((height, width), np.float32)
    for octave in range(3):
        across = _SPOTS * 2**octave
        num = (max(2, round(across * height / width)), across)
        values = rng.standard_normal(num, np.float32) * np.float32(0.6**octave)
        noise += np.asarray(cv2.resize(values, size_wh, interpolation=cv2.INTER_CUBIC), np.float32)
    num_clean = min(noise.size - 1, round((1 - share) * noise.size))
    over = noise - np.partition(noise.ravel(), num_clean)[num_clean]
    layer = np.minimum(0.1 + over / np.float32(0.25), 1) * np.float32(_OPAQUE)
    return np.asarray(np.where(over >= 0, layer, 0), np.float32)
