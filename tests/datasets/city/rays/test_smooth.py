"""Round normals against a cylinder's own, and edges that stay."""

import numpy as np

from fbench.datasets.city.instant import Rays
from fbench.datasets.city.mesh import Actor, Body, Skin, box, cylinder
from fbench.datasets.city.rays.caster import EmbreeCaster

PAINT = Skin("paint", (0.5, 0.5, 0.5))


def looked_at(mesh, states, row=(10.0, 0.0, 0.0)):
    """Flat and round normals of a body that rays from x = 0 meet, and where."""
    body = Body("car", (2.0, 4.0, 3.0), (mesh,))
    caster = EmbreeCaster(box((0, 0, -9), (1, 1, 1), PAINT), (Actor(body), Actor(body)))
    y, z = np.meshgrid(np.linspace(-0.9, 0.9, 60), np.linspace(-0.4, 0.4, 20))
    far = np.stack([np.full(y.size, 9.0), y.ravel(), z.ravel()], axis=1)
    rays = Rays(np.array([[0.0, 0, 1]]), (far / np.sqrt((far**2).sum(axis=1))[:, None]).astype(np.float32), 50.0)
    at = states([(0, 0), row])
    hits = caster.cast(rays, at)
    on = hits.body == 1
    place = rays.origin_m + rays.direction * np.where(on, hits.range_m, 0)[:, None]
    return hits.normal[on], caster.smooth_normals(rays, hits, at)[on], place[on], rays.direction[on]


def test_cylinder_is_round(states):
    """An upright cylinder of 16 sides and radius 1: its flat normals are up to 11 degrees off, round ones hardly."""
    mesh = cylinder((0, 0, 0), (0, 0, 3), 1.0, 16, PAINT)
    flat, round_, place, ray = looked_at(mesh, states, (10.0, 0.0, 0.7))
    true = (place - [10, 0, 0]) * [1, 1, 0]
    true /= np.sqrt((true**2).sum(axis=1))[:, None]
    off = [np.degrees(np.arccos(np.clip((n * true).sum(axis=1), -1, 1))) for n in (flat, round_)]
    assert off[0].max() > 9
    assert off[1].max() < 3
    assert off[1].mean() < 0.3 * off[0].mean()
    assert np.allclose((round_**2).sum(axis=1), 1, atol=1e-5)
    assert ((round_ * ray).sum(axis=1) < 0).all()


def test_box_keeps_its_edges(states):
    flat, round_, _, _ = looked_at(box((0, 0, 1), (1, 1, 1), PAINT), states, (10.0, 0.0, 0.5))
    assert len(np.unique(flat.round(4), axis=0)) == 2
    assert np.array_equal(flat, round_)
