from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fbench.pipelines.sensors.camera.detector import MAX_WINDOWS, merge, to_image, windows
from fbench.pipelines.sensors.camera.layouts import Candidates


def candidates(*rows: tuple[list[float], float, str]) -> Candidates:
    boxes, scores, labels = zip(*rows, strict=True)
    return Candidates(np.array(boxes, np.float64), np.array(scores), np.array(labels))


def test_images_up_to_the_aspect_are_looked_at_as_a_whole() -> None:
    assert windows((800, 600), 2.0, 0.1) == [(0, 0, 800, 600)]
    assert windows((1920, 1080), 2.0, 0.1) == [(0, 0, 1920, 1080)]


def test_wide_and_tall_images_are_cut_along_the_longer_side() -> None:
    assert windows((300, 100), 2.0, 0.1) == [(0, 0, 300, 100), (0, 0, 200, 100), (100, 0, 300, 100)]
    assert windows((100, 300), 2.0, 0.1) == [(0, 0, 100, 300), (0, 0, 100, 200), (0, 100, 100, 300)]


def test_a_strip_is_cut_into_eight_longer_windows() -> None:
    whole, *parts = windows((20000, 1), 2.0, 0.1)
    assert whole == (0, 0, 20000, 1)
    assert len(parts) == 8
    assert parts[0] == (0, 0, 2740, 1)  # 20000 / (1 + 7 * 0.9)
    assert parts[-1] == (17260, 0, 20000, 1)


@given(st.integers(1, 40000), st.integers(1, 1000), st.floats(1.0, 3.0), st.floats(0.0, 0.5))
def test_windows_cover_the_image_and_overlap(width: int, height: int, aspect: float, overlap: float) -> None:
    parts = windows((width, height), aspect, overlap)[1:]
    for part in parts:
        assert 0 <= part[0] < part[2] <= width
        assert 0 <= part[1] < part[3] <= height
    if parts:
        axis = 0 if width > height else 1
        assert parts[0][axis] == 0
        assert parts[-1][axis + 2] == max(width, height)
        side = parts[0][axis + 2]
        assert len(parts) <= MAX_WINDOWS
        assert all(a[axis + 2] - b[axis] >= overlap * side - 1.5 for a, b in pairwise(parts))


def test_a_box_cut_by_an_inner_border_is_dropped_one_at_the_images_border_stays() -> None:
    found = candidates(([0, 5, 20, 15], 0.9, "car"), ([180, 5, 200, 15], 0.8, "car"), ([50, 5, 60, 15], 0.7, "car"))
    left = to_image(found, (0, 0, 200, 100), (300, 100))
    assert left.xyxy.tolist() == [[0, 5, 20, 15], [50, 5, 60, 15]]
    right = to_image(found, (100, 0, 300, 100), (300, 100))
    assert right.xyxy.tolist() == [[280, 5, 300, 15], [150, 5, 160, 15]]


def test_boxes_are_clipped_to_the_image_and_damaged_ones_dropped() -> None:
    found = candidates(
        ([-5, -5, 20, 15], 0.9, "car"), ([500, 0, 600, 9], 0.8, "car"), ([9, 9, 5, 5], 0.7, "car"),
        ([np.nan, 0, 5, 5], 0.7, "car"), ([1, 1, 5, 5], np.nan, "car"),
    )  # fmt: skip
    assert to_image(found, (0, 0, 300, 100), (300, 100)).xyxy.tolist() == [[0, 0, 20, 15]]


def test_one_vehicle_found_as_bus_and_truck_stays_once_with_the_better_score() -> None:
    merged = merge([candidates(([0, 0, 10, 10], 0.7, "truck"), ([0, 0, 10, 9], 0.8, "bus"))], 0.5, 0.9)
    assert merged.label.tolist() == ["bus"]


def test_a_pedestrian_in_front_of_a_car_stays() -> None:
    merged = merge([candidates(([0, 0, 10, 10], 0.7, "pedestrian"), ([0, 0, 10, 9], 0.8, "car"))], 0.5, 0.9)
    assert merged.label.tolist() == ["car", "pedestrian"]


def test_a_part_of_a_vehicle_is_dropped_a_half_hidden_vehicle_stays() -> None:
    whole = ([0.0, 0.0, 100.0, 50.0], 0.9, "bus")
    part, neighbor = ([60.0, 10.0, 100.0, 50.0], 0.8, "car"), ([70.0, 10.0, 130.0, 50.0], 0.7, "car")
    assert merge([candidates(whole, part, neighbor)], 0.5, 0.9).score.tolist() == [0.9, 0.7]


def test_no_candidates_give_no_boxes() -> None:
    assert len(merge([], 0.5, 0.9)) == 0


@given(st.permutations(range(6)), st.integers(0, 6))
def test_order_and_grouping_of_candidates_change_nothing(order: list[int], cut: int) -> None:
    rows = [([float(i % 3), 0.0, 10.0 + i, 10.0], 0.5, label) for i, label in enumerate(["car", "bus", "truck"] * 2)]
    expected = merge([candidates(*rows)], 0.7, 0.99)
    parts = [candidates(*chunk) for chunk in ([rows[i] for i in order[:cut]], [rows[i] for i in order[cut:]]) if chunk]
    got = merge(parts, 0.7, 0.99)
    assert got.xyxy.tolist() == expected.xyxy.tolist()
    assert got.label.tolist() == expected.label.tolist()
