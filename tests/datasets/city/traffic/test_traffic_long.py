"""No two bodies ever overlap, and traffic keeps flowing."""

from dataclasses import replace
from typing import Literal

import numba
import numpy as np
import pytest
from tests.datasets.city.traffic.conftest import Scene

from fbench.datasets.city.instant import BodyStates
from fbench.datasets.city.spec import WorldName
from fbench.datasets.city.traffic.placing import TrafficParams
from fbench.datasets.city.traffic.traffic import Traffic
from fbench.datasets.city.world.urban import layout


@numba.njit  # type: ignore[untyped-decorator]  # numba has no types
def _touch(at: np.ndarray, size: np.ndarray, i: int, j: int) -> bool:
    """Whether no side of either footprint has the other wholly beyond it: by corners, unlike traffic's own check."""
    for a, b in ((i, j), (j, i)):
        cos, sin = np.cos(at[a, 2]), np.sin(at[a, 2])
        c, s = 0.5 * np.cos(at[b, 2]), 0.5 * np.sin(at[b, 2])
        low_x, high_x, low_y, high_y = np.inf, -np.inf, np.inf, -np.inf
        for u, v in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            x = at[b, 0] + u * size[b, 0] * c - v * size[b, 1] * s - at[a, 0]
            y = at[b, 1] + u * size[b, 0] * s + v * size[b, 1] * c - at[a, 1]
            along, aside = x * cos + y * sin, y * cos - x * sin
            low_x, high_x, low_y, high_y = min(low_x, along), max(high_x, along), min(low_y, aside), max(high_y, aside)
        if low_x >= size[a, 0] / 2 or high_x <= -size[a, 0] / 2:
            return False
        if low_y >= size[a, 1] / 2 or high_y <= -size[a, 1] / 2:
            return False
    return True


@numba.njit  # type: ignore[untyped-decorator]  # numba has no types
def _pairs(at: np.ndarray, size: np.ndarray, order: np.ndarray) -> list[tuple[int, int]]:
    """Of bodies in the order of their x, each with those whose x isn't beyond its reach."""
    longest = 0.5 * (size[:, 0] + size[:, 1]).max()
    found = []
    for m in range(len(order)):
        i = order[m]
        for n in range(m + 1, len(order)):
            j = order[n]
            reach = 0.5 * (size[i, 0] + size[i, 1])
            if at[j, 0] - at[i, 0] > reach + longest:
                break
            reach += 0.5 * (size[j, 0] + size[j, 1])
            if abs(at[i, 1] - at[j, 1]) < reach and _touch(at, size, i, j):
                found.append((max(i, j), min(i, j)))
    return found


def overlapping(state: BodyStates, sizes: np.ndarray) -> list[tuple[int, int]]:
    """Pairs whose footprints overlap, of all pairs."""
    at = np.column_stack([state.position_m[:, :2], state.yaw_rad])
    return list(_pairs(at, np.ascontiguousarray(sizes[:, :2]), np.argsort(at[:, 0])))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["urban", "highway"])
def test_no_two_bodies_overlap(name: str, request: pytest.FixtureRequest) -> None:
    scene: Scene = request.getfixturevalue(name)
    for k in range(0, 600, 2):
        assert overlapping(scene.motion.at(k / 10 + 0.03), scene.sizes) == []


def test_the_check_itself_finds_overlaps(urban: Scene) -> None:
    state = urban.states[0]
    moved = state.position_m.copy()
    moved[1] = moved[0] + [1.0, 0.5, 0.0]
    assert (1, 0) in overlapping(replace(state, position_m=moved), urban.sizes)


@pytest.mark.parametrize(("x", "y", "yaw", "touch"), [
    (3.99, 0.0, 0.0, True), (4.01, 0.0, 0.0, False), (0.0, 1.99, 0.0, True), (0.0, 2.01, 0.0, False),
    (2.99, 0.0, np.pi / 2, True), (3.01, 0.0, np.pi / 2, False),
    (2 + 2.12 - 0.02, 1.0 + 0.0, np.pi / 4, True), (2 + 2.13, 0.0, np.pi / 4, False), (3.6, 2.6, np.pi / 4, False),
])  # fmt: skip
def test_the_check_matches_footprints_drawn_by_hand(x: float, y: float, yaw: float, touch: bool) -> None:
    # Two of 4 x 2 m; turned by 45 degrees the other reaches (4 + 2) / 2 / sqrt(2) = 2.121 m to each side.
    at = np.array([[0.0, 0.0, 0.0], [x, y, yaw]])
    for order in ([0, 1], [1, 0]):  # whoever is first
        at, size = at[order], np.full((2, 2), 2.0) * [2.0, 1.0]
        assert bool(_pairs(at, size, np.argsort(at[:, 0]))) == touch


def test_the_check_of_a_crowd_finds_what_a_look_at_each_pair_finds() -> None:
    draw = np.random.default_rng(0)
    at, size = draw.uniform(0, 100, (300, 3)), draw.uniform(0.5, 12, (300, 2))
    each = [(i, j) for i in range(300) for j in range(i) if _touch(at, size, i, j)]
    assert len(each) > 50
    assert sorted(_pairs(at, size, np.argsort(at[:, 0]))) == each


@pytest.mark.slow
@pytest.mark.parametrize(("world", "density", "seed", "seconds"), [
    ("urban", "normal", 11, 600), ("urban", "dense", 12, 600),
    ("highway", "normal", 14, 400), ("highway", "dense", 15, 400),
])  # fmt: skip
def test_nobody_touches_anybody_for_minutes(
    world: WorldName, density: Literal["normal", "dense"], seed: int, seconds: int
) -> None:
    traffic = Traffic(layout(world, seed), TrafficParams.of(world, density), seed)
    sizes = np.array([actor.body.size_lwh_m for actor in traffic.actors])
    moving = np.array([not actor.parked for actor in traffic.actors])
    standing, longest, speeds = np.zeros(len(sizes)), 0.0, []
    for begin in range(0, seconds, 50):
        motion = traffic.motion(float(begin), begin + 50.0)
        for k in range(500):
            state = motion.at(begin + k / 10)
            assert overlapping(state, sizes) == []
            if k % 10:
                continue
            speed = np.hypot(*state.velocity_mps[:, :2].T)
            standing = np.where((speed < 0.1) & moving, standing + 1.0, 0.0)
            longest = max(longest, float(standing.max()))
            speeds.append(float(speed[moving].mean()))
    cycles = 5 if density == "dense" else 3
    assert np.mean(speeds[-300:]) > (15.0 if world == "highway" else 1.0 if density == "dense" else 1.5)
    assert longest < cycles * 75
    assert traffic.num_emergencies < 5 * seconds / 3600 + 2
