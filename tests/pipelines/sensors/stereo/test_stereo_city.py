"""Simulated drives: depth against the LiDAR's, and which weather leaves depth."""

import numpy as np
import pytest
from tests.datasets.city.city_logs import Log, moved, simulated

from fbench.pipelines.sensors.stereo.stage import StereoParams, StereoStage, StereoView
from fbench.replay.contracts.params import StageClock
from fbench.replay.data.frames import Frame

PAIR = ("stereo_left", "stereo_right")


def views(log: Log) -> dict[int, StereoView]:
    stage = StereoStage(log.rig, "drive", StereoParams())
    left, right = (log.images(name) for name in PAIR)
    instants = sorted(set(left) & set(right))
    frames = [Frame(i, ns, 0, dict(zip(PAIR, (left[ns], right[ns]), strict=True))) for i, ns in enumerate(instants)]
    return {frame.stamp_ns: stage.view(frame, StageClock(), []) for frame in frames}


@pytest.mark.slow
@pytest.mark.parametrize(("world", "seed"), [("urban", 101), ("highway", 102)])
def test_points_lie_where_the_lidar_has_some(tmp_path, world, seed):
    """Up to 15 m ahead, at half resolution; an error of 0.35 px is 0.2 m at 7 m, and 1 m at 15 m."""
    log = simulated(tmp_path, "clear", world, "--seed", seed, "--seconds", 0.2, "--sensors", "stereo*,lidar")
    found = views(log)
    stamp_ns = min(set(found) & set(log.clouds()))
    lidar = moved(log.rig.body_T_sensor("lidar"), log.clouds()[stamp_ns].xyz)
    xyz = found[stamp_ns].xyz
    near = xyz[(np.hypot(xyz[:, 0], xyz[:, 1]) < 15) & (xyz[:, 2] < 2.5)]
    assert len(near) > 300
    distance = np.array([np.sqrt(((lidar - one) ** 2).sum(axis=1).min()) for one in near])
    assert np.median(distance) < 0.2
    assert np.percentile(distance, 90) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize(("world", "seed"), [("urban", 104), ("highway", 102)])
def test_bad_weather_switches_stereo_off(tmp_path, world, seed):
    for condition in ("clear", "fog", "night", "rain"):
        options = ("--seed", seed, "--seconds", 0.2, "--sensors", "stereo*", "--condition", condition)
        off = [view.is_off for view in views(simulated(tmp_path, condition, world, *options)).values()]
        assert off
        assert all(one == (condition != "clear") for one in off), condition
