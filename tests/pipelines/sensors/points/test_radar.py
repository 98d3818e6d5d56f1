from dataclasses import replace

import numpy as np
import pytest
from tests.pipelines.scenes import echoes, radial, surroundings

from fbench.pipelines.sensors.points.merged import Echoes
from fbench.pipelines.sensors.radar.doppler import wrap_velocity
from fbench.pipelines.sensors.radar.stage import RadarParams, compensate, detect, resolve_scoring
from fbench.replay.data.metadata import SIMULATED
from fbench.replay.data.rig import LogInfo

PERIOD = 10.4


def scan(xyz, velocity, magnitude=60.0, period_mps=0.0):
    direction = xyz / np.linalg.norm(xyz, axis=1)[:, None]
    return Echoes(xyz, direction, velocity, np.full(len(xyz), magnitude), period_mps)


def scene(over_ground_mps, ego_mps=8.0, period_mps=0.0):
    car, rest = echoes(20.0, 2.0), surroundings()
    velocity = np.concatenate([radial(car, ego_mps, over_ground_mps), radial(rest, ego_mps)])
    return scan(np.concatenate([car, rest]), wrap_velocity(velocity, period_mps), period_mps=period_mps)


def found(*scans, params=RadarParams()):  # noqa: B008
    return detect(compensate(scans, {scan.sensor: params for scan in scans}), params).boxes


@pytest.mark.parametrize("speed", [-6.0, 0.8, 5.0])
def test_moving_car_with_its_velocity(speed):
    boxes = found(scene(speed))
    assert len(boxes) == 1
    assert boxes.center_m[0, :2] == pytest.approx([21.7, 2.2], abs=0.4)
    assert boxes.size_lwh_m[0] == pytest.approx([4.2, 1.8, 1.6])
    assert boxes.velocity_mps is not None
    assert boxes.velocity_mps[0, 0] == pytest.approx(speed, abs=0.1)
    assert boxes.score is not None
    assert boxes.score[0] == pytest.approx(1 - np.exp(-2))


def test_far_echoes_count_more_where_rays_spread():
    """40 echoes on a car 20 m away, whose middle is completed to 21.7 m or so."""
    near, far = (found(scene(5.0), params=RadarParams(full_score_within_m=within)) for within in (30.0, 10.0))
    distance = np.hypot(*far.center_m[0, :2])
    assert near.score[0] == pytest.approx(1 - np.exp(-2))
    assert far.score[0] == pytest.approx(1 - np.exp(-2 * (distance / 10) ** 2))


def test_rays_spread_in_simulated_logs():
    simulated, other = LogInfo("drive", "id", {SIMULATED: "city"}), LogInfo("drive", "id")
    assert resolve_scoring(RadarParams(), simulated).full_score_within_m == 20.0
    assert resolve_scoring(RadarParams(full_score_within_m=50.0), simulated).full_score_within_m == 50.0
    assert resolve_scoring(RadarParams(), other).full_score_within_m is None


def test_stationary_things_are_not_found():
    assert len(found(scene(0.0))) == 0
    assert len(found(scene(0.2))) == 0


def test_velocities_across_the_seam_of_the_period_are_one_cluster():
    car, rest = echoes(20.0, 2.0), surroundings()
    over_ground = PERIOD / 2 + 0.1 * np.sin(np.arange(len(car)))
    velocity = np.concatenate([radial(car, 8.0, over_ground), radial(rest, 8.0)])
    boxes = found(scan(np.concatenate([car, rest]), wrap_velocity(velocity, PERIOD), period_mps=PERIOD))
    assert len(boxes) == 1
    assert boxes.score is not None
    assert boxes.score[0] == pytest.approx(1 - np.exp(-2))


def test_two_radars_with_different_motion_are_merged():
    backwards = scene(5.0)
    turned = Echoes(
        backwards.xyz * [-1, -1, 1],
        backwards.direction * [-1, -1, 1],
        radial(backwards.xyz * [-1, -1, 1], 8.0, np.r_[np.full(40, 5.0), np.zeros(300)]),
        backwards.magnitude_db,
    )
    boxes = found(scene(5.0), turned)
    assert sorted(boxes.center_m[:, 0].round().tolist()) == [-22.0, 22.0]
    assert boxes.velocity_mps is not None
    assert np.sign(boxes.velocity_mps[:, 0]).tolist() == np.sign(boxes.center_m[:, 0]).tolist()


def test_long_vehicles_keep_their_length():
    bus = echoes(20.0, 2.0, num=80, length_m=12.0)
    rest = surroundings()
    velocity = np.concatenate([radial(bus, 8.0, 4.0), radial(rest, 8.0)])
    boxes = found(scan(np.concatenate([bus, rest]), velocity))
    assert boxes.size_lwh_m[0, 0] == pytest.approx(0.8 * 12, abs=0.5)
    assert boxes.center_m[0, 0] == pytest.approx(26.0, abs=0.5)


def test_without_velocities_everything_may_move():
    boxes = found(scan(echoes(20.0, 2.0), np.full(40, np.nan)))
    assert len(boxes) == 1
    assert boxes.velocity_mps is not None
    assert np.isnan(boxes.velocity_mps).all()


@pytest.mark.parametrize("xyz", [np.zeros((0, 3)), np.ones((1, 3)), np.full((50, 3), 100.0)])
def test_nothing_to_find(xyz):
    assert len(found(Echoes(xyz, xyz / np.sqrt(3), np.ones(len(xyz)), np.ones(len(xyz))))) == 0


def test_equal_points_are_one_place():
    assert len(found(scan(np.ones((50, 3)), np.full(50, 3.0)))) <= 1


def test_weak_and_far_echoes_can_be_left_out():
    params = RadarParams()
    assert len(found(scene(5.0), params=replace(params, min_magnitude_db=61.0))) == 0
    assert len(found(scene(5.0), params=replace(params, max_range_m=15.0))) == 0


def test_unknown_magnitudes_are_never_weak():
    params = RadarParams(min_magnitude_db=61.0)
    unknown = scene(5.0)
    boxes = found(replace(unknown, magnitude_db=np.full(len(unknown.xyz), np.nan)), params=params)
    assert len(boxes) == 1


@pytest.mark.parametrize("speed", [-3.0, 3.0])
def test_a_period_counts_for_its_radar_alone(speed):
    """The unambiguous radar's car is faster than the other radar's period could tell."""
    behind = scene(8.0)
    velocity = radial(behind.xyz * [-1, -1, 1], 8.0, np.r_[np.full(40, 8.0), np.zeros(300)])
    rear = replace(
        behind, xyz=behind.xyz * [-1, -1, 1], direction=behind.direction * [-1, -1, 1], radial_velocity_mps=velocity
    )
    boxes = found(scene(speed, period_mps=PERIOD), rear)
    assert boxes.velocity_mps is not None
    by_x = np.argsort(boxes.center_m[:, 0])
    assert boxes.velocity_mps[by_x, 0] == pytest.approx([-8.0, speed], abs=0.1)


def test_radars_with_different_periods_see_one_car_once():
    boxes = found(scene(-3.0, period_mps=PERIOD), scene(-3.0))
    assert len(boxes) == 1
    assert boxes.velocity_mps is not None
    assert boxes.velocity_mps[0, 0] == pytest.approx(-3.0, abs=0.1)
