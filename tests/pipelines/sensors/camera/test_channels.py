"""Points of LiDARs and radars as channels of an image; values are checked by hand."""

import numpy as np
import pytest
from tests.pipelines.frames import CAMERA, MOUNTS

from fbench.pipelines.sensors.bev.stage import BevMeasurement
from fbench.pipelines.sensors.camera.channels import NO_POINTS, ImagePoints, draw_channels, project_points
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.sensors.radar.stage import Compensated
from fbench.replay.data.rig import Rig

RIG = Rig(MOUNTS, {"cam": CAMERA})
DEPTH_12_M = 134  # 255 - 254 * log(12 / 1.5) / log(120 / 1.5)


def seen(lidar=(), radar=(), focal_px=320.0) -> ImagePoints:
    lidar, radar = np.array(lidar, np.float32).reshape(-1, 3), np.array(radar, np.float32).reshape(-1, 4)
    return ImagePoints(lidar, radar, focal_px)


def lit(channel: np.ndarray) -> tuple[int, int, int, int]:
    """First and last column, first and last row of what is drawn; it fills the rectangle between."""
    rows, columns = np.nonzero(channel)
    left, right, top, bottom = (int(side) for side in (columns.min(), columns.max(), rows.min(), rows.max()))
    assert len(rows) == (right - left + 1) * (bottom - top + 1)
    return left, right, top, bottom


def test_a_lidar_point_fills_its_pixel_and_those_around():
    image = draw_channels(seen([[10.9, 5.1, 12.0]]), (40, 30))
    assert image.shape == (30, 40, 2)
    assert lit(image[..., 0]) == (9, 11, 4, 6)
    assert set(image[4:7, 9:12, 0].ravel()) == {DEPTH_12_M}
    assert not image[..., 1].any()


def test_limits_of_depth():
    columns = [[5.5, 5.5, 1.5], [15.5, 5.5, 0.9], [25.5, 5.5, 119.9], [35.5, 5.5, 500.0]]
    image = draw_channels(seen(columns), (40, 30))
    assert image[5, [5, 15, 25, 35], 0].tolist() == [255, 255, 1, 1]


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 0, 2)])
def test_the_nearest_point_hides_the_others(order):
    points = np.array([[10.5, 5.5, 12.0], [11.5, 5.5, 60.0], [13.5, 5.5, 60.0]])[list(order)]
    row = draw_channels(seen(points), (40, 30))[5, :, 0]
    assert row[9:12].tolist() == [DEPTH_12_M] * 3
    assert 0 < row[12] == row[14] < DEPTH_12_M


def test_a_longer_lens_shows_far_things_as_near_ones():
    """What is twice as far looks equal at twice the focal length, and so do its channels."""
    near = draw_channels(seen([[10.5, 5.5, 12.0]], [[20.5, 15.5, 9.0, 5.0]]), (40, 30))
    far = draw_channels(seen([[10.5, 5.5, 24.0]], [[20.5, 15.5, 18.0, 5.0]], focal_px=640.0), (40, 30))
    np.testing.assert_array_equal(near, far)
    half = seen([[21.0, 11.0, 24.0]], [[41.0, 31.0, 18.0, 5.0]], focal_px=1280.0).move(0.5, np.zeros(2))
    np.testing.assert_array_equal(draw_channels(half, (40, 30)), near)


def test_an_echo_fills_what_radars_can_be_wrong_by():
    """0.2 m to each side and 0.5 m up and down: at 16 m and 320 px 4 and 10 px."""
    image = draw_channels(seen(radar=[[50.2, 40.2, 16.0, 5.0]]), (100, 80))
    assert lit(image[..., 1]) == lit(image[..., 0]) == (46, 54, 30, 50)
    assert set(np.unique(image[..., 1])) == {0, 160}, "128 + 127 * 5 / 20"
    rates = [[20.5 + 10 * i, 40.5, 100.0, rate] for i, rate in enumerate((0.0, -5.0, -90.0, 90.0))]
    assert draw_channels(seen(radar=rates), (100, 80))[40, [20, 30, 40, 50], 1].tolist() == [128, 96, 1, 255]


def test_lidar_tells_the_depth_and_the_nearest_echo_the_velocity():
    image = draw_channels(seen([[50.5, 40.5, 12.0]], [[50.5, 40.5, 30.0, 20.0], [50.5, 40.5, 10.0, -20.0]]), (100, 80))
    assert image[40, 50].tolist() == [DEPTH_12_M, 1]
    assert image[40, 53, 0] > DEPTH_12_M, "beside the point the echo does"


def test_parts_of_an_image():
    moved = seen([[30.0, 22.0, 12.0]], [[30.0, 22.0, 9.0, 5.0]]).move(0.5, np.array([10.0, 2.0]))
    assert moved.lidar.tolist() == [[10.0, 10.0, 12.0]]
    assert moved.radar.tolist() == [[10.0, 10.0, 9.0, 5.0]]
    assert moved.focal_px == 160.0
    mirrored = moved.mirror(40)
    assert mirrored.lidar.tolist() == [[30.0, 10.0, 12.0]]
    assert not draw_channels(NO_POINTS, (8, 8)).any()


def echoes(xyz: list[list[float]], rate_mps: list[float]) -> Compensated:
    num = len(xyz)
    return Compensated(
        np.array(xyz), np.zeros((num, 3)), np.array(rate_mps), np.zeros(num), np.zeros(num, bool), np.zeros(num)
    )


def test_what_stands_on_the_ground_or_moves_is_projected():
    """u = 29.5 - 500 y / x, v = 19.5 - 500 z / x, half a pixel more from the corner; the ground is 1.6 m below."""
    ground = Plane(0.0, 0.0, -1.6)
    xyz = np.array([[20.0, 0.4, -0.6], [20, 0, -1.4], [20, 0, 3.0], [-20, 0, 0], [200, 0, 0]])
    radar = echoes([[10.0, 0, -0.6], [10, 0, -1.5], [10, 0, -1.5], [25, 0, 0]], [0.0, 0.5, -2.0, np.nan])
    found = project_points(RIG, "cam", BevMeasurement(xyz, xyz[:, 2] + 1.6, radar, ground), ground)
    assert found.lidar.tolist() == [[20.0, 35.0, 20.0]]
    assert found.radar.tolist() == [[30.0, 50.0, 10.0, 0.0], [30.0, 95.0, 10.0, -2.0], [30.0, 20.0, 25.0, 0.0]]
    assert found.focal_px == 500.0


def test_where_a_frame_does_not_show_the_ground_earlier_ones_do():
    xyz = np.array([[20.0, 0.4, -0.6]])
    unknown = BevMeasurement(xyz, np.zeros(0), None, None)
    assert len(project_points(RIG, "cam", unknown, Plane(0.0, 0.0, -1.6)).lidar) == 1
    assert len(project_points(RIG, "cam", unknown, Plane(0.0, 0.0, 0.0)).lidar) == 0
    nothing = project_points(RIG, "cam", BevMeasurement(None, np.zeros(0), None, None), Plane(0.0, 0.0, 0.0))
    assert (nothing.lidar.shape, nothing.radar.shape) == ((0, 3), (0, 4))
