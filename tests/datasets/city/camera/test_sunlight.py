"""Shadows from half the rays, against a ray for every pixel."""

import numpy as np

from fbench.datasets.city.camera.light import light_of
from fbench.datasets.city.camera.samples import Eye, first_samples
from fbench.datasets.city.rays.hits import Rays
from fbench.datasets.city.rig import RigSpec
from fbench.datasets.city.shapes import Skin, box
from fbench.replay.weather import Weather


def test_shadows_are_those_of_a_ray_for_every_pixel(look, ground, spec):
    """Poles of 8 cm and a wall throw shadows over road and boxes."""
    posts = [box((6 + 2.5 * k, 2.0, 2), (0.08, 0.08, 4), Skin("pole", (0.3,) * 3)) for k in range(6)]
    things = [ground, *posts, box((15, 5, 1.5), (10, 0.3, 3), Skin("brick", (0.3,) * 3)),
              box((12, -2, 0.5), (2, 2, 1), Skin("concrete", (0.4,) * 3))]  # fmt: skip
    view, camera = look(things), spec()
    light = light_of(Weather(sun_azimuth_deg=80.0, sun_elevation_deg=35.0))
    T = RigSpec(cameras={"camera": camera}).rig().body_T_sensor("camera")
    eye = Eye(camera.model(), view.states.world_T_body(0) @ T)
    found = first_samples(view.caster, view.states, eye, eye.pixels(), light)
    toward = found.hits.normal.astype(float) @ np.array(light.sun)
    faces = np.flatnonzero((found.hits.body > -2) & (toward > 0))
    lift = 0.01 + 1e-4 * found.hits.range_m[faces, None]
    start = found.rays.origin_m + found.rays.direction[faces] * found.hits.range_m[faces, None].astype(float)
    start = start + lift * found.hits.normal[faces]
    sun = np.tile(np.array(light.sun, np.float32), (len(faces), 1))
    expected = np.zeros(len(found.lit), bool)
    expected[faces] = ~view.caster.blocked(Rays(start, sun, 250.0), view.states)
    shadow = ~expected[faces]
    assert 0.02 < shadow.mean() < 0.6
    assert (found.lit != expected).sum() < 0.005 * shadow.sum()
