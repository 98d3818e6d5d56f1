"""Patches cover what their outlines enclose, and look up."""

from collections.abc import Callable

import numpy as np
import pytest

from fbench.datasets.city.mesh import INDEX, Mesh
from fbench.datasets.city.scenery.ground import GROUND_SIDE_M, ground
from fbench.datasets.city.world.city_map import GROUND_Z_M, Patch
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.arrays import Array, Float64


def _ring_strip(num: int, from_rad: float, to_rad: float) -> Float64:
    """A curved road between radii of 20 and 26 m."""
    angle = np.linspace(from_rad, to_rad, num)
    way = np.column_stack([np.cos(angle), np.sin(angle)])
    return np.concatenate([26 * way, 20 * way[::-1]])


def _star(num: int, seed: int) -> Float64:
    angle = np.arange(num) * (2 * np.pi / num)
    radius = np.random.default_rng(seed).uniform(2, 10, num)
    return radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


OUTLINES = {
    "square": np.array([(0.0, 0), (4, 0), (4, 3), (0, 3)]),
    "arrow": np.array([(0.0, 0), (4, 2), (0, 4), (1, 2)]),
    "L": np.array([(0.0, 0), (5, 0), (5, 1), (1, 1), (1, 6), (0, 6)]),
    "points on its edges": np.array([(0.0, 0), (1, 0), (2, 0), (5, 0), (5, 1), (1, 1), (1, 3), (1, 6), (0, 6), (0, 3)]),
    "comb": np.array(
        [(0.0, 0), (9, 0), (9, 4), (7, 4), (7, 1), (5, 1), (5, 4), (3, 4), (3, 1), (1, 1), (1, 4), (0, 4)]
    ),
    "half ring": _ring_strip(40, 0.0, np.pi),
    "half ring from elsewhere": np.roll(_ring_strip(41, 0.0, np.pi), 7, axis=0),
    "thin ring": _ring_strip(120, 0.0, 6.2),
    **{f"star {seed}": _star(37, seed) for seed in range(4)},
}


def _shoelace(points: Float64) -> float:
    x, y = points.T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)


def _only(mesh: Mesh, keep: Array) -> Mesh:
    return Mesh(mesh.vertices_m, mesh.triangles[keep], mesh.material[keep], mesh.color[keep], mesh.lamp[keep])


@pytest.mark.parametrize("outline", OUTLINES.values(), ids=OUTLINES)
def test_triangles_fill_an_outline_and_look_up(
    outline: Float64, areas: Callable[[Mesh], Array], corners: Callable[[Mesh], Float64]
) -> None:
    whole = ground([Patch("asphalt", outline + np.array([300.0, -200.0]), 0.1)])
    patch = _only(whole, whole.material == INDEX["asphalt"])
    a, b, c = np.moveaxis(corners(patch), 1, 0)
    assert areas(patch).sum() == pytest.approx(_shoelace(outline), rel=1e-3)
    assert areas(patch).min() > 1e-7
    assert np.all(np.cross(b - a, c - a)[:, 2] > 0)
    np.testing.assert_allclose(corners(patch)[..., 2], 0.1, atol=1e-6)


@pytest.mark.parametrize("name", ["L", "comb", "half ring", "star 1"])
def test_every_place_lies_in_as_many_triangles_as_in_the_outline(name: str, corners: Callable[[Mesh], Float64]) -> None:
    outline = OUTLINES[name]
    whole = ground([Patch("asphalt", outline, 0.0)])
    a, b, c = np.moveaxis(corners(_only(whole, whole.material == INDEX["asphalt"]))[..., :2], 1, 0)
    points = np.random.default_rng(5).uniform(outline.min(axis=0), outline.max(axis=0), (500, 2))

    def left(p: Float64, q: Float64) -> Array:
        return np.asarray((q - p)[:, 0] * (points[:, None] - p)[..., 1] - (q - p)[:, 1] * (points[:, None] - p)[..., 0])

    covered = ((left(a, b) > 0) & (left(b, c) > 0) & (left(c, a) > 0)).sum(axis=1)
    assert covered.tolist() == [_crossings(point, outline) % 2 for point in points]


def _crossings(point: Float64, outline: Float64) -> int:
    """How often a ray to the right crosses an outline."""
    (x, y), after = point, np.roll(outline, -1, axis=0)
    spans = (outline[:, 1] > y) != (after[:, 1] > y)
    p, q = outline[spans], after[spans]
    return int((p[:, 0] + (y - p[:, 1]) * (q - p)[:, 0] / (q - p)[:, 1] > x).sum())


@pytest.mark.parametrize("name", ["square", "L", "half ring"])
def test_kerbs_look_outwards(name: str, areas: Callable[[Mesh], Array], corners: Callable[[Mesh], Float64]) -> None:
    outline = OUTLINES[name]
    whole = ground([Patch("sidewalk", outline, 0.15, has_kerb=True)])
    kerb = _only(whole, whole.material == INDEX["concrete"])
    around = np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1).sum()
    assert areas(kerb).sum() == pytest.approx(0.15 * around, rel=1e-3)
    both = corners(_only(whole, whole.material != INDEX["grass"]))
    a, b, c = np.moveaxis(both - [0, 0, 0.0], 1, 0)
    volume = (a * np.cross(b, c)).sum() / 6  # the open bottom lies at z = 0 and adds none
    assert volume == pytest.approx(0.15 * _shoelace(outline), rel=1e-3)


def test_grass_lies_below_around_the_middle(areas: Callable[[Mesh], Array]) -> None:
    whole = ground([Patch("asphalt", OUTLINES["square"] + np.array([98.0, 48.5]), 0.0)])
    grass = _only(whole, whole.material == INDEX["grass"])
    used = whole.vertices_m[np.unique(grass.triangles)]
    assert areas(grass).sum() == pytest.approx(GROUND_SIDE_M**2)
    np.testing.assert_allclose(used.mean(axis=0), [100, 50, GROUND_Z_M], atol=1e-3)


def test_shade_darkens() -> None:
    pale, dark = (ground([Patch("asphalt", OUTLINES["L"], 0.0, shade=s)]).color[-1] for s in (1.0, 0.5))
    np.testing.assert_allclose(dark, pale / 2, rtol=1e-6)


@pytest.mark.parametrize(
    "outline",
    [OUTLINES["L"][::-1], np.array([(0.0, 0), (4, 4), (4, 0), (0, 4), (-2, 2)])],
    ids=["clockwise", "crossed"],
)
def test_a_wrong_outline_is_told(outline: Float64) -> None:
    with pytest.raises(ConfigError, match="outline of a patch near"):
        ground([Patch("asphalt", outline, 0.0)])
