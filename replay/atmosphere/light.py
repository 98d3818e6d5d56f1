"""Light through fog and rain: extinction, transmission and airlight."""

from math import log

import numpy as np

from fbench.replay.arrays import Array


def koschmieder_per_m(visibility_m: float) -> float:
    """Return the extinction [1/m] of air with a meteorological optical range: ln 20 / MOR.

    The contrast of a dark object falls to 5 % there (Koschmieder 1924; WMO-No. 8, chapter 9).
    """
    return log(20) / visibility_m


def rain_extinction_per_m(rain_mm_h: float) -> float:
    """Return the extinction [1/m] of rain: 3.65e-4 R^0.63, for visible light and near infrared alike.

    The geometric cross-sections of Marshall and Palmer's drops (1948), each counted twice, since drops are large
    against the wavelength; within 10 % of Ulbrich and Atlas (1985), 1.45 R^0.64 dB/km.
    """
    return float(3.65e-4 * rain_mm_h**0.63)


def transmitted(extinction_per_m: float, distance_m: Array) -> Array:
    """Return the share of light that arrives over distances [m] of any shape: exp(-extinction * distance)."""
    share: Array = np.exp(-extinction_per_m * distance_m)
    return share


def through_air(light: Array, share: Array, airlight: Array) -> Array:
    """Return what is seen through air: I' = I t + L (1 - t) (Koschmieder).

    Args:
        light: (..., 3) linear light that leaves the surfaces.
        share: (...) t, what of it arrives, see `transmitted`.
        airlight: (3,) L, the light of fog of endless depth, in the unit of `light`.
    """
    t = share[..., None]
    mixed: Array = light * t + airlight * (1 - t)
    return mixed
