"""Points of objects: exact numbers, and nothing outside of boxes, against a plain account of which point is where."""

from dataclasses import replace

import numpy as np
import pytest

from fbench.replay.conditions.objects import Cutout, Density, Moved, Occlusion, Rotated, Scaled, Sheared
from fbench.replay.contracts.conditions import Site
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import PointCloud, RadarScan
from fbench.replay.data.rig import Mount, Rig

TURNED = Mount("lidar", np.array([1.0, 2.0, 1.5]), np.array([0.0, 0.0, np.sin(0.4), np.cos(0.4)]))
RIG = Rig({"lidar": TURNED, "radar": replace(TURNED, kind="radar")}, {})
BOX = Boxes3D(np.array([[20.0, 3.0, 0.8], [20.5, 3.0, 0.8]]), np.array([[4.0, 2.0, 1.6]] * 2), np.array([0.3, 0.3]),
              track_id=np.array([7, 8]))  # fmt: skip
NUM_INSIDE, NUM = 40, 100


def body_points():
    """40 points inside of the first box, of which some are in the second one too, then 60 far away."""
    rng = np.random.default_rng(5)
    own = rng.uniform(-1, 1, (NUM_INSIDE, 3)) * [1.9, 0.9, 0.7]
    c, s = np.cos(0.3), np.sin(0.3)
    inside = own @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + BOX.center_m[0]
    return np.concatenate([inside, rng.uniform(-50, 0, (NUM - NUM_INSIDE, 3))])


def in_sensor(points):
    matrix = RIG.body_T_sensor("lidar")
    return ((points - matrix[:3, 3]) @ matrix[:3, :3]).astype(np.float32)


def in_body(xyz):
    matrix = RIG.body_T_sensor("lidar")
    return xyz.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def cloud(stamp_ns=0):
    ids = np.arange(NUM)
    fields = (ids.astype(np.float32), ids.astype(np.uint16), ids.astype(np.int32))
    return PointCloud("lidar", stamp_ns, stamp_ns, in_sensor(body_points()), *fields)


def site(truth=BOX, sensor="lidar", seed=0):
    return Site((seed, "x@1:3", "log", sensor), RIG, sensor, RIG.kinds[sensor], 0, 10**9, truth=truth)


@pytest.mark.parametrize(("condition", "name", "share", "num"), [
    (Density(), "removed_share", 0.1, 4), (Density(), "removed_share", 0.5, 20), (Cutout(), "removed_share", 0.3, 12),
    (Cutout(), "removed_share", 0.71, 28),
])  # fmt: skip
def test_exact_numbers_go_with_all_their_fields(condition, name, share, num):
    (found,) = condition.disturb(cloud(), {name: share}, site(BOX[:1]))
    kept = found.ring.astype(int)
    assert len(kept) == NUM - num
    assert (np.diff(kept) > 0).all()
    assert set(range(NUM_INSIDE, NUM)) <= set(kept)
    assert found.intensity.tolist() == found.offset_ns.tolist() == kept.tolist()
    assert (found.xyz == cloud().xyz[kept]).all()


def test_a_hole_is_one_neighborhood():
    (found,) = Cutout().disturb(cloud(), {"removed_share": 0.3}, site(BOX[:1]))
    gone = np.setdiff1d(np.arange(NUM_INSIDE), found.ring)
    points = body_points()[:NUM_INSIDE]
    holds = []
    for middle in gone:
        distance = np.linalg.norm(points - points[middle], axis=1)
        holds.append(set(np.argsort(distance)[: len(gone)]) == set(gone))
    assert any(holds)


@pytest.mark.parametrize("share", [0.2, 0.6, 1.0])
def test_occlusion_hides_from_one_side(share):
    (found,) = Occlusion().disturb(cloud(), {"hidden_share": share}, site(BOX[:1]))
    bearing = np.arctan2(*(body_points()[:NUM_INSIDE, :2] - TURNED.translation_m[:2]).T[::-1])
    kept = np.isin(np.arange(NUM_INSIDE), found.ring)
    if share == 1:
        assert not kept.any()
        return
    width = bearing.max() - bearing.min()
    from_left = bearing > bearing.min() + share * width
    from_right = bearing < bearing.max() - share * width
    assert kept.tolist() in (from_left.tolist(), from_right.tolist())


def moves(condition, level, truth=BOX[:1]):
    (found,) = condition.disturb(cloud(), level, site(truth))
    assert found.ring.tolist() == list(range(NUM))
    assert (found.xyz[NUM_INSIDE:] == cloud().xyz[NUM_INSIDE:]).all()
    return in_body(found.xyz)[:NUM_INSIDE] - in_body(cloud().xyz)[:NUM_INSIDE]


