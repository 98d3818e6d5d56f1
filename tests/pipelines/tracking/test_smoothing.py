import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbench.pipelines.tracking.params import Tracker3DParams
from fbench.pipelines.tracking.trackers import Tracker3D, mean_of, mean_yaw
from fbench.replay.data.boxes import Boxes3D

NONE = Boxes3D.empty()


def cars(*scores, length_m=4.0):
    num = len(scores)
    center = np.column_stack([20.0 * np.arange(num), np.zeros(num), np.full(num, 0.8)])
    return Boxes3D(center, np.tile([length_m, 1.8, 1.6], (num, 1)), np.zeros(num), score=np.array(scores))


def track(found, **params):
    tracker = Tracker3D(Tracker3DParams(min_hits=1, **params))
    return [tracker.step(boxes, (i + 1) * 100_000_000) for i, boxes in enumerate(found)]


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=20))
def test_without_a_least_share_it_is_the_mean_of_all(values):
    mean = np.array([values[0]])
    for hits, value in enumerate(values[1:], start=2):
        mean = mean_of(mean, np.array([value]), 1.0 / np.array([hits]))
    assert mean[0] == pytest.approx(np.mean(values), abs=1e-9)


def test_the_newest_counts_at_least_its_share():
    found = [cars(0.9, length_m=length_m) for length_m in (4.0, 5.0, 5.0, 5.0, 5.0)]
    lengths = [boxes.size_lwh_m[0, 0] for boxes in track(found, size_share=0.3)]
    shares = [0.5, 1 / 3, 0.3, 0.3]
    assert lengths == pytest.approx([4.0, *(5.0 - np.cumprod(1 - np.array(shares)))])
    rows = mean_of(np.zeros((2, 3)), np.full((2, 3), 4.0), np.array([0.5, 0.25]))
    assert rows.tolist() == [[2, 2, 2], [1, 1, 1]]


@pytest.mark.parametrize(
    ("before", "now", "expected", "backwards"),
    [
        (0.0, 0.2, 0.1, False),
        (0.0, 0.2 + np.pi, 0.1, True),
        (0.0, 0.2 - np.pi, 0.1, True),
        (np.pi - 0.1, -np.pi + 0.1, -np.pi, False),
        # -0.1 turned by pi is 3.04, which is -3.24.
        (-3.0, -0.1, -3.0 + (-0.1 - np.pi + 3.0) / 2, True),
    ],
)
def test_headings_turned_by_pi_count_the_right_way_round(before, now, expected, backwards):
    yaw, turned = mean_yaw(np.array([before]), np.array([now]), np.array([0.5]))
    assert turned.tolist() == [backwards]
    assert np.cos(yaw[0] - expected) == pytest.approx(1, abs=1e-12)
    assert -np.pi <= yaw[0] < np.pi


def test_scores_of_predicted_tracks():
    found = [cars(0.8, -0.4), NONE]
    measured, predicted = track(found, predicted_share=0.5)
    assert (measured.score.tolist(), predicted.score.tolist()) == ([0.8, -0.4], [0.4, -0.4])
    assert [boxes.score.tolist() for boxes in track(found, predicted_share=1.0)] == [[0.8, -0.4]] * 2
