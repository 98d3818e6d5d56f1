"""Cameras in weather."""

from fbench.replay.conditions.weather import Weather
from fbench.replay.contracts.conditions import Site
from fbench.replay.data.messages import Image


def disturb_image(image: Image, weather: Weather, site: Site) -> Image:
    """Return the image, raw BGR, as it would be in a weather."""
    return image
