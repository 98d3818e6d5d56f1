"""From above x forward is up and y left is left."""

import numpy as np
import pytest
from tests.reports.preview.street import one_box, sample, street_rig

from fbench.reports.preview.draw import TRUTH, of_sensor
from fbench.reports.preview.views import Ground, from_above, from_own, from_side, ground_of

GROUND = Ground((-20.0, -20.0), (20.0, 20.0), 20.0)


def color_at(picture, x, y):
    u, v = GROUND.to_picture(np.array([[x, y]]))[0]
    return tuple(int(c) for c in picture[round(v), round(u)])


def test_forward_is_up_and_left_is_left():
    assert GROUND.to_picture(np.array([[20.0, 20], [-20, -20], [0, 0]])).tolist() == [[0, 0], [800, 800], [400, 400]]


def test_points_have_the_colors_of_lidar_and_speed():
    scans = {"radar": ([[15.0, -5, 0], [12.0, -6, 0]], [10.0, -10.0])}
    picture = from_above(sample(street_rig(), clouds={"lidar": [[7.0, -13.0, 0]]}, scans=scans), GROUND, ["a", "lidar"])
    assert color_at(picture, 7, -13) == of_sensor(1)
    assert color_at(picture, 15, -5) == (0, 0, 255)
    assert color_at(picture, 12, -6) == (255, 0, 0)


def test_many_echoes_are_small():
    """Of 2,000 echoes each is a large disk, of more a few pixels: they would hide each other."""
    for num, is_large in ((2000, True), (2001, False)):
        xyz = [[15.0, -5, 0]] + [[-15.0, 5, 0]] * (num - 1)
        picture = from_above(sample(street_rig(), scans={"radar": (xyz, [10.0] * num)}), GROUND, [])
        assert color_at(picture, 15, -5) == (0, 0, 255)
        assert (color_at(picture, 15, -5.15) == (0, 0, 255)) == is_large  # 3 px beside


def test_truth_is_outlined_with_its_front():
    picture = from_above(sample(street_rig(), boxes=one_box(-10, 8)), GROUND, [])
    assert color_at(picture, -8, 8) == pytest.approx(TRUTH, abs=30)  # front edge
    assert color_at(picture, -9, 8) == pytest.approx(TRUTH, abs=30)  # line to it
    assert color_at(picture, -11, 8) != pytest.approx(TRUTH, abs=60)


def test_the_ground_holds_points_and_body():
    ground = ground_of([sample(street_rig(), clouds={"lidar": [[x, 0.0, 0] for x in range(10, 60)]})])
    assert ground.low_m[0] <= -5
    assert ground.high_m[0] >= 55
    assert max(ground.size_wh) == 1100
    assert ground_of([]).size_wh[0] > 0


def test_the_side_view_shows_height():
    flat = from_side(sample(street_rig(), clouds={"lidar": [[x, 0.0, -2.0] for x in range(15)]}), GROUND, ["lidar"])
    tilted = from_side(
        sample(street_rig(), clouds={"lidar": [[x, 0.0, -2.0 + 0.1 * x] for x in range(15)]}), GROUND, ["lidar"]
    )
    rows = [np.unique(np.nonzero((p == of_sensor(0)).all(axis=2))[0]) for p in (flat, tilted)]
    assert np.ptp(rows[0]) <= 3
    assert np.ptp(rows[1]) > 40


def test_a_sensor_without_a_place_is_drawn_in_its_own_coordinates():
    rig = street_rig().without(["lidar"])
    (points,) = sample(rig, clouds={"lidar": [[5.0, 0, 0], [np.nan, 0, 0]]}).points
    assert not points.is_placed
    assert from_own(points).shape == (700, 700, 3)
