from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbench.metrics.core.similarity import MAX_PAIRS, MAX_PAIRS_IN_ALL, blocks, image_overlaps
from fbench.replay.contracts.errors import LimitError, MetricError
from fbench.replay.contracts.profiles import SIMILARITY_KINDS, SimilarityKind
from fbench.replay.data.arrays import Float64
from fbench.replay.data.sequences import Objects
from fbench.replay.geometry.iou import distance_bev, iou_2d

Solid = tuple[float, float, float, float, float, float, float]


def objects(*solids: Solid, step: np.ndarray | int = 0) -> Objects:
    """Boxes of x, y, z, length, width, height, heading."""
    values, n = np.array(solids, float).reshape(-1, 7), len(solids)
    return Objects(
        np.broadcast_to(step, n).astype(np.int64), np.full(n, "car"), np.arange(n), np.zeros(n),
        np.hstack([values[:, :2], values[:, :2] + values[:, 3:5]]), values[:, :3], values[:, 3:6], values[:, 6],
    )  # fmt: skip


def random_objects(seed: int, num: int, num_steps: int) -> Objects:
    rng = np.random.Generator(np.random.PCG64(seed))
    step = np.sort(rng.integers(0, num_steps, num))
    values = np.hstack([rng.uniform(-5, 5, (num, 3)), rng.uniform(0.5, 5, (num, 3)), rng.uniform(-4, 4, (num, 1))])
    return objects(*map(tuple, values.tolist()), step=step)


def similarity(truth: Objects, estimates: Objects, kind: SimilarityKind, ego: object = None) -> Float64:
    """The matrix of a single step."""
    return blocks(truth, estimates, 1, kind, ego).values.reshape(len(truth), len(estimates))


@pytest.mark.parametrize("kind", SIMILARITY_KINDS)
def test_layout_and_independence_of_what_stands_beside(kind: SimilarityKind) -> None:
    truth, estimates = random_objects(1, 40, 6), random_objects(2, 50, 6)
    ego = np.random.Generator(np.random.PCG64(3)).uniform(-9, 9, (6, 3))
    starts = truth.starts(6), estimates.starts(6)
    pairs = blocks(truth, estimates, 6, kind, ego)
    flat, block_start = pairs.values, pairs.start
    assert len(flat) == block_start[-1] == sum(
        int((truth.step == s).sum() * (estimates.step == s).sum()) for s in range(6)
    )  # fmt: skip
    alone = np.zeros(1, np.int64)
    for s in range(6):
        rows, columns = (np.arange(*start[s : s + 2]) for start in starts)
        block = flat[block_start[s] : block_start[s + 1]].reshape(len(rows), len(columns))
        for i, row in enumerate(rows):
            for j, column in enumerate(columns):
                a, b = replace(truth[row : row + 1], step=alone), replace(estimates[column : column + 1], step=alone)
                assert similarity(a, b, kind, ego[s : s + 1])[0, 0] == block[i, j]


def test_rectangles_and_distances_are_those_of_geometry() -> None:
    truth, estimates = random_objects(4, 20, 1), random_objects(5, 30, 1)
    assert np.array_equal(similarity(truth, estimates, "iou2d"), iou_2d(truth.xyxy_px, estimates.xyxy_px))
    ground = -distance_bev(truth.center_m, estimates.center_m)
    np.testing.assert_allclose(similarity(truth, estimates, "bev"), ground, rtol=1e-15)
    space = -np.linalg.norm(truth.center_m[:, None] - estimates.center_m[None], axis=2)
    np.testing.assert_allclose(similarity(truth, estimates, "center3d"), space, rtol=1e-15)


def test_hand_values() -> None:
    a, b = objects((0, 0, 0, 4, 2, 2, 0)), objects((3, 4, 12, 4, 2, 2, 0))
    assert similarity(a, b, "bev").tolist() == [[-5.0]]
    assert similarity(a, b, "center3d").tolist() == [[-13.0]]
    half = objects((2, 0, 1, 4, 2, 2, 0))
    assert similarity(a, half, "iou2d").tolist() == [[1 / 3]]
    np.testing.assert_allclose(similarity(a, half, "ioubev"), [[1 / 3]])
    np.testing.assert_allclose(similarity(a, half, "iou3d"), [[4 / 28]])


