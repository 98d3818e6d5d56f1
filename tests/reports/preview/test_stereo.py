"""Pairs are found by their geometry, and depth comes out right."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.reports.preview.street import FORWARD, sample, street_rig

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.geometry.stereo_pairs import pairs, rectify
from fbench.reports.preview.preview import write_preview
from fbench.reports.preview.sample import Material
from fbench.reports.preview.stereo import stereo_view


def texture(shift, depth_m, K, size):
    """An image of a wall with a fixed pattern, `depth_m` ahead of a camera that is `shift` to the right."""
    u, v = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    x = (u - K[0, 2]) / K[0, 0] * depth_m + shift
    y = (v - K[1, 2]) / K[1, 1] * depth_m
    waves = np.sin(9 * x) + np.sin(23 * x + 5 * y) + np.sin(13 * y) + np.sin(31 * x - 17 * y)
    return np.repeat(np.round(128 + 30 * waves).astype(np.uint8)[:, :, None], 3, axis=2)


def wall(depth_m):
    return [[depth_m, y, z] for y in np.linspace(-2, 2, 20) for z in np.linspace(-1, 1, 10)]


def test_the_left_camera_of_a_pair_is_found():
    (pair,) = pairs(street_rig(left=0.2, right=-0.2))
    assert (pair.left, pair.right) == ("cam", "cam2")
    assert pair.baseline_m == pytest.approx(0.4)
    (swapped,) = pairs(street_rig(left=-0.2, right=0.2))
    assert swapped.left == "cam2"


def test_cameras_that_are_no_pair_are_left_alone():
    assert not pairs(street_rig(left=0.0, right=-3.0))
    assert not pairs(street_rig(left=0.0, right=0.0))
    rig = street_rig(left=0.2, right=-0.2)
    aside = (Rotation.from_euler("z", 30, degrees=True) * Rotation.from_quat(FORWARD)).as_quat()
    away = Mount("camera", rig.mounts["cam2"].translation_m, aside)
    assert not pairs(Rig({**rig.mounts, "cam2": away}, rig.cameras))
    small = CameraModel(rig.cameras["cam"].K, (100, 100))
    assert not pairs(Rig(rig.mounts, {**rig.cameras, "cam2": small}))
    assert not pairs(Rig(rig.mounts, {"cam": rig.cameras["cam"]}))


@pytest.mark.parametrize("lidar_m", [6.0, 5.0])
def test_depth_agrees_with_the_lidar_where_both_are_right(lidar_m):
    rig = street_rig(left=0.2, right=-0.2)
    K, size = rig.cameras["cam"].K, rig.cameras["cam"].size_wh
    images = {"cam": texture(-0.2, 6.0, K, size), "cam2": texture(0.2, 6.0, K, size)}
    (pair,) = pairs(rig)
    view = stereo_view(sample(rig, clouds={"lidar": wall(lidar_m)}, images=images), pair, rectify(rig, pair))
    assert view.found_share > 0.7
    assert view.median_bias == pytest.approx((6.0 - lidar_m) / lidar_m, abs=0.02)
    assert "median relative difference from LiDAR" in view.caption
    # The clouds from above, 16 px per meter, x up from 0 to 40 m, y from 20 m on the left: the wall is 4 m wide.
    vivid = np.ptp(view.cloud.astype(int), axis=2) > 100
    for half, far_m in ((vivid[:, :640], lidar_m), (vivid[:, 644:], 6.0)):
        rows, columns = np.nonzero(half)
        assert 40 - np.median(rows) / 16 == pytest.approx(far_m, abs=0.2)
        assert 20 - np.median(columns) / 16 == pytest.approx(0, abs=1.0)  # its left end has no match


def test_turned_cameras_are_rectified():
    """The right camera looks 2 degrees to the left and rolls 1: recorded pixels follow its rays."""
    rig = street_rig(left=0.2, right=-0.2)
    body_R_turn = Rotation.from_euler("zx", [2, 1], degrees=True)
    mount = Mount("camera", rig.mounts["cam2"].translation_m, (body_R_turn * Rotation.from_quat(FORWARD)).as_quat())
    rig = Rig({**rig.mounts, "cam2": mount}, rig.cameras)
    K, size = rig.cameras["cam"].K, rig.cameras["cam"].size_wh
    (pair,) = pairs(rig)
    how = rectify(rig, pair)
    assert how.baseline_m == pytest.approx(0.4, abs=1e-3)
    u, v = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1)
    seen = rays @ (Rotation.from_quat(FORWARD).inv() * body_R_turn * Rotation.from_quat(FORWARD)).as_matrix().T
    at = seen / seen[..., 2:] * 6.0 + [0.2, 0, 0]
    waves = np.sin(9 * at[..., 0]) + np.sin(23 * at[..., 0] + 5 * at[..., 1]) + np.sin(13 * at[..., 1])
    waves += np.sin(31 * at[..., 0] - 17 * at[..., 1])
    right = np.repeat(np.round(128 + 30 * waves).astype(np.uint8)[:, :, None], 3, axis=2)
    images = {"cam": texture(-0.2, 6.0, K, size), "cam2": right}
    view = stereo_view(sample(rig, clouds={"lidar": wall(6.0)}, images=images), pair, how)
    assert view.median_error < 0.03


def test_without_a_lidar_nothing_is_compared():
    rig = street_rig(left=0.2, right=-0.2)
    K, size = rig.cameras["cam"].K, rig.cameras["cam"].size_wh
    images = {"cam": texture(-0.2, 6.0, K, size), "cam2": texture(0.2, 6.0, K, size)}
    (pair,) = pairs(rig)
    view = stereo_view(sample(rig, images=images), pair, rectify(rig, pair))
    assert view.median_error is None
    assert "no comparison" in view.caption


def test_each_frame_is_judged_by_its_own_calibration(tmp_path):
    """Both cameras move 0.1 m outward between two frames."""
    rigs = [street_rig(left=half, right=-half) for half in (0.2, 0.3)]
    K, size = rigs[0].cameras["cam"].K, rigs[0].cameras["cam"].size_wh
    samples = []
    for i, (rig, x) in enumerate(zip(rigs, (0.2, 0.3), strict=True)):
        images = {"cam": texture(-x, 6.0, K, size), "cam2": texture(x, 6.0, K, size)}
        samples.append(sample(rig, i, clouds={"lidar": wall(6.0)}, images=images))
    kinds = {name: mount.kind for name, mount in rigs[0].mounts.items()}
    material = Material(LogInfo("log", "id"), kinds, rigs[0], {}, "lidar", samples, samples, 2, 0, [], {}, {})
    (stereo,) = [v for v in write_preview(material, tmp_path).verdicts if v.what == "stereo"]
    assert (stereo.is_bad, stereo.text.split(",")[0]) == (False, "baseline 0.400 m")
    off = float(re.search(r"difference from LiDAR ([\d.]+)%", stereo.text)[1])
    assert off < 2  # with the first calibration it is a third for the second frame


@pytest.mark.parametrize("size", [(32, 32), (200, 60)])
def test_images_narrower_than_the_largest_disparity(size):
    street = street_rig(left=0.9, right=-0.9)
    camera = CameraModel(np.array([[900.0, 0, size[0] / 2], [0, 900.0, size[1] / 2], [0, 0, 1]]), size)
    rig = Rig(street.mounts, {"cam": camera, "cam2": camera})
    images = {name: texture(0.0, 6.0, camera.K, size) for name in ("cam", "cam2")}
    (pair,) = pairs(rig)
    assert 0 <= stereo_view(sample(rig, images=images), pair, rectify(rig, pair)).found_share <= 1


def test_images_too_small_for_stereo():
    street = street_rig(left=0.2, right=-0.2)
    camera = CameraModel(np.array([[7.0, 0, 3], [0, 7.0, 2], [0, 0, 1]]), (6, 4))
    rig = Rig(street.mounts, {"cam": camera, "cam2": camera})
    (pair,) = pairs(rig)
    with pytest.raises(LogError, match=r"^stereo of cam and cam2: images of less than 32 px a side$"):
        rectify(rig, pair)
