"""Named conditions of a scene: weather, light, traffic, and mixtures of them."""

from collections.abc import Mapping
from dataclasses import dataclass

from fbench.replay.errors import ConfigError
from fbench.replay.names import did_you_mean
from fbench.replay.weather import Weather


@dataclass(frozen=True)
class Condition:
    """Under which circumstances a scene is recorded."""

    name: str
    weather: Weather
    is_dense: bool = False
    """Whether there is much traffic; it is another scene then."""


_OVERCAST_LUX = 8_000.0
CONDITIONS: Mapping[str, Condition] = {
    condition.name: condition
    for condition in (
        Condition("clear", Weather()),
        Condition("traffic", Weather(), is_dense=True),
        Condition("rain", Weather(visibility_m=8_000.0, rain_mm_h=15.0, lux=_OVERCAST_LUX)),
        Condition("heavy-rain", Weather(visibility_m=4_000.0, rain_mm_h=50.0, lux=4_000.0)),
        Condition("fog", Weather(visibility_m=100.0, lux=6_000.0)),
        Condition("dense-fog", Weather(visibility_m=50.0, lux=5_000.0)),
        Condition("night", Weather(lux=0.3, sun_elevation_deg=-30.0)),
        Condition("dusk", Weather(lux=150.0, sun_elevation_deg=-3.0)),
        Condition("low-sun", Weather(lux=10_000.0, sun_elevation_deg=6.0, sun_azimuth_deg=15.0)),
        Condition("overcast", Weather(visibility_m=15_000.0, lux=_OVERCAST_LUX)),
    )
}
"""By name. Visibilities in fog are the two densest levels of Dong et al. (CVPR 2023), rain rates those of heavy and
violent showers, illuminances those of the sky that the name says; the rest is chosen.
"""


def condition(text: str) -> Condition:
    """Return the condition of a name, or the mixture of several joined by `+`, such as `traffic+fog`.

    A mixture has the shortest visibility, the most rain, the least light, the lowest sun, and dense traffic where any
    of its parts has.

    Raises:
        ConfigError: for an unknown name, or one that comes twice.
    """
    names = [name.strip() for name in text.split("+")]
    for name in names:
        if name not in CONDITIONS:
            raise ConfigError(f"--condition {text}: no condition '{name}'{did_you_mean(name, CONDITIONS)}")
        if names.count(name) > 1:
            raise ConfigError(f"--condition {text}: '{name}' comes twice")
    parts = [CONDITIONS[name] for name in names]
    return Condition("+".join(names), _mixed([part.weather for part in parts]), any(p.is_dense for p in parts))


def _mixed(weathers: list[Weather]) -> Weather:
    lowest = min(weathers, key=lambda weather: weather.sun_elevation_deg)
    return Weather(
        visibility_m=min(weather.visibility_m for weather in weathers),
        rain_mm_h=max(weather.rain_mm_h for weather in weathers),
        lux=min(weather.lux for weather in weathers),
        sun_elevation_deg=lowest.sun_elevation_deg,
        sun_azimuth_deg=lowest.sun_azimuth_deg,
    )