CAR = (10.0, 0.0, 0.0, 4.0, 2.0, 1.5, 0.0)


@pytest.mark.parametrize(
    ("estimate", "distance"),
    [
        (CAR, 0.0),
        ((10, 0, 0, 4, 2, 1.5, np.pi), 0.0),  # turned round, the same rear
        ((11, 0, 0, 6, 2, 1.5, 0), 0.0),  # longer, but the side that is seen is the same
        ((9, 0, 0, 2, 2, 1.5, np.pi), 0.0),
        ((13, 0, 0, 4, 2, 1.5, 0), 3.0),
        ((10, 0, 5, 4, 2, 9, 0), 0.0),  # only the ground plane counts
        ((10, 0, 0, 4, 4, 1.5, 0), 1.0),  # both corners are 1 m further out
        ((10, 1, 0, 4, 4, 1.5, 0), np.sqrt(0.5 * 2**2)),  # one fits, the other is 2 m away
    ],
)
def test_plane_distance_to_a_car_ahead(estimate: Solid, distance: float) -> None:
    np.testing.assert_allclose(similarity(objects(CAR), objects(estimate), "plane"), [[-distance]], atol=1e-12)


def test_plane_distance_looks_from_the_ego() -> None:
    # Beside the car, its right side is seen: a wider car that keeps that side is the same, a longer one isn't.
    ego = np.array([[10.0, -8.0, 0.0]])
    wider, longer = objects((10, 1, 0, 4, 4, 1.5, 0)), objects((11, 0, 0, 6, 2, 1.5, 0))
    np.testing.assert_allclose(similarity(objects(CAR), wider, "plane", ego), [[0]], atol=1e-12)
    np.testing.assert_allclose(similarity(objects(CAR), longer, "plane", ego), [[-np.sqrt(0.5 * 2**2)]], atol=1e-12)


@given(st.integers(0, 10_000))
def test_plane_distance_as_corners_sorted_by_distance(seed: int) -> None:
    truth, estimates = random_objects(seed, 3, 1), random_objects(seed + 1, 3, 1)
    ego = np.random.Generator(np.random.PCG64(seed)).uniform(-20, 20, (1, 2))
    found = similarity(truth, estimates, "plane", ego)
    for i in range(3):
        near = np.argsort(np.linalg.norm(corners(truth, i) - ego, axis=1))[:2]
        for j in range(3):
            turned = np.cos(estimates.yaw_rad[j] - truth.yaw_rad[i]) < 0
            other = np.roll(corners(estimates, j), 2 if turned else 0, axis=0)
            squares = ((corners(truth, i)[near] - other[near]) ** 2).sum(axis=1)
            np.testing.assert_allclose(-found[i, j], np.sqrt(squares.mean()), atol=1e-9)


def corners(boxes: Objects, i: int) -> Float64:
    cos, sin = np.cos(boxes.yaw_rad[i]), np.sin(boxes.yaw_rad[i])
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2
    return boxes.center_m[i, :2] + (signs * boxes.size_lwh_m[i, :2]) @ np.array([[cos, sin], [-sin, cos]])


@pytest.mark.parametrize("kind", SIMILARITY_KINDS)
def test_what_is_not_finite_is_like_nothing(kind: SimilarityKind) -> None:
    good = objects(CAR)
    for bad in (objects((np.nan, *CAR[1:])), objects((1e12, *CAR[1:]))):
        assert similarity(bad, good, kind).tolist() == similarity(good, bad, kind).tolist() == [[-np.inf]]


def test_negative_sizes_are_like_nothing_and_no_size_is_no_overlap() -> None:
    good, negative, flat = objects(CAR), objects((10, 0, 0, -4, 2, 1, 0)), objects((10, 0, 0, 0, 2, 0, 0))
    for kind in ("iou2d", "ioubev", "iou3d"):
        assert similarity(good, negative, kind).tolist() == [[-np.inf]]
        assert similarity(good, flat, kind).tolist() == similarity(flat, flat, kind).tolist() == [[0.0]]
    assert similarity(good, negative, "plane").tolist() == [[-np.inf]]
    assert similarity(good, negative, "bev").tolist() == [[0.0]]


