"""Lanes of both worlds: closed, smooth, side by side."""

import numpy as np
import pytest

from fbench.datasets.city.world.city_map import Lane, Layout
from fbench.datasets.city.world.urban import layout

WORLDS = [("urban", 0), ("urban", 1), ("urban", 2), ("urban", 7), ("highway", 0)]


@pytest.fixture(scope="module", params=WORLDS, ids=lambda world: f"{world[0]}-{world[1]}")
def world(request: pytest.FixtureRequest) -> Layout:
    return layout(*request.param)


def _headings(points: np.ndarray) -> np.ndarray:
    steps = np.diff(points[:, :2], axis=0)
    return np.arctan2(steps[:, 1], steps[:, 0])


def _jumps(headings: np.ndarray) -> np.ndarray:
    return np.abs((np.diff(headings) + np.pi) % (2 * np.pi) - np.pi)


def test_every_lane_goes_on_and_joins(world: Layout) -> None:
    lanes = world.map.lanes
    for lane in lanes:
        assert lane.successors
        for after in (lanes[i] for i in lane.successors):
            np.testing.assert_allclose(lane.points_m[-1], after.points_m[0], atol=1e-6)
            assert after.kind == lane.kind


def test_headings_are_smooth_within_lanes_and_over_joints(world: Layout) -> None:
    lanes = world.map.lanes
    for lane in lanes:
        assert _jumps(_headings(lane.points_m)).max(initial=0) < 0.1
        for after in (lanes[i] for i in lane.successors):
            joint = np.concatenate([lane.points_m[-2:], after.points_m[1:2]])
            assert _jumps(_headings(joint)).max() < 0.1


def test_points_are_near_each_other_and_none_repeats(world: Layout) -> None:
    for lane in world.map.lanes:
        steps = np.linalg.norm(np.diff(lane.points_m, axis=0), axis=1)
        assert steps.max() <= 1.0 + 1e-9
        assert steps.min() > 0.01


def test_every_lane_is_reached(world: Layout) -> None:
    reached = {i for lane in world.map.lanes for i in lane.successors}
    assert reached == set(range(len(world.map.lanes)))


def test_neighbors_lie_beside_each_other(world: Layout) -> None:
    lanes = world.map.lanes
    for i, lane in enumerate(lanes):
        for other, side in ((lane.left, 1), (lane.right, -1)):
            if other is None:
                continue
            beside = lanes[other]
            assert (beside.right if side == 1 else beside.left) == i
            assert beside.points_m.shape == lane.points_m.shape
            across = (beside.points_m - lane.points_m)[:-1, :2]
            heading = _headings(lane.points_m)
            lateral = across[:, 1] * np.cos(heading) - across[:, 0] * np.sin(heading)
            np.testing.assert_allclose(lateral, side * lane.width_m, atol=0.01)


def test_long_vehicles_always_find_a_way_on(world: Layout) -> None:
    lanes = world.map.lanes
    for length_m in (5.0, 8.0, 12.0):
        allowed = [lane for lane in lanes if lane.kind == "drive" and lane.longest_m >= length_m]
        assert allowed
        for lane in allowed:
            assert any(lanes[i].longest_m >= length_m for i in lane.successors)


def test_all_drive_lanes_are_one_network_for_cars_and_each_direction_of_the_highway(world: Layout) -> None:
    lanes = world.map.lanes
    drives = [i for i, lane in enumerate(lanes) if lane.kind == "drive"]
    share = len(_reachable(lanes, drives[0])) / len(drives)
    assert share == (1.0 if world.map.name == "urban" else 0.5)


def test_people_reach_every_block_by_crossings(world: Layout) -> None:
    lanes = world.map.lanes
    crossings = [i for i, lane in enumerate(lanes) if lane.kind == "walk" and lane.in_junction]
    for start in crossings[:1]:
        assert set(crossings) <= _reachable(lanes, start)


def _reachable(lanes: tuple[Lane, ...], start: int) -> set[int]:
    """By successors and changes of lane."""
    seen, todo = {start}, [start]
    while todo:
        lane = lanes[todo.pop()]
        for after in (*lane.successors, lane.left, lane.right):
            if after is not None and after not in seen:
                seen.add(after)
                todo.append(after)
    return seen
