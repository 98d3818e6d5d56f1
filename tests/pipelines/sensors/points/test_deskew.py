"""Points of a moving LiDAR, put where the body would have seen them at one instant."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from fbench.pipelines.sensors.points.merged import FROZEN, Deskew, Outline, carry_points, lidar_points, motion
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import PointCloud, Pose
from fbench.replay.data.rig import LogInfo, Mount, Rig

STRAIGHT = np.array([0.0, 0, 0, 1])
RIG = Rig({name: Mount("lidar", np.array([x, 0, 2.0]), STRAIGHT) for name, x in (("front", 2.0), ("back", -2.0))}, {})
RANGES = {"front": (0.0, np.inf), "back": (0.0, np.inf)}
MS = 1_000_000
PERIOD_MS = 100
SPEED_MPS, TURN_RADPS = 10.0, 0.5
LOG = LogInfo("drive", "id")


def pose(ms: float) -> Pose:
    """On a circle of 20 m, at 10 m/s: 1 m and 0.05 rad in a period."""
    angle = TURN_RADPS * ms / 1000
    place = SPEED_MPS / TURN_RADPS * np.array([np.sin(angle), 1 - np.cos(angle), 0])
    return Pose("gps", round(ms * MS), round(ms * MS), place, Rotation.from_rotvec([0, 0, angle]).as_quat())


def seen(ms: float, at: tuple[float, float, float], lidar: str = "front") -> np.ndarray:
    """Where a LiDAR has a point of the world at some time."""
    body = np.linalg.inv(pose(ms).world_T_body) @ [*at, 1.0]
    return body[:3] - RIG.mounts[lidar].translation_m


POLE = (25.0, 8.0, 1.0)


def sweep(ms: float, lidar: str = "front", num: int = 50, late_ms: float = 0.0) -> PointCloud:
    """All points of a turn are of one pole, the last one at the stamp."""
    offset_ms = np.linspace(-PERIOD_MS, 0, num)
    xyz = np.array([seen(ms + late_ms + one, POLE, lidar) for one in offset_ms], np.float32)
    stamp = round((ms + late_ms) * MS)
    return PointCloud(lidar, stamp, stamp, xyz, offset_ns=np.round(offset_ms * MS).astype(np.int32))


def frame(ms: float, *messages, **missing) -> Frame:
    return Frame(round(ms / PERIOD_MS), round(ms * MS), 0, {m.sensor: m for m in messages}, missing)


def spread(xyz: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(xyz, axis=0)))


def merged(deskew: Deskew | None, *frames: Frame) -> np.ndarray:
    return [lidar_points(RIG, one, RANGES, Outline(), deskew) for one in frames][-1]


def test_a_pole_seen_from_a_curve_becomes_one_point_again():
    frames = [frame(ms, sweep(ms), pose(ms)) for ms in (400, 500)]
    raw, sharp = merged(None, *frames), merged(Deskew(LOG), *frames)
    # Seen at (21.3, 2.2) in the end, it moves by 0.05 rad * 2.2 m - 1 m along the body, and by 0.05 rad * 21.3 m aside.
    assert spread(raw) == pytest.approx(np.hypot(0.89, 1.06), abs=0.02)
    assert spread(sharp) < 1e-4
    expected = seen(500, POLE) + RIG.mounts["front"].translation_m
    np.testing.assert_allclose(sharp, np.tile(expected, (50, 1)), atol=1e-4)


def test_straight_on_by_hand():
    """At 10 m/s what was seen 60 ms before the instant is 0.6 m nearer now."""
    poses = [Pose("gps", ms * MS, ms * MS, np.array([ms / 100, 5.0, 0]), STRAIGHT) for ms in (0, 100)]
    cloud = PointCloud(
        "front", 100 * MS, 0, np.full((2, 3), 8, np.float32), offset_ns=np.array([-60 * MS, 0]).astype("i4")
    )
    found = merged(Deskew(LOG), frame(0, poses[0]), frame(100, cloud, poses[1]))
    np.testing.assert_allclose(found, [[9.4, 8, 10], [10, 8, 10]], atol=1e-9)


def test_lidars_with_other_stamps_fit_together():
    def both(ms):
        return frame(ms, sweep(ms), sweep(ms, "back", late_ms=-30.0), pose(ms))

    assert spread(merged(Deskew(LOG), both(400), both(500))) < 1e-4
    assert spread(merged(None, both(400), both(500))) > 1.0


def test_sweeps_without_times_are_moved_as_a_whole():
    def late(ms):
        return frame(ms, PointCloud("front", (ms - 30) * MS, 0, seen(ms - 30, POLE).astype(np.float32)[None]), pose(ms))

    expected = seen(500, POLE) + RIG.mounts["front"].translation_m
    np.testing.assert_allclose(merged(Deskew(LOG), late(400), late(500))[0], expected, atol=1e-4)


@pytest.mark.parametrize(
    ("frames", "log"),
    [
        ([frame(500, sweep(500), pose(500))], LOG),  # nothing tells how it moves
        ([frame(400, pose(400)), frame(500, sweep(500))], LOG),
        ([frame(400, sweep(400)), frame(500, sweep(500))], LOG),
        ([frame(400, pose(400)), frame(500, sweep(500), pose(500))], LogInfo("a", "b", {"lidar.front.motion": FROZEN})),
        ([frame(400, pose(400)), frame(500, sweep(500), pose(400))], LOG),  # a clock that stands
        ([frame(400, pose(-2000)), frame(500, sweep(500), pose(500))], LOG),  # too long ago
        ([frame(400, pose(400)), frame(500, sweep(500), pose(4500))], LOG),  # a jump
    ],
)
def test_without_a_motion_points_stay(frames, log):
    np.testing.assert_array_equal(merged(Deskew(log), *frames), merged(None, *frames))


def test_times_of_zero_change_no_bit():
    cloud = PointCloud("front", 500 * MS, 0, sweep(500).xyz, offset_ns=np.zeros(50, np.int32))
    frames = [frame(400, pose(400)), frame(500, cloud, pose(500))]
    np.testing.assert_array_equal(merged(Deskew(LOG), *frames), merged(None, *frames))


def test_a_standing_body_changes_no_bit():
    frames = [frame(ms, sweep(ms), Pose("gps", ms * MS, 0, np.ones(3), STRAIGHT)) for ms in (400, 500)]
    np.testing.assert_array_equal(merged(Deskew(LOG), *frames), merged(None, *frames))


def test_a_reset_forgets_the_motion():
    deskew, last = Deskew(LOG), frame(500, sweep(500), pose(500))
    merged(deskew, frame(400, pose(400)), last)
    deskew.reset()
    np.testing.assert_array_equal(merged(deskew, last), merged(None, last))


def test_a_motion_goes_on_where_a_pose_is_missing_but_not_for_long():
    deskew = Deskew(LOG)
    merged(deskew, frame(400, pose(400)), frame(500, pose(500)))
    assert spread(merged(deskew, frame(600, sweep(600)))) < 0.01
    raw = merged(None, frame(1100, sweep(1100)))
    np.testing.assert_array_equal(merged(deskew, frame(1100, sweep(1100))), raw)


def test_the_own_vehicle_moves_along():
    """Points on it are left out where they were measured, before others are moved."""
    xyz = np.array([[-2.0, 0, 0], [30, 0, 0]], np.float32)
    cloud = PointCloud("front", 500 * MS, 0, xyz, offset_ns=np.full(2, -100 * MS, np.int32))
    deskew = Deskew(LOG)
    deskew.note(pose(400), 400 * MS)
    found = lidar_points(RIG, frame(500, cloud, pose(500)), RANGES, Outline(0.5, 0.5, 0.5), deskew)
    assert len(found) == 1


def test_motion_between_poses():
    found = motion(pose(400), pose(500))
    np.testing.assert_allclose(found[:3], [0, 0, TURN_RADPS], atol=1e-12)
    np.testing.assert_allclose(found[3:], [SPEED_MPS, 0, 0], atol=1e-12)
    assert motion(pose(500), pose(400)) is None
    assert motion(pose(0), pose(1001)) is None


@settings(deadline=None, max_examples=100)
@given(
    seed=st.integers(0, 2**32 - 1),
    turn=st.sampled_from([0.0, 1e-12, 1e-6, 1e-3, 0.3, 5.0]),
    longest_s=st.sampled_from([0.01, 0.1, 1.0]),
)
def test_the_kernel_is_the_exponential_of_the_twist(seed, turn, longest_s):
    """scipy's, one point at a time, within rounding."""
    rng = np.random.default_rng(seed)
    w, v = turn * rng.normal(size=3) / np.sqrt(3), rng.normal(0, 20, 3)
    xyz, time = rng.normal(0, 50, (20, 3)), np.repeat(rng.uniform(-longest_s, longest_s, 10), 2)
    time[3:5] = 0.0
    found = carry_points(xyz, time, w, v)
    twists = RigidTransform.from_exp_coords(time[:, None] * np.concatenate([w, v]))
    np.testing.assert_allclose(found, [twists[i].apply(xyz[i]) for i in range(20)], rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(found[3:5], xyz[3:5])
