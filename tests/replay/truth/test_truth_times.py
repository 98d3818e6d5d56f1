"""Truth at the instants of frames: a frame every 100 ms, truth beside them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.messages import Truth
from fbench.replay.geometry.iou import move_boxes
from fbench.replay.geometry.transforms import inverse, pose_matrix
from fbench.replay.truth.labelling import Instant
from fbench.replay.truth.times import TruthTimes, make_max_between_ns

MS = 1_000_000


def boxes(ids, *centers, yaw=None, **columns):
    center = np.array(centers, float).reshape(-1, 3)
    turned = np.zeros(len(center)) if yaw is None else np.array(yaw, float)
    return Boxes3D(center, np.tile([4.0, 2, 1.5], (len(center), 1)), turned, track_id=np.array(ids, int), **columns)


def at(ms, *x, ids=None, **kinds):
    """Boxes ahead at x, with ids 0, 1, ..."""
    solid = boxes(range(len(x)) if ids is None else ids, *((v, 0, 0) for v in x))
    return Truth(round(ms * MS), round(ms * MS), solid, **kinds)


def flat(ms, *rows, **columns):
    """2D boxes (camera, id, left)."""
    xyxy = np.array([[left, 0, left + 10, 10] for _, _, left in rows], float).reshape(-1, 4)
    named, ids = np.array([row[0] for row in rows], np.str_), np.array([row[1] for row in rows], int)
    return Truth(round(ms * MS), 0, None, Boxes2D(named, xyxy, track_id=ids, **columns))


def instants(num=6, segments=(), numbers=False, chosen=None):
    """Frames; new segments begin with those of these indices."""
    return [
        Instant(i, i * 100 * MS, i if numbers else None, chosen is None or i in chosen, sum(i >= s for s in segments))
        for i in range(num)
    ]  # fmt: skip


def timed(*truths, frames=None, poses=None, between_ms=0):
    frames = instants() if frames is None else frames
    known = np.full((len(frames), 7), np.nan) if poses is None else poses
    times = TruthTimes(frames, known, round(between_ms * MS))
    found = list(times.match(iter(truths)))
    return found, times


def places(found):
    """x of the boxes by frame."""
    return {index: truth.boxes3d.center_m[:, 0].tolist() for index, truth in found if index is not None}


def test_truth_of_the_instant_is_left_alone():
    truths = [at(0, 1.0), at(100, 2.0), at(200, 3.0)]
    found, _ = timed(*truths)
    assert [truth for _, truth in found] == truths


def test_truth_moves_towards_the_next_on_the_other_side():
    """Stamps 5 ms late: frame 1 is 95 % of the way; the first frame has nothing before it."""
    found, _ = timed(at(5, 10.0), at(105, 12.0), at(205, 16.0))
    assert places(found) == {0: [10.0], 1: [pytest.approx(11.9)], 2: [pytest.approx(15.8)]}
    assert [truth.stamp_ns for _, truth in found] == [5 * MS, 105 * MS, 205 * MS]
    early, _ = timed(at(95, 10.0), at(195, 12.0))
    assert places(early) == {1: [pytest.approx(10.1)], 2: [12.0]}


def test_each_box_has_a_partner_of_its_own():
    """Id 1 ends, id 2 comes, id 3 is there in the truth after the next one only."""
    found, _ = timed(at(95, 10, 20, 40, ids=[0, 1, 3]), at(195, 12, 30, ids=[0, 2]), at(295, 50, ids=[3]))
    assert places(found)[1] == [pytest.approx(10.1), 20.0, 40.0]


def test_truth_without_ids_stays():
    bare = [replace(t, boxes3d=replace(t.boxes3d, track_id=None)) for t in (at(95, 10.0), at(195, 12.0))]
    found, _ = timed(*bare, between_ms=500)
    assert places(found) == {1: [10.0], 2: [12.0]}


def test_gaps_may_be_as_long_as_keyframes_need():
    assert places(timed(at(95, 0.0), at(695, 6.0), frames=instants(9))[0])[1] == [pytest.approx(0.05)]
    assert places(timed(at(95, 0.0), at(696, 6.0), frames=instants(9))[0])[1] == [0.0]


def test_borders_of_segments_arent_crossed():
    truths = [at(95, 0.0), at(195, 1.0), at(295, 2.0)]
    assert places(timed(*truths, frames=instants(segments=[2]))[0]) == {1: [0.0], 2: [pytest.approx(1.05)], 3: [2.0]}
    lone = [at(95, 0.0), at(150, 1.0), at(250, 2.0), at(350, 3.0)]
    assert places(timed(*lone, frames=instants(segments=[2]), between_ms=100)[0]) == {1: [0.0], 3: [pytest.approx(2.5)]}
    assert places(timed(*lone, frames=instants(segments=[2, 4]), between_ms=100)[0]) == {1: [0.0]}


def test_clocks_that_were_set_back():
    """Two segments of the same stamps: nothing is between them."""
    frames = [replace(i, stamp_ns=i.stamp_ns - 300 * MS * i.segment) for i in instants(6, segments=[3], numbers=True)]
    truths = [replace(at(100 * (i % 3) + 5, i), frame_number=i) for i in range(6)]
    found, _ = timed(*truths, frames=frames, between_ms=500)
    assert places(found) == {i: [float(i)] for i in range(6)}


def test_truth_by_number_counts_where_its_clock_is_that_of_the_frames():
    near = [replace(at(100 * i + 30, i), frame_number=i) for i in range(3)]
    assert places(timed(*near, frames=instants(numbers=True))[0])[1] == [pytest.approx(0.7)]
    far = [replace(at(100 * i + 5_000, i), frame_number=i) for i in range(0, 6, 2)]
    assert places(timed(*far, frames=instants(numbers=True), between_ms=900)[0]) == {0: [0.0], 2: [2.0], 4: [4.0]}


def counted(index, x):
    return replace(at(0, x), frame_index=index)


def test_truth_that_counts_frames():
    found, _ = timed(counted(0, 1.0), counted(1, 2.0), counted(4, 5.0))
    assert places(found) == {0: [1.0], 1: [2.0], 4: [5.0]}
    found, times = timed(counted(0, 1.0), counted(1, 2.0), counted(4, 5.0), between_ms=300)
    assert places(found) == {0: [1.0], 1: [2.0], 2: [pytest.approx(3)], 3: [pytest.approx(4)], 4: [5.0]}
    assert [times.is_between(i) for i in range(5)] == [False, False, True, True, False]


class TestImages:
    def test_cameras_are_told_apart(self):
        found, _ = timed(
            flat(95, ("right", 0, 0), ("left", 0, 100), ("left", 1, 5)), flat(195, ("left", 0, 200), ("right", 0, 20))
        )
        truth = dict(found)[1].boxes2d
        assert truth.camera.tolist() == ["right", "left", "left"]
        np.testing.assert_allclose(truth.xyxy_px[:, 0], [1, 105, 5])

    def test_truths_of_one_frame_complement_each_other(self):
        """Each camera's own message: the right one's says nothing about the left one."""
        found, _ = timed(
            flat(95, ("left", 0, 100)), flat(97, ("right", 0, 0)),
            flat(194, ("right", 0, 97)), flat(195, ("left", 0, 200)),
        )  # fmt: skip
        truth = dict(found)[1].boxes2d
        assert dict(zip(truth.camera.tolist(), truth.xyxy_px[:, 0].tolist(), strict=True)) == {
            "left": pytest.approx(105), "right": pytest.approx(3),
        }  # fmt: skip

    def test_a_camera_without_boxes_ends_what_was_there(self):
        found, _ = timed(flat(95, ("left", 0, 100)), flat(195, ("right", 0, 0)), flat(295, ("left", 0, 300)))
        assert dict(found)[1].boxes2d.xyxy_px[0, 0] == 100

    def test_between_truths(self):
        found, _ = timed(
            flat(0, ("left", 0, 0), ("right", 1, 7)), flat(200, ("left", 0, 10), ("left", 2, 3)), between_ms=200
        )
        truth = dict(found)[1]
        assert truth.boxes3d is None
        assert (truth.boxes2d.camera.tolist(), truth.boxes2d.xyxy_px[:, 0].tolist()) == (["left"], [5.0])
        found, _ = timed(flat(0), flat(200), between_ms=200)
        assert len(dict(found)[1].boxes2d) == 0


class TestBetween:
    def test_frames_between_truths_get_what_both_have(self):
        found, times = timed(
            at(0, 0, 50, ids=[0, 1]), at(400, 8, 60, ids=[0, 2]), at(500, 9, 61, ids=[0, 2]), between_ms=400
        )
        assert [index for index, _ in found] == [0, 1, 2, 3, 4, 5]
        assert places(found) == {
            0: [0, 50], 1: [pytest.approx(2)], 2: [pytest.approx(4)], 3: [pytest.approx(6)], 4: [8, 60], 5: [9, 61]
        }  # fmt: skip
        assert [times.is_between(i) for i in range(6)] == [False, True, True, True, False, False]
        assert places(timed(at(0, 0.0), at(400, 8.0), between_ms=399)[0]) == {0: [0.0], 4: [8.0]}

    def test_the_nearer_one_tells_the_rest(self):
        seen = [replace(t, boxes3d=replace(t.boxes3d, visibility=np.array([v])))
                for t, v in ((at(0, 0.0), 0.1), (at(400, 4.0), 0.9))]  # fmt: skip
        found, _ = timed(*seen, between_ms=400)
        assert [t.boxes3d.visibility.tolist() for _, t in found] == [[0.1], [0.1], [0.1], [0.9], [0.9]]

    def test_truth_of_no_frame_is_used_and_else_stray(self):
        """Labelled at 10 Hz, but never when a frame is."""
        truths = [at(100 * i + 40, i) for i in range(4)]
        found, _ = timed(*truths)
        assert [index for index, _ in found] == [None] * 4
        found, times = timed(*truths, between_ms=100)
        assert places(found) == {1: [pytest.approx(0.6)], 2: [pytest.approx(1.6)], 3: [pytest.approx(2.6)]}
        assert [index for index, _ in found] == [1, 2, 3]
        assert times.is_between(3)

    def test_nothing_at_both_means_nothing_between(self):
        assert places(timed(at(0), at(200), between_ms=200)[0]) == {0: [], 1: [], 2: []}

    def test_only_chosen_frames_in_their_segment(self):
        frames = instants(6, segments=[3], chosen=[1])
        assert list(places(timed(at(0, 0.0), at(200, 1.0), at(500, 2.0), frames=frames, between_ms=500)[0])) == [
            0,
            1,
            2,
            5,
        ]

    def test_world_truth_needs_a_pose_at_the_frame(self):
        poses = np.tile([0.0, 0, 0, 0, 0, 0, 1], (6, 1))
        poses[1] = np.nan
        found, _ = timed(at(0, 0.0, in_world=True), at(300, 3.0, in_world=True), poses=poses, between_ms=300)
        assert places(found) == {0: [0.0], 2: [pytest.approx(2)], 3: [3.0]}
        assert all(truth.in_world for _, truth in found)
        mixed, _ = timed(at(0, 0.0, in_world=True), at(200, 3.0), poses=poses, between_ms=300)
        assert places(mixed)[0] == [0.0]

    @pytest.mark.parametrize("gap", [-1.0, np.nan, np.inf, 60_001.0])
    def test_gaps_that_make_no_sense(self, gap):
        with pytest.raises(ConfigError, match=r"--interpolate-truth .*: not a number of ms from 0 to 60000"):
            make_max_between_ns(gap)
        assert make_max_between_ns(0.5) == 500_000


def curve(stamp_ns):
    """A body that drives a circle of 20 m at 10 m/s: position, quaternion."""
    angle = 10 / 20 * stamp_ns / 1e9
    return [20 * np.sin(angle), 20 - 20 * np.cos(angle), 0, 0, 0, np.sin(angle / 2), np.cos(angle / 2)]


def seen(stamp_ns, world):
    pose = np.array(curve(stamp_ns))
    return Truth(stamp_ns, stamp_ns, replace(move_boxes(world, inverse(pose_matrix(pose[:3], pose[3:]))),
                                             roll_rad=None, pitch_rad=None))  # fmt: skip


def test_standing_objects_stand_while_the_body_turns():
    """50 m away; what is between the poses of frames, 100 ms apart, is a chord instead of an arc."""
    world = boxes([5], (30, 40, 1), yaw=[2.0])
    frames, poses = instants(6), np.array([curve(i * 100 * MS) for i in range(6)])
    truths = [seen((100 * i + 5) * MS, world) for i in range(6)]
    found, _ = timed(*truths, frames=frames, poses=poses)
    for index in (1, 2, 3, 4):
        solid = dict(found)[index].boxes3d
        expected = seen(index * 100 * MS, world).boxes3d
        np.testing.assert_allclose(solid.center_m, expected.center_m, atol=2e-3)
        np.testing.assert_allclose(solid.yaw_rad, expected.yaw_rad, atol=1e-9)
        assert np.abs(truths[index].boxes3d.center_m - expected.center_m).max() > 0.05
        assert solid.roll_rad is None


def test_standing_objects_between_keyframes():
    """Half a second apart: in body coordinates the chord would be 0.2 m off."""
    world = boxes([5], (30, 40, 1), yaw=[2.0])
    poses = np.array([curve(i * 100 * MS) for i in range(6)])
    key = [seen(0, world), seen(500 * MS, world)]
    found, _ = timed(*key, poses=poses, between_ms=500)
    blind, _ = timed(*key, between_ms=500)
    for index in range(1, 5):
        expected = seen(index * 100 * MS, world).boxes3d.center_m
        np.testing.assert_allclose(dict(found)[index].boxes3d.center_m, expected, atol=1e-9)
    assert np.abs(dict(blind)[2].boxes3d.center_m - seen(200 * MS, world).boxes3d.center_m).max() > 0.2


@settings(max_examples=60, deadline=None)
@given(
    offsets=st.lists(st.integers(-10 * MS, 10 * MS), min_size=6, max_size=6),
    speed=st.floats(-40, 40), rate=st.floats(-3, 3), drive=st.floats(0, 40), far=st.booleans(),
)  # fmt: skip
def test_linear_motion_is_recovered(offsets, speed, rate, drive, far):
    """A car that drives and turns evenly, seen from a body that drives evenly, in body or in world coordinates."""

    def state(stamp_ns, body):
        t = stamp_ns / 1e9
        own = drive * t if body else 0.0
        return boxes([3], (10 + speed * t - own, 2 * t, 0.5), yaw=[(2.5 + rate * t + np.pi) % (2 * np.pi) - np.pi])

    frames = instants(6)
    poses = np.array([[1000.0 * far + drive * i / 10, 0, 0, 0, 0, 0, 1] for i in range(6)])
    stamps = [i * 100 * MS + offset for i, offset in enumerate(offsets)]
    for in_world in (False, True):
        truths = [Truth(s, s, state(s, not in_world), in_world=in_world) for s in stamps]
        found, _ = timed(*truths, frames=frames, poses=poses)
        for index, truth in found[1:-1]:
            expected = state(index * 100 * MS, not in_world)
            np.testing.assert_allclose(truth.boxes3d.center_m, expected.center_m, atol=1e-9)
            turn = np.exp(1j * (truth.boxes3d.yaw_rad - expected.yaw_rad))
            np.testing.assert_allclose(turn, 1, atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.integers(0, 5_000), unique=True, max_size=60), st.integers(0, 900))
def test_every_truth_has_its_place_at_most_once(stamps, between):
    """As without interpolation, but for frames between, and for truth that these are made of."""
    truths = [at(ms, ms / 100) for ms in sorted(stamps)]
    frames = instants(51, segments=[20, 33])
    plain, _ = timed(*truths, frames=frames)
    found, times = timed(*truths, frames=frames, between_ms=between)
    own = {i: t.boxes3d.center_m.tolist() for i, t in found if i is not None and not times.is_between(i)}
    assert own == {i: t.boxes3d.center_m.tolist() for i, t in plain if i is not None}
    indices = [i for i, _ in found if i is not None]
    assert len(set(indices)) == len(indices)
    for index, truth in found:
        if index is not None and not 19 <= index <= 34:
            assert truth.boxes3d.center_m[0, 0] == pytest.approx(index, abs=0.1 * (not times.is_between(index)) + 1e-9)
