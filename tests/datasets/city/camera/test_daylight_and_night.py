"""Light: shadows, lamps, exposure, noise."""

import numpy as np
import pytest

from fbench.datasets.city.camera.develop import linear, tone
from fbench.datasets.city.mesh import Skin, box
from fbench.replay.conditions.weather import Weather

NIGHT = Weather(lux=0.3, sun_elevation_deg=-30.0)
GREY = Skin("pole", (0.18, 0.18, 0.18))


def brightness(shot, where):
    return linear(shot.rgb[where] / 255).mean()


def test_tone_curve_can_be_undone():
    light = np.linspace(0, 1.5, 200)
    assert np.allclose(linear(tone(light)), light, atol=1e-9)
    assert tone(np.array(0.18)) == pytest.approx(0.4613, abs=1e-3)  # sRGB
    assert (np.diff(tone(light)) > 0).all()


def test_shadow_falls_away_from_the_sun(look, ground, spec):
    """A wall 2 m high; the sun on its left at 45 degrees: the shadow reaches 2 m to its right."""
    wall = box((9, 4, 1), (4, 0.2, 2), Skin("concrete", (0.4,) * 3))
    camera = spec(translation_m=(9.0, 0.0, 12.0), yaw_pitch_roll_deg=(0.0, 90.0, 0.0))  # looks down
    sun = Weather(sun_elevation_deg=45.0, sun_azimuth_deg=90.0)
    shot = look([ground, wall]).take(camera, sun)
    # from 12 m, 200 px / 12 m; image right is body right (-y), up is forward
    on = {}
    for y in (3.0, 2.3, 1.4, 0.5, 6.0):
        column = round(199.5 - y * 200 / 12)
        on[y] = brightness(shot, (slice(140, 160), slice(column - 3, column + 3)))
    assert max(on[3.0], on[2.3]) < 0.5 * min(on[1.4], on[0.5], on[6.0])


def test_no_shadow_without_sun(look, ground, spec):
    wall = box((9, 4, 1), (4, 0.2, 2), Skin("concrete", (0.4,) * 3))
    camera = spec(translation_m=(9.0, 0.0, 12.0), yaw_pitch_roll_deg=(0.0, 90.0, 0.0))
    shot = look([ground, wall]).take(camera, Weather(lux=8_000, rain_mm_h=1.0, sun_azimuth_deg=90.0))
    levels = [brightness(shot, (slice(100, 200), slice(c - 9, c + 9))) for c in (158, 185, 215)]
    assert max(levels) < 1.3 * min(levels)


def test_brake_lights_shine_while_braking(look, ground, spec, body):
    lights = box((0, 0, 0.75), (4, 1.8, 1.5), Skin("taillight", (1.0, 0.05, 0.05), lamp=0))
    lamp = type(body())("car", (4.0, 1.8, 1.5), (lights,))
    shots = [look([ground], [(lamp, (14.0, 0, 0), 0.0)], braking=(on,)).take(spec()) for on in (False, True)]
    off, on = (linear(s.rgb[s.body == 1] / 255)[:, 0].mean() for s in shots)
    assert on > 2 * off


def test_signals_shine_when_they_are_on(look, ground, spec):
    lamp = box((12, 0, 1), (1, 1, 1), Skin("signal_lamp", (0.05, 1.0, 0.2), lamp=1))
    off, on = (look([ground, lamp], lamps=(True, state)).take(spec()).rgb[150, 200, 1] for state in (False, True))
    assert on > off + 40


def test_tail_lights_shine_by_night_only_and_not_of_parked_cars(look, ground, spec, body):
    lights = box((0, 0, 0.75), (4, 1.8, 1.5), Skin("taillight", (1.0, 0.05, 0.05), lamp=2))
    lamp = type(body())("car", (4.0, 1.8, 1.5), (lights,))
    moving, parked = (look([ground], [(lamp, (14.0, 0, 0), 0.0)], parked=p) for p in (False, True))
    night = [linear(v.take(spec(), NIGHT).rgb[150, 200] / 255)[0] for v in (moving, parked)]
    assert night[0] > 2 * night[1]
    assert moving.take(spec()).rgb[150, 200, 0] == parked.take(spec()).rgb[150, 200, 0]


def test_night_is_darker_and_noisier(look, ground, spec):
    wall = box((30, 0, 2), (2, 40, 4), Skin("concrete", (0.4,) * 3))
    view, camera = look([ground, wall]), spec(noise=0.006)
    day, night = (view.take(camera, w, stamp_ns=1) for w in (Weather(), NIGHT))
    again = [view.take(camera, w, stamp_ns=2) for w in (Weather(), NIGHT)]
    assert night.rgb.mean() < 0.6 * day.rgb.mean()
    noise = [np.std(a.rgb.astype(float) - b.rgb) for a, b in zip((day, night), again, strict=True)]
    assert noise[1] > 2 * noise[0]


def test_street_lamps_light_the_road_below_them(look, ground, spec):
    view = look([ground])
    camera = spec(translation_m=(40.0, 0.0, 12.0), yaw_pitch_roll_deg=(0.0, 90.0, 0.0))
    dark, lit = (view.take(camera, NIGHT, street_lamps_m=p) for p in (None, [(40.0, 0.0, 8.0)]))
    middle = (slice(140, 160), slice(190, 210))
    assert brightness(lit, middle) > 3 * brightness(dark, middle)
    assert brightness(lit, middle) > 2 * brightness(lit, (slice(140, 160), slice(0, 20)))
    assert lit.rgb[150, 200, 0] > lit.rgb[150, 200, 2]  # warm
    by_day = [view.take(camera, Weather(), street_lamps_m=p).rgb for p in (None, [(40.0, 0.0, 8.0)])]
    assert np.array_equal(*by_day)


def test_exposure_is_sane(look, ground, spec):
    wall = box((30, 0, 2), (2, 40, 4), Skin("plaster", (0.5, 0.47, 0.4)))
    for weather in (Weather(), Weather(lux=8_000, rain_mm_h=15), Weather(lux=6_000, visibility_m=100)):
        assert 0.2 < look([ground, wall]).take(spec(), weather).rgb.mean() / 255 < 0.7


@pytest.mark.parametrize("noise", [0.006, 0.02])
def test_noise_has_the_stated_deviation_at_mid_grey(look, spec, noise):
    """The difference of two images of a wall; on it, noise of the pixels near mid-gray."""
    wall = box((13, 0, 0), (2, 60, 60), GREY)
    view, camera = look([wall]), spec(noise=noise)
    weather = Weather(sun_azimuth_deg=180.0, lux=30_000.0)  # behind the camera
    a, b = (view.take(camera, weather, stamp_ns=k).rgb.astype(float) for k in (1, 2))
    mean = (a + b) / 2
    gray = np.abs(mean - 255 * 0.4613) < 15
    assert gray.sum() > 2_000
    assert np.std((a - b)[gray]) / np.sqrt(2) / 255 == pytest.approx(noise, rel=0.1)


def test_corners_are_darker(look, spec):
    wall = box((13, 0, 0), (2, 90, 90), GREY)
    without, with_it = (look([wall]).take(spec(vignetting=v)) for v in (0.0, 0.3))
    ratio = linear(with_it.rgb / 255).astype(float) / linear(without.rgb / 255)
    assert ratio[:8, :8].mean() == pytest.approx(0.7, abs=0.03)
    assert ratio[145:155, 195:205].mean() == pytest.approx(1.0, abs=0.02)
