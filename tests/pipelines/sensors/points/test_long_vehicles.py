from dataclasses import replace

import numpy as np
import pytest

from fbench.pipelines.sensors.lidar.clusters import MAX_TRUCKS, LidarView, complete_trucks
from fbench.pipelines.sensors.points.ground import Plane
from fbench.replay.data.boxes import Boxes3D

EYE = np.zeros(2)
STRIPES = np.arange(21.4, 30.1, 1.2)
"""Where the side of a truck of 10 m is hit, whose front is 20 m ahead and 3 to 5.6 m to the left."""

NO_BOXES = replace(Boxes3D.empty(), label=np.zeros(0, "<U5"), score=np.zeros(0))


def view(parts, labels, scores, centers, sizes) -> LidarView:
    """Clusters of points (x, y), each with heights from 0.3 to 1.8 m and a box that points ahead."""
    heights = np.linspace(0.3, 1.8, 4)
    xyz = [np.column_stack([np.repeat(part, 4, axis=0), np.tile(heights, len(part))]) for part in parts]
    number = np.concatenate([np.full(len(part), row) for row, part in enumerate(xyz)])
    boxes = Boxes3D(
        np.column_stack([centers, np.ones(len(centers))]), np.array(sizes), np.zeros(len(centers)),
        label=np.array(labels), score=np.array(scores),
    )  # fmt: skip
    return LidarView(None, np.concatenate(xyz), number, boxes)


def truck(score=0.6, stripes=STRIPES, kind="pedestrian", stripe_score=0.3) -> LidarView:
    front = np.column_stack([np.full(10, 20.0), np.linspace(3.0, 5.6, 10)])
    sides = [np.array([[x, 3.0]]) for x in stripes]
    return view(
        [front, *sides], ["truck", *[kind] * len(sides)], [score, *[stripe_score] * len(sides)],
        np.array([[24.25, 4.3], *[[x + 0.3, 3.0] for x in stripes]]),
        [[8.5, 2.6, 3.3], *[[0.6, 0.6, 1.7]] * len(sides)],
    )  # fmt: skip


def turned(seen: LidarView, angle: float) -> LidarView:
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    center, yaw = seen.boxes.center_m @ turn, seen.boxes.yaw_rad + angle
    return replace(seen, xyz=seen.xyz @ turn, boxes=replace(seen.boxes, center_m=center, yaw_rad=yaw))


def test_a_truck_takes_the_stripes_of_its_side_and_becomes_as_long():
    whole = complete_trucks(truck(), EYE)
    assert len(whole.boxes) == 1
    assert whole.boxes.size_lwh_m[0] == pytest.approx([9.8, 2.6, 3.3])
    assert whole.boxes.center_m[0, :2] == pytest.approx([24.9, 4.3], abs=0.01)
    assert (whole.cluster == 0).all()
    assert len(whole.xyz) == len(truck().xyz)


def test_a_turned_scene_gives_a_turned_truck():
    angle = 0.5
    expected = turned(complete_trucks(truck(), EYE), angle).boxes
    found = complete_trucks(turned(truck(), angle), EYE).boxes
    assert found.center_m == pytest.approx(expected.center_m, abs=1e-9)
    assert found.size_lwh_m == pytest.approx(expected.size_lwh_m)
    assert np.cos(found.yaw_rad - expected.yaw_rad) == pytest.approx(1.0)


def test_a_truck_that_faces_the_other_way_goes_on_away_from_the_viewer():
    seen = truck()
    seen = replace(seen, boxes=replace(seen.boxes, yaw_rad=np.full(len(seen.boxes), np.pi)))
    assert complete_trucks(seen, EYE).boxes.center_m[0, :2] == pytest.approx([24.9, 4.3], abs=0.01)


def test_what_lies_behind_a_gap_is_something_else():
    stripes = np.append(STRIPES, 33.0)
    whole = complete_trucks(truck(stripes=stripes), EYE)
    assert len(whole.boxes) == 2
    assert whole.boxes.size_lwh_m[0, 0] == pytest.approx(9.8)
    assert whole.cluster.tolist() == sorted(whole.cluster.tolist())
    assert whole.xyz[whole.cluster == 1, 0] == pytest.approx(33.0)


def test_what_looks_more_like_a_vehicle_stays():
    assert len(complete_trucks(truck(kind="car", stripe_score=0.7), EYE).boxes) == 1 + len(STRIPES)


@pytest.mark.parametrize(
    "seen",
    [
        truck(score=0.1),
        truck(stripes=[]),
        replace(truck(), boxes=replace(truck().boxes, label=None)),
        LidarView(None, np.zeros((0, 3)), np.zeros(0, np.int64), Boxes3D.empty()),
        LidarView(None, np.ones((3, 3)), np.full(3, -1), NO_BOXES),
    ],
    ids=["unlikely", "alone", "no classes", "nothing", "no clusters"],
)  # fmt: skip
def test_other_views_stay_as_they_are(seen):
    found = complete_trucks(seen, EYE)
    assert np.array_equal(found.xyz, seen.xyz)
    assert np.array_equal(found.cluster, seen.cluster)
    assert np.array_equal(found.boxes.center_m, seen.boxes.center_m)
    assert np.array_equal(found.boxes.size_lwh_m, seen.boxes.size_lwh_m)


def test_points_of_no_cluster_stay_so_but_bridge_gaps():
    seen = truck(stripes=STRIPES[::2])
    loose = np.array([[x, 3.0, 1.0] for x in STRIPES[1::2]])
    seen = replace(
        seen, xyz=np.concatenate([loose, seen.xyz]), cluster=np.append(np.full(len(loose), -1), seen.cluster)
    )
    whole = complete_trucks(seen, EYE)
    assert len(whole.boxes) == 1
    assert (whole.cluster == -1).sum() == len(loose)