def test_objects_move_as_a_whole_along_the_ground():
    off = moves(Moved(), {"moved_m": 0.6})
    assert np.abs(off - off[0]).max() < 1e-5
    assert np.linalg.norm(off[0]) == pytest.approx(0.6, abs=1e-5)
    assert off[0, 2] == pytest.approx(0, abs=1e-5)


def test_an_object_moves_alike_all_the_time_and_another_one_differently():
    level, found = {"moved_m": 0.6}, []
    for stamp_ns, row in ((0, 0), (10**8, 0), (0, 1)):
        (after,) = Moved().disturb(cloud(stamp_ns), level, site(BOX[row : row + 1]))
        changed = in_body(after.xyz) - in_body(cloud().xyz)
        found.append(changed[np.linalg.norm(changed, axis=1) > 0.1][0])
    assert found[0] == pytest.approx(found[1], abs=1e-5)
    assert np.linalg.norm(found[0] - found[2]) > 0.1


def own(points):
    c, s = np.cos(0.3), np.sin(0.3)
    return (points - BOX.center_m[0]) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def test_rotation_scale_and_shear_are_those_of_the_box():
    before = own(in_body(cloud().xyz)[:NUM_INSIDE])

    def after(condition, **level):
        (found,) = condition.disturb(cloud(), level, site(BOX[:1]))
        return own(in_body(found.xyz)[:NUM_INSIDE])

    turned = after(Rotated(), rotated_deg=9.0)
    angle = np.arctan2(turned[:, 1], turned[:, 0]) - np.arctan2(before[:, 1], before[:, 0])
    assert np.abs(np.abs((np.degrees(angle) + 180) % 360 - 180) - 9).max() < 0.01
    assert np.abs(turned[:, 2] - before[:, 2]).max() < 1e-5
    floor = np.array([0, 0, -0.8])
    scaled = (after(Scaled(), scale_share=0.2) - floor) / (before - floor)
    assert np.abs(np.abs(scaled - 1) - 0.2).max() < 1e-2
    sheared = after(Sheared(), shear_share=0.1)
    x, y = (sheared - before)[:, :2].T
    assert np.abs(np.abs(x) - 0.1 * np.abs(before[:, 1])).max() < 1e-5
    assert np.abs(np.abs(y) - 0.1 * np.abs(before[:, 0])).max() < 1e-5


def test_a_point_in_two_boxes_belongs_to_the_first():
    (both,) = Density().disturb(cloud(), {"removed_share": 1.0}, site(BOX))
    assert len(both.xyz) == NUM - NUM_INSIDE
    off = moves(Moved(), {"moved_m": 0.6}, BOX)
    assert np.abs(off - off[0]).max() < 1e-5


def test_radar_points_keep_their_polar_form_true():
    xyz = in_sensor(body_points()).astype(np.float64)
    polar = [
        np.linalg.norm(xyz, axis=1),
        np.arctan2(xyz[:, 1], xyz[:, 0]),
        np.arcsin(xyz[:, 2] / np.linalg.norm(xyz, axis=1)),
    ]
    one = np.ones(NUM, np.float32)
    scan = RadarScan("radar", 0, 0, xyz.astype(np.float32), one, one, *(p.astype(np.float32) for p in polar))
    (found,) = Moved().disturb(scan, {"moved_m": 0.8}, site(BOX[:1], "radar"))
    flat = found.range_m * np.cos(found.altitude_rad)
    again = np.column_stack([flat * np.cos(found.azimuth_rad), flat * np.sin(found.azimuth_rad),
                             found.range_m * np.sin(found.altitude_rad)])  # fmt: skip
    assert np.abs(again - found.xyz).max() < 1e-3
    assert (found.range_m[:NUM_INSIDE] != scan.range_m[:NUM_INSIDE]).all()
    assert (found.range_m[NUM_INSIDE:] == scan.range_m[NUM_INSIDE:]).all()
    (fewer,) = Density().disturb(scan, {"removed_share": 0.5}, site(BOX[:1], "radar"))
    assert len(fewer.rcs_dbsm) == len(fewer.altitude_rad) == NUM - 20


@pytest.mark.parametrize("condition", [Density(), Cutout(), Occlusion(), Moved(), Rotated(), Scaled(), Sheared()])
def test_what_has_no_objects_stays_the_same_message(condition):
    level = {name: values[4] for name, values in condition.levels.items()}
    same = cloud()
    far = replace(BOX, center_m=BOX.center_m + np.array([500.0, 0, 0]))
    for truth in (None, Boxes3D.empty(), far):
        assert condition.disturb(same, level, site(truth)) == (same,)
    empty = PointCloud("lidar", 0, 0, np.zeros((0, 3), np.float32))
    assert condition.disturb(empty, level, site()) == (empty,)
    broken = replace(same, xyz=np.where(np.arange(NUM)[:, None] == 3, np.nan, same.xyz).astype(np.float32))
    (found,) = condition.disturb(broken, level, site())
    assert np.isnan(found.xyz).any(axis=1).sum() == 1
