import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.pipelines.fusion.early.clouds import L, R, S, joined, points, row

from fbench.pipelines.fusion.early.density import DensityParams, cluster_cloud, connect_cells
from fbench.replay.contracts.errors import ConfigError


def found(cloud, is_seen=False, **params):
    return cluster_cloud(cloud, np.full(len(cloud), is_seen), DensityParams(**params)).tolist()


def test_each_sensor_has_its_own_number_of_points():
    for source, least in ((L, 3), (S, 8)):
        assert found(points(source, row(least, 0.01))) == [0] * least
        assert found(points(source, row(least - 1, 0.01))) == [-1] * (least - 1)


def test_few_echoes_are_enough_where_they_move():
    assert found(points(R, row(3, 1.5), rate_mps=5.0)) == [0, 0, 0]
    assert found(points(R, row(3, 1.5), rate_mps=0.0)) == [-1, -1, -1]


def test_weights_of_different_sensors_add_up():
    lidar, radar = points(L, row(2, 0.3)), points(R, row(1, 0.3, y_m=0.15), rate_mps=5.0)
    assert found(lidar) == [-1, -1]
    assert found(joined(lidar, radar)) == [0, 0, 0]


def test_what_a_camera_sees_needs_fewer_points():
    assert found(points(L, row(2, 0.3)), is_seen=True) == [0, 0]
    assert found(points(L, row(2, 0.3)), is_seen=True, seen_factor=1.0) == [-1, -1]


def test_echoes_at_different_speeds_are_different_objects():
    slow, fast = points(R, row(4, 0.5), rate_mps=2.0), points(R, row(4, 0.5, y_m=0.2), rate_mps=9.0)
    assert found(joined(slow, fast)) == [0] * 4 + [1] * 4
    assert found(joined(slow, fast), seconds=0.0) == [0] * 8


def test_ambiguous_velocities_meet_at_the_seam():
    """3 m/s and -7 m/s are the same where velocities alias with 10 m/s."""
    one, other = (points(R, row(3, 0.5, y_m=y), rate_mps=rate, period_mps=10.0) for y, rate in ((0, 3.0), (0.2, -7.0)))
    assert found(joined(one, other)) == [0] * 6


def test_radius_grows_with_distance():
    assert found(points(L, row(5, 1.0, x_m=10.0))) == [-1] * 5
    assert found(points(L, row(5, 1.0, x_m=50.0))) == [0] * 5
    assert found(points(L, row(5, 1.0, x_m=50.0)), reach_rad=0.0) == [-1] * 5


def test_clusters_are_numbered_by_place():
    near, far = row(4, 0.1, x_m=5.0), row(4, 0.1, x_m=30.0)
    assert found(points(L, np.concatenate([far, near]))) == [1] * 4 + [0] * 4


def test_empty_one_point_all_equal_and_far_away():
    assert found(points(L, [])) == []
    assert found(points(L, [[1, 2, 3]])) == [-1]
    assert found(points(L, [[1, 2, 3]] * 1000)) == [0] * 1000
    assert found(points(R, [[1, 2, 3]] * 1000, rate_mps=3.0)) == [0] * 1000
    assert found(points(L, [[1e30, 0, 0]] * 5)) == [-1] * 5


@pytest.mark.slow
def test_a_million_points():
    random = np.random.default_rng(1)
    xyz = np.concatenate([random.uniform(-60, 60, (500_000, 3)), random.normal([20, 0, 0], 0.3, (500_000, 3))])
    assert max(found(joined(points(L, xyz[::2]), points(R, xyz[1::2], rate_mps=4.0)))) >= 0


@settings(deadline=None, max_examples=100)
@given(num=st.integers(0, 30), seed=st.integers(0, 1000), wide=st.sampled_from([0.5, 2.0, 5.0]))
def test_the_kernel_agrees_with_the_definition(num: int, seed: int, wide: float):
    random, edge = np.random.default_rng(seed), 0.2
    cells = np.unique(np.floor(random.uniform(0, wide, (num, 2)) / edge).astype(np.int64), axis=0)
    num = len(cells)
    xy = (cells + random.uniform(0, 1, (num, 2))) * edge
    weight, reach = random.choice([0.1, 0.25, 0.5, 1.5], num), random.choice([0.3, 0.6, 2.0], num)
    velocity = random.choice([np.nan, 0.0, 1.0, 5.0], num)
    gap = np.nan_to_num(velocity[:, None] - velocity)
    distance = np.sqrt(((xy[:, None] - xy) ** 2).sum(axis=2) + gap**2)
    near = distance <= (reach[:, None] + reach) / 2
    able = random.random(num) < 0.8
    core = able & (near @ weight >= 1 - 1e-9)
    group = np.arange(num)
    for _ in range(num):
        group = np.array([min([group[j] for j in range(num) if near[i, j] and core[i] and core[j]] + [group[i]])
                          for i in range(num)], np.int64)  # fmt: skip
    roots = sorted(set(group[core].tolist()))
    expected = [
        min([roots.index(group[j]) for j in range(num) if near[i, j] and core[j]], default=-1)
        if not core[i] else roots.index(group[i])
        for i in range(num)
    ]  # fmt: skip
    label, is_core = connect_cells(cells, xy, weight, able, reach, velocity, edge)
    assert is_core.tolist() == core.tolist()
    assert label.tolist() == expected


@pytest.mark.parametrize("name", ["lidar_points", "reach_m", "cell_m"])
def test_limits(name: str):
    with pytest.raises(ConfigError, match=rf"fusion\.density\.{name}: expected"):
        DensityParams(**{name: 0.0})
