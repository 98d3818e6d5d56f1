"""What must hold for any set of measurements."""

from dataclasses import replace

import numpy as np
import pytest
from tests.pipelines.fusion.views import AHEAD, PLANE, RIG, K, car, lidar_view, outline, radar_view, standing_view

from fbench.pipelines.fusion.late.existence import FusionParams
from fbench.pipelines.fusion.late.fuse import LateFusion, SensorViews, fuse
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.lidar.clusters import LidarView
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.sensors.radar.stage import RadarView
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.replay.geometry.camera import project_boxes
from fbench.replay.geometry.transforms import wrap_angle

PARAMS = FusionParams(min_score=0.2, lidar_weight=1.0)
SEEDS = range(12)
SIZES = [(4.2, 1.8, 1.55), (0.6, 0.6, 1.7), (8.0, 2.5, 3.2), (1.8, 0.6, 1.6)]


def scene(seed: int) -> SensorViews:
    """Some objects, each seen by some sensors, one of them twice by the camera, and clutter."""
    random = np.random.default_rng(seed)
    objects = [
        car(random.uniform(6, 55), random.uniform(-12, 12), SIZES[random.integers(4)], random.uniform(-3, 3))
        for _ in range(random.integers(1, 9))
    ]
    by_camera, by_lidar, by_radar = ([box for box in objects if random.uniform() < 0.7] for _ in range(3))
    camera = outline(*by_camera)
    labels = random.choice(["car", "truck", "pedestrian", "bicycle"], len(camera))
    camera = CameraDetections(camera.xyxy_px, random.uniform(0.3, 0.95, len(camera)), labels)
    lidar = lidar_view(*by_lidar)
    lidar = replace(lidar, boxes=replace(lidar.boxes, score=random.uniform(0, 1, len(by_lidar)))) if by_lidar else lidar
    return SensorViews(RIG, {"cam": camera}, lidar, radar_view(*by_radar))


def permuted(seen: SensorViews, random: np.random.Generator) -> SensorViews:
    camera = seen.cameras["cam"]
    order = random.permutation(len(camera))
    cameras = {"cam": CameraDetections(camera.xyxy_px[order], camera.score[order], camera.label[order])}
    lidar, radar = (_renumbered(view.cluster, view.boxes, random) for view in (seen.lidar, seen.radar))
    by_cluster = np.argsort(lidar[0], kind="stable")
    return SensorViews(
        seen.rig,
        cameras,
        LidarView(seen.lidar.plane, seen.lidar.xyz[by_cluster], lidar[0][by_cluster], lidar[1]),
        RadarView(seen.radar.xyz, *radar),
    )


def _renumbered(cluster, boxes, random):
    order = random.permutation(len(boxes))
    rank = np.append(np.argsort(order), -1)
    return rank[cluster], boxes[order]


def assert_same(a: Boxes3D, b: Boxes3D) -> None:
    assert a.arrays().keys() == b.arrays().keys()
    for name, value in a.arrays().items():
        np.testing.assert_array_equal(value, b.arrays()[name], err_msg=name)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_order_of_detections_changes_nothing(seed):
    seen = scene(seed)
    assert_same(fuse(seen, PARAMS), fuse(permuted(seen, np.random.default_rng(seed)), PARAMS))


def turned(seen: SensorViews, angle: float, shift: np.ndarray) -> SensorViews:
    """The same scene with body axes that are turned about z and moved."""
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    half = np.array([0, 0, np.sin(angle / 2), np.cos(angle / 2)])
    mounts = {
        name: Mount(m.kind, turn @ m.translation_m + shift, _product(half, m.rotation_xyzw))
        for name, m in seen.rig.mounts.items()
    }

    def moved(boxes: Boxes3D) -> Boxes3D:
        velocity = None if boxes.velocity_mps is None else boxes.velocity_mps @ turn.T
        return replace(
            boxes, center_m=boxes.center_m @ turn.T + shift, yaw_rad=boxes.yaw_rad + angle, velocity_mps=velocity
        )

    plane = None if seen.lidar.plane is None else Plane(0.0, 0.0, seen.lidar.plane.height_m + shift[2])
    lidar = LidarView(plane, seen.lidar.xyz @ turn.T + shift, seen.lidar.cluster, moved(seen.lidar.boxes))
    radar = RadarView(seen.radar.xyz @ turn.T + shift, seen.radar.cluster, moved(seen.radar.boxes))
    return SensorViews(Rig(mounts, seen.rig.cameras), seen.cameras, lidar, radar)


def _product(a, b):
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return np.array([
        aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz,
    ])  # fmt: skip


@pytest.mark.parametrize("seed", SEEDS)
def test_a_turn_about_the_vertical_moves_the_result_with_it(seed):
    """By right angles: what is guessed of a heading from one image prefers multiples of them."""
    seen = scene(seed)
    angle = np.pi / 2 * (1 + seed % 3)
    first, other = fuse(seen, PARAMS), fuse(turned(seen, angle, np.zeros(3)), PARAMS)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    assert len(first) == len(other)
    assert other.score == pytest.approx(first.score, abs=1e-6)
    assert other.center_m == pytest.approx(first.center_m @ turn.T, abs=1e-6)
    assert other.size_lwh_m == pytest.approx(first.size_lwh_m)
    away = np.abs(wrap_angle(other.yaw_rad - first.yaw_rad - angle))
    assert np.minimum(away, np.pi - away) == pytest.approx(np.zeros(len(away)), abs=1e-6)
    np.testing.assert_array_equal(other.sources, first.sources)
    np.testing.assert_array_equal(other.label, first.label)


