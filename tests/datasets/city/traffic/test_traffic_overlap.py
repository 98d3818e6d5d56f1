"""Who is stopped at once lest bodies touch, on poses written by hand."""

import numpy as np
import pytest

from fbench.datasets.city.traffic.network import MOVER
from fbench.datasets.city.traffic.occupancy_kernel import near_pairs
from fbench.datasets.city.traffic.path_kernel import MARGIN_M, overlaps, stop_before_touching

SIZE = (4.0, 2.0)


def poses(*rows: tuple[float, float, float]) -> np.ndarray:
    """Poses (N, 9) of x, y, yaw."""
    result = np.zeros((len(rows), 9))
    result[:, [0, 1, 6]] = rows
    return result


def stopped(now: np.ndarray, then: np.ndarray, frozen: tuple[int, ...] = ()) -> tuple[list[int], int]:
    """Who is stopped (with those of `frozen`), and how many drove."""
    movers = np.zeros(len(now), MOVER)
    movers["speed_mps"] = np.hypot(*(then - now)[:, :2].T) / 0.1
    movers["frozen"][list(frozen)] = True
    sizes = np.full((len(now), 2), SIZE)
    goes_on = then.copy()
    num = stop_before_touching(movers, now, then, sizes, near_pairs(now, then, sizes, MARGIN_M))
    who = np.flatnonzero(movers["frozen"])
    assert np.array_equal(then[who], np.where(np.isin(who, frozen)[:, None], goes_on[who], now[who]))
    assert movers["braking"][[i for i in who if i not in frozen]].all()
    rest = np.flatnonzero(~movers["frozen"])
    assert np.array_equal(then[rest], goes_on[rest])
    return who.tolist(), num


@pytest.mark.parametrize(("gap_m", "stops"), [(0.04, True), (0.06, False)])
def test_a_follower_stops_short_of_who_stands(gap_m: float, stops: bool) -> None:
    # It goes 1 m, up to `gap_m` before the other; nearer than 0.05 m is too near.
    now, then = poses((5.0 + gap_m, 0, 0), (0, 0, 0)), poses((5.0 + gap_m, 0, 0), (1, 0, 0))
    assert stopped(now, then) == (([1], 1) if stops else ([], 0))


@pytest.mark.parametrize("numbers", [(0, 1), (1, 0)])
def test_whoever_is_behind_stops(numbers: tuple[int, int]) -> None:
    rear, front = numbers
    now, then = np.zeros((2, 9)), np.zeros((2, 9))
    now[front, 0], then[front, 0], then[rear, 0] = 4.5, 4.7, 1.5
    assert stopped(now, then) == ([rear], 1)


def test_who_has_the_higher_number_stops_when_both_see_each_other() -> None:
    assert stopped(poses((0, 0, 0), (5, 0, np.pi)), poses((1, 0, 0), (4, 0, np.pi))) == ([1], 1)


def test_a_queue_stops_one_after_the_other() -> None:
    # Each goes on by 1 m, 0.5 m behind the one before; whoever stands at the head stops all, in any order of numbers.
    place = np.array([3, 0, 4, 1, 2]) * 4.5
    now = poses(*((x, 0.0, 0.0) for x in place))
    then = now.copy()
    then[place < 18, 0] += 1.0
    assert stopped(now, then) == ([0, 1, 3, 4], 4)


def test_who_goes_on_beside_or_ahead_is_left_alone() -> None:
    now = poses((0, 0, 0), (0, 2.2, 0), (9, 0, 0))
    assert stopped(now, now + np.eye(9)[0]) == ([], 0)


def test_who_is_stopped_already_stays_where_it_is_and_others_stop_for_it() -> None:
    # They stand 0.02 m apart, nearer than the margin: who may drive away isn't held for that.
    now = poses((0, 0, 0), (4.02, 0, 0))
    assert stopped(now, poses((0, 0, 0), (5, 0, 0)), frozen=(0,)) == ([0], 0)
    assert stopped(now, poses((1, 0, 0), (4.02, 0, 0)), frozen=(1,)) == ([0, 1], 1)


def test_near_pairs_hold_all_that_touch_even_in_a_crowd() -> None:
    draw = np.random.default_rng(0)
    for num, wide_m in ((60, 1.0), (60, 30.0), (80, 200.0), (1, 1.0), (0, 1.0)):
        now = np.zeros((num, 9))
        now[:, :2] = draw.uniform(0, wide_m, (num, 2))
        then = now + draw.uniform(-1, 1, (num, 9))
        sizes = draw.uniform(0.5, 12.0, (num, 2))
        found = {frozenset(pair) for pair in near_pairs(now, then, sizes, MARGIN_M).tolist()}
        half = np.hypot(*sizes.T) / 2
        for i in range(num):
            for j in range(i):
                apart = min(np.hypot(*(a[i, :2] - b[j, :2])) for a in (now, then) for b in (now, then))
                assert apart > half[i] + half[j] + 2 * MARGIN_M or {i, j} in found
        assert len(found) == len(near_pairs(now, then, sizes, MARGIN_M))
        assert wide_m < 200 or len(found) < num * (num - 1) / 8


@pytest.mark.parametrize(("ahead_m", "is_near"), [(11.9, True), (12.04, True), (12.06, False)])
def test_long_vehicles_touch_end_to_end(ahead_m: float, is_near: bool) -> None:
    """Their centers are farther apart than their width and one length would allow."""
    first, second = poses((0, 0, 0), (ahead_m, 0, 0))
    size = np.array([12.0, 2.5])
    assert overlaps(first, second, size, size, 0.05) is is_near
    assert overlaps(second, first, size, size, 0.05) is is_near
