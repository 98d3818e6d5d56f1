"""Surfaces have enough texture for stereo matching: Z = f B / d of a rendered pair."""

import cv2
import numpy as np
import pytest

from fbench.datasets.city.mesh import Skin, box
from fbench.datasets.city.rig import thesis_rig


@pytest.fixture(scope="module")
def pair_maker():
    cameras = thesis_rig().cameras
    return lambda look: [look.take(cameras[f"stereo_{side}"], sensor=f"stereo_{side}") for side in ("left", "right")]


def relative_errors(left, right):
    gray = [cv2.cvtColor(p.rgb, cv2.COLOR_RGB2GRAY) for p in (left, right)]
    matcher = cv2.StereoSGBM.create(
        minDisparity=0, numDisparities=96, blockSize=7, P1=8 * 49, P2=32 * 49, disp12MaxDiff=1, uniquenessRatio=10,
        speckleWindowSize=100, speckleRange=2, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )  # fmt: skip
    disparity = matcher.compute(*gray) / 16.0
    valid = (disparity > 0) & (left.depth_m < 30) & (np.arange(800) > 100)
    return np.where(valid, np.abs(400 * 0.4 / np.where(valid, disparity, 1) / left.depth_m - 1), np.nan)


def test_depth_by_disparity_is_within_two_percent_to_30_m(look, ground, body, pair_maker):
    walls = [
        box((30, 9, 4), (60, 2, 8), Skin("brick", (0.3, 0.15, 0.1))),
        box((30, -9, 4), (60, 2, 8), Skin("plaster", (0.5, 0.45, 0.4))),
        box((28, 0, 2), (2, 8, 4), Skin("concrete", (0.4, 0.4, 0.4))),
    ]
    bodies = [(body(), (12.0, 2.5, 0), 0.1), (body((0.2, 0.3, 0.5)), (18.0, -2.5, 0), 3.0),
              (body((0.3, 0.25, 0.2), (0.5, 0.6, 1.75), "cloth", "pedestrian"), (9.0, -3, 0), 0.4)]  # fmt: skip
    left, right = pair_maker(look([ground, *walls], bodies))
    errors = relative_errors(left, right)
    for part in (left.body >= 0, left.body == -1):
        matched = np.isfinite(errors[part & (left.depth_m < 30)])
        assert matched.mean() > 0.6
        assert np.nanmedian(errors[part]) < 0.02
    assert np.nanmedian(errors[(left.depth_m < 8) & (left.normal[..., 2] > 0.9)]) < 0.01  # the road
    assert np.nanmedian(errors[left.depth_m > 15]) < 0.03  # 5 to 10 px, of which SGBM is a fifth or so off


def test_both_cameras_see_the_same_surface(look, ground, spec):
    """A point's color is a matter of the point: the pixel that shows it in the other camera has it too."""
    view = look([ground, box((11, 0, 2), (2, 12, 4), Skin("concrete", (0.4, 0.4, 0.4)))])
    left = view.take(spec(translation_m=(2.0, 0.25, 1.0)), sensor="left")
    right = view.take(spec(translation_m=(2.0, -0.25, 1.0)), sensor="right")
    assert np.allclose(left.depth_m[140, 150:250], 8.0, atol=1e-4)  # the wall's face at x = 10
    shift = 200 * 0.5 / 8.0  # 12.5 px: the middle of two pixels
    a = left.rgb[100:160, 150:250].astype(float)
    b = (right.rgb[100:160, 137:237].astype(float) + right.rgb[100:160, 138:238]) / 2
    assert shift == 12.5
    assert np.abs(a - b).mean() < 0.25 * a.std()