def test_the_same_frames_give_the_same_result_after_a_reset():
    fusion, frames = LateFusion(PARAMS), [scene(seed) for seed in SEEDS]
    first = [fusion.step(seen) for seen in frames]
    fusion.reset()
    for before, seen in zip(first, frames, strict=True):
        assert_same(before, fusion.step(seen))


def test_frames_before_count():
    fusion = LateFusion(replace(PARAMS, min_score=0.0))
    blind = SensorViews(RIG, {"cam": outline()}, lidar_view(car(20.0)), radar_view(car(20.0)))
    ahead = SensorViews(RIG, {"cam": outline()}, lidar_view(car(20.0), score=0.7), radar_view())
    (before,) = LateFusion(replace(PARAMS, min_score=0.0)).step(ahead).score
    for _ in range(20):
        fusion.step(blind)
    assert fusion.step(ahead).score[0] > before + 0.1


def test_a_sensor_that_is_missing_for_a_second_is_missed_but_does_no_harm():
    cars = car(14.0, -2.0), car(24.0, 3.0), car(40.0, 0.0)
    full = {"cam": outline(*cars)}, lidar_view(*cars), radar_view(*cars)
    nothing = {}, LidarView(PLANE, np.zeros((0, 3)), np.zeros(0, np.int64), Boxes3D.empty()), radar_view()
    for at, bit in enumerate((1, 2, 4)):
        fusion = LateFusion(FusionParams())
        sources = []
        for step in range(30):
            is_gone = 10 <= step < 20
            measured = tuple(nothing[k] if is_gone and k == at else full[k] for k in range(3))
            sources.append(fusion.step(SensorViews(RIG, *measured)).sources.tolist())
        assert sources == [[7 - bit if 10 <= step < 20 else 7] * 3 for step in range(30)]


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("kept", ["", "C", "L", "R", "CL", "CR", "LR"])
def test_any_sensors_give_the_same_fields_and_finite_boxes(seed, kept):
    seen = scene(seed)
    cameras = seen.cameras if "C" in kept else {}
    lidar = seen.lidar if "L" in kept else LidarView(None, np.zeros((0, 3)), np.zeros(0, np.int64), Boxes3D.empty())
    radar = seen.radar if "R" in kept else radar_view()
    found = fuse(SensorViews(RIG, cameras, lidar, radar), PARAMS)
    assert found.arrays().keys() == fuse(seen, PARAMS).arrays().keys()
    for array in (found.center_m, found.size_lwh_m, found.yaw_rad, found.score):
        assert array is not None
        assert np.isfinite(array).all()
    assert ((found.score > 0) & (found.score <= 1)).all() if found.score is not None else False
    bits = sum(bit for name, bit in zip("CLR", (1, 2, 4), strict=True) if name in kept)
    assert found.sources is not None
    assert (found.sources & ~np.uint8(bits) == 0).all()


def test_one_point_and_all_points_equal():
    point = np.array([[20.0, 0, -1.0]])
    for num in (1, 50):
        lidar = LidarView(PLANE, np.tile(point, (num, 1)), np.zeros(num, np.int64), car(20.0))
        radar = RadarView(np.tile(point, (num, 1)), np.zeros(num, np.int64), car(20.0))
        found = fuse(SensorViews(RIG, {"cam": outline(car(20.0))}, lidar, radar), PARAMS)
        assert np.isfinite(found.center_m).all()


def test_a_million_echoes_that_stand():
    xyz = np.random.default_rng(1).uniform(-50, 50, (1_000_000, 3))
    radar = RadarView(xyz, np.full(len(xyz), -1), Boxes3D.empty())
    found = fuse(SensorViews(RIG, {"cam": outline(car(20.0))}, lidar_view(), radar), PARAMS)
    assert np.isfinite(found.center_m).all()


def test_a_camera_without_other_sensors_near_it_sees_what_standing_echoes_place():
    box = car(30.0)
    small = replace(box, size_lwh_m=np.array([[4.2, 1.8, 1.35]]))
    camera = outline(small)
    guess, found = (fuse(SensorViews(RIG, {"cam": camera}, lidar_view(), view), PARAMS) for view in
                    (radar_view(), standing_view(box)))  # fmt: skip
    assert abs(found.center_m[0, 0] - 30) <= abs(guess.center_m[0, 0] - 30)


def test_cameras_of_any_size_and_place():
    mounts = {"cam": Mount("camera", np.array([1.0, -0.4, 0.6]), AHEAD), "lidar": RIG.mounts["lidar"]}
    rig = Rig(mounts, {"cam": CameraModel(K / 4, (320, 180))})
    box = car(12.0, 0.5)
    rectangle, _ = project_boxes(rig, "cam", box)
    cameras = {"cam": CameraDetections(rectangle, np.array([0.9]), np.array(["car"]))}
    found = fuse(SensorViews(rig, cameras, lidar_view(box), radar_view()), PARAMS)
    assert found.sources.tolist() == [3]
