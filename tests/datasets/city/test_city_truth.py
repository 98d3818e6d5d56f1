"""The truth of simulated logs: the same under all circumstances, consistent in itself and with what sensors show."""

from itertools import pairwise

import numpy as np
import pytest
from tests.datasets.city.city_logs import in_boxes, moved, simulated

from fbench.replay.data.metadata import inside
from fbench.replay.geometry.camera import project_boxes


def in_world(log, stamp_ns):
    """Boxes' centers and velocities in the world, and the vehicle's pose."""
    pose, boxes = log.poses()[stamp_ns].world_T_body, log.truths[stamp_ns].boxes3d
    return moved(pose, boxes.center_m), boxes.velocity_mps @ pose[:3, :3].T, boxes


@pytest.mark.slow
def test_every_body_keeps_its_id_class_and_size(log):
    known, in_images = {}, {}
    for truth in log.truths.values():
        boxes = truth.boxes3d
        assert len(np.unique(boxes.track_id)) == len(boxes)
        assert (boxes.track_id > 0).all()  # the vehicle itself isn't in it
        for i, label, size in zip(boxes.track_id, boxes.label, boxes.size_lwh_m, strict=True):
            assert known.setdefault(int(i), (label, *size)) == (label, *size)
        for i, label in zip(truth.boxes2d.track_id, truth.boxes2d.label, strict=True):
            assert in_images.setdefault(int(i), label) == label
    assert all(known[i][0] == label for i, label in in_images.items() if i in known)
    assert len({label for label, *_ in known.values()}) >= 2


def test_velocities_are_the_difference_quotients_of_positions(log):
    stamps = sorted(log.truths)
    checked = 0
    for a, b in pairwise(stamps):
        (at_a, v_a, boxes_a), (at_b, v_b, boxes_b) = in_world(log, a), in_world(log, b)
        _, i, j = np.intersect1d(boxes_a.track_id, boxes_b.track_id, return_indices=True)
        seconds = (b - a) / 1e9
        mean = (at_b[j] - at_a[i]) / seconds
        # at most 10 m/s2 of jolt within a step: the trapezoidal rule is off by less than that
        assert np.abs(mean - (v_a[i] + v_b[j]) / 2).max() < 0.25 * seconds * 10
        checked += (np.linalg.norm(mean, axis=1) > 1).sum()
    assert checked > 10


def test_bodies_within_the_range_are_told_and_no_others(log):
    for truth in log.truths.values():
        assert np.linalg.norm(truth.boxes3d.center_m[:, :2], axis=1).max() <= 120


def test_bodies_are_on_roads_and_sidewalks(log):
    regions = log.info.regions
    assert {region.kind for region in regions} <= {"road", "sidewalk"}
    outside = total = 0
    for stamp_ns in log.truths:
        pose, boxes = log.poses()[stamp_ns].world_T_body, log.truths[stamp_ns].boxes3d
        cos, sin = np.cos(boxes.yaw_rad), np.sin(boxes.yaw_rad)
        for x, y in ((0, 0), (-1, -1), (-1, 1), (1, -1), (1, 1)):
            u, v = 0.45 * x * boxes.size_lwh_m[:, 0], 0.45 * y * boxes.size_lwh_m[:, 1]
            corner = boxes.center_m + np.stack([cos * u - sin * v, sin * u + cos * v, 0 * u], axis=1)
            found = inside(regions, moved(pose, corner)[:, :2])
            outside, total = outside + (~found).sum(), total + len(found)
            assert found.all() or (x, y) != (0, 0)
    assert outside < 0.01 * total


def test_bodies_stand_on_the_ground_and_do_not_overlap(log):
    for truth in log.truths.values():
        boxes = truth.boxes3d
        bottom = boxes.center_m[:, 2] - boxes.size_lwh_m[:, 2] / 2
        assert ((bottom > -0.01) & (bottom < 0.3)).all()
        within = in_boxes(boxes.center_m, boxes)
        assert np.array_equal(np.argwhere(within)[:, 0], np.argwhere(within)[:, 1])  # each its own center alone


