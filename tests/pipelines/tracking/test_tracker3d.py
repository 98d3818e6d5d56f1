from dataclasses import replace

import numpy as np
import pytest

from fbench.pipelines.tracking.params import Tracker3DParams
from fbench.pipelines.tracking.trackers import Tracker3D
from fbench.replay.contracts.errors import DataError
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.geometry.iou import move_boxes
from fbench.replay.geometry.transforms import inverse

MS = 1_000_000
FIELDS = {
    "center_m", "size_lwh_m", "yaw_rad", "velocity_mps", "label", "score", "track_id", "sources", "predicted",
}  # fmt: skip


def cars(*centers: tuple[float, float], yaw: float = 0.0) -> Boxes3D:
    num = len(centers)
    xy = np.array(centers, np.float64).reshape(-1, 2)
    return Boxes3D(
        center_m=np.column_stack([xy, np.full(num, 0.8)]), size_lwh_m=np.tile([4.0, 1.8, 1.6], (num, 1)),
        yaw_rad=np.full(num, yaw), label=np.full(num, "car"), score=np.full(num, 0.9),
        sources=np.full(num, 2, np.uint8),
    )  # fmt: skip


def pose(x: float, y: float, yaw: float) -> Float64:
    matrix = np.eye(4)
    matrix[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    matrix[:2, 3] = x, y
    return matrix


def ids(shown: Boxes3D) -> list[int]:
    assert shown.track_id is not None
    return [int(i) for i in shown.track_id]


@pytest.fixture
def tracker() -> Tracker3D:
    return Tracker3D(Tracker3DParams())


def test_velocity_is_learnt_and_carries_the_track_through_a_gap(tracker: Tracker3D) -> None:
    for i in range(12):
        shown = tracker.step(cars((10 + 2.0 * i, 3.0)), (i + 1) * 200 * MS, None)
        assert ids(shown) == [1]
    assert shown.velocity_mps is not None
    np.testing.assert_allclose(shown.velocity_mps, [[10, 0, 0]], atol=0.2)
    coasted = tracker.step(cars(), 13 * 200 * MS, None)
    np.testing.assert_allclose(coasted.center_m, [[34, 3, 0.8]], atol=0.2)
    assert coasted.predicted is not None
    assert coasted.predicted.tolist() == [True]


def test_sparse_detections_without_any_overlap_stay_one_track(tracker: Tracker3D) -> None:
    shown = [tracker.step(cars((10 + 6.0 * i, 0.0)), (i + 1) * 1000 * MS, None) for i in range(4)]
    assert [ids(s) for s in shown] == [[1]] * 4
    overlap = Tracker3D(Tracker3DParams(association="iou"))
    assert ids(overlap.step(cars((10.0, 0.0)), 1000 * MS, None)) == [1]
    assert ids(overlap.step(cars((16.0, 0.0)), 2000 * MS, None)) == []
    assert ids(overlap.step(cars((16.0, 0.0)), 2100 * MS, None)) == [2]


def test_the_gate_rejects_far_detections(tracker: Tracker3D) -> None:
    for stamp in (100, 200):
        tracker.step(cars((10.0, 0.0)), stamp * MS, None)
    shown = tracker.step(cars((14.0, 0.0)), 300 * MS, None)
    assert shown.predicted is not None
    assert (ids(shown), shown.predicted.tolist()) == ([1], [True])


def test_what_was_measured_once_may_have_gone_anywhere(tracker: Tracker3D) -> None:
    shown = [ids(tracker.step(cars((25.0 * s, 0.0)), int((s + 0.1) * 1000) * MS, None)) for s in (0.0, 0.3)]
    assert shown == [[1], [1]]
    narrow = Tracker3D(Tracker3DParams(new_gate_mps=0.0))
    narrow.step(cars((0.0, 0.0)), 100 * MS, None)
    assert ids(narrow.step(cars((7.5, 0.0)), 400 * MS, None)) == []


def test_a_measured_velocity_keeps_the_gate_narrow(tracker: Tracker3D) -> None:
    still = replace(cars((0.0, 0.0)), velocity_mps=np.zeros((1, 3)))
    tracker.step(still, 100 * MS, np.eye(4))
    assert ids(tracker.step(cars((7.5, 0.0)), 400 * MS, np.eye(4))) == []


def test_neighbors_in_close_lanes_do_not_swap(tracker: Tracker3D) -> None:
    for i in range(10):
        shown = tracker.step(cars((2.0 * i, 0.0), (40 - 2.0 * i, 3.5)), (i + 1) * 100 * MS, None)
        assert ids(shown) == [1, 2]
        np.testing.assert_allclose(shown.center_m[:, 1], [0, 3.5], atol=1e-6)


def test_a_parked_car_stands_still_in_the_world_while_the_body_drives_and_turns(tracker: Tracker3D) -> None:
    parked = cars((30.0, 5.0), yaw=0.3)
    for i in range(8):
        world_T_body = pose(1.5 * i, 0.1 * i, 0.05 * i)
        seen = move_boxes(parked, inverse(world_T_body))
        shown = tracker.step(seen, (i + 1) * 100 * MS, world_T_body)
    np.testing.assert_allclose(shown.velocity_mps, np.zeros((1, 3)), atol=1e-6)  # type: ignore[arg-type]
    np.testing.assert_allclose(shown.center_m, seen.center_m, atol=1e-9)
    np.testing.assert_allclose(shown.yaw_rad, seen.yaw_rad)
    later = pose(12.0, 0.8, 0.4)
    coasted = tracker.step(cars(), 900 * MS, later)
    np.testing.assert_allclose(coasted.center_m, move_boxes(parked, inverse(later)).center_m, atol=1e-6)


def test_velocity_comes_back_in_body_axes(tracker: Tracker3D) -> None:
    north = pose(0.0, 0.0, np.pi / 2)
    for i in range(15):
        shown = tracker.step(cars((10 + 1.0 * i, 0.0)), (i + 1) * 100 * MS, north)
    np.testing.assert_allclose(shown.velocity_mps, [[10, 0, 0]], atol=0.2)  # type: ignore[arg-type]


@pytest.mark.parametrize("missing", [(0,), (4, 5, 6), (0, 1, 2, 5)])
def test_poses_may_be_missing(tracker: Tracker3D, missing: tuple[int, ...]) -> None:
    for i in range(12):
        world_T_body = pose(2.0 * i, 0.0, 0.02 * i)
        seen = move_boxes(cars((60.0, 5.0)), inverse(world_T_body))
        shown = tracker.step(seen, (i + 1) * 100 * MS, None if i in missing else world_T_body)
        if i not in missing and i > 8:
            assert len(ids(shown)) == 1
            np.testing.assert_allclose(shown.velocity_mps, np.zeros((1, 3)), atol=0.5)


def test_a_measured_velocity_starts_the_track(tracker: Tracker3D) -> None:
    first = replace(cars((10.0, 0.0)), velocity_mps=np.array([[20.0, 0.0, 0.0]]))
    tracker.step(first, 100 * MS, np.eye(4))
    shown = tracker.step(cars((17.0, 0.0)), 400 * MS, np.eye(4))
    assert ids(shown) == [1]
    assert 16 < shown.center_m[0, 0] < 17
    assert ids(Tracker3D(Tracker3DParams()).step(cars((17.0, 0.0)), 400 * MS, None)) == [1]


@pytest.mark.parametrize("stamp_ns", [100 * MS, 50 * MS])
def test_time_that_does_not_go_forward(tracker: Tracker3D, stamp_ns: int) -> None:
    tracker.step(cars((10.0, 0.0)), 100 * MS, None)
    with pytest.raises(DataError, match=f"stamp {stamp_ns} isn't after {100 * MS}"):
        tracker.step(cars((10.0, 0.0)), stamp_ns, None)


def test_ids_go_on_after_a_reset(tracker: Tracker3D) -> None:
    tracker.step(cars((10.0, 0.0), (20.0, 0.0)), 900 * MS, None)
    tracker.reset()
    assert ids(tracker.step(cars((10.0, 0.0)), 100 * MS, None)) == [3]


def test_tracks_of_boxes_without_classes_have_no_label(tracker: Tracker3D) -> None:
    plain = replace(cars((10.0, 0.0)), label=None, score=None)
    for i in range(3):
        shown = tracker.step(plain, (i + 1) * 100 * MS, None)
        assert set(shown.arrays()) == FIELDS - {"label"}
        assert ids(shown) == [1]
    assert set(tracker.step(Boxes3D.empty(), 400 * MS, None).arrays()) == FIELDS - {"label"}


def test_a_label_that_says_nothing_joins_any_track_and_has_no_vote(tracker: Tracker3D) -> None:
    labels = ["car", "other", "other"]
    shown = [
        tracker.step(replace(cars((10.0, 0.0)), label=np.array([label])), (i + 1) * 100 * MS, None)
        for i, label in enumerate(labels)
    ]
    assert [s.label.tolist() for s in shown if s.label is not None] == [["car"]] * 3
    assert ids(shown[-1]) == [1]


def test_fields_are_the_same_in_every_step(tracker: Tracker3D) -> None:
    for i, found in enumerate([cars(), cars((10.0, 0.0)), cars((10.0, 0.0)), cars()]):
        assert set(tracker.step(found, (i + 1) * 100 * MS, None).arrays()) == FIELDS
