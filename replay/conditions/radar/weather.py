"""Radar in weather."""

from fbench.replay.conditions.weather import Weather
from fbench.replay.contracts.conditions import Site
from fbench.replay.data.messages import RadarScan


def disturb_scan(scan: RadarScan, weather: Weather, site: Site) -> RadarScan:
    """Return the scan as it would be in a weather."""
    return scan
