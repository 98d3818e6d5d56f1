"""Projection, checked by hand and against OpenCV."""

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.replay.geometry.camera import in_image, project, project_body, project_boxes

K = np.array([[400.0, 0, 399.5], [0, 400, 299.5], [0, 0, 1]])
CAMERA = CameraModel(K, (800, 600))
# x right = -y left, y down = -z up, z forward = x forward
FORWARD = np.array([-0.5, 0.5, -0.5, 0.5])


def rig(camera=CAMERA):
    return Rig({"cam": Mount("camera", np.array([2.0, 0, 1]), FORWARD)}, {"cam": camera})


def test_point_ahead_falls_on_the_principal_point():
    uv, depth = project_body(rig(), "cam", np.array([[12.0, 0, 1]]))
    np.testing.assert_allclose(uv, [[399.5, 299.5]], atol=1e-12)
    np.testing.assert_allclose(depth, [10.0])


def test_left_is_left_and_up_is_up():
    uv, _ = project_body(rig(), "cam", np.array([[12.0, 1, 2]]))
    np.testing.assert_allclose(uv, [[359.5, 259.5]])


def test_points_behind_are_nan_and_outside():
    uv, _ = project_body(rig(), "cam", np.array([[1.0, 0, 1], [2.05, 0, 1]]))
    assert np.isnan(uv).all()
    assert not in_image(CAMERA, uv).any()


def test_image_spans_half_a_pixel_beyond_the_centers():
    uv = np.array([[-0.5, 0], [799.5, 599.5], [-0.6, 0], [799.6, 0], [0, 599.6]])
    assert in_image(CAMERA, uv).tolist() == [True, True, False, False, False]


@given(st.lists(st.tuples(*[st.floats(-50, 50)] * 2, st.floats(0.2, 100)), min_size=1, max_size=20))
def test_projection_agrees_with_opencv(points):
    xyz = np.array(points)
    uv, depth = project(CAMERA, xyz)
    reference, _ = cv2.projectPoints(xyz, np.zeros(3), np.zeros(3), K, None)
    np.testing.assert_allclose(uv, reference[:, 0], rtol=1e-9, atol=1e-6)
    np.testing.assert_array_equal(depth, xyz[:, 2])


def test_box_ahead_has_the_outline_of_its_near_face():
    box = Boxes3D(np.array([[12.0, 0, 1]]), np.array([[4.0, 2, 2]]), np.zeros(1))
    outline, seen = project_boxes(rig(), "cam", box)
    assert seen.tolist() == [True]
    np.testing.assert_allclose(outline, [[399.5 - 50, 299.5 - 50, 399.5 + 50, 299.5 + 50]])


def test_what_is_beside_the_camera_is_cut_at_the_near_plane():
    # Turned a little, so that its rear face passes the near plane: the outline must not reach past the box's own edges.
    beside = Boxes3D(np.array([[4.15, -3.0, 0.5]]), np.array([[4.1, 1.6, 1.5]]), np.array([-0.03]))
    xyxy, seen = project_boxes(rig(), "cam", beside)
    assert seen.all()
    share = np.linspace(-0.5, 0.5, 401)
    face = np.stack(np.meshgrid(share, share, [-0.5, 0.5]), axis=-1).reshape(-1, 3) * [4.1, 1.6, 1.5]
    cos, sin = np.cos(-0.03), np.sin(-0.03)
    body = face @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + beside.center_m
    uv, depth = project_body(rig(), "cam", body)
    assert (depth < 0.1).any()
    plain = np.concatenate([np.nanmin(uv, axis=0), np.nanmax(uv, axis=0)]).clip(-0.5, [799.5, 599.5, 799.5, 599.5])
    np.testing.assert_allclose(xyxy, [plain], atol=0.5)


def test_outline_is_clipped_and_boxes_behind_are_not_seen():
    centers = np.array([[3.0, 0, 1], [-10, 0, 1], [12, 100, 1]])
    outline, seen = project_boxes(rig(), "cam", Boxes3D(centers, np.full((3, 3), 2.0), np.zeros(3)))
    assert seen.tolist() == [True, False, False]
    np.testing.assert_allclose(outline[0], [-0.5, -0.5, 799.5, 599.5])
    assert np.isnan(outline[1:]).all()
