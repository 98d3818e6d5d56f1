"""Noise of pixels: every value is exchanged for another by a table of its distribution, which takes no time to speak of
however complicated that is.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from math import ceil, sqrt
from typing import ClassVar

import numpy as np
from scipy.special import gammaln, ndtr, xlogy

from fbench.replay.conditions.camera.image_condition import ImageCondition, for_images
from fbench.replay.conditions.camera.kernels import exchange, is_gray
from fbench.replay.contracts.conditions import Level, Site
from fbench.replay.data.arrays import Array, Float64
from fbench.replay.data.images import Pixels
from fbench.replay.data.messages import Image

_DRAWS = 4096  # Equally likely results a value
_MANY = 200.0  # From so many photons on their number is taken for normal
_EDGES = (np.arange(255) + 0.5) / 255  # Between the values that an image can have, as shares of white
_VALUES = np.arange(256) / 255


class GaussianNoise(ImageCondition):
    """Noise of an amplifier: I + N(0, sigma), for I from 0 to 1.

    Formula and levels of Hendrycks and Dietterich (ICLR 2019) as Michaelis et al. (2019) give them.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"sigma_share": (0.08, 0.12, 0.18, 0.26, 0.38)}

    @for_images
    def disturb(self, pixels: Pixels, level: Level, image: Image, site: Site) -> Pixels:
        """Add noise to every value."""
        return add_noise(pixels, _gaussian(level["sigma_share"]), site.rng_of(image))


class ShotNoise(ImageCondition):
    """Noise of light itself, of which only so many photons make white: Poisson(I n) / n.

    Formula and levels of Hendrycks and Dietterich (ICLR 2019).
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"photons": (60.0, 25.0, 12.0, 5.0, 3.0)}

    @for_images
    def disturb(self, pixels: Pixels, level: Level, image: Image, site: Site) -> Pixels:
        """Draw every value anew."""
        return add_noise(pixels, sensor_table(tuple(_VALUES.tolist()), level["photons"], 0.0), site.rng_of(image))


class ImpulseNoise(ImageCondition):
    """Salt and pepper: a share of values is black or white, as likely each.

    Formula and levels of Hendrycks and Dietterich (ICLR 2019).
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"impulse_share": (0.03, 0.06, 0.09, 0.17, 0.27)}

    @for_images
    def disturb(self, pixels: Pixels, level: Level, image: Image, site: Site) -> Pixels:
        """Replace some values."""
        return add_noise(pixels, _impulse(level["impulse_share"]), site.rng_of(image))


class UniformNoise(ImageCondition):
    """Noise evenly distributed from -c to c, for I from 0 to 1.

    Levels of Dong et al. (CVPR 2023).
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"width_share": (0.08, 0.12, 0.18, 0.26, 0.38)}

    @for_images
    def disturb(self, pixels: Pixels, level: Level, image: Image, site: Site) -> Pixels:
        """Add noise to every value."""
        return add_noise(pixels, _uniform(level["width_share"]), site.rng_of(image))


def add_noise(pixels: Pixels, table: Array, rng: np.random.Generator) -> Pixels:
    """Return an image whose values (H, W, 3) are drawn from their rows of a table (256, 4096); one without color gets
    noise without color.
    """
    one = is_gray(pixels.reshape(-1))
    values = np.ascontiguousarray(pixels[..., 0] if one else pixels)
    raw = rng.bit_generator.random_raw(-(-values.size // 4))
    drawn = exchange(values.reshape(-1), table, raw.view(np.uint16)[: values.size]).reshape(values.shape)
    return np.repeat(drawn[..., None], 3, axis=2) if one else drawn


def make_table(below: Float64) -> Array:
    """Return equally likely results (256, 4096) uint8 of values 0 to 255, from the probability `below` (256, 255) that
    a result lies below 1, 2 ... 255.
    """
    # Rounded, so that the last digits of another CPU's exponentials don't show.
    place = np.clip(np.ceil(np.round(below * _DRAWS - 0.5, 6)), 0, _DRAWS).astype(np.int64)
    each = np.bincount((place + np.arange(256)[:, None] * (_DRAWS + 1)).ravel(), minlength=256 * (_DRAWS + 1))
    table = each.reshape(256, -1)[:, :_DRAWS].cumsum(axis=1).astype(np.uint8)
    table.setflags(write=False)
    return table


@lru_cache(maxsize=16)
def sensor_table(light: tuple[float, ...], photons: float, sigma: float) -> Array:
    """Return the table of a sensor: value v becomes Poisson(light[v] photons) / photons + N(0, sigma), for light (256,)
    from 0 to 1. Many photons are taken for normally distributed.
    """
    mean = np.array(light)
    counts = mean * photons
    few = counts < _MANY
    below = ndtr((_EDGES - mean[:, None]) / np.maximum(np.sqrt(mean / photons + sigma * sigma), 1e-9)[:, None])
    if few.any():
        most = float(counts[few].max())
        num = np.arange(ceil(most + 10 * sqrt(most) + 10))
        chance = np.exp(xlogy(num, counts[few, None]) - counts[few, None] - gammaln(num + 1))
        off = _EDGES - num[:, None] / photons
        step = ndtr(off / sigma) if sigma > 0 else (off > 0).astype(np.float64)
        below[few] = np.einsum("vk,ke->ve", chance, step)
    return make_table(below)


@lru_cache(maxsize=8)
def _gaussian(sigma: float) -> Array:
    return make_table(ndtr((_EDGES - _VALUES[:, None]) / max(sigma, 1e-9)))


@lru_cache(maxsize=8)
def _uniform(width: float) -> Array:
    below = (_EDGES - _VALUES[:, None] + width) / max(2 * width, 1e-9)
    return make_table(np.asarray(np.clip(below, 0, 1), np.float64))


@lru_cache(maxsize=8)
def _impulse(share: float) -> Array:
    return make_table(np.where(_VALUES[:, None] < _EDGES, 1 - share / 2, share / 2))
