"""By night, every lamp in reach lights a surface, wherever the grid has it."""

import numpy as np
import pytest

from fbench.datasets.city.camera.samples import HitArrays
from fbench.datasets.city.camera.shade import add_lamplight, lamps_of
from fbench.datasets.city.camera.sky import light_of
from fbench.datasets.city.camera.surfaces import grid_around
from fbench.datasets.city.instant import STATIC
from fbench.replay.conditions.weather import Weather

NIGHT = Weather(lux=0.3, sun_elevation_deg=-30.0)


def lit(lamps, points):
    """Light (N, 3) on surfaces at points (N, 3) that face the ego vehicle."""
    range_m = np.sqrt((points * points).sum(axis=1))
    direction, num = (points / range_m[:, None]).astype(np.float32), len(points)
    body = np.full(num, STATIC, np.int32)
    hits = HitArrays(direction, range_m.astype(np.float32), body, body, -direction, np.zeros(num, np.uint8),
                     np.zeros(num, bool))  # fmt: skip
    light_on = np.zeros((num, 3), np.float32)
    add_lamplight(light_on, hits, np.zeros(3), lamps)
    return light_on


@pytest.mark.parametrize("yaw", [0.0, np.pi / 4, 2.0])
def test_beams_and_street_lamps_reach_as_far_as_they_do_without_a_grid(look, ground, body, yaw):
    view = look([ground], [(body(), (10.0 * k - 20, 8.0, 0), yaw) for k in range(3)])
    lamps = lamps_of(view.actors, view.states, np.array([(20.0, 5, 8), (-15, 30, 8)]), light_of(NIGHT))
    num = len(lamps.position_m)
    everywhere = lamps._replace(near=grid_around(0.0, 0.0, np.zeros((num, 2)), np.full(num, 1e3)))
    points = np.random.default_rng(1).uniform((-80, -80, 0.05), (80, 80, 3), (20_000, 3))
    every = lit(everywhere, points)
    assert (every > 0).any(axis=1).mean() > 0.1
    np.testing.assert_array_equal(lit(lamps, points), every)


def test_nothing_shines_by_day(look, ground, body):
    view = look([ground], [(body(), (10.0, 8.0, 0), 0.0)])
    lamps = lamps_of(view.actors, view.states, np.array([(20.0, 5, 8)]), light_of(Weather()))
    assert len(lamps.position_m) == 0
    assert not lit(lamps, np.array([(12.0, 8, 1), (20, 5, 0.1)])).any()
