"""Radars without Doppler: no velocity is made up, and strong clusters of a vehicle's size are found, moving or not."""

from dataclasses import replace

import numpy as np
import pytest
from tests.pipelines.frames import UPRIGHT, assert_equal, cloud, frame, rig, scan
from tests.pipelines.scenes import echoes, radial, surroundings

from fbench.pipelines.fusion.late.existence import FusionParams
from fbench.pipelines.fusion.late.fuse import SensorViews, fuse
from fbench.pipelines.sensors.lidar.clusters import LidarView
from fbench.pipelines.sensors.points.merged import Echoes
from fbench.pipelines.sensors.radar.doppler import UnmeasuredParams, strong
from fbench.pipelines.sensors.radar.stage import RadarParams, RadarView, compensate, detect
from fbench.pipelines.variants.late import Late3D
from fbench.pipelines.variants.radar import Radar3D, Radar3DParams
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import RadarScan
from fbench.replay.data.rig import LogInfo, Mount, Rig

LOG = LogInfo("drive", "id")


def plain(xyz: np.ndarray, magnitude: float | np.ndarray = 60.0, sensor: str = "plain") -> Echoes:
    """A scan without velocities."""
    direction = xyz / np.linalg.norm(xyz, axis=1)[:, None]
    unknown = np.full(len(xyz), np.nan)
    return Echoes(xyz, direction, unknown, np.broadcast_to(np.asarray(magnitude, float), (len(xyz),)), 0.0, sensor)


def measured(car_mps: float, period_mps: float = 0.0) -> Echoes:
    """A scan with velocities: a car 20 m ahead, and what stands around."""
    car, rest = echoes(20.0, 2.0), surroundings()
    xyz = np.concatenate([car, rest])
    velocity = np.concatenate([radial(car, 8.0, car_mps), radial(rest, 8.0)])
    direction = xyz / np.linalg.norm(xyz, axis=1)[:, None]
    return Echoes(xyz, direction, velocity, np.full(len(xyz), 60.0), period_mps, "doppler")


def found(*scans: Echoes, params: RadarParams = RadarParams()) -> RadarView:  # noqa: B008
    return detect(compensate(scans, {one.sensor: params for one in scans}), params)


def without_velocity(message: RadarScan, **fields: object) -> RadarScan:
    return replace(message, radial_velocity_mps=None, **fields)


def wall(length_m: float, num: int = 60) -> np.ndarray:
    return np.column_stack([np.linspace(10, 10 + length_m, num), np.full(num, -8.0), np.zeros(num)])


def test_a_cluster_without_velocity_has_none():
    boxes = found(plain(echoes(20.0, 2.0))).boxes
    assert len(boxes) == 1
    assert boxes.center_m[0, :2] == pytest.approx([21.7, 2.2], abs=0.4)
    assert np.isnan(boxes.velocity_mps).all()


def test_walls_and_buildings_are_too_large():
    block = np.column_stack([*(a.ravel() for a in np.meshgrid(np.arange(20, 30), np.arange(-5, 5))), np.zeros(100)])
    assert len(found(plain(np.concatenate([wall(30.0), block.astype(float), echoes(20.0, 12.0)]))).boxes) == 1
    wide = RadarParams(unmeasured=UnmeasuredParams(max_length_m=40.0, max_width_m=40.0))
    assert len(found(plain(wall(30.0)), params=wide).boxes) == 1


def test_only_strong_echoes_of_a_dense_scan_are_clustered():
    rng = np.random.default_rng(3)
    noise = np.column_stack([rng.uniform(5, 60, 2000), rng.uniform(-40, 40, 2000), np.zeros(2000)])
    scene = np.concatenate([echoes(20.0, 2.0), noise])
    magnitude = np.concatenate([np.full(40, 70.0), rng.uniform(20, 60, 2000)])
    params = RadarParams(unmeasured=UnmeasuredParams(strongest=0.02, least_kept=0))
    view = found(plain(scene, magnitude), params=params)
    assert len(view.boxes) == 1
    in_range = np.hypot(scene[:, 0], scene[:, 1]) < params.max_range_m
    assert len(view.xyz) == in_range.sum(), "weak echoes may still confirm what cameras see"
    assert view.boxes.center_m[0, :2] == pytest.approx([21.7, 2.2], abs=0.4)


def test_the_strongest_share_of_a_scan():
    magnitude = np.arange(1000.0)
    assert strong(magnitude, UnmeasuredParams(strongest=0.25)).sum() == 250
    assert strong(magnitude, UnmeasuredParams(strongest=0.0)).sum() == 200
    assert strong(magnitude[:150], UnmeasuredParams(strongest=0.0)).all()
    assert not strong(magnitude, UnmeasuredParams(strongest=0.0, least_kept=0)).any()
    assert strong(np.full(1000, np.nan), UnmeasuredParams(strongest=0.1)).all()
    assert strong(np.full(1000, 5.0), UnmeasuredParams(strongest=0.1)).all()
    assert strong(np.zeros(0), UnmeasuredParams()).shape == (0,)


@pytest.mark.parametrize(
    "values", [{"strongest": 1.5}, {"strongest": np.nan}, {"least_kept": -1}, {"max_width_m": 0.0}]
)
def test_parameters_out_of_range_are_refused(values):
    with pytest.raises(ConfigError, match=rf"radar\.unmeasured\.{next(iter(values))}"):
        UnmeasuredParams(**values)


def test_two_radars_that_see_one_moving_car_make_one_box_with_its_velocity():
    boxes = found(measured(5.0), plain(echoes(20.2, 2.1))).boxes
    assert len(boxes) == 1
    assert boxes.velocity_mps[0, 0] == pytest.approx(5.0, abs=0.1)
    assert boxes.score[0] == pytest.approx(1 - np.exp(-80 / 20))


