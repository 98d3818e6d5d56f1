"""Lenses, checked by hand, against OpenCV, and there and back."""

from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.replay.geometry.camera import (
    in_image,
    not_projectable,
    project,
    project_body,
    project_boxes,
    project_edges,
    rays,
)
from fbench.replay.geometry.iou import corners

K = np.array([[400.0, 0, 399.5], [0, 410, 299.5], [0, 0, 1]])
SKEWED = np.array([[400.0, 3, 399.5], [0, 410, 299.5], [0, 0, 1]])
FORWARD = np.array([-0.5, 0.5, -0.5, 0.5])
BARREL = (-0.3, 0.1, 0.001, -0.002, -0.02)
RATIONAL = (0.5, -0.2, 0.001, 0.0005, 0.01, 0.7, -0.1, 0.02)
FISHEYE = (0.05, -0.01, 0.003, -0.001)
LENSES = [("plumb_bob", BARREL), ("plumb_bob", (0.2, 0.1, 0.001, -0.002)), ("rational_polynomial", RATIONAL),
          ("fisheye", FISHEYE), ("fisheye", (0, 0, 0, 0))]  # fmt: skip


def camera(model, coefficients, matrix=K):
    return CameraModel(matrix, (800, 600), model, np.array(coefficients, np.float64))


def rig(model, coefficients, matrix=K):
    return Rig({"cam": Mount("camera", np.zeros(3), FORWARD)}, {"cam": camera(model, coefficients, matrix)})


def by_opencv(model, coefficients, xyz):
    points, none = np.asarray(xyz, np.float64).reshape(-1, 1, 3), np.zeros(3)
    project_points = cv2.fisheye.projectPoints if model == "fisheye" else cv2.projectPoints
    return project_points(points, none, none, K, np.array(coefficients, np.float64))[0].reshape(-1, 2)


small = st.floats(-0.05, 0.05)
tiny = st.floats(-0.002, 0.002)
plumb_bobs = st.tuples(st.just("plumb_bob"), st.tuples(small, small, tiny, tiny, small))
rationals = st.tuples(st.just("rational"), st.tuples(small, small, tiny, tiny, small, small, small, small))
fisheyes = st.tuples(st.just("fisheye"), st.tuples(small, small, tiny, tiny))
lenses = st.one_of(plumb_bobs, rationals, fisheyes)
ahead = st.tuples(st.floats(-0.8, 0.8), st.floats(-0.6, 0.6), st.just(1.0), st.floats(0.2, 100))


@given(lenses, st.lists(ahead, min_size=1, max_size=20))
def test_projection_agrees_with_opencv(lens, points):
    (model, coefficients), xyz = lens, np.array([[x * d, y * d, z * d] for x, y, z, d in points])
    uv, _ = project(camera(model, coefficients), xyz)
    np.testing.assert_allclose(uv, by_opencv(model, coefficients, xyz), rtol=1e-9, atol=1e-6)


weak = st.floats(-0.01, 0.01)
weak_lenses = st.one_of(
    st.tuples(st.just("plumb_bob"), st.tuples(weak, weak, tiny, tiny, weak)),
    st.tuples(st.just("rational"), st.tuples(weak, weak, tiny, tiny, weak, weak, weak, weak)),
    fisheyes,
)


@given(weak_lenses, st.lists(st.tuples(st.floats(100, 700), st.floats(75, 525)), min_size=1, max_size=20))
def test_pixels_go_out_and_come_back(lens, pixels):
    model, uv = camera(lens[0], lens[1], SKEWED), np.array(pixels)
    directions = rays(model, uv)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(project(model, 7 * directions)[0], uv, atol=1e-6)
    straight = CameraModel(SKEWED, (800, 600))
    np.testing.assert_allclose(rays(straight, project(straight, directions)[0]), directions, atol=1e-9)


