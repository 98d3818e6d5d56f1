"""Visible shares against brute force: slabs for boxes, and far more rays."""

import numpy as np
import pytest

from fbench.datasets.city.instant import BodyStates
from fbench.datasets.city.measure import EYE_M, visible_shares
from fbench.datasets.city.mesh import Actor, Body, Skin, box, merge_meshes
from fbench.datasets.city.rays.caster import EmbreeCaster

PAINT = Skin("paint", (0.5, 0.5, 0.5))
CAR, TRUCK, PEDESTRIAN = (4.4, 1.8, 1.5), (12.0, 2.5, 4.0), (0.6, 0.6, 1.75)


def body(size):
    return Body("car", size, (box((0, 0, size[2] / 2), size, PAINT),))


def shares(bodies, walls=(), ego=(0.0, 0.0, 0.0)):
    """Of bodies (size, x, y, yaw) behind walls (center, size)."""
    caster = EmbreeCaster(merge_meshes([box(c, s, PAINT) for c, s in walls]),
                          (Actor(body(CAR)), *(Actor(body(size)) for size, *_ in bodies)))  # fmt: skip
    rows = np.array([ego, *([x, y, yaw] for _, x, y, yaw in bodies)], float)
    num = len(rows)
    states = BodyStates(0.0, np.column_stack([rows[:, :2], np.zeros(num)]), rows[:, 2], np.zeros((num, 3)),
                        np.zeros(num), np.zeros(num), np.zeros(num, bool), np.zeros(0, bool))  # fmt: skip
    return visible_shares(caster, states, np.arange(1, num), 200.0)


def entered(directions, middle, yaw, size):
    """How far (N,) from the eye, the origin, rays enter a box that stands at `middle`; infinite for misses."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    o, d = turn @ -np.asarray(middle, float), directions @ turn.T
    with np.errstate(divide="ignore"):
        a, b = (-np.array(size) / 2 - o) / d, (np.array(size) / 2 - o) / d
    enters, leaves = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
    return np.where((enters <= leaves) & (leaves > 0), np.maximum(enters, 0), np.inf)


def brute_force(target, others, ego=(0.0, 0.0, 0.0), step_deg=0.2):
    """Share of the directions that show a box alone in which nothing is before it, each as wide as high."""
    azimuth, altitude = np.radians(np.arange(-180, 180, step_deg)), np.radians(np.arange(-75, 75, step_deg))
    size, x, y, yaw = target
    heading = np.arctan2(y - ego[1], x - ego[0])
    reach = np.arctan2(np.hypot(size[0], size[1]) / 2, max(0.1, np.hypot(x - ego[0], y - ego[1]) - 1)) + 0.4
    a, e = np.meshgrid(heading + azimuth[np.abs(azimuth) < reach], altitude)
    d = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1).reshape(-1, 3)
    eye = np.array([ego[0], ego[1], EYE_M])
    own = entered(d, np.array([x, y, size[2] / 2]) - eye, yaw, size)
    alone = np.isfinite(own)
    before = [entered(d[alone], np.array(c) - eye, turn, s) for c, turn, s in others]
    return (np.min([*before, np.full(alone.sum(), np.inf)], axis=0) > own[alone]).mean()


def as_boxes(bodies, walls):
    return [((x, y, s[2] / 2), yaw, s) for s, x, y, yaw in bodies] + [(c, 0.0, s) for c, s in walls]


WORLDS = {
    "wall before half of a car": ([(CAR, 20, 0, np.pi / 2)], [((10, 5, 2), (0.2, 10, 4))]),
    "low wall before its lower part": ([(CAR, 20, 1, 0.4)], [((12, 0, 0.5), (0.2, 30, 1))]),
    "post before a pedestrian": ([(PEDESTRIAN, 15, -4, 0.3)], [((9, -2.35, 2), (0.2, 0.2, 4))]),
    "car behind a truck": ([(TRUCK, 15, 1, 0.1), (CAR, 34, 6.2, 0)], []),
    "truck alongside, behind a barrier": ([(TRUCK, 1, 3.5, 0.0)], [((0, 1.9, 1.2), (40, 0.1, 2.4))]),
    "truck behind on the left": ([(TRUCK, -9, 4, 0.2)], [((-6, 2.3, 1), (6, 0.1, 2))]),
    "straight behind": ([(CAR, -14, 0.3, 3.0)], [((-9, 2, 2), (0.2, 4, 4))]),
    "elsewhere in the world": ([(CAR, 517, -388, 0.7)], [((508, -394, 0.5), (0.2, 30, 1.2))]),
}


@pytest.mark.parametrize("name", WORLDS)
def test_shares_are_those_of_brute_force(name):
    bodies, walls = WORLDS[name]
    ego = (500.0, -400.0, 1.0) if name == "elsewhere in the world" else (0.0, 0.0, 0.0)
    found = shares(bodies, walls, ego)
    for i, target in enumerate(bodies):
        others = as_boxes([b for k, b in enumerate(bodies) if k != i], walls)
        assert found[i] == pytest.approx(brute_force(target, others, ego), abs=0.06)  # of 12 x 12 rays


def test_the_worlds_hide_something():
    hidden = [shares(*world).min() for name, world in WORLDS.items() if name != "elsewhere in the world"]
    assert all(0.02 < share < 0.98 for share in hidden)


def test_nothing_hides_a_body_alone_and_a_high_wall_hides_it_whole():
    for x, y in ((20, 0), (-20, 3), (0, 5), (60, -60)):
        assert shares([(CAR, x, y, 0.8)]).tolist() == [1.0]
    assert shares([(CAR, 20, 0, 0.8)], [((10, 0, 5), (0.2, 40, 10))]).tolist() == [0.0]
    assert shares([]).shape == (0,)


def test_more_behind_a_wall_is_never_more_visible():
    found = [shares([(TRUCK, 25, 0, 1.2)], [((10, 5 - k, 3), (0.2, 4, 6))])[0] for k in range(4)]
    assert (np.diff(found) <= 0).all()
    assert found[0] > found[-1]
