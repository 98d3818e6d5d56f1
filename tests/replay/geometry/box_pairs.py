"""Pairs of boxes seen from above, ordinary and degenerate, and what shapely says about them."""

import numpy as np
import shapely

from fbench.replay.data.arrays import Float64

_SIGNS = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2


def ordinary(num: int, seed: int) -> tuple[Float64, Float64]:
    """Boxes (num, 7) of road users and others near them: x, y, z, length, width, height, heading."""
    rng = np.random.Generator(np.random.PCG64(seed))
    a, b = (
        np.column_stack([
            rng.uniform(-4, 4, (num, 3)), rng.uniform(0.3, 8, num), rng.uniform(0.3, 3, num), rng.uniform(1, 3, num),
            rng.uniform(-2 * np.pi, 2 * np.pi, num),
        ])
        for _ in range(2)
    )  # fmt: skip
    return a, b


def degenerate(num: int, seed: int) -> dict[str, tuple[Float64, Float64]]:
    """`num` pairs of each kind that breaks careless geometry."""
    rng = np.random.Generator(np.random.PCG64([seed, 1]))
    a, other = ordinary(num, seed)
    along, across = np.stack([np.cos(a[:, 6]), np.sin(a[:, 6])], 1), np.stack([-np.sin(a[:, 6]), np.cos(a[:, 6])], 1)
    u, v = rng.uniform(-1, 1, (2, num, 1))
    far = rng.uniform(1e5, 1e6, (num, 2)) * rng.choice([-1, 1], (num, 2))
    pairs = {
        "equal": a.copy(),
        "turned by a half": _with(a, yaw=a[:, 6] + np.pi),
        "turned by a quarter": _with(a, yaw=a[:, 6] + np.pi / 2),
        "turned by 1e-12": _with(a, yaw=a[:, 6] + rng.uniform(-1e-12, 1e-12, num)),
        "turned by 1e-7": _with(a, yaw=a[:, 6] + rng.uniform(-1e-7, 1e-7, num)),
        "moved along": _with(a, xy=a[:, :2] + u * along * a[:, 3:4]),
        "shared side": _with(a, xy=a[:, :2] + along * a[:, 3:4]),
        "touching corners": _with(a, xy=a[:, :2] + along * a[:, 3:4] + across * a[:, 4:5]),
        "almost touching": _with(a, xy=a[:, :2] + along * a[:, 3:4] * (1 + 1e-13 * u)),
        "contained": _with(a, xy=a[:, :2] + (u * along * a[:, 3:4] + v * across * a[:, 4:5]) / 4, size=a[:, 3:6] / 2),
        "contained, on a side": _with(a, xy=a[:, :2] + along * a[:, 3:4] / 4, size=a[:, 3:6] / [2, 1, 1]),
        "without length": _with(other, size=other[:, 3:6] * [0, 1, 1]),
        "without area": _with(other, size=other[:, 3:6] * [0, 0, 1]),
        "sliver": _with(other, size=np.column_stack([other[:, 3], 10 ** rng.uniform(-6, -2, num), other[:, 5]])),
    }
    cases = {name: (a, b) for name, b in pairs.items()}
    thin = _with(a, size=np.column_stack([a[:, 3], 10 ** rng.uniform(-4, -2, num), a[:, 5]]))
    cases["two slivers"] = (thin, _with(thin, xy=a[:, :2] + u * along, yaw=a[:, 6] + rng.uniform(-1e-3, 1e-3, num)))
    cases["far away"] = (_with(a, xy=a[:, :2] + far), _with(other, xy=other[:, :2] + far))
    cases["far away, equal"] = (_with(a, xy=a[:, :2] + far), _with(a, xy=a[:, :2] + far))
    grid = rng.integers(-2, 3, (2, num, 2)), rng.integers(0, 4, (2, num, 2)), rng.integers(0, 8, (2, num))
    cases["on a grid"] = (_on_grid(a, *(part[0] for part in grid)), _on_grid(a, *(part[1] for part in grid)))
    return cases


def shapely_iou_bev(a: Float64, b: Float64, grid_m: float | None = None) -> Float64:
    """Intersection over union (N,) of pairs (N, 7) by shapely, which may round corners to a grid.

    Coordinates count from the first box's center: the difference is exact where both are far away, and corners at
    1e6 m would be rounded to 1e-10 m before shapely sees them. Without a grid, shapely 2.2.0 with GEOS 3.14.1 finds
    no common area at all in 1 of 500 pairs that are equal but turned by a half.
    """
    away = b[:, :2] - a[:, :2]
    first, second = (shapely.polygons(_corners(boxes, xy)) for boxes, xy in ((a, np.zeros_like(away)), (b, away)))
    common = shapely.area(shapely.intersection(first, second, grid_size=grid_m))
    union = shapely.area(first) + shapely.area(second) - common
    return np.divide(common, union, out=np.zeros_like(common), where=union > 0)


def _with(
    boxes: Float64, xy: Float64 | None = None, size: Float64 | None = None, yaw: Float64 | None = None
) -> Float64:
    changed = boxes.copy()
    for columns, values in ((slice(0, 2), xy), (slice(3, 6), size), (6, yaw)):
        if values is not None:
            changed[:, columns] = values
    return changed


def _on_grid(boxes: Float64, xy: Float64, size: Float64, eighth: Float64) -> Float64:
    return _with(boxes, xy.astype(float), np.column_stack([size, boxes[:, 5]]), eighth * np.pi / 4)


def _corners(boxes: Float64, center: Float64) -> Float64:
    cos, sin = np.cos(boxes[:, 6])[:, None], np.sin(boxes[:, 6])[:, None]
    x, y = boxes[:, 3:4] * _SIGNS[:, 0], boxes[:, 4:5] * _SIGNS[:, 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=2) + center[:, None]
