"""Rain near the camera, and what wet ground mirrors."""

import numpy as np
import pytest

from fbench.datasets.city.camera.develop import add_streaks, linear
from fbench.datasets.city.camera.picture import mirror_samples, spread_mirrored
from fbench.datasets.city.camera.samples import Eye, first_samples
from fbench.datasets.city.camera.sky import light_of
from fbench.datasets.city.mesh import Skin, box
from fbench.replay.conditions.weather import Weather


@pytest.fixture
def streaks(look, ground, spec):
    def draw(rain_mm_h, seed=1, stamp_ns=0, y=0.0):
        camera = spec(translation_m=(2.0, y, 1.0))
        image, weather = np.zeros((300, 400, 3), np.float32), Weather(lux=8_000.0, rain_mm_h=rain_mm_h)
        now = look([ground]).now(camera, weather, seed=seed, stamp_ns=stamp_ns)
        add_streaks(image, now, camera.model(), light_of(weather))
        return image

    return draw


def test_more_rain_more_streaks(streaks):
    dry, light, heavy = (streaks(rate) for rate in (0.0, 5.0, 50.0))
    assert not dry.any()
    assert heavy.sum() > 2 * light.sum() > 0
    assert heavy.max() < 1.2  # never brighter than the sky
    assert (heavy.max(axis=2) > 0.02).mean() < 0.2


def test_streaks_belong_to_an_instant(streaks):
    one = streaks(15.0)
    assert np.array_equal(one, streaks(15.0))
    assert not np.array_equal(one, streaks(15.0, stamp_ns=1))
    assert not np.array_equal(one, streaks(15.0, seed=2))


def test_both_cameras_of_a_pair_see_the_same_drops(streaks):
    """Two cameras 2 cm apart: at f = 200 px, drops move by 4 px at 1 m and by 1 px at 4 m."""
    left, right = streaks(30.0, y=0.01)[..., 0], streaks(30.0, y=-0.01)[..., 0]

    def similarity(shift):
        return float(np.corrcoef(left[:, 10:-10].ravel(), np.roll(right, shift, axis=1)[:, 10:-10].ravel())[0, 1])

    assert max(similarity(k) for k in range(1, 5)) > 3 * abs(similarity(-4))


def test_wet_ground_mirrors_what_stands_on_it(look, ground, spec):
    """A red wall before a camera 1 m high: rays that meet the road before it go on to the wall."""
    wall = box((20, 0, 3), (1, 6, 6), Skin("plaster", (0.6, 0.05, 0.05)))
    view = look([ground, wall])
    dry, wet = (view.take(spec(), Weather(lux=8_000.0, rain_mm_h=rain)) for rain in (0.0, 20.0))
    rows = slice(170, 180)  # 7 to 10 m away

    def redness(shot, columns):
        light = linear(shot.rgb[rows, columns] / 255).mean(axis=(0, 1))
        return light[0] / light[1]

    before, beside = slice(190, 210), slice(20, 60)
    assert redness(wet, before) > 1.1 * redness(wet, beside)
    assert redness(dry, before) == pytest.approx(redness(dry, beside), rel=0.05)


def test_wet_ground_is_darker_than_dry(look, ground, spec):
    view, camera = look([ground]), spec(translation_m=(2.0, 0.0, 6.0), yaw_pitch_roll_deg=(0.0, 80.0, 0.0))
    dry, wet = (view.take(camera, Weather(lux=8_000.0, rain_mm_h=rain)) for rain in (0.0, 20.0))
    assert linear(wet.rgb / 255).mean() < 0.9 * linear(dry.rgb / 255).mean()


@pytest.mark.parametrize("size_wh", [(17, 16), (17, 33), (16, 17), (17, 101), (33, 32)])
def test_every_other_wet_pixel_of_every_other_row_mirrors(look, ground, spec, size_wh):
    camera = spec(size_wh=size_wh, fov_deg=10.0, translation_m=(9.0, 0.0, 12.0), yaw_pitch_roll_deg=(0.0, 90.0, 0.0))
    now = look([ground]).now(camera, Weather(lux=8_000.0, rain_mm_h=20.0))
    eye = Eye(camera.model(), now.world_T_sensor)
    samples = first_samples(now.caster, now.states, eye, eye.pixels(), light_of(now.weather))
    found, index = mirror_samples(now.caster, now.states, samples, size_wh[0])
    width, height = size_wh
    assert index.tolist() == [v * width + u for v in range(0, height, 2) for u in range(0, width, 2)]
    assert len(found.lit) == len(found.rays.direction) == len(index)


@pytest.mark.parametrize("size_wh", [(40, 60), (41, 61)])
def test_mirrored_light_is_spread_up_to_the_borders(size_wh):
    """It grows from row to row: so it does where it is drawn from half resolution, in the last rows too."""
    width, height = size_wh
    index = np.array([v * width + u for v in range(0, height, 2) for u in range(0, width, 2)])
    rows, columns = (spread_mirrored(np.repeat(level[:, None] / 100, 3, axis=1).astype(np.float32), index, size_wh)
                     for level in (index // width, index % width))  # fmt: skip
    assert rows.shape == (width * height, 4)
    assert (rows[:, 3] == 1).all()
    even = -2 if height % 2 == 0 else None  # the very last row of an even number has nothing below it
    assert (np.diff(rows[:, 0].reshape(height, width)[:even].mean(axis=1)) > 0).all()
    assert (np.diff(columns[:, 0].reshape(height, width)[:, :even].mean(axis=0)) > 0).all()
