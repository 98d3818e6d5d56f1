from dataclasses import replace

import numpy as np
import pytest

from fbench.pipelines.tracking.params import Tracker2DParams
from fbench.pipelines.tracking.trackers import Tracker2D
from fbench.replay.contracts.errors import DataError
from fbench.replay.data.boxes import Boxes2D

MS = 1_000_000
FIELDS = {
    "camera", "xyxy_px", "label", "score", "track_id", "distance_m", "range_rate_mps", "sources", "predicted",
}  # fmt: skip


def boxes(*rows: tuple[float, float, float, float], camera: str = "front", label: str = "car") -> Boxes2D:
    num = len(rows)
    return Boxes2D(
        camera=np.full(num, camera), xyxy_px=np.array(rows, np.float64).reshape(-1, 4), label=np.full(num, label),
        score=np.full(num, 0.8), sources=np.ones(num, np.uint8),
    )  # fmt: skip


def at(x: float, y: float = 100.0, size: float = 40.0) -> tuple[float, float, float, float]:
    return x, y, x + size, y + size


@pytest.fixture
def tracker() -> Tracker2D:
    return Tracker2D(Tracker2DParams(max_missed_shown=2))


def test_a_moving_box_keeps_its_id_and_is_predicted_through_a_gap(tracker: Tracker2D) -> None:
    ids = set()
    for i in range(10):
        shown = tracker.step(boxes(at(100 + 10 * i)), (i + 1) * 100 * MS)
        ids |= set(shown.track_id.tolist() if shown.track_id is not None else [])
    assert ids == {1}
    shown = tracker.step(boxes(), 1100 * MS)
    assert shown.predicted is not None
    assert shown.predicted.tolist() == [True]
    np.testing.assert_allclose(shown.xyxy_px, [at(200)], atol=1.5)
    shown = tracker.step(boxes(at(210)), 1200 * MS)
    assert (shown.track_id.tolist(), shown.predicted.tolist()) == ([1], [False])  # type: ignore[union-attr]


def test_a_track_that_is_missed_goes_on_unseen() -> None:
    tracker = Tracker2D(Tracker2DParams())
    for i in range(3):
        tracker.step(boxes(at(100 + 10 * i)), (i + 1) * 100 * MS)
    assert len(tracker.predict(350 * MS)) == 1, "nobody looked"
    assert len(tracker.step(boxes(), 400 * MS)) == 0
    shown = tracker.step(boxes(at(140)), 500 * MS)
    assert (shown.track_id.tolist(), shown.predicted.tolist()) == ([1], [False])  # type: ignore[union-attr]


def test_prediction_follows_stamps_not_steps(tracker: Tracker2D) -> None:
    for i in range(10):
        tracker.step(boxes(at(100 + 10 * i)), (i + 1) * 100 * MS)
    shown = tracker.step(boxes(), 1300 * MS)
    np.testing.assert_allclose(shown.xyxy_px, [at(220)], atol=3)


def test_a_track_ends_and_its_id_is_not_used_again(tracker: Tracker2D) -> None:
    for i in range(3):
        tracker.step(boxes(at(100)), (i + 1) * 100 * MS)
    counts = [len(tracker.step(boxes(), (i + 4) * 100 * MS)) for i in range(4)]
    assert counts == [1, 1, 0, 0]
    tracker.step(boxes(at(100)), 900 * MS)
    assert tracker.step(boxes(at(100)), 1000 * MS).track_id.tolist() == [2]  # type: ignore[union-attr]


def test_a_prediction_over_a_long_time_is_kept_but_not_shown(tracker: Tracker2D) -> None:
    for i in range(3):
        tracker.step(boxes(at(100)), (i + 1) * 100 * MS)
    assert len(tracker.step(boxes(), 800 * MS)) == 1
    assert len(tracker.step(boxes(), 801 * MS)) == 0
    assert tracker.step(boxes(at(100)), 900 * MS).track_id.tolist() == [1]  # type: ignore[union-attr]


def test_a_track_that_was_never_confirmed_ends_when_it_is_missed_once(tracker: Tracker2D) -> None:
    tracker.step(boxes(at(100)), 100 * MS)
    assert len(tracker.step(boxes(), 200 * MS)) == 0
    tracker.step(boxes(at(100)), 300 * MS)
    assert tracker.step(boxes(at(100)), 400 * MS).track_id.tolist() == [2]  # type: ignore[union-attr]


