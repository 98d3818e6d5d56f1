"""Overtaking, crossing, waiting for room: on toy maps; and nobody walks before wheels."""

import numpy as np
import pytest
from tests.datasets.city.traffic.conftest import Scene
from tests.datasets.city.traffic.test_traffic_long import overlapping

from fbench.datasets.city.instant import BodyStates
from fbench.datasets.city.traffic.placing import TrafficParams
from fbench.datasets.city.traffic.traffic import Traffic
from fbench.datasets.city.world.city_map import CityMap, Lane, Layout, SignalPlan

NO_SIGNALS = SignalPlan(60.0, np.zeros(0), np.zeros(0))
CARS = {"car": 1.0}


def _toy(lanes: tuple[Lane, ...], signals: SignalPlan = NO_SIGNALS) -> Layout:
    return Layout(CityMap("toy", lanes, signals, (), (), np.zeros((0, 3))), (), ())


def _arc(middle: tuple[float, float], radius: float, start: float, turn: float, num: int) -> np.ndarray:
    angle = np.linspace(start, start + turn, num)
    return np.column_stack([middle[0] + radius * np.cos(angle), middle[1] + radius * np.sin(angle), 0 * angle])


def _ring() -> Layout:
    """Two lanes around a circle of 200 m, in quarters; the left one is inside."""
    left = [_arc((0, 0), 196.5, q * np.pi / 2, np.pi / 2, 330) for q in range(4)]
    right = [_arc((0, 0), 200.0, q * np.pi / 2, np.pi / 2, 330) for q in range(4)]
    return _toy((
        *(Lane(points, 3.5, 20.0, "drive", ((q + 1) % 4,), right=4 + q) for q, points in enumerate(left)),
        *(Lane(points, 3.5, 20.0, "drive", (4 + (q + 1) % 4,), left=q) for q, points in enumerate(right)),
    ))  # fmt: skip


def _eight(green_s: float) -> Layout:
    """A figure of eight whose straights cross; the line of a signal is 21 m after the crossing."""
    x = np.linspace(-25.0, 25.0, 51)
    east, north = np.column_stack([x, 0 * x, 0 * x]), np.column_stack([0 * x, x, 0 * x])
    loop = _arc((25, -25), 25.0, np.pi / 2, -1.5 * np.pi, 132)
    return _toy((
        Lane(east, 3.5, 8.0, "drive", (1,), in_junction=True),
        Lane(loop[:24], 3.5, 8.0, "drive", (2,), signal=0),
        Lane(loop[23:], 3.5, 8.0, "drive", (3,)),
        Lane(north, 3.5, 8.0, "drive", (4,), in_junction=True),
        Lane(_arc((-25, 25), 25.0, 0.0, 1.5 * np.pi, 132), 3.5, 8.0, "drive", (0,)),
    ), SignalPlan(60.0, np.zeros(1), np.array([green_s])))  # fmt: skip


def _states(layout: Layout, vehicles_per_km: float, seconds: int) -> tuple[list[BodyStates], np.ndarray, Traffic]:
    traffic = Traffic(layout, TrafficParams(vehicles_per_km, mix=CARS, speed_spread=0.15), 4)
    motion = traffic.motion(0.0, float(seconds))
    sizes = np.array([actor.body.size_lwh_m for actor in traffic.actors])
    return [motion.at(k / 10) for k in range(seconds * 10)], sizes, traffic


@pytest.mark.slow
def test_on_a_ring_faster_ones_pass_on_the_left_and_return() -> None:
    states, sizes, traffic = _states(_ring(), 8.0, 120)
    radius = np.array([np.hypot(*state.position_m[:, :2].T) for state in states])
    angle = np.unwrap([np.arctan2(*state.position_m[:, 1::-1].T) for state in states], axis=0)
    assert ((radius > 195.5) & (radius < 201)).all()
    assert traffic.num_lane_changes > 3
    assert (radius < 197).any()
    assert np.median(radius) > 199  # keeping right
    gone = angle[-1] - angle[0]
    assert gone.min() > 0
    assert gone.max() - gone.min() > 0.5
    assert not any(overlapping(state, sizes) for state in states[::5])
    assert traffic.num_emergencies == 0


def test_only_one_direction_is_on_a_crossing_without_signals() -> None:
    states, sizes, traffic = _states(_eight(np.inf), 90.0, 120)
    assert len(sizes) >= 5
    for state in states:
        x, y = state.position_m[:, 0], state.position_m[:, 1]
        east = (np.cos(state.yaw_rad) > 0.9) & (np.abs(y) < 0.5) & (np.abs(x) < 1.3 + sizes[:, 0] / 2)
        north = (np.sin(state.yaw_rad) > 0.9) & (np.abs(x) < 0.5) & (np.abs(y) < 1.3 + sizes[:, 0] / 2)
        assert not (east.any() and north.any())
    speed = np.array([np.hypot(*state.velocity_mps[:, :2].T) for state in states])
    assert speed.mean(axis=0).min() > 1.0
    assert traffic.num_emergencies == 0


def test_nobody_enters_a_crossing_that_has_no_room_behind_it() -> None:
    states, sizes, _ = _states(_eight(0.0), 90.0, 60)
    last = states[-1]
    assert np.hypot(*last.velocity_mps[:, :2].T).max() < 0.05
    x, y = last.position_m[:, 0], last.position_m[:, 1]
    front_east, rear_east = x + sizes[:, 0] / 2, x - sizes[:, 0] / 2
    on_east = (np.abs(y) < 0.5) & (np.cos(last.yaw_rad) > 0.9)
    assert not (on_east & (front_east > -25.0) & (rear_east < 25.0)).any()
    assert len(sizes) >= 5  # three have room before the line; others wait


def test_nobody_is_on_the_road_on_foot_when_vehicles_get_green(urban: Scene) -> None:
    walks = urban.labels == "pedestrian"
    lanes = urban.layout.map.lanes
    crossings = [lane.points_m[lane.points_m[:, 2] == 0.0][:, :2] for lane in lanes if lane.kind == "walk"]
    over = [points for points in crossings if len(points)]
    group = {lane.signal: lane.points_m[-1, :2] for lane in lanes if lane.kind == "drive" and lane.signal is not None}
    walked = 0
    for before, state in zip(urban.states[:-1:5], urban.states[5::5], strict=False):
        now, then = (urban.layout.map.signals.is_green(s.time_s) for s in (state, before))
        feet = state.position_m[walks, :2]
        on = [feet[np.hypot(*(feet[:, None] - points[None]).transpose(2, 0, 1)).min(axis=1) < 0.5] for points in over]
        walked += sum(len(points) for points in on)
        for line in (group[k] for k in np.flatnonzero(now & ~then).tolist() if k in group):
            assert all(np.hypot(*(points - line).T).min(initial=np.inf) > 12.0 for points in on)
    assert walked > 50
