"""Fog and rain: Koschmieder's law with the true distance."""

import numpy as np
import pytest

from fbench.datasets.city.camera.develop import linear
from fbench.datasets.city.mesh import Skin, box
from fbench.replay.conditions.weather import Weather


def contrast(look, spec, distance_m, weather):
    """Linear light of a bright less that of a dark target at a distance, on its right and left."""
    targets = [box((2 + distance_m + 0.5, y, 1), (1, 2, 2), Skin("pole", (albedo,) * 3))
               for y, albedo in ((1, 0.02), (-1, 0.7))]  # fmt: skip
    fov_deg = float(np.degrees(2 * np.arctan(200 / (40 * distance_m))))  # 40 px a meter at any distance
    shot = look(targets).take(spec(fov_deg=fov_deg), weather)
    light = linear(shot.rgb / 255).mean(axis=2)
    middle = slice(140, 160)
    assert np.allclose(shot.depth_m[middle, 160:240], distance_m, rtol=1e-4)
    return light[middle, 210:240].mean() - light[middle, 160:190].mean()


@pytest.mark.parametrize(("visibility_m", "rain_mm_h"), [(100.0, 0.0), (50.0, 0.0), (300.0, 0.0), (400.0, 50.0)])
def test_contrast_falls_as_beer_and_lambert_say(look, spec, visibility_m, rain_mm_h):
    weather = Weather(visibility_m=visibility_m, rain_mm_h=rain_mm_h, lux=6_000.0)
    distances = np.array([10.0, 25.0, 50.0])
    measured = np.log([contrast(look, spec, d, weather) for d in distances])
    extinction = -np.polyfit(distances, measured, 1)[0]
    stated = np.log(20) / visibility_m + 3.65e-4 * rain_mm_h**0.63  # 5 % at the visibility; rain on top
    assert extinction == pytest.approx(stated, rel=0.05)


def test_far_away_there_is_only_grey_fog(look, ground, spec):
    shot = look([ground, box((150, 0, 10), (2, 400, 40), Skin("brick", (0.3, 0.1, 0.1)))]).take(
        spec(), Weather(visibility_m=50.0, lux=6_000.0)
    )
    wall, sky = shot.rgb[140, 150:250].astype(float), shot.rgb[0:20].astype(float)
    assert np.abs(wall.mean(axis=0) - sky.mean(axis=(0, 1))).max() < 8
    assert np.ptp(wall.mean(axis=0)) < 25