FLAT = Plane(0.0, 0.0, 0.0)
RARE = np.array([23.5, 27.5, 33.0])
"""Where columns a degree apart hit a side 3 m to the left that begins at 20 m: four to six meters apart."""


def with_height(seen: LidarView, number: int, top_m: float) -> LidarView:
    """The same with another cluster as high as this."""
    xyz = seen.xyz.copy()
    xyz[seen.cluster == number, 2] = np.linspace(0.3, top_m, 4)
    return replace(seen, xyz=xyz, plane=FLAT)


def test_columns_of_points_on_the_side_of_a_truck_ahead_are_its_own():
    seen = with_height(with_height(truck(stripes=RARE), 2, 2.4), 3, 2.4)
    whole = complete_trucks(seen, EYE)
    assert len(whole.boxes) == 1
    assert whole.boxes.size_lwh_m[0, 0] == pytest.approx(13.0)
    assert whole.boxes.center_m[0, 0] == pytest.approx(26.5, abs=0.05)


def test_a_truck_ends_where_it_was_last_seen_to_be_high():
    seen = with_height(with_height(truck(stripes=RARE), 2, 2.4), 3, 1.4)  # the last column may be a car ahead of it
    whole = complete_trucks(seen, EYE)
    assert len(whole.boxes) == 2
    assert whole.boxes.size_lwh_m[0, 0] == pytest.approx(8.5)  # it was seen for 7.5 m


def test_a_column_that_was_not_hit_ends_the_truck():
    seen = with_height(with_height(truck(stripes=[23.5, 33.0]), 1, 2.4), 2, 2.4)
    assert complete_trucks(seen, EYE).boxes.size_lwh_m[0, 0] == pytest.approx(8.5)


def test_wheels_right_behind_what_is_high_are_the_trucks():
    seen = truck(stripes=[23.5, 27.5, 29.0])
    whole = complete_trucks(with_height(with_height(seen, 2, 2.4), 3, 0.9), EYE)
    assert len(whole.boxes) == 1
    assert whole.boxes.size_lwh_m[0, 0] == pytest.approx(9.0)


def test_low_columns_farther_behind_what_is_high_may_be_a_car_ahead():
    """At 27.5 m it is high; of what follows 1.5 m apart only the first column is its own."""
    seen = truck(stripes=[23.5, 27.5, 29.0, 30.5, 32.0])
    for number, top_m in ((2, 2.4), (3, 0.9), (4, 0.9), (5, 0.9)):
        seen = with_height(seen, number, top_m)
    whole = complete_trucks(seen, EYE)
    assert len(whole.boxes) == 3
    assert whole.boxes.size_lwh_m[0, 0] == pytest.approx(9.0)


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_points_changes_nothing(seed):
    """Of points at one distance, of which one is under the truck and one on its side."""
    seen = with_height(with_height(truck(stripes=RARE), 2, 2.4), 3, 2.4)
    under = np.array([[27.5, 4.5, 0.9], [33.0, 4.5, 0.9]])
    seen = replace(seen, xyz=np.concatenate([under, seen.xyz]), cluster=np.append([-1, -1], seen.cluster))
    order = np.random.default_rng(seed).permutation(len(seen.xyz))
    order = order[np.argsort(seen.cluster[order], kind="stable")]
    mixed = complete_trucks(replace(seen, xyz=seen.xyz[order], cluster=seen.cluster[order]), EYE)
    assert len(mixed.boxes) == 1
    assert mixed.boxes.size_lwh_m[0, 0] == pytest.approx(13.0)


@pytest.mark.parametrize("under", [[[25.0, 4.5, 0.9]], [[20.5, 5.0, 0.9], [25.0, 5.2, 0.9], [29.0, 4.4, 0.9]]])
def test_what_is_seen_under_a_truck_does_not_end_it(under):
    seen = with_height(with_height(truck(stripes=RARE), 2, 2.4), 3, 2.4)
    seen = replace(
        seen, xyz=np.concatenate([under, seen.xyz]), cluster=np.append(np.full(len(under), -1), seen.cluster)
    )
    whole = complete_trucks(seen, EYE)
    assert len(whole.boxes) == 1
    assert whole.boxes.size_lwh_m[0, 0] == pytest.approx(13.0)


def test_as_many_trucks_as_no_road_has_are_completed_the_likeliest_first():
    num = MAX_TRUCKS + 20
    score = np.linspace(0.9, 0.3, num)
    one, places = truck(stripes=[21.4]), np.column_stack([40.0 * np.arange(num), np.zeros(num)])
    parts = [one.xyz[one.cluster == part][::4, :2] + place for place in places for part in (0, 1)]
    centers = [center + place for place in places for center in one.boxes.center_m[:, :2]]
    scores = np.column_stack([score, np.full(num, 0.1)]).ravel()
    crowd = view(parts, ["truck", "pedestrian"] * num, scores, np.array(centers), [[8.5, 2.6, 3.3], [0.6] * 3] * num)
    found = complete_trucks(crowd, np.array([-100.0, 0]))
    assert (found.boxes.label == "truck").sum() == num
    assert (found.boxes.label == "pedestrian").sum() == num - MAX_TRUCKS
    left = found.boxes.center_m[found.boxes.label == "pedestrian", 0]
    assert left == pytest.approx(21.7 + places[MAX_TRUCKS:, 0])
