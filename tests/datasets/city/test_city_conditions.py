import pytest

from fbench.datasets.city.request import SEEDS, SUITE, CityRequest
from fbench.datasets.city.spec import CONDITIONS, condition
from fbench.replay.contracts.errors import ConfigError


def test_the_conditions_of_the_thesis_are_there():
    assert {"clear", "traffic", "rain", "fog", "night"} <= set(CONDITIONS)
    assert condition("fog").weather.visibility_m == 100
    assert condition("rain").weather.rain_mm_h > 0
    assert condition("night").weather.lux < 1
    assert condition("traffic").is_dense
    assert not condition("clear").is_dense
    assert condition("low-sun").weather.sun_elevation_deg < 10


def test_a_mixture_has_the_worst_of_its_parts():
    mixed = condition("rain+night+traffic")
    rain, night = condition("rain").weather, condition("night").weather
    assert mixed.name == "rain+night+traffic"
    assert mixed.is_dense
    assert mixed.weather.rain_mm_h == rain.rain_mm_h
    assert mixed.weather.visibility_m == rain.visibility_m
    assert (mixed.weather.lux, mixed.weather.sun_elevation_deg) == (night.lux, night.sun_elevation_deg)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("foggy", r"no condition 'foggy'; did you mean 'fog'\?"),
        ("fog+fog", "'fog' comes twice"),
        ("", "no condition ''"),
        ("fog+", "no condition ''"),
    ],
)
def test_conditions_that_are_none_are_named(text, says):
    with pytest.raises(ConfigError, match=says):
        condition(text)


def test_the_suite_is_what_was_fixed():
    """Seeds and scenes are frozen: figures that were published with them must stay comparable."""
    assert [(scene.world, scene.condition) for scene in SUITE] == [
        ("urban", "clear"), ("urban", "traffic"), ("urban", "rain"), ("urban", "fog"), ("urban", "night"),
        ("highway", "clear"), ("highway", "traffic"), ("highway", "rain"), ("highway", "fog"), ("highway", "night"),
        ("urban", "traffic+fog"), ("highway", "heavy-rain"),
    ]  # fmt: skip
    assert SEEDS == {"dev": (101, 102, 103, 104, 105, 106, 107, 108), "test": (9001, 9002, 9003, 9004)}
    assert not set(SEEDS["dev"]) & set(SEEDS["test"])


def test_all_of_the_suite_can_be_made():
    names = {scene.name(seed) for scene in SUITE for seeds in SEEDS.values() for seed in seeds}
    assert len(names) == len(SUITE) * 12
    for scene in SUITE:
        assert CityRequest(scene.world, scene.condition).spec().condition.name == scene.condition