@pytest.mark.parametrize(("model", "coefficients"), LENSES)
def test_undistorted_pixels_agree_with_opencv(model, coefficients):
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(250, 550, 9), np.linspace(200, 400, 7)))
    uv = np.column_stack([x, y])
    values, points = np.array(coefficients, np.float64), uv[:, None]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    if model == "fisheye":
        reference = cv2.fisheye.undistortPoints(points, K, values, P=K, criteria=criteria)
    else:
        reference = cv2.undistortPoints(points, K, values, P=K, criteria=criteria)
    flat, _ = project(camera("", []), rays(camera(model, coefficients), uv))
    np.testing.assert_allclose(flat, reference[:, 0], atol=1e-5)


def test_a_pinhole_is_bit_for_bit_what_it_was():
    xyz = np.random.default_rng(0).uniform([-5, -5, -1], [5, 5, 30], (500, 3))
    u = (400.0 * xyz[:, 0] + 3.0 * xyz[:, 1]) / np.where(xyz[:, 2] > 0.1, xyz[:, 2], np.nan) + 399.5
    for model, zeros in (("", 0), ("plumb_bob", 5), ("rational_polynomial", 8), ("plumb_bob", 0), ("omni", 4)):
        uv, depth = project(camera(model, [0.0] * zeros, SKEWED), xyz)
        assert uv[:, 0].tobytes() == u.tobytes()
        assert depth.tolist() == xyz[:, 2].tolist()
    np.testing.assert_allclose(rays(camera("", []), np.array([[799.5, 299.5]])), [[2**-0.5, 0, 2**-0.5]])


def test_barrel_by_hand():
    # r = 0.5: 0.5 (1 - 0.2 * 0.25) = 0.475, 190 px right of the center.
    uv, _ = project(camera("plumb_bob", (-0.2, 0, 0, 0)), np.array([[1.0, 0, 2]]))
    np.testing.assert_allclose(uv, [[589.5, 299.5]])


def test_nothing_folds_back_into_the_image():
    # r (1 - 0.3 r2) grows up to r = 1 / sqrt(0.9) = 1.054, and is 0 again at r = 1.826.
    model = camera("plumb_bob", (-0.3, 0, 0, 0))
    tangents = np.array([0.0, 1.0, 1.05, 1.06, 1.5, 1.826, 5.0])
    uv, _ = project(model, np.column_stack([tangents, np.zeros(7), np.ones(7)]))
    assert np.isfinite(uv).all(axis=1).tolist() == [True, True, True, False, False, False, False]
    assert in_image(model, uv).tolist() == [True, True, True, False, False, False, False]
    np.testing.assert_allclose(uv[2, 0], 399.5 + 400 * 1.05 * (1 - 0.3 * 1.05**2))


@given(lenses, st.floats(0, 2 * np.pi))
def test_the_image_grows_with_the_angle_until_nothing_is_seen(lens, around):
    model = camera(lens[0], [c if i not in (2, 3) or lens[0] == "fisheye" else 0 for i, c in enumerate(lens[1])])
    angle = np.linspace(0.01, 3.1, 400)
    directions = np.column_stack([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)])
    uv, _ = project(model, 100 * directions)
    far = np.hypot((uv[:, 0] - 399.5) / 400, (uv[:, 1] - 299.5) / 410)
    seen = np.isfinite(far)
    assert not np.diff(seen.astype(int)).any() or np.diff(seen.astype(int)).tolist().count(-1) == 1
    assert all(a < b for a, b in pairwise(far[seen]))


def test_a_pole_of_the_denominator_ends_the_view():
    model = camera("rational", (0, 0, 0, 0, 0, -1.0, 0, 0))  # 1 / (1 - r2)
    uv, _ = project(model, np.array([[0.5, 0, 1], [0.99, 0, 1], [1.01, 0, 1], [3, 0, 1]]))
    assert np.isfinite(uv[:, 0]).tolist() == [True, True, False, False]


