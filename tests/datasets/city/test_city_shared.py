"""Drives that share a city are what they are alone."""

from tests.city_log import SMALL_RIG

from fbench.datasets.city.city import Cities
from fbench.datasets.city.conditions import condition
from fbench.datasets.city.recording import CityRecording
from fbench.datasets.city.rig import RigSpec
from fbench.datasets.city.spec import CitySpec
from fbench.replay.data import PointCloud

RIG = RigSpec(lidars=SMALL_RIG.lidars, pose_rate_hz=10.0)


def content(weather: str, cities: Cities, world="urban"):
    """All clouds of one drive, and all its items as text."""
    items = list(CityRecording(CitySpec(world, condition(weather), 0.4, 3, RIG), "log", cities=cities).items())
    clouds = [item.xyz.tobytes() for item in items if isinstance(item, PointCloud)]
    assert clouds
    return clouds, [repr(item) for item in items]


def test_weathers_of_one_scene_share_a_city_and_stay_as_they_are():
    shared = Cities()
    assert [content(name, shared) for name in ("clear", "night", "fog", "traffic", "clear")] == [
        content(name, Cities()) for name in ("clear", "night", "fog", "traffic", "clear")
    ]


def test_a_city_is_built_once_for_all_weathers(monkeypatch):
    built = []

    def build(plan, *key):
        built.append(key)
        return build_city(plan, *key)

    from fbench.datasets.city import city

    build_city = city.build_city
    monkeypatch.setattr(city, "build_city", build)
    shared = Cities()
    for name in ("clear", "night", "traffic", "traffic+fog", "dense-fog"):
        content(name, shared)
    assert built == [("urban", False, 3), ("urban", True, 3)]