def test_what_a_radar_with_doppler_sees_standing_is_left_out():
    assert len(found(plain(echoes(20.2, 2.1))).boxes) == 1
    assert len(found(measured(0.0), plain(echoes(20.2, 2.1))).boxes) == 0


def test_where_only_the_radar_without_doppler_looks_its_clusters_count():
    behind = echoes(20.0, 2.0) * [-1, 1, 1]
    boxes = found(measured(5.0), plain(behind)).boxes
    assert np.isfinite(boxes.velocity_mps[:, 0]).tolist() == [True, False]
    assert np.sign(boxes.center_m[:, 0]).tolist() == [1.0, -1.0]


def test_a_radar_without_doppler_does_not_unsettle_an_ambiguous_one():
    """Its velocities lie on both sides of the seam of the period."""
    car, rest = echoes(20.0, 2.0), surroundings()
    over_ground = 5.2 + 0.1 * np.sin(np.arange(len(car)))
    speed = np.concatenate([radial(car, 8.0, over_ground), radial(rest, 8.0)])
    wrapped = (speed + 5.2) % 10.4 - 5.2
    both = replace(measured(0.0, 10.4), radial_velocity_mps=wrapped)
    alone = found(both).boxes
    assert len(alone) == 1
    assert_equal(alone, found(both, plain(np.array([[-30.0, 30.0, 0.0]]))).boxes)


def test_order_of_echoes_changes_nothing():
    rng = np.random.default_rng(1)
    xyz = np.concatenate([echoes(20.0, 2.0), echoes(30.0, -14.0), wall(30.0)])
    radars = Rig({"radar": Mount("radar", np.zeros(3), UPRIGHT)}, {})
    outputs = []
    for order in (np.arange(len(xyz)), rng.permutation(len(xyz))):
        pipeline = Radar3D(Radar3DParams(min_score=0.1))
        pipeline.start(radars, LOG)
        magnitude = np.hypot(xyz[:, 0], xyz[:, 1])[order].astype(np.float32)
        message = RadarScan("radar", 0, 0, xyz[order].astype(np.float32), None, magnitude)
        outputs.append(pipeline.step(frame(0, message)).detections)
    assert len(outputs[0]) >= 2
    assert_equal(*outputs)


@pytest.mark.parametrize("num", [0, 1, 4, 300])
@pytest.mark.parametrize("magnitude", [None, np.nan, 7.0])
def test_radar3d_and_late3d_take_any_scan_without_velocities(num, magnitude):
    rcs = None if magnitude is None else np.full(num, magnitude, np.float32)
    message = RadarScan("radar", 0, 0, (np.arange(3 * num).reshape(-1, 3) % 50).astype(np.float32), None, rcs)
    for pipeline in (Radar3D(), Late3D()):
        pipeline.start(rig("radar"), LOG)
        output = pipeline.step(frame(0, message))
        for boxes in (output.detections, output.tracks):
            assert boxes.velocity_mps is not None
        assert np.isnan(output.detections.velocity_mps).all()


def test_radar3d_reports_unknown_velocities_in_the_same_fields():
    pipeline = Radar3D()
    pipeline.start(rig("radar"), LOG)
    known = pipeline.step(frame(0, scan())).detections
    unknown = pipeline.step(frame(1, without_velocity(scan()))).detections
    assert {name: a.dtype for name, a in known.arrays().items() if a.dtype.kind != "U"} == {
        name: a.dtype for name, a in unknown.arrays().items() if a.dtype.kind != "U"
    }


def one_box(velocity: float) -> Boxes3D:
    return Boxes3D(np.array([[20.0, 0, 0]]), np.array([[4.2, 1.8, 1.6]]), np.zeros(1),
                   velocity_mps=np.full((1, 3), velocity), score=np.array([0.9]))  # fmt: skip


def fused(velocity: float, lidar_score: float = 0.0, params: FusionParams = FusionParams()) -> Boxes3D:  # noqa: B008
    points = np.tile([20.0, 0.0, 0.0], (5, 1))
    lidar = LidarView(None, np.zeros((0, 3)), np.zeros(0, np.int64), Boxes3D.empty())
    if lidar_score:
        lidar = replace(lidar, boxes=replace(one_box(np.nan), velocity_mps=None, score=np.array([lidar_score])))
    seen = SensorViews(rig("lidar", "radar"), {}, lidar, RadarView(points, np.zeros(5, np.int64), one_box(velocity)))
    return fuse(seen, params)


def test_alone_a_cluster_without_velocity_is_believed_as_little_as_what_stands():
    assert fused(3.0).score.tolist() == pytest.approx([0.8 * 0.9])
    assert len(fused(np.nan)) == 0
    assert fused(np.nan, params=FusionParams(min_score=0.1)).score.tolist() == pytest.approx([0.19 * 0.9])


def test_with_a_lidar_it_confirms_and_gives_no_velocity():
    boxes = fused(np.nan, lidar_score=0.6, params=FusionParams(lidar_weight=1.0))
    assert boxes.sources.tolist() == [6]
    assert boxes.score[0] > 0.5
    assert np.isnan(boxes.velocity_mps).all()


def test_late3d_with_lidar_and_a_radar_without_doppler():
    pipeline = Late3D()
    pipeline.start(rig("lidar", "radar"), LOG)
    output = pipeline.step(frame(0, cloud(), without_velocity(scan())))
    assert np.isnan(output.detections.velocity_mps).all()
