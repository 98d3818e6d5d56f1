"""Drives that share a city are what they are alone."""

import pytest
from tests.city_log import SMALL_RIG

from fbench.datasets.city import recording as city
from fbench.datasets.city.recording import Cities, CityRecording
from fbench.datasets.city.rig import RigSpec
from fbench.datasets.city.spec import CitySpec, condition
from fbench.replay.data.messages import PointCloud

RIG = RigSpec(lidars=SMALL_RIG.lidars, pose_rate_hz=10.0)


def content(weather: str, cities: Cities, world="highway"):
    """All clouds of one drive, and all its items as text."""
    items = list(CityRecording(CitySpec(world, condition(weather), 0.4, 3, RIG), "log", cities=cities).items())
    clouds = [item.xyz.tobytes() for item in items if isinstance(item, PointCloud)]
    assert clouds
    return clouds, [repr(item) for item in items]


@pytest.mark.slow
def test_weathers_of_one_scene_share_a_city_that_is_built_once_and_stay_as_they_are(monkeypatch):
    alone = {"night": content("night", Cities())}
    built, build_city = [], city.build_city

    def build(plan, *key):
        built.append(key)
        return build_city(plan, *key)

    monkeypatch.setattr(city, "build_city", build)
    shared = Cities()
    for name in ("clear", "traffic", "night", "clear"):
        found = content(name, shared)
        assert alone.setdefault(name, found) == found
    assert built == [("highway", False, 3), ("highway", True, 3)]
