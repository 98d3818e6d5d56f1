"""Poses at the instants of frames."""

import numpy as np

from fbench.replay.data.messages import Pose
from fbench.replay.engine.poses import FramePoses, pose_of

MS = 1_000_000
HALF = np.sqrt(0.5)


def pose(ms, x, turn=(0.0, 0, 0, 1), sensor="ego"):
    return Pose(sensor, ms * MS, ms * MS, np.array([x, 0.0, 0.0]), np.array(turn))


def poses_of(*steps, name="ego"):
    """Numbers are frames [ms], others poses."""
    found, num = FramePoses(name), 0
    for step in steps:
        if isinstance(step, Pose):
            found.add(step)
        else:
            found.open(num, step * MS)
            num += 1
    found.finish()
    return found


def test_between_two_poses():
    """A quarter of the way, and of the turn to the left by 90 degrees."""
    found = poses_of(pose(0, 0.0), 25, pose(100, 8.0, (0, 0, HALF, HALF)))
    angle = np.deg2rad(22.5) / 2
    np.testing.assert_allclose(found.values, [[2, 0, 0, 0, 0, np.sin(angle), np.cos(angle)]], atol=1e-12)
    np.testing.assert_allclose(found.world_T_body(0)[:2, :2], [[np.cos(2 * angle), -np.sin(2 * angle)],
                                                               [np.sin(2 * angle), np.cos(2 * angle)]])  # fmt: skip


def test_at_a_pose_it_is_as_given():
    found = poses_of(pose(0, 1.0, (0, 0, 2, 2)), 0, pose(100, 2.0), 100, 100)
    assert found.values.tolist() == [[1, 0, 0, 0, 0, 2, 2], [2, 0, 0, 0, 0, 0, 1], [2, 0, 0, 0, 0, 0, 1]]


def test_before_the_first_and_behind_the_last_pose_only_near_ones_hold():
    found = poses_of(0, 70, pose(100, 1.0), 140, 160)
    assert np.isnan(found.values[:, 0]).tolist() == [True, False, False, True]
    assert found.world_T_body(0) is None
    assert found.is_known


def test_over_a_gap_nothing_is_known():
    found = poses_of(pose(0, 0.0), 20, 1000, 1980, pose(2000, 1.0))
    np.testing.assert_array_equal(found.values[:, 0], [0, np.nan, 1])


def test_other_streams_and_insane_poses_dont_count():
    found = poses_of(pose(0, 5.0, sensor="other"), 0, pose(0, np.nan), pose(1, 1.0, (0, 0, 0, 0)))
    assert not found.is_known
    assert not poses_of(pose(0, 5.0), 0, name=None).is_known
    assert pose_of(np.full(7, np.nan)) is None


def test_a_frame_that_opens_long_after_its_poses_came_is_between_the_two_around_it():
    """A LiDAR that is stamped as its sweep begins arrives 100 ms later than an odometry of 50 Hz does."""
    drive = [pose(ms, ms / 10) for ms in range(0, 2000, 20)]
    found = poses_of(*drive[:50], 875, 5, *drive[50:], 1990)
    np.testing.assert_allclose(found.values[:, 0], [87.5, 0.5, 198])


def test_a_near_pose_that_came_before_isnt_taken_for_the_one_at_the_instant():
    np.testing.assert_allclose(poses_of(pose(0, 0.0), pose(40, 4.0), 10).values[:, 0], [1])


def test_poses_out_of_order_are_sorted():
    np.testing.assert_allclose(poses_of(pose(0, 0.0), pose(40, 4.0), pose(20, 3.0), 10, 30).values[:, 0], [1.5, 3.5])


def test_after_a_clock_that_jumped_back_only_new_poses_count():
    found = poses_of(pose(9000, 0.0), pose(9100, 1.0), 9120, pose(100, 50.0), 150, pose(200, 60.0), 9050)
    np.testing.assert_array_equal(found.values[:, 0], [1, 55, np.nan])


def test_poses_are_kept_for_ten_seconds():
    drive = [pose(ms, ms / 10) for ms in range(0, 20_000, 100)]
    np.testing.assert_array_equal(poses_of(*drive, 9950, 8850).values[:, 0], [995, np.nan])
