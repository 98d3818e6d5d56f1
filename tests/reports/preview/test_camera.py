"""Points and boxes land where they must, in the colors that they must have."""

import numpy as np
import pytest
from tests.reports.preview.street import gray, one_box, sample, street_rig

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.rig import CameraModel, Rig
from fbench.reports.preview.camera import Window, around, bare, layer, overlay, whole, zoom
from fbench.reports.preview.draw import TRUTH, of_depth, of_speed


def pixel(picture, u, v):
    return tuple(int(c) for c in picture[v, u])


def test_speed_is_red_receding_white_equal_blue_approaching():
    colors = of_speed(np.array([10.0, 0.0, -10.0, 5.0, -40.0, np.nan]))
    blue_green_red = [[0, 0, 255], [255, 255, 255], [255, 0, 0], [128, 128, 255], [255, 0, 0], [150, 150, 150]]
    assert colors.tolist() == blue_green_red


def test_depth_goes_from_red_over_green_to_blue():
    near, middle, far = of_depth(np.array([2.0, 12.0, 80.0])).astype(int)
    assert near[2] > 150 > near[1] + near[0]
    assert middle[1] == max(middle)
    assert far[0] == max(far)
    assert of_depth(np.zeros(0)).shape == (0, 3)


def test_a_point_ahead_lands_in_the_middle_of_the_image():
    seen = sample(street_rig(), clouds={"lidar": [[10.0, 0, 0]]}, images={"cam": gray()})
    picture = overlay(seen, "cam", "lidar")
    assert picture.shape == (600, 960, 3)  # three times as large as recorded
    assert pixel(picture, 480, 300) == tuple(of_depth(np.array([10.0]))[0])
    assert pixel(picture, 520, 300) == (100, 100, 100)


def test_radar_points_have_the_colors_of_their_speed():
    # u = 159.5 - 200 y / 10 for points 10 m ahead; three picture pixels a pixel
    xyz = [[10.0, 2.0, 0], [10.0, 0.0, 0], [10.0, -2.0, 0]]
    seen = sample(street_rig(), scans={"radar": (xyz, [10.0, 0.0, -10.0])}, images={"cam": gray()})
    picture = overlay(seen, "cam", "radar")
    assert [pixel(picture, u, 300) for u in (360, 480, 600)] == [(0, 0, 255), (255, 255, 255), (255, 0, 0)]


def test_near_points_are_larger_and_drawn_last():
    found = layer(sample(street_rig(), clouds={"lidar": [[5.0, 0, 0], [60.0, 0, 0], [20.0, 0, 0]]}), "cam", "lidar")
    assert found.depth_m.tolist() == [60.0, 20.0, 5.0]
    assert found.radii_px[0] < found.radii_px[1] < found.radii_px[2]


def test_points_behind_and_beside_the_camera_are_left_out():
    found = layer(sample(street_rig(), clouds={"lidar": [[-5.0, 0, 0], [5.0, 50, 0], [5.0, 0, 0]]}), "cam", "lidar")
    assert len(found.uv_px) == 1


def test_boxes_of_the_truth_are_outlined():
    seen = sample(street_rig(), images={"cam": gray()}, boxes=one_box())
    picture = overlay(seen, "cam", "lidar")
    # back face at x = 8: corners at u = 159.5 ± 200 / 8
    assert pixel(picture, round((159.5 - 25 + 0.5) * 3 - 0.5), 300) == pytest.approx(TRUTH, abs=50)


def test_zoom_shows_the_nearest_box_and_else_the_densest_points():
    near = sample(
        street_rig(), clouds={"lidar": [[8.0, y, 0] for y in (-1, 0, 1)]}, images={"cam": gray()}, boxes=one_box()
    )
    assert zoom(near, "cam", "lidar").shape == (384, 640, 3)
    without = sample(street_rig(), clouds={"lidar": [[20.0, 0.1, 0.1]] * 9}, images={"cam": gray()})
    assert zoom(without, "cam", "lidar") is not None
    assert zoom(sample(street_rig(), images={"cam": gray()}), "cam", "lidar") is None


def test_an_image_without_calibration_is_shown_alone():
    assert bare(sample(Rig({}, {}), images={"cam": gray()}), "cam").shape == (600, 960, 3)


def test_unknown_lenses_are_refused_by_name():
    rig = street_rig()
    odd = Rig(rig.mounts, {"cam": CameraModel(rig.cameras["cam"].K, (320, 200), "kaleidoscope", np.ones(4))})
    with pytest.raises(LogError, match=r"'cam'.*kaleidoscope"):
        overlay(sample(odd, clouds={"lidar": [[10.0, 0, 0]]}, images={"cam": gray()}), "cam", "lidar")


def test_windows_map_pixel_centers():
    half = whole((2560, 1000))
    assert half.size_wh == (1280, 500)
    assert half.to_picture(np.array([[0.5, 0.5]])).tolist() == [[0.0, 0.0]]
    assert Window(10, 20, 30, 40, 2.0).to_picture(np.array([[10.0, 20.0]])).tolist() == [[0.5, 0.5]]
    corner = around((320, 200), np.array([310.0, 190, 319, 199]), 640)
    assert (corner.left + corner.width, corner.top + corner.height) == (320, 200)