def test_outlines_enclose_what_images_show(log):
    pairs = 0
    for truth in log.truths.values():
        flat, boxes = truth.boxes2d, truth.boxes3d
        assert (flat.visible_xyxy_px[:, :2] >= flat.xyxy_px[:, :2]).all()
        assert (flat.visible_xyxy_px[:, 2:] <= flat.xyxy_px[:, 2:]).all()
        assert ((flat.visibility >= 0) & (flat.visibility <= 1)).all()
        assert (flat.ignore | (flat.visibility >= 0.1)).all()
        for camera, model in log.rig.cameras.items():
            outline, seen = project_boxes(log.rig, camera, boxes)
            rows = np.flatnonzero(flat.camera == camera)
            assert (flat.xyxy_px[rows] >= -0.5).all()
            assert (flat.xyxy_px[rows, 2:] <= np.array(model.size_wh) - 0.5).all()
            _, i, j = np.intersect1d(flat.track_id[rows], boxes.track_id, return_indices=True)
            assert seen[j].all()
            full, around = flat.xyxy_px[rows[i]], outline[j]
            assert (around[:, :2] - full[:, :2]).max(initial=0) <= 1
            assert (full[:, 2:] - around[:, 2:]).max(initial=0) <= 1
            distance = np.linalg.norm(boxes.center_m[j], axis=1)
            assert np.allclose(flat.distance_m[rows[i]], distance)
            pairs += len(i)
            large = (full[:, 2:] - full[:, :2]).min(axis=1) > 20
            area = np.prod(full[:, 2:] - full[:, :2], axis=1) / np.prod(around[:, 2:] - around[:, :2], axis=1)
            assert (area[large] > 0.35).all()
    assert pairs > 20


def test_what_is_visible_gives_points_and_what_is_hidden_does_not(log):
    for truth in log.truths.values():
        boxes = truth.boxes3d
        assert ((boxes.visibility >= 0) & (boxes.visibility <= 1)).all()
        assert np.array_equal(boxes.ignore, boxes.visibility == 0)
        distance = np.linalg.norm(boxes.center_m, axis=1)
        plain = (boxes.visibility > 0.5) & (distance < 30) & (boxes.size_lwh_m[:, 0] > 3)
        assert (boxes.num_lidar_pts[plain] > 20).all()
        assert (boxes.num_lidar_pts[boxes.visibility == 0] < 100).all()  # the LiDAR is 0.2 m higher


def same_scene(a, b):
    stamps = sorted(set(a.truths) & set(b.truths))
    assert stamps
    for stamp_ns in stamps:
        x, y = a.truths[stamp_ns].boxes3d, b.truths[stamp_ns].boxes3d
        for field in ("center_m", "size_lwh_m", "yaw_rad", "velocity_mps", "track_id", "visibility"):
            assert getattr(x, field).tobytes() == getattr(y, field).tobytes(), field
        assert x.label.tolist() == y.label.tolist()
        assert x.attribute.tolist() == y.attribute.tolist()
    a_poses, b_poses = a.poses(), b.poses()
    both = set(a_poses) & set(b_poses)
    assert both
    assert all(a_poses[ns].world_T_body.tobytes() == b_poses[ns].world_T_body.tobytes() for ns in both)
    return len(stamps)


@pytest.mark.parametrize("condition", ["clear", "fog", "night", "heavy-rain"])
def test_weather_and_light_change_no_trajectory(urban, under, condition):
    assert same_scene(urban, under(condition)) == 2
    images = [log.truths[min(log.truths)].boxes2d for log in (urban, under(condition))]
    assert images[0].xyxy_px.tobytes() == images[1].xyxy_px.tobytes()


def test_rig_rate_and_length_change_no_trajectory(urban, tmp_path):
    args = ("--sensors", "radar", "--set", "radar.rate_hz=25", "--set", "radar.points_per_s=1000", "--seconds", 1.5)
    assert same_scene(urban, simulated(tmp_path, "other", "urban", "--seed", 3, *args)) == 5


@pytest.mark.slow
def test_dense_traffic_and_another_seed_are_other_scenes(urban, tmp_path):
    args = ("--sensors", "radar", "--set", "radar.points_per_s=1000", "--seconds", 0.1)
    dense = simulated(tmp_path, "dense", "urban", "--seed", 3, "--condition", "traffic", *args)
    other = simulated(tmp_path, "other", "urban", "--seed", 4, *args)
    first = min(urban.truths)
    assert dense.info.metadata["regions"] == urban.info.metadata["regions"]  # the same world
    assert other.info.metadata["regions"] != urban.info.metadata["regions"]
    for log in (dense, other):
        assert log.truths[first].boxes3d.center_m.tobytes() != urban.truths[first].boxes3d.center_m.tobytes()
    assert len({log.info.log_id for log in (urban, dense, other)}) == 3