@pytest.mark.parametrize("kind", SIMILARITY_KINDS)
def test_without_boxes(kind: SimilarityKind) -> None:
    nothing = Objects(np.zeros(0, np.int64), np.zeros(0, "U1"), np.zeros(0, np.int64), np.zeros(0))
    pairs = blocks(nothing, objects(CAR), 2, kind)
    assert pairs.values.shape == (0,)
    assert pairs.start.tolist() == [0, 0, 0]


def test_boxes_that_lack_what_is_compared_are_refused() -> None:
    bare = replace(objects(CAR), xyxy_px=None)
    with pytest.raises(MetricError, match="no rectangles"):
        similarity(bare, bare, "iou2d")
    bare = replace(objects(CAR), center_m=None)
    with pytest.raises(MetricError, match="no place in space"):
        similarity(bare, bare, "bev")
    bare = replace(objects(CAR), yaw_rad=None)
    with pytest.raises(MetricError, match="no size or heading"):
        similarity(bare, bare, "iou3d")


def test_share_of_an_estimate_in_a_region() -> None:
    truth, estimate = objects((0, 0, 0, 10, 10, 1, 0), (0, 0, 0, 10, 10, 1, 0)), objects((5, 0, 0, 10, 5, 1, 0))
    overlaps = image_overlaps(truth, estimate, 1, np.array([True, False]))
    assert overlaps.values.tolist() == [0.5, 0.2]


@pytest.mark.parametrize("kind", SIMILARITY_KINDS)
def test_more_pairs_than_fit_into_memory_are_refused(kind: SimilarityKind) -> None:
    one, many = (objects(*[(1.0, 2, 0, 4, 2, 1, 0)] * num) for num in (1, 1001))
    assert len(blocks(one, many, 1, kind).values) == 1001
    with pytest.raises(
        LimitError, match=f"1001 truth boxes and 1001 results to compare, more than {MAX_PAIRS}"
    ) as caught:
        blocks(many, many, 1, kind)
    assert caught.value.code == "LIM005"
    spread = np.arange(1001)  # one in each step: linear in the length of the log
    assert len(blocks(replace(many, step=spread), replace(many, step=spread), 1001, kind).values) == 1001


def test_more_pairs_in_all_frames_than_fit_into_memory_are_refused() -> None:
    crowd = objects((1.0, 2, 0, 4, 2, 1, 0), step=0)[np.zeros(101_000, np.int64)]
    crowd = replace(crowd, step=np.repeat(np.arange(101), 1000))
    line = "the 101 frames of the sequence: 101000000 pairs of truth boxes and results to compare, more than"
    with pytest.raises(LimitError, match=f"{line} {MAX_PAIRS_IN_ALL}") as caught:
        blocks(crowd, crowd, 101, "bev")
    assert caught.value.code == "LIM005"


def test_parts_hold_the_pairs_of_their_rows_and_columns() -> None:
    num_steps, rng = 40, np.random.Generator(np.random.PCG64(3))
    truth, estimates = (random_objects(seed, 55 * num_steps, num_steps) for seed in (1, 2))
    whole = blocks(truth, estimates, num_steps, "bev")
    rows, columns = rng.integers(2, size=len(truth)) == 0, rng.integers(3, size=len(estimates)) == 0
    part, only = whole.select(rows, columns), whole.only(rows, columns)
    assert part.shape == (rows.sum(), columns.sum())
    for step in range(num_steps):
        block, own, other = whole.block(step), rows[truth.step == step], columns[estimates.step == step]
        np.testing.assert_array_equal(part.block(step), block[own][:, other])
        np.testing.assert_array_equal(only.block(step), np.where(own[:, None] | other, block, -np.inf))
    row, column = whole.locate(np.flatnonzero(only.values > -np.inf))
    assert (rows[row] | columns[column]).all()
