import numpy as np
import pytest
from numpy.testing import assert_array_equal
from tests.pipelines.sensors.image.places import RIG, back, cloud, wall

from fbench.pipelines.sensors.image.objects import Spots, spots
from fbench.pipelines.sensors.image.params import LidarImageParams, ShapeParams
from fbench.replay.contracts.errors import ConfigError

DEFAULT = LidarImageParams()
PARAMS = DEFAULT


def seen(*parts, **how) -> Spots:
    found = spots(RIG, "cam", cloud(*parts, **how), PARAMS)
    return found[found.score > 0.3]


def test_a_car_before_a_wall_is_outlined_down_to_the_ground():
    car = seen(back(20), wall())
    assert len(car) == 1
    # 400 px / 20 m: 0.9 m to each side are 18 px, 0.35 m up 7 px, and the ground, 1 m below the camera, 20 px down.
    assert car.xyxy_px[0] == pytest.approx([399.5 - 21, 299.5 - 10, 399.5 + 21, 299.5 + 20], abs=0.6)
    assert car.depth_m[0] == pytest.approx(20)
    assert car.distance_m[0] == pytest.approx(22.1, abs=0.1)
    assert np.isnan(car.rate_mps[0])


def test_cars_behind_each_other_are_told_apart_by_depth():
    assert sorted(seen(back(15, 0.4), back(25, -0.8, top_m=1.6)).depth_m.tolist()) == [15, 25]


@pytest.mark.parametrize(("over_ground", "own"), [(8.0, 10.0), (-5.0, 10.0), (15.0, 3.0)])
def test_range_rates_are_relative_and_positive_when_receding(over_ground, own):
    car = seen(back(20), rate_mps=over_ground, own_mps=own)
    assert car.rate_mps.tolist() == [over_ground - own]


def test_what_moves_is_another_object_than_what_stands_beside_it():
    both = spots(RIG, "cam", joined(cloud(back(20), rate_mps=5.0), cloud(back(20, 1.9), rate_mps=0.0)), PARAMS)
    assert sorted(both.rate_mps.tolist()) == [-10, -5]


def joined(a, b):
    fields = ("xyz", "height_m", "moves", "over_ground_mps", "own_mps", "period_mps")
    return type(a)(
        plane=a.plane, tall=a.tall, viewpoint=a.viewpoint,
        **{name: np.concatenate([getattr(a, name), getattr(b, name)]) for name in fields},
    )  # fmt: skip


def test_the_order_of_points_changes_nothing():
    scene = back(20), back(12, 4.0), wall()
    reference = seen(*scene, order=np.random.default_rng(0))
    for seed in range(1, 4):
        other = seen(*scene, order=np.random.default_rng(seed))
        assert_array_equal(np.sort(other.xyxy_px, axis=0), np.sort(reference.xyxy_px, axis=0))
        assert sorted(other.score.tolist()) == sorted(reference.score.tolist())


@pytest.mark.parametrize(
    "points", [np.zeros((0, 3)), back(20)[:1], np.repeat(back(20)[:1], 50, axis=0), back(-20)],
    ids=["none", "one", "all equal", "behind"],
)  # fmt: skip
def test_points_that_show_no_vehicle(points):
    assert len(seen(points)) == 0


def test_a_guard_rail_and_a_wall_are_no_vehicles():
    rail = np.column_stack([np.arange(15, 30, 0.3), np.full(50, -6.0), np.tile([0.5, 0.75], 25)])
    assert len(seen(rail, wall(30))) == 0


def test_pixels_of_parameters_are_those_of_a_focal_length_of_400():
    twice = RIG.cameras["cam"].K * np.array([[2], [2], [1]])
    finer = type(RIG)(RIG.mounts, {"cam": type(RIG.cameras["cam"])(twice, (1600, 1200))})
    a = spots(RIG, "cam", cloud(back(20), back(30, 6)), PARAMS)
    b = spots(finer, "cam", cloud(back(20), back(30, 6)), PARAMS)
    assert b.xyxy_px == pytest.approx(2 * a.xyxy_px, abs=0.6)


def test_impossible_shapes_are_refused():
    with pytest.raises(ConfigError, match=r"shape\.top_m: expected two different values, got 2,2"):
        ShapeParams(top_m=(2.0, 2.0))
