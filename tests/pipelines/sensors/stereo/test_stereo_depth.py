"""Disparity and depth of surfaces that are known exactly."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from tests.pipelines.sensors.stereo.pairs import BASELINE_M, HEIGHT_M, K, frame, rig, road, seen, wall

from fbench.pipelines.sensors.stereo.depth import DepthParams, DisparityParams, Matcher, choose_pair, points, rectifier
from fbench.pipelines.sensors.stereo.stage import StereoParams, StereoStage, StereoView
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.params import StageClock
from fbench.replay.data.rig import Rig

FULL = DisparityParams(shrink=1)


def matched(sensors: Rig, surfaces, params=FULL):
    how = rectifier(sensors, choose_pair(sensors, "drive", None, None), params.shrink)
    matcher = Matcher(how.camera.K[0, 0], how.baseline_m, how.camera.size_wh[0], params)
    left, right = how.images(seen(sensors, "left", surfaces), seen(sensors, "right", surfaces))
    return matcher.disparity(left, right, matcher.texture(left)), how


def view(sensors: Rig, surfaces) -> StereoView:
    return StereoStage(sensors, "drive", StereoParams(disparity=FULL)).view(frame(sensors, surfaces), StageClock(), [])


@pytest.mark.parametrize(("distance_m", "shrink"), [(4.0, 1), (8.0, 1), (16.0, 1), (4.0, 2), (8.0, 2)])
def test_disparity_of_a_wall_is_f_b_over_z(distance_m, shrink):
    disparity, how = matched(rig(), [wall(distance_m)], replace(FULL, shrink=shrink))
    expected = K[0, 0] / shrink * BASELINE_M / distance_m
    inner = disparity[10:-10, int(expected) + 10 : -10]
    assert how.maps is None
    assert np.isfinite(inner).mean() > 0.85
    assert np.nanmedian(np.abs(inner - expected)) < 0.1
    assert np.nanpercentile(np.abs(inner - expected), 95) < 0.5


def test_what_only_the_left_camera_sees_has_no_disparity():
    disparity, _ = matched(rig(), [wall(4.0)])
    assert np.isnan(disparity[:, :16]).mean() > 0.95  # a wall at 4 m has 20 px
    assert np.isfinite(disparity[:, 25:]).mean() > 0.8  # also nearer to the border than the disparities searched


@pytest.mark.parametrize("sensors", [rig(turned_deg=2.0), rig(distortion=(-0.1, 0.02, 0.001, 0.0))])
def test_turned_and_bent_cameras_are_rectified(sensors):
    disparity, how = matched(sensors, [wall(6.0)])
    assert how.maps is not None
    xyz = points(disparity, how, 3.0, DepthParams())
    assert np.median(xyz[:, 0]) == pytest.approx(6.0, rel=0.03)
    assert np.percentile(np.abs(xyz[:, 0] - 6.0), 80) < 0.4


def test_points_are_in_body_coordinates():
    disparity = np.full((300, 400), np.nan, np.float32)
    disparity[100:104, 300:304] = 8.0
    how = rectifier(rig(), choose_pair(rig(), "drive", None, None), 1)
    xyz = points(disparity, how, 3.0, DepthParams(cell_px=4, cell_height_m=5.0))
    z = K[0, 0] * BASELINE_M / 8.0
    expected = [z, BASELINE_M / 2 - (301.5 - K[0, 2]) * z / K[0, 0], HEIGHT_M - (101.5 - K[1, 2]) * z / K[1, 1]]
    assert xyz == pytest.approx(np.array([expected]))


def test_points_are_thinned_and_limited():
    disparity, how = matched(rig(), [road(), wall(20.0)])
    xyz = points(disparity, how, 3.0, DepthParams())
    assert 100 < len(xyz) < np.isfinite(disparity).sum() / 8
    assert np.array_equal(xyz, xyz[np.lexsort(xyz.T[::-1])])
    assert not (points(disparity, how, 3.0, DepthParams(max_range_m=15.0))[:, 0] > 15.0 + 1e-9).any()
    assert len(points(disparity, how, 3.0, DepthParams(min_pixels=10_000))) == 0
    assert len(points(np.full_like(disparity, np.nan), how, 3.0, DepthParams())) == 0


def test_the_ground_is_flat():
    xyz = view(rig(), [road(), wall(20.0)]).xyz
    ground = xyz[(xyz[:, 0] < 15) & (xyz[:, 2] < 0.5)]
    assert len(ground) > 200
    assert abs(np.median(ground[:, 2])) < 0.05
    assert np.percentile(np.abs(ground[:, 2]), 90) < 0.15


def test_threads_change_nothing():
    before = cv2.getNumThreads()
    try:
        found = []
        for num in (1, 2, 5):
            cv2.setNumThreads(num)
            found.append(matched(rig(), [road(), wall(12.0)])[0])
    finally:
        cv2.setNumThreads(before)
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])


@pytest.mark.parametrize("level", [0, 128, 255])
def test_flat_images_have_no_disparity(level):
    matcher = Matcher(200.0, 0.4, 400, FULL)
    flat = np.full((300, 400), level, np.uint8)
    assert np.isnan(matcher.disparity(flat, flat, matcher.texture(flat))).all()


@pytest.mark.parametrize("width", [32, 47, 64])
def test_small_images_are_matched_as_far_as_they_reach(width):
    matcher = Matcher(2000.0, 2.0, width, FULL)
    image = np.random.default_rng(0).integers(0, 255, (32, width)).astype(np.uint8)
    assert matcher.num_px <= width
    assert matcher.disparity(image, image, matcher.texture(image)).shape == (32, width)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: DisparityParams(block_px=4), "stereo.disparity.block_px: expected an odd number, got 4"),
        (lambda: DisparityParams(smoothness=(32, 8)), "stereo.disparity.smoothness: expected"),
        (lambda: DisparityParams(shrink=0), "stereo.disparity.shrink: expected between 1 and 8, got 0"),
        (lambda: DepthParams(cell_px=0), "stereo.depth.cell_px: expected between 1 and 100, got 0"),
    ],
)
def test_parameters_that_make_no_sense(make, match):
    with pytest.raises(ConfigError, match=match):
        make()
