"""Signals of the urban world: those who cross go one after the other, and nobody walks while a vehicle may come."""

import numpy as np

from fbench.datasets.city.world.city_map import Layout

CAR_M, CLEAR_MPS, SLOW_WALK_MPS = 6.0, 10.0, 1.0


def _junctions(urban: Layout) -> list[list[int]]:
    """Groups of each junction: those whose lanes' ends lie within 45 m of each other's."""
    ends: dict[int, list[np.ndarray]] = {}
    for lane in urban.map.lanes:
        if lane.signal is not None:
            ends.setdefault(lane.signal, []).append(lane.points_m[-1, :2])
    spots = np.array([np.mean(ends[i], axis=0) for i in range(urban.map.signals.num_groups)])
    parts = [{i} for i in range(len(spots))]
    for i in range(len(spots)):
        for j in np.flatnonzero(np.hypot(*(spots - spots[i]).T) < 45):
            a, b = parts[i], parts[j]
            if a is not b:
                a |= b
                for k in b:
                    parts[k] = a
    return [sorted(part) for i, part in enumerate(parts) if min(part) == i]


def _clear_s(urban: Layout, group: int) -> float:
    """How long the junction isn't empty after a group's green."""
    lanes = urban.map.lanes
    onto = [lanes[k] for lane in lanes if lane.signal == group for k in lane.successors]
    way = [float(np.linalg.norm(np.diff(lane.points_m, axis=0), axis=1).sum()) for lane in onto]
    if onto[0].kind == "walk":
        return max(way) / SLOW_WALK_MPS
    return max(3.0 + (m + CAR_M) / min(CLEAR_MPS, lane.speed_mps) for m, lane in zip(way, onto, strict=True))


def _heading(urban: Layout, group: int) -> np.ndarray:
    points = next(lane.points_m for lane in urban.map.lanes if lane.signal == group and lane.kind == "drive")
    return np.asarray((points[-1] - points[-2])[:2] / np.linalg.norm(points[-1] - points[-2]))


def test_there_are_sixteen_junctions(urban: Layout) -> None:
    sizes = sorted(len(groups) for groups in _junctions(urban))
    assert sizes == [3] * 4 + [4] * 8 + [5] * 4  # approaches and one for all pedestrians


def test_vehicles_that_cross_are_not_let_go_at_once(urban: Layout) -> None:
    plan, walks = urban.map.signals, _walks(urban)
    times = np.arange(0, plan.cycle_s, 0.05)
    busy = (times[:, None] - plan.green_from_s) % plan.cycle_s < plan.green_s + 3.0 + 2.0 - 0.01
    for groups in _junctions(urban):
        drives = [group for group in groups if group not in walks]
        for i, a in enumerate(drives):
            for b in drives[:i]:
                facing = abs(float((_heading(urban, a) * _heading(urban, b)).sum())) > 0.99
                assert facing or len(drives) == 2 or not (busy[:, a] & busy[:, b]).any()


def test_nobody_walks_while_a_vehicle_goes_or_clears(urban: Layout) -> None:
    plan, walks = urban.map.signals, _walks(urban)
    times = np.arange(0, plan.cycle_s, 0.05)
    since = (times[:, None] - plan.green_from_s) % plan.cycle_s
    for groups in _junctions(urban):
        clear = np.array([_clear_s(urban, group) for group in groups])
        busy = since[:, groups] < plan.green_s[groups] + clear - 0.01
        walk = np.isin(groups, list(walks))
        assert walk.sum() == 1
        assert not (busy[:, walk] & busy[:, ~walk]).any()


def _walks(urban: Layout) -> set[int]:
    return {lane.signal for lane in urban.map.lanes if lane.kind == "walk" and lane.signal is not None}


def test_greens_are_long_enough_and_fit_into_the_cycle(urban: Layout) -> None:
    plan = urban.map.signals
    walks = sorted({lane.signal for lane in urban.map.lanes if lane.kind == "walk" and lane.signal is not None})
    drives = sorted({lane.signal for lane in urban.map.lanes if lane.kind == "drive" and lane.signal is not None})
    assert set(walks) | set(drives) == set(range(plan.num_groups))
    assert not set(walks) & set(drives)
    assert plan.green_s[drives].min() >= 12.0
    assert plan.green_s[walks].min() >= 5.0
    assert ((plan.green_from_s >= 0) & (plan.green_from_s < plan.cycle_s)).all()
    assert 60 < plan.cycle_s < 75


def test_every_way_into_a_junction_is_signalled(urban: Layout) -> None:
    lanes = urban.map.lanes
    for lane in lanes:
        enters = not lane.in_junction and any(lanes[i].in_junction for i in lane.successors)
        assert enters == (lane.signal is not None)


def test_signals_stand_for_every_group(urban: Layout) -> None:
    shown = {p.signal for p in urban.placements if p.kind == "signal"}
    assert shown == set(range(urban.map.signals.num_groups))
    assert all(p.signal is None for p in urban.placements if p.kind != "signal")


def test_the_highway_has_no_signals(highway: Layout) -> None:
    assert highway.map.signals.num_groups == 0
    assert not highway.map.signals.is_green(12.0).any()
    assert all(lane.signal is None and lane.kind == "drive" for lane in highway.map.lanes)
