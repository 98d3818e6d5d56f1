"""LiDAR in weather."""

from fbench.replay.conditions.weather import Weather
from fbench.replay.contracts.conditions import Site
from fbench.replay.data.messages import PointCloud


def disturb_cloud(cloud: PointCloud, weather: Weather, site: Site) -> PointCloud:
    """Return the cloud as it would be in a weather."""
    return cloud
