"""Signals of the urban world: never two of one junction at once, with time to clear it in between."""

import numpy as np

from fbench.datasets.city.world.layout import Layout

BUS_M, SLOW_MPS, SLOW_WALK_MPS = 12.0, 5.0, 1.0


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


def _way_m(urban: Layout, group: int) -> float:
    """The longest way through the junction of those whom a group stops."""
    lanes = urban.map.lanes
    onto = [lanes[k] for lane in lanes if lane.signal == group for k in lane.successors]
    return max(float(np.linalg.norm(np.diff(lane.points_m, axis=0), axis=1).sum()) for lane in onto)


def test_there_are_sixteen_junctions(urban: Layout) -> None:
    sizes = sorted(len(groups) for groups in _junctions(urban))
    assert sizes == [3] * 4 + [4] * 8 + [5] * 4  # approaches and one for all pedestrians


def test_no_two_groups_of_a_junction_are_green_or_clearing_at_once(urban: Layout) -> None:
    plan = urban.map.signals
    walks = {lane.signal for lane in urban.map.lanes if lane.kind == "walk"}
    times = np.arange(0, plan.cycle_s, 0.05)
    for groups in _junctions(urban):
        busy = np.zeros(len(times), int)
        for group in groups:
            way = _way_m(urban, group)
            clear = way / SLOW_WALK_MPS if group in walks else 3.0 + (way + BUS_M) / SLOW_MPS
            since = (times - plan.green_from_s[group]) % plan.cycle_s
            busy += since < plan.green_s[group] + clear - 0.01
        assert busy.max() == 1


def test_greens_are_long_enough_and_fit_into_the_cycle(urban: Layout) -> None:
    plan = urban.map.signals
    walks = sorted({lane.signal for lane in urban.map.lanes if lane.kind == "walk" and lane.signal is not None})
    drives = sorted({lane.signal for lane in urban.map.lanes if lane.kind == "drive" and lane.signal is not None})
    assert set(walks) | set(drives) == set(range(plan.num_groups))
    assert not set(walks) & set(drives)
    assert plan.green_s[drives].min() >= 8.0
    assert plan.green_s[walks].min() >= 6.0
    assert ((plan.green_from_s >= 0) & (plan.green_from_s < plan.cycle_s)).all()
    assert plan.cycle_s < 130


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
