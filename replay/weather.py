"""One physical weather and the equations by which every sensor obeys it."""

from dataclasses import dataclass

CLEAR_MOR_M = 20_000.0
"""Visibility of clear air [m]: 20 km, where haze is no longer spoken of (WMO)."""


@dataclass(frozen=True)
class Weather:
    """The state of the air and of the light, the same everywhere.

    Raises:
        ConfigError: where a number is out of range.
    """

    visibility_m: float = CLEAR_MOR_M
    """Meteorological optical range in fog and haze [m], at which contrast falls to 5 %; rain comes on top."""
    rain_mm_h: float = 0.0
    """Rain rate [mm/h]."""
    lux: float = 50_000.0
    """Illuminance of a horizontal plane outdoors [lx]: 50,000 a clear day, 400 sunrise, 0.3 full moon."""
    sun_elevation_deg: float = 45.0
    """Above the horizon; the sun has set where it is negative."""
    sun_azimuth_deg: float = 60.0
    """From the world's x axis towards y."""
