"""Too little light and too much."""

from collections.abc import Mapping, Sequence
from math import log
from typing import ClassVar

import numpy as np

from fbench.replay.conditions.camera.image_condition import ImageCondition, for_images
from fbench.replay.conditions.camera.kernels import brighten
from fbench.replay.conditions.camera.noise import add_noise, sensor_table
from fbench.replay.contracts.conditions import Level, Site
from fbench.replay.data.images import Pixels
from fbench.replay.data.messages import Image

_LUX = (100.0, 30.0, 10.0, 3.0, 0.3)  # Of the five nights that have the levels of `LowLight`
_ENOUGH_LUX = 1_000.0  # From here on a camera needs no more gain than by day: half an hour before sunset
_WHITE = (0.60, 0.50, 0.40, 0.30, 0.20)
_PHOTONS = (600.0, 250.0, 120.0, 50.0, 30.0)
_READ_NOISE = (0.008, 0.012, 0.018, 0.026, 0.038)


class LowLight(ImageCondition):
    """Little light: I1 = c ((I - min) / (max - min))^2, then Poisson(I1 n) / n + N(0, sigma), for I from 0 to 1: n
    photons make white.

    Formula and levels of RoboBEV (Xie et al. 2023), where each level is one too strong.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {
        "white_share": _WHITE, "photons": _PHOTONS, "sigma_share": _READ_NOISE,
    }  # fmt: skip

    @for_images
    def disturb(self, pixels: Pixels, level: Level, image: Image, site: Site) -> Pixels:
        """Darken, and add noise."""
        return dim(pixels, level["white_share"], level["photons"], level["sigma_share"], site.rng_of(image))


class Overexposure(ImageCondition):
    """Too much light: V of HSV + c, for V from 0 to 1.

    Formula and levels of Hendrycks and Dietterich (ICLR 2019).
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"added_share": (0.1, 0.2, 0.3, 0.4, 0.5)}

    @for_images
    def disturb(self, pixels: Pixels, level: Level, image: Image, site: Site) -> Pixels:
        """Brighten."""
        return brighten(pixels.reshape(-1), round(255 * level["added_share"])).reshape(pixels.shape)


def dim(
    pixels: Pixels, white: float, photons: float, sigma: float, rng: np.random.Generator, strength: float = 1.0
) -> Pixels:
    """Return the image in little light as `LowLight` has it; with a strength below 1 a mixture with the image as it is,
    and noise of that share of the variance.
    """
    low, high = int(pixels.min()) / 255, int(pixels.max()) / 255
    value = np.arange(256) / 255
    stretched = np.clip((value - low) / (high - low), 0, 1) if high > low else value
    light = np.round((1 - strength) * value + strength * white * stretched * stretched, 9)
    return add_noise(pixels, sensor_table(tuple(light.tolist()), photons / strength, sigma * strength**0.5), rng)


def dim_by_lux(pixels: Pixels, lux: float, rng: np.random.Generator) -> Pixels:
    """Return the image under an illuminance [lx]: the levels of `LowLight` are nights of 100, 30, 10, 3 and 0.3 lx,
    between which their numbers are interpolated in the logarithm; 1,000 lx and more change nothing.
    """
    if lux >= _ENOUGH_LUX:
        return pixels
    at, known = log(max(lux, _LUX[-1])), np.log(_LUX[::-1])
    white, photons, sigma = (
        float(np.exp(np.interp(at, known, np.log(values[::-1])))) for values in (_WHITE, _PHOTONS, _READ_NOISE)
    )
    strength = min(1.0, log(_ENOUGH_LUX / max(lux, _LUX[-1])) / log(_ENOUGH_LUX / _LUX[0]))
    return dim(pixels, white, photons, sigma, rng, strength)
