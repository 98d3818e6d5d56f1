"""Parts of objects that a detector takes for objects are believed less."""

from dataclasses import replace

import numpy as np
import pytest
from tests.pipelines.fusion.views import PLANE, RIG, car, outline

from fbench.pipelines.fusion.late.fuse import lower_nested
from fbench.pipelines.fusion.observations import AssociationParams, observe_camera

OBSERVATION = observe_camera(RIG, "cam", outline(car(20.0)), PLANE, AssociationParams())[0]


def boxed(left, right, score, camera="cam", label="car"):
    edges = np.array([left, 100.0, right, 200.0])
    return replace(OBSERVATION, xyxy_px=edges, score=score, is_sure=score >= 0.55, camera=camera, label=label)


def told(*seen):
    return {(s.camera, *s.xyxy_px[[0, 2]].tolist()): (round(s.score, 6), s.is_sure) for s in lower_nested(seen)}


@pytest.mark.parametrize(
    ("right", "score", "is_sure"),
    [(250.0, 0.6, True), (200.0, 0.6, True), (175.0, 0.3, False), (160.0, 0.12, False), (149.0, 0.012, False)],
)  # fmt: skip
def test_what_lies_in_a_surer_box_counts_less_the_more_of_it_does(right, score, is_sure):
    """The part is 100 px wide; of it 0, 50, 75, 90 and 99 px lie in the other, and up to 50 px nothing is lost."""
    part = boxed(right - 100, right, 0.6)
    whole = boxed(50.0, 150.0, 0.9)
    assert told(whole, part)["cam", right - 100, right] == (score, is_sure)
    assert told(whole, part)["cam", 50.0, 150.0] == (0.9, True)


def test_a_large_box_around_a_surer_small_one_stays():
    small, large = boxed(100.0, 140.0, 0.9), boxed(50.0, 250.0, 0.6, label="truck")
    assert told(small, large) == {("cam", 100.0, 140.0): (0.9, True), ("cam", 50.0, 250.0): (0.6, True)}


def boxed_upright(left, top, right, bottom, score, label):
    return replace(OBSERVATION, xyxy_px=np.array([left, top, right, bottom], np.float64), score=score, label=label)


@pytest.mark.parametrize(("bottom", "score"), [(210.0, 0.8), (201.0, 0.8 * 0.02), (190.0, 0.8 * 0.01)])
def test_who_stands_in_front_of_a_bus_is_no_part_of_it(bottom, score):
    """By the lower edge, which may be a pixel off."""
    bus, person = (
        boxed_upright(0, 0, 300, 200, 0.9, "bus"),
        boxed_upright(100, bottom - 100, 140, bottom, 0.8, "person"),
    )
    assert sorted(s.score for s in lower_nested([bus, person])) == pytest.approx([score, 0.9])


def test_a_box_that_is_doubted_itself_says_less():
    """In a row each overlaps the next by 70 of 100 px; only the first of them counts for the second, which then has a
    lower score than the third, so that the third loses nothing to it and 40 px to the first.
    """
    assert told(boxed(0.0, 100.0, 0.9), boxed(30.0, 130.0, 0.8), boxed(60.0, 160.0, 0.7)) == {
        ("cam", 0.0, 100.0): (0.9, True), ("cam", 30.0, 130.0): (0.48, False), ("cam", 60.0, 160.0): (0.7, True),
    }  # fmt: skip


def test_scores_that_are_no_probabilities_never_rise():
    assert told(boxed(0.0, 100.0, -1.0), boxed(0.0, 100.0, -3.0, label="van"))["cam", 0.0, 100.0] == (-3.0, False)
    low = [replace(boxed(left, 100.0, score), is_sure=True) for left, score in ((0.0, 0.3), (4.0, 0.29), (10.0, 0.2))]
    assert [s.is_sure for s in lower_nested(low)] == [True, False, False]


def test_other_images_say_nothing():
    assert told(boxed(0.0, 100.0, 0.9), boxed(0.0, 100.0, 0.6, "other"))["other", 0.0, 100.0] == (0.6, True)


def test_of_equal_boxes_one_stays_whatever_their_order():
    twins = [boxed(0.0, 100.0, 0.7), boxed(10.0, 100.0, 0.7)]
    assert (
        told(*twins)
        == told(*reversed(twins))
        == {("cam", 0.0, 100.0): (0.7, True), ("cam", 10.0, 100.0): (0.007, False)}
    )


def test_nothing_seen():
    assert lower_nested([]) == []
