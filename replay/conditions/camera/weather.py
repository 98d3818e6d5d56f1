"""Cameras in weather."""

from fbench.replay.conditions.camera.image_condition import edit_image
from fbench.replay.conditions.weather import (
    CLEAR_MOR_M,
    Weather,
    fog_extinction_per_m,
    rain_extinction_per_m,
    snow_extinction_per_m,
)
from fbench.replay.contracts.conditions import Site
from fbench.replay.data.images import Pixels
from fbench.replay.data.messages import Image


def disturb_image(image: Image, weather: Weather, site: Site) -> Image:
    """Return the image, raw BGR, as it would be in a weather, in the order in which light meets it: what fog, rain and
    snow in the air take, by distance; streaks and flakes near the lens; the duller light of rain; little light and its
    noise. Clear air was recorded already. Wet ground changes nothing: what it mirrors isn't known.
    """
    from fbench.replay.conditions.camera import fog, light, precipitation  # they need OpenCV and numba

    def edit(pixels: Pixels) -> Pixels:
        extinction = rain_extinction_per_m(weather.rain_mm_h) + snow_extinction_per_m(weather.snow_mm_h)
        if weather.visibility_m < CLEAR_MOR_M:
            extinction += fog_extinction_per_m(weather)
        if extinction > 0:
            pixels = fog.attenuate(pixels, extinction, site)
        if weather.rain_mm_h > 0:
            pixels = precipitation.add_rain(pixels, weather.rain_mm_h, site.rng_of(image, "rain"))
        if weather.snow_mm_h > 0:
            pixels = precipitation.add_snow(pixels, weather.snow_mm_h, site.rng_of(image, "snow"))
        if weather.rain_mm_h > 0:
            pixels = precipitation.dull(pixels, weather.rain_mm_h)
        return light.dim_by_lux(pixels, weather.lux, site.rng_of(image, "light"))

    return edit_image(image, edit)
