"""One physical weather and the equations by which every sensor obeys it."""

from dataclasses import dataclass, fields

import numpy as np

from fbench.replay.conditions.attenuation import (
    fog_db_per_km,
    koschmieder_per_m,
    radar_rain_db_per_km,
    rain_extinction_per_m,
    through_air,
    transmit,
)
from fbench.replay.conditions.lidar import FogReturn, fog_return
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Array

__all__ = [
    "CLEAR_MOR_M", "Weather", "extinction_per_m", "fog_extinction_per_m", "fog_of", "radar_loss_db",
    "radar_rain_db_per_km", "rain_extinction_per_m", "through_air", "transmission",
]  # fmt: skip

CLEAR_MOR_M = 20_000.0
"""Visibility of clear air [m]: 20 km, where haze is no longer spoken of (WMO)."""
_LIMITS = {
    "visibility_m": (10.0, 100_000.0),
    "rain_mm_h": (0.0, 300.0),
    "lux": (0.0, 150_000.0),
    "sun_elevation_deg": (-90.0, 90.0),
    "sun_azimuth_deg": (-360.0, 360.0),
}


@dataclass(frozen=True)
class Weather:
    """The state of the air and of the light, the same everywhere. Raises ConfigError where a number is out of range."""

    visibility_m: float = CLEAR_MOR_M
    """Meteorological optical range in fog and haze [m], at which contrast falls to 5 %; rain comes on top. 10 to
    100,000; clear 20,000, mist 2,000, fog below 1,000 (WMO), dense fog 50 to 200."""
    rain_mm_h: float = 0.0
    """Rain rate [mm/h], 0 to 300; light below 2.5, heavy from 10, violent from 50 (AMS, WMO)."""
    lux: float = 50_000.0
    """Illuminance of a horizontal plane outdoors [lx], 0 to 150,000: 100,000 in full sun, 50,000 a clear day, 10,000
    overcast, 400 sunrise, 10 a lit street by night, 0.3 full moon."""
    sun_elevation_deg: float = 45.0
    """Above the horizon, -90 to 90; the sun has set where it is negative, and it is night below -18."""
    sun_azimuth_deg: float = 60.0
    """From the world's x axis towards y, -360 to 360."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value, (low, high) = getattr(self, field.name), _LIMITS[field.name]
            if not low <= value <= high:  # also where it isn't a number
                raise ConfigError(f"Weather.{field.name}: expected {low:g} to {high:g}, got {value!r}")
            object.__setattr__(self, field.name, float(value))  # 5 and 5.0 are written down alike


def fog_extinction_per_m(weather: Weather) -> float:
    """Return the extinction [1/m] of fog and haze; never 0, in clear air that of 20 km: 1.5e-4."""
    return koschmieder_per_m(weather.visibility_m)


def extinction_per_m(weather: Weather) -> float:
    """Return the extinction [1/m] of visible light and near infrared by fog and rain together (Beer-Lambert)."""
    return fog_extinction_per_m(weather) + rain_extinction_per_m(weather.rain_mm_h)


def transmission(weather: Weather, distance_m: Array) -> Array:
    """Return the share of light that arrives over distances [m] of any shape, one way."""
    return transmit(extinction_per_m(weather), distance_m)


def fog_of(weather: Weather) -> FogReturn:
    """Return how fog answers a LiDAR; rain weakens both echoes."""
    return fog_return(extinction_per_m(weather), weather.visibility_m)


def radar_loss_db(weather: Weather, range_m: Array, frequency_ghz: float = 77.0) -> Array:
    """Return what rain and fog take from radar echoes at `range_m` (N,) [m], there and back [dB]. Raises ConfigError
    where the frequency is none of car radars, 24 to 81 GHz.
    """
    rain = radar_rain_db_per_km(weather.rain_mm_h, frequency_ghz)
    per_km = rain + fog_db_per_km(fog_extinction_per_m(weather), frequency_ghz)
    loss: Array = np.asarray(range_m) * (2 * per_km / 1000)
    return loss
