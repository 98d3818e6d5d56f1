"""Who follows which rules, seen from outside."""

import numpy as np
from scipy.spatial import cKDTree
from tests.datasets.city.traffic.conftest import Scene

from fbench.datasets.city.world.city_map import Lane


def fronts(scene: Scene) -> np.ndarray:
    """(T, N, 2)."""
    half = scene.sizes[:, 0] / 2
    return np.array([s.position_m[:, :2] + half[:, None] * np.column_stack([np.cos(s.yaw_rad), np.sin(s.yaw_rad)])
                     for s in scene.states])  # fmt: skip


def line_of(lane: Lane) -> tuple[np.ndarray, np.ndarray]:
    ahead = lane.points_m[-1, :2] - lane.points_m[-2, :2]
    return lane.points_m[-1, :2], ahead / np.hypot(*ahead)


def test_nobody_passes_a_red_light(urban: Scene) -> None:
    city_map, front, passed = urban.layout.map, fronts(urban), 0
    yaw = np.array([s.yaw_rad for s in urban.states[1:]])
    cos, sin = np.cos(yaw), np.sin(yaw)
    for lane in city_map.lanes:
        if lane.signal is None:
            continue
        end, ahead = line_of(lane)
        left = np.array([-ahead[1], ahead[0]])
        along, aside = (front - end) @ ahead, np.abs((front - end) @ left)
        over = (along[:-1] < 0) & (along[1:] >= 0) & (aside[1:] < 0.7) & (along[1:] < 3)
        facing = cos * ahead[0] + sin * ahead[1] > 0.9
        for step, _ in np.argwhere(over & facing):
            now = city_map.signals.is_green(step / 10) | city_map.signals.is_yellow(step / 10)
            assert now[lane.signal]
            passed += 1
    assert passed > 20


def test_nobody_stands_in_a_junction(urban: Scene) -> None:
    vehicles = np.isin(urban.labels, ["car", "van", "truck", "bus", "motorcycle"]) & ~urban.parked
    inner = np.concatenate([lane.points_m[2:-2, :2] for lane in urban.layout.map.lanes
                            if lane.in_junction and lane.kind == "drive"])  # fmt: skip
    standing = np.zeros(len(vehicles))
    for state in urban.states[::5]:
        slow = vehicles & (np.hypot(*state.velocity_mps[:, :2].T) < 0.1)
        near = np.zeros(len(vehicles), bool)
        for i in np.flatnonzero(slow):
            near[i] = np.hypot(*(inner - state.position_m[i, :2]).T).min() < 0.6
        standing = np.where(near, standing + 0.5, 0.0)
        assert standing.max() < 5.0


def test_nobody_stands_for_ever(urban: Scene) -> None:
    moved = urban.states[-1].position_m - urban.states[0].position_m
    assert (np.hypot(*moved[~urban.parked, :2].T) > 0.5).mean() > 0.8


def test_brake_lights_shine_while_slowing(urban: Scene) -> None:
    speed = np.array([np.hypot(*s.velocity_mps[:, :2].T) for s in urban.states])
    braking = np.array([s.braking for s in urban.states])[:-1]
    hard = (np.diff(speed, axis=0) / 0.1 < -1.5) & ~urban.parked & (urban.labels == "car")
    assert braking[hard].mean() > 0.95
    rising = (np.diff(speed, axis=0) / 0.1 > 0.7) & (speed[:-1] > 1.0) & (urban.labels == "car")
    assert braking[rising].mean() < 0.05


def test_lamps_show_one_color_of_each_signal(urban: Scene) -> None:
    for state in urban.states[::10]:
        assert (state.lamps.reshape(-1, 3).sum(axis=1) == 1).all()


def test_lane_changes_are_smooth_and_sideways(highway: Scene) -> None:
    assert highway.traffic.num_lane_changes > 3
    lanes = highway.layout.map.lanes
    tree = cKDTree(np.concatenate([lane.points_m[:-1, :2] for lane in lanes]))
    step = np.concatenate([np.diff(lane.points_m[:, :2], axis=0) for lane in lanes])
    ahead = step / np.hypot(*step.T)[:, None]
    rows = [ahead[tree.query(s.position_m[:, :2])[1]] for s in highway.states]
    sideways = np.array([s.velocity_mps[:, 1] * r[:, 0] - s.velocity_mps[:, 0] * r[:, 1]
                         for s, r in zip(highway.states, rows, strict=True)])  # fmt: skip
    assert 0.5 < np.abs(sideways).max() < 3.0  # 3.5 m in 3.5 s: at most 1.9 m/s
    assert np.abs(np.diff(sideways, axis=0)).max() < 0.4  # 10 / sqrt(3) * 3.5 / 3.5^2 = 1.65 m/s^2


def test_trucks_keep_off_the_fast_lane(highway: Scene) -> None:
    fast = np.concatenate([lane.points_m[:, :2] for lane in highway.layout.map.lanes if lane.left is None])
    for i in np.flatnonzero(highway.labels == "truck"):
        for state in highway.states[::100]:
            assert np.hypot(*(fast - state.position_m[i, :2]).T).min() > 1.0
