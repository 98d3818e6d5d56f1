"""One physical weather, and the equations by which every sensor obeys it: attenuation of light and radar waves."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from math import log

import numpy as np

from fbench.replay.conditions.lidar.echoes import FogReturn, Particles, fog_return, rain_drops, snow_flakes
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Array

CLEAR_MOR_M = 20_000.0  # Visibility of clear air [m]: 20 km, where haze is no longer spoken of (WMO)
_LIMITS = {
    "visibility_m": (10.0, 100_000.0),
    "rain_mm_h": (0.0, 300.0),
    "snow_mm_h": (0.0, 300.0),
    "water_mm": (0.0, 100.0),
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
    snow_mm_h: float = field(default=0.0, repr=False)  # Left out of the text that ids of simulated logs are made of
    """Snowfall as the rate of rain of equal water [mm/h], 0 to 300; light below 2.5."""
    water_mm: float = field(default=0.0, repr=False)
    """Depth of the water on the ground [mm], 0 to 100; a wet road has 0.2 to 1.2."""
    lux: float = 50_000.0
    """Illuminance of a horizontal plane outdoors [lx], 0 to 150,000: 100,000 in full sun, 50,000 a clear day, 10,000
    overcast, 400 sunrise, 10 a lit street by night, 0.3 full moon."""
    sun_elevation_deg: float = 45.0
    """Above the horizon, -90 to 90; the sun has set where it is negative, and it is night below -18."""
    sun_azimuth_deg: float = 60.0
    """From the world's x axis towards y, -360 to 360."""

    def __post_init__(self) -> None:
        for name in (f.name for f in fields(self)):
            value, (low, high) = getattr(self, name), _LIMITS[name]
            if not low <= value <= high:  # also where it isn't a number
                raise ConfigError(f"Weather.{name}: expected {low:g} to {high:g}, got {value!r}")
            object.__setattr__(self, name, float(value))  # 5 and 5.0 are written down alike


def combine(weathers: Sequence[Weather]) -> Weather:
    """Return the mixture of several weathers: the shortest visibility, the most rain, snow and water, the least light
    and the lowest sun.
    """
    lowest = min(weathers, key=lambda weather: weather.sun_elevation_deg)
    return replace(
        lowest,
        visibility_m=min(w.visibility_m for w in weathers),
        rain_mm_h=max(w.rain_mm_h for w in weathers),
        snow_mm_h=max(w.snow_mm_h for w in weathers),
        water_mm=max(w.water_mm for w in weathers),
        lux=min(w.lux for w in weathers),
    )


def koschmieder_per_m(visibility_m: float) -> float:
    """Return the extinction [1/m] of air with a meteorological optical range: ln 20 / MOR. The contrast of a dark
    object falls to 5 % there (Koschmieder 1924; WMO-No. 8, chapter 9).
    """
    return log(20) / visibility_m


def rain_extinction_per_m(rain_mm_h: float) -> float:
    """Return the extinction [1/m] of rain: 3.65e-4 R^0.63, for visible light and near infrared alike. The geometric
    cross-sections of Marshall and Palmer's drops (1948), each counted twice, since drops are large against the
    wavelength; within 10 % of Ulbrich and Atlas (1985), 1.45 R^0.64 dB/km.
    """
    return float(3.65e-4 * rain_mm_h**0.63)


def fog_extinction_per_m(weather: Weather) -> float:
    """Return the extinction [1/m] of fog and haze; never 0, in clear air that of 20 km: 1.5e-4."""
    return koschmieder_per_m(weather.visibility_m)


def snow_extinction_per_m(snow_mm_h: float) -> float:
    """Return the extinction [1/m] of snow: 1.44e-3 S^0.57, the geometric cross-sections of Gunn and Marshall's flakes
    (1958), each counted twice.
    """
    return snow_flakes(snow_mm_h).extinction_per_m if snow_mm_h > 0 else 0.0