def test_pixels_without_a_ray_are_nan():
    barrel = camera("plumb_bob", (-0.3, 0, 0, 0))  # reaches 0.703 at most: 281 px
    found = rays(barrel, np.array([[399.5 + 280, 299.5], [399.5 + 282, 299.5]]))
    assert np.isfinite(found).all(axis=1).tolist() == [True, False]
    tangential = camera("plumb_bob", (-0.3, 0, 0.001, 0.001))
    assert np.isnan(rays(tangential, np.array([[0.0, 0.0]]))).all()
    fisheye = camera("fisheye", (0, 0, 0, 0))  # sees all around: pi * 400 px
    assert np.isfinite(rays(fisheye, np.array([[399.5 + 1256, 299.5]]))).all()
    assert np.isnan(rays(fisheye, np.array([[399.5 + 1258, 299.5]]))).all()
    beside = np.array([[399.5 + 400 * 1.6, 299.5]])
    assert rays(fisheye, beside)[0, 2] < 0


def test_a_fisheye_sees_beside_and_behind_itself():
    model = camera("fisheye", (0, 0, 0, 0))
    xyz = np.array([[5.0, 0, 0], [5, 0, -5], [0, 0, 3], [0.05, 0, 0.05], [0, 0, -5]])
    uv, depth = project(model, xyz)
    np.testing.assert_allclose(uv[:3, 0], 399.5 + 400 * np.array([np.pi / 2, 3 * np.pi / 4, 0]))
    np.testing.assert_allclose(depth[:3], [5, 50**0.5, 3])
    assert np.isnan(uv[3:]).all()


def test_polynomial_lenses_see_nothing_behind_themselves():
    uv, depth = project(camera("plumb_bob", BARREL), np.array([[0.0, 0, -5], [0, 0, 0.05], [0, 0, 0]]))
    assert np.isnan(uv).all()
    assert depth.tolist() == [-5, 0.05, 0]


@pytest.mark.parametrize(
    ("model", "coefficients", "why"),
    [
        ("omni", [1.0], "distortion model 'omni' isn't supported, only plumb_bob, rational_polynomial, fisheye"),
        ("double_sphere", [0.1, 0.5], "distortion model 'double_sphere' isn't supported"),
        ("", [0.1], "distortion model '' isn't supported"),
        ("plumb_bob", [0.1, 0.2], "distortion model 'plumb_bob' has 2 coefficients, not 4 or 5"),
        ("plumb_bob", [0.1] * 8, "distortion model 'plumb_bob' has 8 coefficients, not 4 or 5"),
        ("rational", [0.1] * 5, "distortion model 'rational' has 5 coefficients, not 8"),
        ("rational_polynomial", [0.1] * 12, "'rational_polynomial' with thin prism or tilt isn't supported"),
        ("rational_polynomial", [0.1] * 14, "'rational_polynomial' with thin prism or tilt isn't supported"),
        ("fisheye", [0.1] * 5, "distortion model 'fisheye' has 5 coefficients, not 4"),
        ("fisheye", [0.1, np.nan, 0, 0], "distortion model 'fisheye': coefficients aren't finite"),
    ],
)
def test_other_models_are_refused_by_name(model, coefficients, why):
    with pytest.raises(LogError) as error:
        project_body(rig(model, coefficients), "cam", np.zeros((1, 3)))
    assert str(error.value).startswith("camera 'cam': ")
    assert why in str(error.value)
    assert str(error.value).endswith("; rectify the images")
    assert error.value.code == "CAL001"
    assert why in (not_projectable(camera(model, coefficients)) or "")


def test_appended_zeros_and_other_names_mean_the_same():
    xyz = np.array([[0.5, 0.2, 1.0]])

    def at(model, *coefficients):
        return project(camera(model, coefficients), xyz)[0].tolist()

    assert at("plumb_bob", *BARREL, 0, 0, 0) == at("radtan", *BARREL) == at("plumb_bob", *BARREL)
    assert at("rational", *RATIONAL, *[0] * 6) == at("rational_polynomial", *RATIONAL)
    assert at("equidistant", *FISHEYE) == at("fisheye", *FISHEYE)


def face_points(box, num=120):
    """Points all over the faces of one box."""
    eight = corners(box)[0]
    axes = eight[[1, 2, 4]] - eight[0]
    a, b = (g.ravel()[:, None] for g in np.meshgrid(*[np.linspace(0, 1, num)] * 2))
    return np.concatenate(
        [eight[0] + side * axes[i] + a * axes[i - 1] + b * axes[i - 2] for i in range(3) for side in (0, 1)]
    )


