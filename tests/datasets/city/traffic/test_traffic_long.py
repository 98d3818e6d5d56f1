"""No two bodies ever overlap, and traffic keeps flowing."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fbench.datasets.city.motion import BodyStates
from fbench.datasets.city.traffic.traffic import Traffic, TrafficParams
from fbench.datasets.city.world.worlds import layout

from .conftest import Scene


def corners(state: BodyStates, sizes: np.ndarray) -> np.ndarray:
    """(N, 4, 2)."""
    cos, sin = np.cos(state.yaw_rad)[:, None], np.sin(state.yaw_rad)[:, None]
    x, y = (sizes[:, k, None] / 2 * np.array(signs) for k, signs in ((0, [1, 1, -1, -1]), (1, [-1, 1, 1, -1])))
    return np.stack([state.position_m[:, :1] + x * cos - y * sin, state.position_m[:, 1:2] + x * sin + y * cos], axis=2)


def overlapping(state: BodyStates, sizes: np.ndarray) -> list[tuple[int, int]]:
    """Pairs whose footprints overlap: no axis of either separates their corners."""
    reach = np.hypot(sizes[:, 0], sizes[:, 1]) / 2
    pairs = cKDTree(state.position_m[:, :2]).query_pairs(2 * reach.max(), output_type="ndarray")
    apart = np.hypot(*(state.position_m[pairs[:, 0], :2] - state.position_m[pairs[:, 1], :2]).T)
    pairs = pairs[apart < reach[pairs[:, 0]] + reach[pairs[:, 1]]]
    box = corners(state, sizes)
    touch = np.ones(len(pairs), bool)
    for k in (0, 1):
        yaw = state.yaw_rad[pairs[:, k]]
        for axis in (np.stack([np.cos(yaw), np.sin(yaw)], 1), np.stack([-np.sin(yaw), np.cos(yaw)], 1)):
            p, q = ((box[pairs[:, m]] * axis[:, None]).sum(axis=2) for m in (0, 1))
            touch &= (p.max(axis=1) > q.min(axis=1)) & (q.max(axis=1) > p.min(axis=1))
    return [(int(i), int(j)) for i, j in pairs[touch]]


@pytest.mark.parametrize("name", ["urban", "highway"])
def test_no_two_bodies_overlap(name: str, request: pytest.FixtureRequest) -> None:
    scene: Scene = request.getfixturevalue(name)
    for k in range(0, 600, 2):
        assert overlapping(scene.motion.at(k / 10 + 0.03), scene.sizes) == []


def test_the_check_itself_finds_overlaps(urban: Scene) -> None:
    state = urban.states[0]
    moved = state.position_m.copy()
    moved[1] = moved[0] + [1.0, 0.5, 0.0]
    fields = {name: getattr(state, name) for name in BodyStates.__dataclass_fields__} | {"position_m": moved}
    assert overlapping(BodyStates(**fields), urban.sizes) != []


@pytest.mark.slow
@pytest.mark.parametrize(("world", "density", "seed", "seconds"), [
    ("urban", "normal", 11, 3000), ("urban", "dense", 12, 2000), ("urban", "normal", 13, 1500),
    ("highway", "normal", 14, 2000), ("highway", "dense", 15, 1500),
])  # fmt: skip
def test_nobody_touches_anybody_in_hours(world: str, density: str, seed: int, seconds: int) -> None:
    traffic = Traffic(layout(world, seed), TrafficParams.of(world, density), seed)  # type: ignore[arg-type]
    sizes = np.array([actor.body.size_lwh_m for actor in traffic.actors])
    moving = np.array([not actor.parked for actor in traffic.actors])
    standing, longest, speeds = np.zeros(len(sizes)), 0.0, []
    for begin in range(0, seconds, 50):
        motion = traffic.motion(float(begin), begin + 50.0)
        for k in range(500):
            state = motion.at(begin + k / 10)
            assert overlapping(state, sizes) == []
            speed = np.hypot(*state.velocity_mps[:, :2].T)
            standing = np.where((speed < 0.1) & moving, standing + 0.1, 0.0)
            longest = max(longest, float(standing.max()))
            speeds.append(float(speed[moving].mean()))
    assert np.mean(speeds[-3000:]) > (15.0 if world == "highway" else 0.8)
    assert longest < 4 * 120
    assert traffic.num_emergencies < 5 * seconds / 3600 + 2
