"""What cameras say of boxes and points in space. The camera of `frames` looks along x; its focal length is 500 px."""

import numpy as np
from tests.pipelines.frames import rig

from fbench.pipelines.baseline.boxes import (
    add_camera,
    camera_extents,
    cluster_labels,
    label_boxes,
    label_points,
    make_extents,
    project_extents,
    to_solid,
)
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.replay.data.boxes import Source

RIG = rig("cam")
# u = 29.5 - 500 y / x, v = 19.5 - 500 z / x
SEEN = CameraDetections(
    np.array([[9.5, 9.5, 49.5, 29.5], [9.5, 9.5, 29.5, 29.5], [60, 0, 70, 10]]), np.array([0.9, 0.95, 0.8]),
    np.array(["car", "truck", "bus"]),
)  # fmt: skip
LOW = np.array([[50.0, -2, -1], [50, 6, -1], [-60, -2, -1]])
AHEAD = make_extents(LOW, LOW + np.array([[1, 4, 2], [1, 2, 2], [10, 4, 2]]), int(Source.L))


def test_an_outline_in_the_image():
    outline, seen = project_extents(AHEAD, RIG, "cam")
    assert seen.tolist() == [True, False, False]
    np.testing.assert_allclose(np.column_stack([outline.low, outline.high]), [[9.5, 9.5, 49.5, 29.5]])


def test_boxes_are_along_the_axes():
    boxes = to_solid(AHEAD)
    np.testing.assert_array_equal(boxes.center_m[0], [50.5, 0, 0])
    np.testing.assert_array_equal(boxes.size_lwh_m[0], [1, 4, 2])
    assert not boxes.yaw_rad.any()


def test_a_camera_names_what_it_overlaps_most():
    found = label_boxes(AHEAD, RIG, {"cam": SEEN}, 0.5)
    assert found.label.tolist() == ["car", "", ""]
    assert found.sources.tolist() == [Source.C | Source.L, Source.L, Source.L]
    truck = CameraDetections(SEEN.xyxy_px[1:2], SEEN.score[1:2], SEEN.label[1:2])  # a half of the outline
    assert label_boxes(AHEAD, RIG, {"cam": truck}, 0.5).label.tolist() == ["truck", "", ""]
    assert label_boxes(AHEAD, RIG, {"cam": truck}, 0.51).label.tolist() == ["", "", ""]
    nothing = CameraDetections(np.zeros((0, 4)), np.zeros(0), np.zeros(0, "U1"))
    assert label_boxes(AHEAD, RIG, {"cam": nothing}, 0.5).label.tolist() == ["", "", ""]
    assert label_boxes(AHEAD[:0], RIG, {"cam": SEEN}, 0.5).label.tolist() == []


def test_points_get_the_label_of_the_surest_box_around_their_pixel():
    xyz = np.array([[50.0, 1, 0], [50, -1, 0], [50, -4, 0], [50, -1, 4], [-50, 1, 0], [100, -1, 0]])
    assert label_points(xyz, RIG, {"cam": SEEN}).tolist() == ["truck", "car", "", "", "", "car"]
    assert label_points(xyz, RIG, {}).tolist() == [""] * 6


def test_a_cluster_is_called_what_most_of_its_points_are():
    cluster = np.array([0, 0, 0, 0, 1, 1, 1, 2, 2, -1])
    label = np.array(["car", "", "truck", "truck", "", "", "car", "truck", "car", "bus"])
    assert cluster_labels(cluster, label, 0.5).tolist() == ["truck", "", "car"]
    assert cluster_labels(cluster, label, 0.3).tolist() == ["truck", "car", "car"]
    assert cluster_labels(np.array([-1]), np.array(["bus"]), 0.5).tolist() == []


def test_sources_of_what_has_a_name():
    assert add_camera(np.array([2, 6], np.uint8), np.array(["", "car"])).tolist() == [2, 7]


def test_boxes_of_a_camera():
    own = camera_extents(SEEN)
    assert own.sources.tolist() == [Source.C] * 3
    assert own.score.tolist() == [0.9, 0.95, 0.8]
    assert own.label.tolist() == ["car", "truck", "bus"]
