"""Rain near the camera, and what wet ground mirrors."""

import numpy as np
import pytest

from fbench.datasets.city.camera.develop import linear
from fbench.datasets.city.camera.light import light_of
from fbench.datasets.city.camera.rain import add_streaks
from fbench.datasets.city.rig import RigSpec
from fbench.datasets.city.shapes import Skin, box
from fbench.replay.weather import Weather


@pytest.fixture
def streaks(look, ground, spec):
    def draw(rain_mm_h, seed=1, stamp_ns=0, y=0.0):
        camera = spec(translation_m=(2.0, y, 1.0))
        image, weather = np.zeros((300, 400, 3), np.float32), Weather(lux=8_000.0, rain_mm_h=rain_mm_h)
        T = RigSpec(cameras={"camera": camera}).rig().body_T_sensor("camera")
        add_streaks(image, camera.model(), T, look([ground]).states, weather, light_of(weather), seed, stamp_ns)
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

    def likeness(shift):
        return float(np.corrcoef(left[:, 10:-10].ravel(), np.roll(right, shift, axis=1)[:, 10:-10].ravel())[0, 1])

    assert max(likeness(k) for k in range(1, 5)) > 3 * abs(likeness(-4))


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
