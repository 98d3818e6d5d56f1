"""Which frames have truth: by number where both have one, else by stamp."""

import numpy as np
import pytest

from fbench.replay.check.truth import TruthCheck
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Truth

MS = 1_000_000
NO_BOXES = Boxes3D(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))


def checked(*truths: tuple[int, int | None]) -> TruthCheck:
    check = TruthCheck()
    for stamp_ms, number in truths:
        check.add(Truth(stamp_ms * MS, stamp_ms * MS, NO_BOXES, frame_number=number))
    return check


@pytest.mark.parametrize("number", [0, 1, 7])
def test_an_equal_number_is_enough(number):
    check = checked((900, number))
    assert check.find_labeled(np.array([100 * MS]), np.array([number])).tolist() == [True]
    assert list(check.findings(np.array([100 * MS]), np.array([number]))) == []


def test_numbers_that_are_none_are_not_equal():
    check = checked((900, None))
    assert check.find_labeled(np.array([100 * MS]), np.array([-1])).tolist() == [False]
    (lost,) = check.findings(np.array([100 * MS]), np.array([-1]))
    assert (lost.code, lost.text) == ("GT006", "1 of 1 message of truth belong to no frame")


def test_the_nearest_truth_before_or_behind_counts():
    check = checked((100, None), (300, None))
    frames = np.array([99, 101, 200, 299, 301]) * MS
    assert check.find_labeled(frames, np.full(5, -1)).tolist() == [True, True, False, True, True]


def test_a_log_without_truth_says_so():
    assert [one.code for one in TruthCheck().findings(np.array([MS]), np.array([-1]))] == ["GT001"]
    assert TruthCheck().find_labeled(np.array([MS]), np.array([0])).tolist() == [False]
