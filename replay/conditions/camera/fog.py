"""Fog in images: by the distance of what is seen, and without."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import cv2
import numpy as np

from fbench.replay.conditions.camera.depth import FAR_M, distances, gray_cells
from fbench.replay.conditions.camera.image_condition import ImageCondition, for_images
from fbench.replay.conditions.camera.kernels import veil
from fbench.replay.contracts.conditions import Level, Site
from fbench.replay.data.arrays import Array, Float32
from fbench.replay.data.images import Pixels
from fbench.replay.data.messages import Image

AIRLIGHT = 0.8
"""Brightness of endless fog by day, as a share of white, of all cameras and all the time; low light dims it later."""
_QUANTILES, _STEPS = 65, 1024  # By which the distribution of noise is made even
_RADIUS, _EVEN = 5, 1e-3 * 255**2  # Of the guided filter: cells around, and the variance of gray that isn't an edge


def attenuate(pixels: Pixels, extinction_per_m: float, site: Site) -> Pixels:
    """Return what is left of the image through air: I t + L (1 - t), t = exp(-extinction * distance), on values as they
    are stored (Koschmieder 1924; Sakaridis et al. 2018, Foggy Cityscapes, with their L and guided filter).
    """
    size = pixels.shape[1::-1]
    gray = gray_cells(pixels)
    transmission = np.exp(-np.float32(extinction_per_m) * distances(gray, size, site))
    slope, offset = (cv2.resize(cells, size).ravel() for cells in _guide(transmission, gray))
    least = float(np.exp(-extinction_per_m * FAR_M))
    return veil(pixels.reshape(-1), slope, offset, least, 255 * AIRLIGHT).reshape(pixels.shape)


def _guide(values: Float32, gray: Float32) -> tuple[Float32, Float32]:
    """Slope and offset (h, w) by which values follow the edges of an image: the guided filter of He et al. (2013)."""

    def mean(cells: Array) -> Float32:
        size = (2 * _RADIUS + 1, 2 * _RADIUS + 1)
        return np.asarray(cv2.blur(cells, size, borderType=cv2.BORDER_REPLICATE), np.float32)

    of_gray, of_values = mean(gray), mean(values)
    variance = mean(gray * gray) - of_gray * of_gray
    slope = (mean(gray * values) - of_gray * of_values) / (variance + np.float32(_EVEN))
    return mean(slope), mean(of_values - slope * of_gray)


class FogWithoutDepth(ImageCondition):
    """Swaths of fog that know nothing of distance: (I + c P) m / (m + c), m the largest I, P a plasma fractal evenly
    distributed from 0 to 1, whose octaves weaken by a factor. It stays over the log.

    Formula of Hendrycks and Dietterich (ICLR 2019), and their levels, but that severity 4 has no more fog than 3 with
    them: 2.5. Their fractal of midpoints is here a sum of smooth octaves, with as much fog at every decay.
    """

    version: ClassVar[int] = 2
    levels: ClassVar[Mapping[str, Sequence[float]]] = {
        "density": (1.5, 2.0, 2.5, 2.75, 3.0), "decay": (2.0, 2.0, 1.7, 1.5, 1.4),
    }  # fmt: skip

    @for_images
    def disturb(self, pixels: Pixels, level: Level, image: Image, site: Site) -> Pixels:
        """Add the fractal."""
        height, width = pixels.shape[:2]
        added = level["density"] * plasma(site.rng_of_place("plasma"), (width, height), level["decay"])[..., None]
        most = int(pixels.max()) / 255
        if most == 0:
            return pixels.copy()
        return np.asarray((pixels + 255 * added) * np.float32(most / (most + level["density"])) + 0.5, np.uint8)


def plasma(rng: np.random.Generator, size_wh: tuple[int, int], decay: float, octaves: int = 7) -> Float32:
    """Return smooth noise (H, W), evenly distributed from 0 to 1: octaves, each twice as fine and weaker."""
    width, height = size_wh
    total = np.zeros((height, width), np.float32)
    for octave in range(octaves):
        num = 2**octave + 1
        values = rng.uniform(-1, 1, (num, num)).astype(np.float32)
        total += cv2.resize(values, size_wh, interpolation=cv2.INTER_CUBIC) * np.float32(decay**-octave)
    sample = total[:: max(1, height // 100), :: max(1, width // 100)]
    known = np.quantile(sample, np.linspace(0, 1, _QUANTILES))
    low, high = float(known[0]), float(known[-1])
    if high <= low:
        return np.full_like(total, 0.5)
    table = np.interp(np.linspace(low, high, _STEPS), known, np.linspace(0, 1, _QUANTILES)).astype(np.float32)
    step = np.clip((total - low) * ((_STEPS - 1) / (high - low)), 0, _STEPS - 1).astype(np.int32)
    return np.asarray(table[step], np.float32)
