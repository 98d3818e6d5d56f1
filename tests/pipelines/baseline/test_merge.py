"""Pairwise merging, by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbench.pipelines.baseline.boxes import Extents, iou, make_extents, merge_boxes, no_extents
from fbench.replay.data.boxes import Source


def flat(*rectangles, source=Source.L, **known):
    sides = np.array(rectangles, np.float64).reshape(-1, 4)
    return make_extents(sides[:, :2], sides[:, 2:], int(source), **{name: np.array(v) for name, v in known.items()})


CAMERA = flat((0, 0, 10, 10), (20, 0, 30, 10), source=Source.C, label=["car", "truck"], score=[0.7, 0.8])


def test_overlap_in_an_image_and_in_space():
    a, b = flat((0, 0, 10, 10)), flat((5, 0, 15, 10), (20, 20, 30, 30), (0, 0, 0, 0))
    np.testing.assert_allclose(iou(a, b), [[50 / 150, 0, 0]])
    cube = make_extents(np.zeros((1, 3)), np.full((1, 3), 2.0), 2)
    other = make_extents(np.ones((1, 3)), np.full((1, 3), 3.0), 2)
    np.testing.assert_allclose(iou(cube, other), [[1 / 15]])
    assert iou(make_extents(np.ones((1, 3)), np.ones((1, 3)), 2), cube)[0, 0] == 0


def test_a_merged_box_knows_what_each_sensor_knows():
    """Outline and class from the camera, distance from LiDAR, speed from radar; the thesis's rule."""
    lidar = flat((1, 1, 9, 9), distance_m=[12.0])
    radar = flat((0, 2, 10, 10), source=Source.R, distance_m=[13.0], range_rate_mps=[-4.0])
    found = merge_boxes([CAMERA, lidar, radar], 0.3)
    np.testing.assert_array_equal(found.low, CAMERA.low)
    np.testing.assert_array_equal(found.high, CAMERA.high)
    assert found.label.tolist() == ["car", "truck"]
    np.testing.assert_array_equal(found.distance_m, [12.0, np.nan])
    np.testing.assert_array_equal(found.range_rate_mps, [-4.0, np.nan])
    assert found.sources.tolist() == [Source.C | Source.L | Source.R, Source.C]
    assert found.score.tolist() == [1.0, 0.8]


def test_what_only_one_sensor_sees_stays():
    found = merge_boxes([CAMERA, flat((40, 0, 50, 10)), flat((60, 0, 70, 10), source=Source.R)], 0.3)
    assert found.low[:, 0].tolist() == [0, 20, 40, 60]
    assert found.sources.tolist() == [Source.C, Source.C, Source.L, Source.R]
    assert found.label.tolist() == ["car", "truck", "", ""]


@pytest.mark.parametrize(("min_iou", "num"), [(0.5, 2), (0.5000001, 3)])
def test_the_overlap_that_merges(min_iou, num):
    """(0, 0, 10, 10) and (0, 0, 10, 5) overlap by exactly a half."""
    assert len(merge_boxes([CAMERA, flat((0, 0, 10, 5))], min_iou)) == num


def test_a_box_joins_the_one_that_it_overlaps_most():
    wide = flat((0, 0, 10, 10), (4, 0, 14, 10), source=Source.C)
    found = merge_boxes([wide, flat((3, 0, 13, 10))], 0.1)
    assert found.sources.tolist() == [Source.C, Source.C | Source.L]
    between = merge_boxes([wide, flat((2, 0, 12, 10))], 0.1)  # as much with both
    assert between.sources.tolist() == [Source.C | Source.L, Source.C]


def test_boxes_of_one_sensor_are_not_merged_but_may_join_one():
    parts = flat((0, 0, 6, 10), (4, 0, 10, 10), distance_m=[5.0, 6.0])
    assert len(merge_boxes([flat(), parts], 0.1)) == 2
    found = merge_boxes([CAMERA[:1], parts], 0.5)
    assert found.sources.tolist() == [Source.C | Source.L]
    assert found.distance_m.tolist() == [5.0]


def test_the_order_of_sensors_matters():
    """A chain: LiDAR overlaps camera and radar, which don't overlap each other."""
    camera = flat((0, 0, 10, 10), source=Source.C)
    lidar, radar = flat((6, 0, 16, 10)), flat((12, 0, 22, 10), source=Source.R)
    assert merge_boxes([camera, lidar, radar], 0.2).sources.tolist() == [Source.C | Source.L, Source.R]
    assert merge_boxes([lidar, camera, radar], 0.2).sources.tolist() == [Source.C | Source.L | Source.R]
    assert merge_boxes([lidar, camera, radar], 0.2).low[:, 0].tolist() == [6]


def test_nothing_at_all():
    assert len(merge_boxes([no_extents(2), no_extents(2)], 0.5)) == 0
    assert len(merge_boxes([no_extents(3)], 0.5)) == 0
    assert len(merge_boxes([no_extents(2), CAMERA, no_extents(2)], 0.5)) == 2


BOXES = st.lists(st.tuples(*[st.integers(0, 20)] * 2, *[st.integers(1, 8)] * 2), max_size=6)


@given(BOXES, BOXES, st.integers(1, 10))
def test_as_a_plain_loop_does(first, second, tenths):
    a, b = (flat(*((x, y, x + w, y + h) for x, y, w, h in boxes)) for boxes in (first, second))
    b = Extents.join([b, no_extents(2)])
    found, kept = merge_boxes([a, b], tenths / 10), [*range(len(first))]
    for row in range(len(second)):
        overlaps = [iou(b[row : row + 1], a[at : at + 1])[0, 0] for at in range(len(first))]
        if not overlaps or max(overlaps) < tenths / 10:
            kept.append(len(first) + row)
    np.testing.assert_array_equal(found.low, Extents.join([a, b]).low[kept])