def extinction_per_m(weather: Weather) -> float:
    """Return the extinction [1/m] of visible light and near infrared by fog, rain and snow together (Beer-Lambert)."""
    fallen = rain_extinction_per_m(weather.rain_mm_h) + snow_extinction_per_m(weather.snow_mm_h)
    return fog_extinction_per_m(weather) + fallen


def particles_of(weather: Weather) -> tuple[Particles, ...]:
    """Return the drops and flakes that beams of light meet."""
    rates = ((weather.rain_mm_h, rain_drops), (weather.snow_mm_h, snow_flakes))
    return tuple(kind(rate) for rate, kind in rates if rate > 0)


def transmission(weather: Weather, distance_m: Array) -> Array:
    """Return the share of light that arrives over distances [m] of any shape: exp(-extinction * distance)."""
    return np.asarray(np.exp(-extinction_per_m(weather) * distance_m))


def fog_of(weather: Weather) -> FogReturn:
    """Return how fog answers a LiDAR; rain weakens both echoes."""
    return fog_return(extinction_per_m(weather), weather.visibility_m)


def radar_loss_db(weather: Weather, range_m: Array, frequency_ghz: float = 77.0) -> Array:
    """Return what rain, snow and fog take from radar echoes at `range_m` (N,) [m], there and back [dB]. Snow takes a
    quarter of what rain of equal water does, which is chosen: dry snow takes hardly anything, wet snow as much as rain.
    Raises ConfigError where the frequency is none of car radars, 24 to 81 GHz.
    """
    rain = radar_rain_db_per_km(weather.rain_mm_h, frequency_ghz)
    snow = _SNOW_SHARE * radar_rain_db_per_km(weather.snow_mm_h, frequency_ghz)
    per_km = rain + snow + fog_db_per_km(fog_extinction_per_m(weather), frequency_ghz)
    return np.asarray(range_m) * (2 * per_km / 1000)


_GHZ = (24.0, 60.0, 76.0, 76.5, 77.0, 79.0, 81.0)
_K = (0.1404, 0.8515, 1.1139, 1.1208, 1.1276, 1.1541, 1.1793)
_A = (0.9561, 0.7486, 0.7091, 0.7082, 0.7073, 0.7038, 0.7004)
_SNOW_SHARE = 0.25
_LIQUID_77 = 3.15  # Attenuation of fog at 77 GHz and 10 C [dB/km per g/m^3] (ITU-R P.840)


def radar_rain_db_per_km(rain_mm_h: float, frequency_ghz: float = 77.0) -> float:
    """Return how rain weakens vertically polarised waves, one way: k R^a (ITU-R P.838-3). Between the recommendation's
    frequencies k is interpolated in the logarithms of both, a in that of the frequency. Raises ConfigError where the
    frequency isn't within 24 to 81 GHz.
    """
    at, known = _log_frequency(frequency_ghz), np.log(_GHZ)
    k = np.exp(np.interp(at, known, np.log(_K)))
    return float(k * rain_mm_h ** np.interp(at, known, _A))


def liquid_water_g_m3(extinction_per_m: float) -> float:
    """Return the water in fog of an extinction of light: 144.7 W^0.88 per km (Kunkel 1984)."""
    return float((extinction_per_m * 1000 / 144.7) ** (1 / 0.88))


def fog_db_per_km(extinction_per_m: float, frequency_ghz: float = 77.0) -> float:
    """Return how fog of an extinction of light weakens radar waves, one way, at 10 C (ITU-R P.840). Droplets are small
    against the wavelength: the attenuation follows the water alone. Away from 77 GHz it is scaled by f^1.75, the slope
    of the recommendation's curve between 24 and 81 GHz within some 10 %.
    """
    _log_frequency(frequency_ghz)
    return float(_LIQUID_77 * (frequency_ghz / 77.0) ** 1.75 * liquid_water_g_m3(extinction_per_m))


def _log_frequency(frequency_ghz: float) -> float:
    if not _GHZ[0] <= frequency_ghz <= _GHZ[-1]:
        raise ConfigError(f"frequency_ghz: expected {_GHZ[0]:g} to {_GHZ[-1]:g}, as of car radars, got {frequency_ghz}")
    return log(frequency_ghz)
