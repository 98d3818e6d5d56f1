"""Labeled objects: only points in boxes are touched, by the mount, and by exact counts."""

import numpy as np
import pytest
from tests.replay.conditions.sites import QUARTER_LEFT, bytes_of, cloud, disturb, site

from fbench.replay.conditions.lidar.objects import (
    IncompleteEcho,
    ObjectCutout,
    ObjectDensity,
    ObjectMoved,
    ObjectRotation,
    ObjectScale,
    ObjectShear,
    find_objects,
)
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.geometry.transforms import inverse, transform

COUNTS = {
    ObjectDensity: (0.1, 0.2, 0.3, 0.4, 0.5), ObjectCutout: (0.3, 0.4, 0.5, 0.6, 0.7),
    IncompleteEcho: (0.55, 0.65, 0.75, 0.85, 0.95),
}  # fmt: skip
SHAPES = [ObjectMoved(), ObjectRotation(), ObjectScale(), ObjectShear()]
YAW = 0.6
TRUTH = Boxes3D(
    np.array([[12.0, 4, 1], [-20, 0, 0.8], [50, 50, 1]]),
    np.array([[4.0, 2, 1.6], [8, 2.5, 3], [4, 2, 2]]),
    np.array([YAW, 0, 0]),
)
IN_FIRST, IN_SECOND = 400, 300


def scene(rotation):
    """Points in two of three boxes, and around them."""
    rng = np.random.default_rng(0)
    parts = []
    for i, num in ((0, IN_FIRST), (1, IN_SECOND)):
        local = rng.uniform(-0.499, 0.499, (num, 3)) * TRUTH.size_lwh_m[i]
        cos, sin = np.cos(TRUTH.yaw_rad[i]), np.sin(TRUTH.yaw_rad[i])
        turned = np.stack(
            [cos * local[:, 0] - sin * local[:, 1], sin * local[:, 0] + cos * local[:, 1], local[:, 2]], 1
        )
        parts.append(turned + TRUTH.center_m[i])
    parts.append(np.stack([rng.uniform(-40, 40, 1000), rng.uniform(8, 40, 1000), rng.uniform(0, 3, 1000)], axis=1))
    body = np.concatenate(parts)
    where = site(rotation=rotation)
    xyz = transform(inverse(where.rig.body_T_sensor("lidar")), body)
    return cloud(xyz, intensity=np.arange(1700) / 1700, ring=np.arange(1700).astype(np.uint16))


@pytest.mark.parametrize("rotation", [np.array([0.0, 0, 0, 1]), QUARTER_LEFT])
def test_points_are_found_in_their_boxes(rotation):
    base = scene(rotation)
    found = list(find_objects(base, site(rotation=rotation, truth=TRUTH)))
    assert [len(rows) for rows, *_ in found] == [IN_FIRST, IN_SECOND]
    for rows, local, size, sensor_T_box in found:
        assert (np.abs(local) <= size / 2).all()
        np.testing.assert_allclose(transform(sensor_T_box, local), base.xyz[rows], atol=1e-4)


@pytest.mark.parametrize("kind", COUNTS)
def test_exactly_the_share_of_each_object_is_lost(kind):
    base = scene(QUARTER_LEFT)
    before = bytes_of(base)
    for severity, share in enumerate(COUNTS[kind], 1):
        ring = disturb(kind(), base, severity, rotation=QUARTER_LEFT, truth=TRUTH).ring
        assert (ring < IN_FIRST).sum() == IN_FIRST - round(share * IN_FIRST)
        assert ((ring >= IN_FIRST) & (ring < IN_FIRST + IN_SECOND)).sum() == IN_SECOND - round(share * IN_SECOND)
        assert (ring >= IN_FIRST + IN_SECOND).sum() == 1000
        assert (np.diff(ring.astype(np.int64)) > 0).all()
    assert bytes_of(base) == before


def test_cutouts_are_holes():
    base = scene(QUARTER_LEFT)
    left = disturb(ObjectCutout(), base, 1, rotation=QUARTER_LEFT, truth=TRUTH)
    gone = np.setdiff1d(np.arange(IN_FIRST), left.ring)
    middle = base.xyz[gone].mean(axis=0)
    others = np.setdiff1d(np.arange(IN_FIRST), gone)
    spread = [np.sqrt(((base.xyz[rows] - middle) ** 2).sum(axis=1)).mean() for rows in (gone, others)]
    assert spread[0] < 0.7 * spread[1]


@pytest.mark.parametrize("condition", SHAPES, ids=lambda c: type(c).__name__)
def test_shapes_change_by_more_at_every_step_and_nothing_else(condition):
    base = scene(QUARTER_LEFT)
    means = []
    for severity in range(1, 6):
        after = disturb(condition, base, severity, rotation=QUARTER_LEFT, truth=TRUTH)
        off = np.sqrt(((after.xyz.astype(np.float64) - base.xyz) ** 2).sum(axis=1))
        assert off[700:].max() == 0
        assert after.intensity.tobytes() == base.intensity.tobytes()
        means.append(np.mean([
            np.abs(disturb(condition, base, severity, rotation=QUARTER_LEFT, truth=TRUTH, seed=seed).xyz - base.xyz)
            .mean() for seed in range(10)
        ]))  # fmt: skip
    assert means[0] > 0
    assert (np.diff(means) > 0).all()


def test_moved_objects_move_along_their_heading():
    base = scene(np.array([0.0, 0, 0, 1]))
    after = disturb(ObjectMoved(), base, 5, truth=TRUTH)
    off = (after.xyz.astype(np.float64) - base.xyz)[:IN_FIRST]
    assert np.abs(off @ [np.cos(YAW), np.sin(YAW), 0]) == pytest.approx(np.ones(IN_FIRST), abs=1e-5)
    assert np.abs(off @ [-np.sin(YAW), np.cos(YAW), 0]).max() < 1e-5


def test_turned_objects_keep_their_shape():
    base = scene(np.array([0.0, 0, 0, 1]))
    after = disturb(ObjectRotation(), base, 5, truth=TRUTH)
    a, b = (m.xyz[:IN_FIRST].astype(np.float64) - TRUTH.center_m[0] + [0, 0, 2] for m in (base, after))
    np.testing.assert_allclose(np.sqrt((b**2).sum(axis=1)), np.sqrt((a**2).sum(axis=1)), atol=1e-4)
    turned = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1])
    assert np.degrees(np.abs(np.median(turned))) == pytest.approx(9, abs=0.01)


@pytest.mark.parametrize("condition", [*SHAPES, ObjectDensity(), ObjectCutout()], ids=lambda c: type(c).__name__)
@pytest.mark.parametrize("truth", [None, Boxes3D.empty(), TRUTH[np.array([2])]])
def test_without_labels_or_points_in_them_nothing_changes(condition, truth):
    base = scene(QUARTER_LEFT)
    assert bytes_of(disturb(condition, base, truth=truth)) == bytes_of(base)
    assert condition.needs == ("truth",)


def test_boxes_that_are_not_finite_are_passed_over():
    center = TRUTH.center_m.copy()
    center[1, 0] = np.nan
    broken = Boxes3D(center, TRUTH.size_lwh_m, TRUTH.yaw_rad)
    assert len(list(find_objects(scene(QUARTER_LEFT), site(rotation=QUARTER_LEFT, truth=broken)))) == 1
