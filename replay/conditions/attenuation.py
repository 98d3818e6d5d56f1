"""Attenuation of light and radar waves by fog and rain."""

from math import log

import numpy as np

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Array


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


def transmit(extinction_per_m: float, distance_m: Array) -> Array:
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


_GHZ = (24.0, 60.0, 76.0, 76.5, 77.0, 79.0, 81.0)
_K = (0.1404, 0.8515, 1.1139, 1.1208, 1.1276, 1.1541, 1.1793)
_A = (0.9561, 0.7486, 0.7091, 0.7082, 0.7073, 0.7038, 0.7004)
_LIQUID_77 = 3.15
"""Attenuation of fog at 77 GHz and 10 C [dB/km per g/m^3] (ITU-R P.840)."""


def radar_rain_db_per_km(rain_mm_h: float, frequency_ghz: float = 77.0) -> float:
    """Return how rain weakens vertically polarised waves, one way: k R^a (ITU-R P.838-3).

    Between the recommendation's frequencies k is interpolated in the logarithms of both, a in that of the frequency.
    Raises ConfigError where the frequency isn't within 24 to 81 GHz.
    """
    at, known = _log_frequency(frequency_ghz), np.log(_GHZ)
    k = np.exp(np.interp(at, known, np.log(_K)))
    return float(k * rain_mm_h ** np.interp(at, known, _A))


def liquid_water_g_m3(extinction_per_m: float) -> float:
    """Return the water in fog of an extinction of light: 144.7 W^0.88 per km (Kunkel 1984)."""
    return float((extinction_per_m * 1000 / 144.7) ** (1 / 0.88))


def fog_db_per_km(extinction_per_m: float, frequency_ghz: float = 77.0) -> float:
    """Return how fog of an extinction of light weakens radar waves, one way, at 10 C (ITU-R P.840).

    Droplets are small against the wavelength: the attenuation follows the water alone. Away from 77 GHz it is scaled
    by f^1.75, the slope of the recommendation's curve between 24 and 81 GHz within some 10 %.
    """
    _log_frequency(frequency_ghz)
    return float(_LIQUID_77 * (frequency_ghz / 77.0) ** 1.75 * liquid_water_g_m3(extinction_per_m))


def _log_frequency(frequency_ghz: float) -> float:
    if not _GHZ[0] <= frequency_ghz <= _GHZ[-1]:
        raise ConfigError(f"frequency_ghz: expected {_GHZ[0]:g} to {_GHZ[-1]:g}, as of car radars, got {frequency_ghz}")
    return log(frequency_ghz)
