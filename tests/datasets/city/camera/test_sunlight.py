"""Shadows from half the rays, against a ray for every pixel."""

import numpy as np

from fbench.datasets.city.camera.samples import Eye, find_sunlit, first_samples
from fbench.datasets.city.camera.sky import light_of
from fbench.datasets.city.instant import STATIC, Hits, Rays
from fbench.datasets.city.mesh import Skin, box
from fbench.datasets.city.rig import RigSpec
from fbench.replay.conditions.weather import Weather


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
    expected[faces] = ~view.caster.is_blocked(Rays(start, sun, 250.0), view.states)
    shadow = ~expected[faces]
    assert 0.02 < shadow.mean() < 0.6
    assert (found.lit != expected).sum() < 0.005 * shadow.sum()


class Shade:
    """A world in which shadow lies where pixel numbers say so: rays of pixel k start at x = k m."""

    def __init__(self, dark):
        self.dark = dark

    def is_blocked(self, rays, states):
        return np.isin(np.round(rays.origin_m[:, 0]), self.dark)


def test_pixels_at_the_end_of_a_row_are_no_neighbors_of_those_at_the_next_ones_beginning():
    """4 x 3 pixels: on one triangle, only the first of the middle row is lit. Of those around it the upper one alone
    is on that triangle, as is the last pixel of the row above.
    """
    triangle = np.array([7, 1, 7, 7, 7, 2, 3, 7, 4, 5, 6, 7], np.int32)
    normal, ahead = np.tile([0, 0, 1], (12, 1)).astype(np.float32), np.tile([1, 0, 0], (12, 1)).astype(np.float32)
    hits = Hits(np.arange(12, dtype=np.float32), np.full(12, STATIC, np.int32), triangle, normal, ())
    rays = Rays(np.zeros((1, 3)), ahead, 100.0)
    dark = [0, 2, 3, 7, 11]
    lit = find_sunlit(Shade(dark), None, rays, hits, light_of(Weather()), 4)
    assert lit.tolist() == [k not in dark for k in range(12)]
