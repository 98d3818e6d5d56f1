"""What `Motion` promises: smooth, consistent, the same for whoever asks."""

import subprocess
import sys

import numpy as np
import pytest
from tests.datasets.city.traffic.conftest import SECONDS, Scene

from fbench.datasets.city.instant import BodyStates
from fbench.datasets.city.traffic.placing import TrafficParams
from fbench.datasets.city.traffic.traffic import Traffic
from fbench.datasets.city.world.urban import layout
from fbench.replay.contracts.errors import ConfigError

NAMES = ("position_m", "yaw_rad", "velocity_mps", "phase", "braking")
STATE = f"""
from fbench.datasets.city.traffic.placing import TrafficParams
from fbench.datasets.city.traffic.traffic import Traffic
from fbench.datasets.city.world.urban import layout
traffic = Traffic(layout("urban", 5), TrafficParams.of("urban"), 5)
state = traffic.motion(0.0, 12.0).at(11.87)
print(b"".join(getattr(state, name).tobytes() for name in {NAMES!r}).hex())
"""


@pytest.fixture(scope="module")
def traffic() -> Traffic:
    """Of another seed than `urban`, at its beginning; tests look at copies of it."""
    return Traffic(layout("urban", 3), TrafficParams.of("urban"), 3)


def scenes(request: pytest.FixtureRequest) -> Scene:
    return request.getfixturevalue(request.param)  # type: ignore[no-any-return]


scene = pytest.fixture(scenes, params=["urban", "highway"])


def same(a: BodyStates, b: BodyStates) -> bool:
    names = ("position_m", "yaw_rad", "velocity_mps", "yaw_rate_radps", "phase", "braking", "lamps")
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in names)


def turned(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray((b - a + np.pi) % (2 * np.pi) - np.pi)


@pytest.mark.slow
def test_velocity_and_yaw_rate_are_derivatives(scene: Scene) -> None:
    h = 1e-4
    for time_s in (1.234, 7.777, 33.351, 60.05, 80.962):
        a, m, b = (scene.motion.at(time_s + d) for d in (-h, 0, h))
        assert np.abs((b.position_m - a.position_m) / (2 * h) - m.velocity_mps).max() < 1e-3
        assert np.abs(turned(a.yaw_rad, b.yaw_rad) / (2 * h) - m.yaw_rate_radps).max() < 5e-3


def test_bodies_never_jump(scene: Scene) -> None:
    for k in range(1, SECONDS * 10):
        a, b = scene.motion.at(k / 10 - 1e-7), scene.states[k]
        assert np.abs(a.position_m - b.position_m).max() < 1e-3
        assert np.abs(turned(a.yaw_rad, b.yaw_rad)).max() < 5e-3


def test_bodies_look_where_they_go(scene: Scene) -> None:
    for state in scene.states[::25]:
        speed = np.hypot(*state.velocity_mps[:, :2].T)
        course = np.arctan2(state.velocity_mps[:, 1], state.velocity_mps[:, 0])
        moving = speed > 1.0
        assert np.abs(turned(course, state.yaw_rad))[moving].max() < 0.25


def test_speeds_and_accelerations_are_plausible(scene: Scene) -> None:
    speed = np.array([np.hypot(*s.velocity_mps[:, :2].T) for s in scene.states])
    assert speed.max() < 45
    assert speed[:, ~scene.parked].mean() > 0.8
    assert speed[:, scene.labels == "pedestrian"].max(initial=0.0) < 1.8
    assert speed[:, (scene.labels == "bicycle")].max(initial=0.0) < 6.5
    change = np.diff(speed, axis=0) / 0.1
    assert change.max() < 3.5
    assert (change < -9.5).sum() <= scene.traffic.num_emergencies + 1


def test_parked_bodies_stand_and_come_last(scene: Scene) -> None:
    first, last = scene.states[0], scene.states[-1]
    assert np.array_equal(first.position_m[scene.parked], last.position_m[scene.parked])
    assert not np.diff(scene.parked.astype(int)).min(initial=0) < 0


def test_the_ego_car_drives_at_once(scene: Scene) -> None:
    assert scene.labels[0] == "car"
    assert 4.2 < scene.sizes[0, 0] < 4.8
    speed = [float(np.hypot(*s.velocity_mps[0, :2])) for s in scene.states[:50]]
    assert min(speed) > 2.0


def test_gait_goes_on_with_distance(urban: Scene) -> None:
    walks = urban.labels == "pedestrian"
    a, b = urban.states[100], urban.states[101]
    gone = np.hypot(*(b.position_m - a.position_m)[walks, :2].T)
    cycle = 1.4 * urban.sizes[walks, 2] / 1.75
    assert ((b.phase - a.phase)[walks] % 1.0) == pytest.approx(gone / cycle, abs=0.02)
    assert (b.phase[~walks & (urban.labels != "bicycle")] == 0).all()


@pytest.mark.slow
def test_other_rates_and_chunks_see_the_same(traffic: Traffic) -> None:
    whole, chunks = traffic.rewind().motion(0.0, 6.0), traffic.rewind()
    early = [chunks.motion(float(k), k + 1.0) for k in range(6)]
    for k, motion in enumerate(early):
        for time_s in (k, k + 0.05, k + 1 / 3, k + 0.7, k + 1.0):
            assert same(motion.at(time_s), whole.at(time_s))


@pytest.mark.slow
def test_rewound_traffic_begins_again(traffic: Traffic) -> None:
    traffic = traffic.rewind()
    first = traffic.motion(0.0, 4.0)
    again, later = traffic.rewind(), traffic.motion(4.0, 6.0)
    second = again.motion(0.0, 6.0)
    for time_s in (0.0, 1.3, 4.0):
        assert same(first.at(time_s), second.at(time_s))
    assert same(later.at(5.5), second.at(5.5))
    assert again.actors == traffic.actors
    assert again.num_lane_changes == traffic.num_lane_changes


@pytest.mark.slow
def test_time_never_goes_back(highway: Scene) -> None:
    traffic = Traffic(highway.layout, TrafficParams.of("highway"), 1)
    motion = traffic.motion(1.0, 2.0)
    before = motion.at(1.5)
    traffic.motion(5.0, 6.0)
    assert same(before, motion.at(1.5))
    with pytest.raises(ConfigError, match="ascending"):
        traffic.motion(0.0, 1.0)
    with pytest.raises(ConfigError, match="expected a time"):
        motion.at(2.5)


@pytest.mark.slow
def test_same_seed_same_bytes_in_a_fresh_process_and_other_seed_other(urban: Scene, traffic: Traffic) -> None:
    found = subprocess.run([sys.executable, "-c", STATE], capture_output=True, text=True, check=True).stdout.strip()
    here, other = (
        b"".join(getattr(motion.at(11.87), name).tobytes() for name in NAMES).hex()
        for motion in (urban.motion, traffic.rewind().motion(0.0, 12.0))
    )
    assert found == here != other
