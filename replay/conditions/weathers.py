"""Weathers as conditions: one state of the air and the light, which every sensor of the rig obeys."""

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

from fbench.replay.conditions.camera.weather import disturb_image
from fbench.replay.conditions.lidar.weather import disturb_cloud
from fbench.replay.conditions.radar.weather import disturb_scan
from fbench.replay.conditions.weather import Weather
from fbench.replay.contracts.conditions import Level, MakesWeather, Measurement, Site
from fbench.replay.data.messages import Image, PointCloud
from fbench.replay.data.rig import Kind

WEATHER_OF: Mapping[Kind, Callable[..., Measurement]] = {
    "camera": disturb_image, "lidar": disturb_cloud, "radar": disturb_scan,
}  # fmt: skip
"""What weather does to a message of each kind of sensor."""


def disturb_by_weather(message: Measurement, weather: Weather, site: Site) -> Measurement:
    """Return what a sensor measures in a weather, where a clear day was recorded."""
    if isinstance(message, Image):
        return disturb_image(message, weather, site)
    if isinstance(message, PointCloud):
        return disturb_cloud(message, weather, site)
    return disturb_scan(message, weather, site)


class _AllSensors:
    version: ClassVar[int] = 1
    kinds: ClassVar[Sequence[Kind]] = ("camera", "lidar", "radar")

    def disturb(self: MakesWeather, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Return the message in this weather alone."""
        return (disturb_by_weather(message, self.weather(level), site),)


class Fog(_AllSensors):
    """Fog of a visibility, MOR: extinction ln(20) / MOR of light; radar loses hardly anything.

    Levels of Dong et al. (CVPR 2023) and Hahner et al. (ICCV 2021): extinctions .005, .01, .02, .03, .06 /m.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"visibility_m": (599.0, 300.0, 150.0, 100.0, 50.0)}

    def weather(self, level: Level) -> Weather:
        """Return the weather of a level."""
        return Weather(visibility_m=level["visibility_m"])


class Rain(_AllSensors):
    """Rain of a rate: drops of Marshall and Palmer (1948), extinction 3.65e-4 R^0.63 /m of light, ITU-R P.838-3 for
    radar.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"rain_mm_h": (2.0, 5.0, 10.0, 25.0, 50.0)}

    def weather(self, level: Level) -> Weather:
        """Return the weather of a level."""
        return Weather(rain_mm_h=level["rain_mm_h"])


class Snow(_AllSensors):
    """Snow of a rate in water equivalent."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"snow_mm_h": (2.24, 4.82, 8.85, 34.97, 130.0)}

    def weather(self, level: Level) -> Weather:
        """Return the weather of a level."""
        return Weather(snow_mm_h=level["snow_mm_h"])


class WetGround(_AllSensors):
    """Water on the ground of a depth."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"water_mm": (0.2, 0.4, 0.6, 0.9, 1.2)}

    def weather(self, level: Level) -> Weather:
        """Return the weather of a level."""
        return Weather(water_mm=level["water_mm"])


class Night(_AllSensors):
    """Little light: cameras amplify it, with its noise."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"lux": (100.0, 30.0, 10.0, 3.0, 0.3)}

    def weather(self, level: Level) -> Weather:
        """Return the weather of a level."""
        return Weather(lux=level["lux"], sun_elevation_deg=-30.0)
