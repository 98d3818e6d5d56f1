import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbench.pipelines.tracking.trackers import mean_yaw
from fbench.pipelines.tracking.tracks import lower_predicted, mean_of, newest_share


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=20))
def test_without_a_least_share_it_is_the_mean_of_all(values):
    mean = np.array([values[0]])
    for hits, value in enumerate(values[1:], start=2):
        mean = mean_of(mean, np.array([value]), newest_share(np.array([hits]), 0.0))
    assert mean[0] == pytest.approx(np.mean(values), abs=1e-9)


def test_the_newest_counts_at_least_its_share():
    assert newest_share(np.array([1, 2, 4, 100]), 0.3).tolist() == [1.0, 0.5, 0.3, 0.3]
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
    score, predicted = np.array([0.8, 0.8, -0.4]), np.array([False, True, True])
    assert lower_predicted(score, predicted, 0.5).tolist() == [0.8, 0.4, -0.4]
    assert lower_predicted(score, predicted, 1.0) is score