WIDE = K * np.array([[0.5, 1, 1], [1, 0.5, 1], [1, 1, 1]])
BOXES = st.tuples(st.floats(3, 20), st.floats(-8, 8), st.floats(-2, 2), st.floats(0.5, 5), st.floats(-3, 3))


@pytest.mark.parametrize(("model", "coefficients", "matrix"),
                         [("plumb_bob", (-0.2, 0.05, 0.001, -0.001, 0), K), ("fisheye", FISHEYE, WIDE)])  # fmt: skip
@settings(max_examples=25, deadline=None)
@given(BOXES)
def test_outline_holds_the_whole_box(model, coefficients, matrix, given_box):
    x, y, z, size, yaw = given_box
    box = Boxes3D(np.array([[x, y, z]]), np.array([[size, 2.0, 1.5]]), np.array([yaw]))
    view = rig(model, coefficients, matrix)
    (outline,), (seen,) = project_boxes(view, "cam", box)
    uv, _ = project_body(view, "cam", face_points(box))
    uv = uv[np.isfinite(uv).all(axis=1)]
    low, high = np.maximum(uv.min(axis=0), -0.5), np.minimum(uv.max(axis=0), [799.5, 599.5])
    if (high > low + 2).all():
        assert seen
        np.testing.assert_allclose(outline, [*low, *high], atol=2.0)


def test_an_edge_reaches_farther_than_its_ends():
    # The middle of a wide wall's lower edge is nearer to the image's border than its corners.
    wall = Boxes3D(np.array([[4.0, 0, 0]]), np.array([[0.1, 6.0, 3.0]]), np.zeros(1))
    view = rig("plumb_bob", (-0.2, 0, 0, 0))
    (outline,), _ = project_boxes(view, "cam", wall)
    at_corners, _ = project_body(view, "cam", corners(wall)[0])
    assert outline[3] > np.nanmax(at_corners[:, 1]) + 5
    edges = project_edges(view, "cam", wall)
    assert edges.shape == (1, 12, 9, 2)
    assert np.nanmax(edges[..., 1]) == pytest.approx(outline[3], abs=0.5)


def test_boxes_around_a_camera_fill_its_image():
    around = Boxes3D(np.zeros((1, 3)), np.full((1, 3), 4.0), np.zeros(1))
    for model, coefficients in (("plumb_bob", (-0.1, 0, 0, 0)), ("fisheye", FISHEYE)):
        outline, seen = project_boxes(rig(model, coefficients), "cam", around)
        assert seen.all()
        np.testing.assert_allclose(outline, [[-0.5, -0.5, 799.5, 599.5]])


def test_boxes_behind_are_seen_by_a_fisheye_only():
    behind = Boxes3D(np.array([[-2.0, 6.0, 0]]), np.full((1, 3), 1.0), np.zeros(1))
    small = K * np.array([[0.4, 1, 1], [1, 0.4, 1], [1, 1, 1]])
    outline, seen = project_boxes(rig("fisheye", (0, 0, 0, 0), small), "cam", behind)
    assert seen.all()
    assert outline[0, 2] < 399.5 - 160 * np.pi / 2
    assert not project_boxes(rig("plumb_bob", BARREL), "cam", behind)[1].any()
    assert project_boxes(rig("fisheye", FISHEYE), "cam", Boxes3D.empty())[0].shape == (0, 4)


def test_a_wall_that_is_wider_than_the_lens_sees():
    wall = Boxes3D(np.array([[2.0, 0, 0]]), np.array([[0.1, 50.0, 50.0]]), np.zeros(1))
    (outline,), _ = project_boxes(rig("plumb_bob", (-0.3, 0, 0, 0)), "cam", wall)
    reach = 0.7027 * np.array([400, 410])  # where the lens folds
    np.testing.assert_allclose(outline[[0, 2]], [399.5 - reach[0], 399.5 + reach[0]], atol=0.5)
    np.testing.assert_allclose(outline[[1, 3]], [299.5 - reach[1], 299.5 + reach[1]], atol=0.5)
