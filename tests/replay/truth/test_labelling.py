import numpy as np

from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.messages import Truth
from fbench.replay.truth.labelling import Instant, Labelling

MS = 1_000_000


def boxes2d(*cameras, **columns):
    return Boxes2D(np.array(cameras, np.str_), np.array([[0, 0, 9.0, 9]] * len(cameras)).reshape(-1, 4), **columns)


def boxes3d(x=1.0):
    return Boxes3D(np.array([[x, 0, 0]]), np.ones((1, 3)), np.zeros(1))


def matched(*truths):
    frames = Labelling([Instant(i, i * 100 * MS, None, True) for i in range(3)])
    return list(frames.match(iter(truths)))


def test_truth_of_several_topics_is_joined():
    """3D boxes and those of two cameras, as ROS logs have them: each in its own message."""
    solid = boxes3d()
    [(index, truth)] = matched(
        Truth(100 * MS, 0, solid), Truth(100 * MS, 1, None, boxes2d("left", "left")),
        Truth(104 * MS, 2, None, boxes2d("right")),
    )  # fmt: skip
    assert (index, truth.stamp_ns, truth.boxes3d) == (1, 100 * MS, solid)
    assert truth.boxes2d.camera.tolist() == ["left", "left", "right"]


def test_what_only_one_of_them_tells_is_dropped():
    known = boxes2d("left", track_id=np.array([7]), label=np.array(["car"]))
    [(_, truth)] = matched(Truth(0, 0, None, known), Truth(0, 0, None, boxes2d("right", label=np.array(["van"]))))
    assert truth.boxes2d.track_id is None
    assert truth.boxes2d.label.tolist() == ["car", "van"]
    [(_, truth)] = matched(Truth(0, 0, None, known), Truth(0, 0, None, boxes2d()))
    assert truth.boxes2d.track_id.tolist() == [7]


def test_truths_of_the_same_thing_arent_joined():
    """The nearest gets the frame."""
    near, far = Truth(101 * MS, 0, boxes3d()), Truth(105 * MS, 0, boxes3d(2.0), boxes2d("left"))
    assert matched(near, far) == [(None, far), (1, near)]
    near, far = Truth(99 * MS, 0, None, boxes2d("left")), Truth(95 * MS, 0, None, boxes2d("left", "right"))
    assert matched(far, near) == [(None, far), (1, near)]


def counted(index, number=None):
    return Truth(0, 0, boxes3d(), None, number, index)


def test_files_that_count_frames_mean_numbers_where_there_are_some():
    numbered = Labelling([Instant(i, i * 100 * MS, 50 + i, True) for i in range(3)])
    assert numbered.frame_of(counted(51, 51)) == 1
    assert numbered.frame_of(counted(1, 1)) is None
    assert numbered.frame_of(counted(1)) == 1
    plain = Labelling([Instant(i, i * 100 * MS, None, True) for i in range(3)])
    assert plain.frame_of(counted(2, 2)) == 2
    assert plain.frame_of(counted(3, 3)) is None
    again = Labelling([Instant(i, i * 100 * MS, i % 2, True) for i in range(4)])
    assert again.frame_of(counted(3, 3)) == 3


def test_counted_truth_gets_the_stamp_of_its_frame():
    [(index, truth)] = matched(counted(2, 2))
    assert (index, truth.stamp_ns) == (2, 200 * MS)


def test_frames_of_a_part_of_a_log():
    part = Labelling([Instant(i, i * 100 * MS, None, True) for i in range(10, 13)])
    assert part.frame_of(counted(11)) == 11
    assert part.frame_of(counted(1)) is None
    assert part.frame_of(Truth(1_200 * MS, 0, boxes3d())) == 12
