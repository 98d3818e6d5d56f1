"""Overlap of rotated boxes from above: ours against shapely's on the same pairs, in one process."""

from functools import partial

import numpy as np
import shapely
from common import best_s

from fbench.replay.data.arrays import Float64
from fbench.replay.geometry.iou import flat_iou

NUM = 100_000
SIGNS = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2


def pairs(num: int, reach_m: float) -> tuple[Float64, Float64]:
    """Boxes (num, 7) of road users, and as many others up to `reach_m` away along both axes."""
    rng = np.random.Generator(np.random.PCG64(7))
    low, high = [-reach_m / 2] * 2 + [-1, 0.5, 0.5, 1, -np.pi], [reach_m / 2] * 2 + [1, 6, 3, 2, np.pi]
    return rng.uniform(low, high, (num, 7)), rng.uniform(low, high, (num, 7))


def by_shapely(a: Float64, b: Float64) -> Float64:
    first, second = shapely.polygons(corners(a)), shapely.polygons(corners(b))
    common = shapely.area(shapely.intersection(first, second))
    iou: Float64 = common / (shapely.area(first) + shapely.area(second) - common)
    return iou


def corners(boxes: Float64) -> Float64:
    cos, sin = np.cos(boxes[:, 6:]), np.sin(boxes[:, 6:])
    x, y = boxes[:, 3:4] * SIGNS[:, 0], boxes[:, 4:5] * SIGNS[:, 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=2) + boxes[:, None, :2]


def main() -> None:
    each = np.arange(NUM + 1)
    for reach_m in (2.0, 8.0, 50.0):
        a, b = pairs(NUM, reach_m)
        ours = flat_iou(a, b, each, each, solid=False)  # compiles
        np.testing.assert_allclose(ours, by_shapely(a, b), rtol=0, atol=1e-9)
        mine = best_s(partial(flat_iou, a, b, each, each, solid=False))
        theirs = best_s(partial(by_shapely, a, b), 2)
        times = f"{1e3 * mine:.1f} ms, shapely {1e3 * theirs:.0f} ms, {theirs / mine:.1f} times as fast"
        print(f"iou_bev, {NUM} pairs, {100 * (ours > 0).mean():.0f} % overlap: {times}")


if __name__ == "__main__":
    main()
