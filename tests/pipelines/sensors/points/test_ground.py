import numpy as np
import pytest

from fbench.pipelines.sensors.points.ground import GroundParams, find_ground, lowest_rows

PARAMS = GroundParams()


def road(slope_x=0.0, slope_y=0.0, height_m=-1.6, extent_m=40.0, step_m=0.8):
    axis = np.arange(-extent_m, extent_m, step_m) + 0.13
    x, y = (a.ravel() for a in np.meshgrid(axis, axis))
    return np.column_stack([x, y, slope_x * x + slope_y * y + height_m])


def lowest(points):
    cell = np.floor(points[:, :2] / PARAMS.cell_m).astype(np.int64)
    return points[lowest_rows(cell, points[:, 2], PARAMS.outliers)]


def find_plane(points):
    return find_ground(points, PARAMS)[0]


def heights(points):
    return find_ground(points, PARAMS)[2]


def wall(x_m=10.0, base_m=-1.6):
    y, z = (a.ravel() for a in np.meshgrid(np.arange(-30, 30, 0.2), np.arange(base_m, base_m + 6, 0.4)))
    return np.column_stack([np.full(len(y), x_m), y, z])


@pytest.mark.parametrize(("slope_x", "slope_y", "height_m"), [(0, 0, -1.6), (0.05, -0.09, -1.6), (-0.1, 0.1, 0.4)])
def test_tilted_road(slope_x, slope_y, height_m):
    plane = find_plane(road(slope_x, slope_y, height_m))
    assert plane is not None
    assert [plane.slope_x, plane.slope_y, plane.height_m] == pytest.approx([slope_x, slope_y, height_m], abs=1e-9)


def test_walls_and_points_under_the_road_change_little():
    mirrored = np.column_stack([np.full(50, 6.0), np.linspace(-5, 5, 50), np.full(50, -4.0)])
    points = np.concatenate([road(0.03), wall(), mirrored])
    plane = find_plane(points)
    assert plane is not None
    assert [plane.slope_x, plane.slope_y, plane.height_m] == pytest.approx([0.03, 0, -1.6], abs=0.02)


def test_hoods_and_roofs_of_parked_cars_arent_the_ground():
    """Between two rows of cars few points show the road; those on the cars are more, and as flat."""
    lane = road(0.03, extent_m=40.0)
    lane = lane[(np.abs(lane[:, 1]) < 1.5) & (np.abs(lane[:, 0]) < 20)]
    roofs = road(0.03, height_m=-0.5)
    roofs = roofs[(np.abs(roofs[:, 1]) > 2.5) & (np.abs(roofs[:, 1]) < 7) & (np.abs(roofs[:, 0]) < 20)]
    assert len(roofs) > 2 * len(lane)
    plane = find_plane(np.concatenate([lane, roofs]))
    assert plane is not None
    assert plane.height_m == pytest.approx(-1.6, abs=0.15)


def test_a_road_that_falls_off_behind_a_crest_isnt_far_below():
    points = road()
    points[:, 2] -= np.where(points[:, 0] > 0, points[:, 0] ** 2 / 1000, 0.0)
    plane = find_plane(points)
    assert plane is not None
    assert plane.height_m == pytest.approx(-1.6, abs=0.25)


def test_heights_follow_a_slope_that_leaves_the_plane():
    points = road()
    far = np.abs(points[:, 0]) > 20
    points[far, 2] += 0.04 * (np.abs(points[far, 0]) - 20)
    plane = find_plane(points)
    assert plane is not None
    assert heights(points).max() < PARAMS.tolerance_m


def test_height_of_a_box_on_the_road():
    box = np.array([[10.0, 2.0, -0.6], [10.5, 2.0, -1.0]])
    points = np.concatenate([road(), box])
    plane = find_plane(points)
    assert plane is not None
    assert heights(points)[-2:] == pytest.approx([1.0, 0.6], abs=0.02)


def test_far_points_are_measured_from_the_plane():
    points = np.concatenate([road(), [[500.0, 0, 0.4]]])
    plane = find_plane(points)
    assert plane is not None
    assert heights(points)[-1] == pytest.approx(2.0)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.ones((1, 3)), np.ones((9, 3)), np.full((5, 3), 1000.0)])
def test_too_few_places_give_no_ground(points):
    assert find_plane(points) is None


def test_ground_seen_on_one_line_keeps_its_tilt():
    line = np.column_stack([np.arange(2, 40, 1.0), np.zeros(38), np.full(38, -1.5)])
    plane = find_plane(line)
    assert plane is not None
    assert (plane.slope_x, plane.slope_y, plane.height_m) == (0.0, 0.0, pytest.approx(-1.5))


def test_lowest_point_of_each_cell_and_ties_by_place():
    points = np.array([[0.5, 0.5, 1.0], [1.5, 0.5, 1.0], [0.2, 1.0, 1.5], [2.5, 0.0, 7.0]])
    assert lowest(points[np.lexsort(points.T[::-1])]).tolist() == [[0.5, 0.5, 1.0], [2.5, 0.0, 7.0]]


def test_reflections_below_the_road_are_passed_over_where_there_are_many_points():
    points = np.column_stack([np.linspace(0, 1.9, 100), np.zeros(100), np.full(100, -1.6)])
    points[3, 2] = -4.0
    assert lowest(points)[0, 2] == -1.6
