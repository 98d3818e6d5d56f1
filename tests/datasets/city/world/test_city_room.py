"""Whether there is room for all: swept bodies stay on the road and clear of those who wait or ride beside them."""

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from fbench.datasets.city.world.city_map import Lane, Layout

BUS, TRUCK, VAN, CAR, BIKE = (12.0, 2.55), (8.0, 2.5), (7.0, 2.2), (4.8, 1.95), (1.9, 0.7)


def _rim(size_lw: tuple[float, float]) -> np.ndarray:
    """Points (N, 2) every 0.2 m along a rectangle's edge."""
    length, width = size_lw
    a, b = np.arange(-length / 2, length / 2, 0.2), np.arange(-width / 2, width / 2, 0.2)
    sides = [np.column_stack([a, np.full(len(a), s * width / 2)]) for s in (-1, 1)]
    ends = [np.column_stack([np.full(len(b), s * length / 2), b]) for s in (-1, 1)]
    corners = np.array([[x, y] for x in (-length / 2, length / 2) for y in (-width / 2, width / 2)])
    return np.concatenate([*sides, *ends, corners])


def _swept(points: np.ndarray, size_lw: tuple[float, float]) -> np.ndarray:
    """All rims of a body whose middle follows a line with its heading."""
    steps = np.diff(points[:, :2], axis=0)
    heading = np.arctan2(steps[:, 1], steps[:, 0])
    middle = (points[1:, :2] + points[:-1, :2]) / 2
    rim = _rim(size_lw)
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    x = middle[:, :1] + c * rim[:, 0] - s * rim[:, 1]
    y = middle[:, 1:] + s * rim[:, 0] + c * rim[:, 1]
    return np.column_stack([x.ravel(), y.ravel()])


def _outside_m(urban: Layout, points: np.ndarray, kinds: set[str]) -> float:
    """How far the farthest of some points is from all regions of some kinds."""
    inside = np.full(len(points), -np.inf)
    for polygon in urban.map.polygons:
        near = (points >= polygon.points_m.min(0) - 1).all(1) & (points <= polygon.points_m.max(0) + 1).all(1)
        if polygon.kind in kinds:
            contour = polygon.points_m.astype(np.float32)
            for i in np.flatnonzero(near & (inside < 0)):
                x, y = points[i].tolist()
                inside[i] = max(inside[i], cv2.pointPolygonTest(contour, (x, y), True))
    return float(-inside.min())


def _turns(urban: Layout, at_least_m: float) -> list[Lane]:
    return [n for n in urban.map.lanes if n.kind == "drive" and n.in_junction and n.longest_m >= at_least_m]


def _thinned(points: np.ndarray) -> np.ndarray:
    return np.unique(np.round(points, 1), axis=0)


def test_buses_turn_without_touching_a_kerb(urban: Layout) -> None:
    turns = _turns(urban, 12.0)
    swept = _thinned(np.concatenate([_swept(lane.points_m, BUS) for lane in turns[::2]]))
    assert _outside_m(urban, swept, {"road"}) < 0.1  # thinning moves points by up to 0.07 m


@pytest.mark.parametrize(("size", "longest"), [(BUS, 12.0), (TRUCK, 8.0), (CAR, 5.0)])
def test_whoever_crosses_passes_those_who_wait(urban: Layout, size: tuple[float, float], longest: float) -> None:
    lanes = urban.map.lanes
    waiting: dict[int, np.ndarray] = {}
    for i, lane in enumerate(lanes):
        if lane.signal is not None and lane.kind != "walk":
            front = lane.points_m[-1, :2]
            back = lane.points_m[-2, :2]
            ahead = (front - back) / np.linalg.norm(front - back)
            length = (BUS if lane.kind == "drive" else BIKE)[0]
            body = BUS if lane.kind == "drive" else BIKE
            middle = front - ahead * length / 2
            waiting[i] = _swept(np.array([middle - ahead * 0.01, middle + ahead * 0.01]), body)
    for turn in _turns(urban, longest):
        swept = cKDTree(_swept(turn.points_m, size))
        own = {lanes[i].signal for i in waiting if any(lanes[k] is turn for k in lanes[i].successors)}
        for i, rim in waiting.items():
            if lanes[i].signal not in own and np.linalg.norm(rim[0] - turn.points_m[0, :2]) < 80:
                assert swept.query(rim)[0].min() > 0.25


