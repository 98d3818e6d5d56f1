"""Speeds of bodies that turn, against rigid-body kinematics: v = v_c + omega x r, seen along the line of sight."""

import numpy as np
import pytest
from tests.datasets.city.sensors.radar_worlds import EXACT, MOUNT, ground, look, radar, states, truck, world

from fbench.datasets.city.mesh import Skin, box


def world_points(found, ego):
    """Points (N, 3) in the world from a scan's polar values, and where the sensor is (3,)."""
    x, y, yaw = ego[:3]
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    rotation, sensor = turn @ MOUNT[:3, :3], turn @ MOUNT[:3, 3] + (x, y, 0)
    return sensor + found.message.xyz.astype(np.float64) @ rotation.T, sensor


def speed_over_ground(point, row):
    """v_c + omega x r of points (N, 3) on a body given by its row x, y, yaw, vx, vy, yaw rate."""
    x, y, _, vx, vy, rate = row
    return np.array([vx, vy, 0]) + np.cross([0, 0, rate], point - (x, y, 0))


@pytest.mark.parametrize(
    ("ego", "other"),
    [
        ((0, 0, 0, 0, 0, 0), (25, 0, np.pi / 2, 0, 0, 0.8)),
        ((0, 0, 0, 0, 0, 0.5), (25, 2, 0.3, 0, 0, 0)),
        ((40, -10, 2.0, -5, 9, -0.4), (30, 12, 0.7, 6, -3, -1.2)),
    ],
    ids=["other turns on the spot", "ego turns on the spot", "both drive and turn"],
)
def test_a_turning_body_has_another_speed_at_every_point(ego, other):
    found = look(world(ground(), truck()), states(ego, other), radar(**EXACT))
    point, sensor = world_points(found, ego)
    own, away = speed_over_ground(sensor[None], ego)[0], point - sensor
    away /= np.linalg.norm(away, axis=1)[:, None]
    on_truck = found.body == 1
    assert on_truck.sum() > 50
    over_ground = np.where(on_truck[:, None], speed_over_ground(point, other), 0.0)
    expected = ((over_ground - own) * away).sum(axis=1)
    np.testing.assert_allclose(found.message.radial_velocity_mps, expected, atol=2e-4)


def test_the_ends_of_a_truck_that_turns_on_the_spot_come_and_go():
    """10 m long and 2.5 m wide, across the view at 25 m, 0.8 rad/s: the corners of its near side, (-1.25, +-5) m from
    its middle, move with (-+0.8 * 5, -0.8 * 1.25) = (-+4, -1) m/s and are seen along (25 - 1.25 - 2, +-5).
    """
    found = look(world(ground(), truck()), states((0, 0, 0), (25, 0, np.pi / 2, 0, 0, 0.8)), radar(**EXACT))
    point, _ = world_points(found, (0, 0, 0))
    speed = found.message.radial_velocity_mps
    for y, expected in ((5.0, -(4 * 21.75 + 5)), (-5.0, 4 * 21.75 + 5)):
        at_end = (found.body == 1) & (np.abs(point[:, 1] - y) < 0.3)
        assert at_end.sum() > 3
        assert np.median(speed[at_end]) == pytest.approx(expected / np.hypot(21.75, 5), rel=0.05)
    middle = (found.body == 1) & (np.abs(point[:, 1]) < 0.05)
    assert np.abs(speed[middle]).max() < 0.1


def test_only_the_body_that_turns_is_seen_to_turn():
    wall = box((40, 0, 3), (1, 40, 6), Skin("concrete", (0.5, 0.5, 0.5)))
    found = look(world(wall, truck()), states((0, 0, 0), (25, 0, 0.3, 0, 0, 2.0)), radar(**EXACT))
    speed = found.message.radial_velocity_mps
    assert not speed[found.body < 0].any()
    assert np.ptp(speed[found.body == 1]) > 1