def test_a_reset_ends_tracks_lets_time_jump_back_and_goes_on_counting(tracker: Tracker2D) -> None:
    tracker.step(boxes(at(100), at(300)), 900 * MS)
    tracker.reset()
    assert tracker.step(boxes(at(100)), 100 * MS).track_id.tolist() == [3]  # type: ignore[union-attr]


def test_a_new_track_is_shown_after_min_hits_but_at_once_in_the_first_step(tracker: Tracker2D) -> None:
    assert len(tracker.step(boxes(at(100)), 100 * MS)) == 1
    assert len(tracker.step(boxes(at(100), at(300)), 200 * MS)) == 1
    assert len(tracker.step(boxes(at(100), at(300)), 300 * MS)) == 2


@pytest.mark.parametrize("stamp_ns", [100 * MS, 99 * MS])
def test_time_that_does_not_go_forward(tracker: Tracker2D, stamp_ns: int) -> None:
    tracker.step(boxes(at(100)), 100 * MS)
    with pytest.raises(DataError, match=rf"stamp {stamp_ns} isn't after {100 * MS}, reset trackers where a segment"):
        tracker.step(boxes(at(100)), stamp_ns)


def test_cameras_and_kinds_of_road_users_are_not_mixed(tracker: Tracker2D) -> None:
    for stamp in (100, 200):
        tracker.step(boxes(at(100)), stamp * MS)
    tracker.step(boxes(at(100), camera="rear"), 300 * MS)
    shown = tracker.step(boxes(at(100), label="pedestrian"), 400 * MS)
    assert shown.track_id.tolist() == [1]  # type: ignore[union-attr]
    assert shown.predicted.tolist() == [True]  # type: ignore[union-attr]


def test_the_label_with_most_votes_wins(tracker: Tracker2D) -> None:
    for i, label in enumerate(["truck", "car", "car", "truck", "car"]):
        shown = tracker.step(boxes(at(100), label=label), (i + 1) * 100 * MS)
    assert shown.label.tolist() == ["car"]  # type: ignore[union-attr]


def test_distance_moves_by_signed_range_rate_between_measurements(tracker: Tracker2D) -> None:
    near = replace(boxes(at(100)), distance_m=np.array([30.0]), range_rate_mps=np.array([-5.0]))
    tracker.step(near, 100 * MS)
    unmeasured = tracker.step(boxes(at(100)), 300 * MS)
    assert unmeasured.distance_m is not None
    np.testing.assert_allclose(unmeasured.distance_m, [29.0])
    coasted = tracker.step(boxes(), 500 * MS)
    np.testing.assert_allclose(coasted.distance_m, [28.0])  # type: ignore[arg-type]
    again = replace(boxes(at(100)), distance_m=np.array([27.5]), range_rate_mps=np.array([2.0]))
    assert tracker.step(again, 600 * MS).distance_m.tolist() == [27.5]  # type: ignore[union-attr]
    receding = tracker.step(boxes(at(100)), 700 * MS)
    np.testing.assert_allclose(receding.distance_m, [27.7])  # type: ignore[arg-type]


def test_fields_are_the_same_in_every_step(tracker: Tracker2D) -> None:
    empty = replace(boxes(), label=np.zeros(0, "U1"))
    for stamp, found in ((100, empty), (200, boxes(at(100))), (300, boxes(at(100))), (400, empty)):
        assert set(tracker.step(found, stamp * MS).arrays()) == FIELDS
    plain = Tracker2D(Tracker2DParams()).step(Boxes2D.empty(), 100 * MS)
    assert set(plain.arrays()) == FIELDS - {"label"}


def test_a_shrinking_box_never_gets_an_invalid_shape(tracker: Tracker2D) -> None:
    for i, size in enumerate([80, 40, 10]):
        tracker.step(boxes(at(100, size=size)), (i + 1) * 100 * MS)
    for stamp in (400, 5000):
        shown = tracker.step(boxes(), stamp * MS)
        assert np.isfinite(shown.xyxy_px).all()
        assert (shown.xyxy_px[:, 2:] >= shown.xyxy_px[:, :2]).all()