def test_bicycles_keep_clear_of_those_who_turn_with_them(urban: Layout) -> None:
    lanes = urban.map.lanes
    bikes = [lane for lane in lanes if lane.kind == "bike" and lane.signal is not None]
    assert bikes
    for bike in bikes:
        ride = cKDTree(_swept(lanes[bike.successors[0]].points_m, BIKE))
        together = [n for n in lanes if n.kind == "drive" and n.signal == bike.signal]
        for turn in (lanes[i] for lane in together for i in lane.successors):
            size = BUS if turn.longest_m >= 12 else TRUCK if turn.longest_m >= 8 else VAN
            gap = ride.query(_swept(turn.points_m, size))[0].min()
            assert gap > (0.5 if turn.longest_m >= 12 else 0.2)


def test_walk_lanes_keep_from_kerbs_houses_and_each_other(urban: Layout) -> None:
    walks = [n for n in urban.map.lanes if n.kind == "walk" and (n.points_m[:, 2] == 0.12).all() and n.signal is None]
    long = [n for n in walks if np.linalg.norm(n.points_m[-1] - n.points_m[0]) > 20]
    points = np.concatenate([n.points_m[:, :2] for n in long])
    for house in (p for p in urban.placements if p.kind == "building"):
        c, s = np.cos(house.yaw_rad), np.sin(house.yaw_rad)
        away = (points - house.position_m[:2]) @ np.array([[c, -s], [s, c]])
        gap = np.maximum(np.abs(away) - np.array(house.size_lwh_m[:2]) / 2, 0)
        assert np.hypot(*gap.T).min() >= 0.6
    roads = [p for p in urban.map.polygons if p.kind == "road"]
    for road in roads:
        contour = road.points_m.astype(np.float32)
        near = points[(points >= road.points_m.min(0) - 3).all(1) & (points <= road.points_m.max(0) + 3).all(1)]
        assert max((cv2.pointPolygonTest(contour, p.tolist(), True) for p in near), default=-1.0) <= -0.6
    spots = cKDTree(points)
    heading = np.concatenate([np.gradient(n.points_m[:, :2], axis=0) for n in long])
    for i, j in spots.query_pairs(1.19):
        assert heading[i] @ heading[j] > 0


def test_nothing_stands_where_people_walk(urban: Layout) -> None:
    walks = cKDTree(np.concatenate([n.points_m[:, :2] for n in urban.map.lanes if n.kind == "walk"]))
    for thing in urban.placements:
        if thing.kind not in ("building", "bush"):
            foot = 0.22 if thing.kind in ("bench", "bin") else 0.15
            assert walks.query(thing.position_m[:2])[0] - foot > 0.4, thing


def test_houses_do_not_overlap(urban: Layout) -> None:
    houses = [p for p in urban.placements if p.kind == "building"]
    rects = [((p.position_m[0], p.position_m[1]), (p.size_lwh_m[0] - 0.01, p.size_lwh_m[1] - 0.01),
              float(np.degrees(p.yaw_rad))) for p in houses]  # fmt: skip
    for i, a in enumerate(rects):
        for b in rects[:i]:
            if np.hypot(a[0][0] - b[0][0], a[0][1] - b[0][1]) < 40:
                assert cv2.rotatedRectangleIntersection(a, b)[0] == cv2.INTERSECT_NONE
    assert all(6 <= p.size_lwh_m[2] <= 25 for p in houses)


def test_streetlights_and_signs_keep_off_the_lanes(urban: Layout) -> None:
    drives = [n.points_m[:, :2] for n in urban.map.lanes if n.kind != "walk"]
    lanes = cKDTree(np.concatenate(drives))
    standing = [p for p in urban.placements if p.kind in ("lamp_post", "signal", "sign", "tree", "building")]
    assert min(lanes.query(p.position_m[:2])[0] for p in standing) > 1.1
    assert urban.map.street_lamps_m.shape == (sum(p.kind == "lamp_post" for p in urban.placements), 3)
