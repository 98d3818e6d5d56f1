"""Axis-aligned boxes of clusters of points, in space and in images."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np

from fbench.pipelines.baseline.params import PlainClusterParams, PlainCropParams, PlainImageParams, PlainSizeParams
from fbench.pipelines.sensors.points.dbscan import dbscan
from fbench.replay.data.arrays import Array, Float64, Int64, Text


@dataclass(frozen=True, eq=False)
class Extents:
    """N boxes."""

    low: Float64
    """(N, 3) in body coordinates [m], or (N, 2) in an image [px]."""
    high: Float64
    """The opposite corners."""
    distance_m: Float64
    """(N,) from the body's origin [m]; NaN where nothing measured it."""
    range_rate_mps: Float64
    """(N,) radial velocity as measured [m/s], positive when receding; NaN where nothing measured it."""
    label: Text
    """(N,) of a camera; empty where none told."""
    score: Float64
    """(N,) 0 to 1: a camera's, and 1 for clusters, of which the thesis knows no score."""
    sources: Array
    """(N,) uint8, bits of `Source`."""

    def __len__(self) -> int:
        return len(self.low)

    def __getitem__(self, rows: Array | slice) -> "Extents":
        """Select rows by mask, index array or slice."""
        return replace(self, **{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def extents(low: Float64, high: Float64, source: int | Array, **known: Any) -> Extents:
    """Return boxes of which nothing is known but what is given."""
    num = len(low)
    unknown: dict[str, Any] = {
        "distance_m": np.full(num, np.nan), "range_rate_mps": np.full(num, np.nan), "label": np.full(num, "", "U16"),
        "score": np.ones(num), "sources": np.broadcast_to(np.asarray(source, np.uint8), num),
    }  # fmt: skip
    return Extents(low, high, **(unknown | known))


def no_extents(num_axes: int) -> Extents:
    """Return no boxes."""
    return extents(np.zeros((0, num_axes)), np.zeros((0, num_axes)), 0)


def joined(parts: Sequence[Extents]) -> Extents:
    """Put boxes one after the other."""
    return Extents(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Extents)})


def iou(a: Extents, b: Extents) -> Float64:
    """Intersection over union (N, M): of areas in an image, of volumes in space; 0 where both are empty."""
    low = np.maximum(a.low[:, None], b.low[None])
    high = np.minimum(a.high[:, None], b.high[None])
    overlap = np.prod(np.clip(high - low, 0, None), axis=2)
    size_a, size_b = (np.prod(boxes.high - boxes.low, axis=1) for boxes in (a, b))
    union = size_a[:, None] + size_b[None] - overlap
    share: Float64 = np.divide(overlap, union, out=np.zeros_like(overlap), where=union > 0)
    return share


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of one sensor, or of several."""

    xyz: Float64
    """(N, 3) [m] in body coordinates."""
    range_rate_mps: Float64
    """(N,) radial velocity as measured [m/s], positive when receding; NaN where the sensor gives none."""
    source: Array
    """(N,) uint8, bits of `Source`."""

    def __getitem__(self, rows: Array) -> "Cloud":
        """Select rows by mask or index array."""
        return Cloud(self.xyz[rows], self.range_rate_mps[rows], self.source[rows])


def cloud(xyz: Float64, source: int, range_rate_mps: Float64 | None = None) -> Cloud:
    """Return points (N, 3) of one kind of sensor."""
    rate = np.full(len(xyz), np.nan) if range_rate_mps is None else range_rate_mps
    return Cloud(xyz, rate, np.full(len(xyz), source, np.uint8))


def one_cloud(clouds: list[Cloud]) -> Cloud:
    """Put the points of several clouds into one."""
    columns = ([getattr(c, name) for c in clouds] for name in ("xyz", "range_rate_mps", "source"))
    return Cloud(*(np.concatenate(column) for column in columns)) if clouds else cloud(np.zeros((0, 3)), 0)


def cropped(points: Cloud, params: PlainCropParams) -> Cloud:
    """Leave out ground, own vehicle, and what is too high or too far."""
    range_m, z = np.hypot(points.xyz[:, 0], points.xyz[:, 1]), points.xyz[:, 2]
    near = (range_m >= params.min_range_m) & (range_m <= params.max_range_m)
    return points[near & (z >= params.low_m) & (z <= params.high_m)]


def space_clusters(points: Cloud, params: PlainClusterParams) -> Int64:
    """Number the clusters (N,) of points in space; -1: none. See `dbscan` for their order."""
    return dbscan(points.xyz, params.eps_m, params.min_points)


def image_clusters(uv_px: Float64, depth_m: Float64, params: PlainImageParams) -> Int64:
    """Number the clusters (N,) of points at places (N, 2) [px] of an image and depths (N,) [m]; -1: none."""
    features = np.column_stack([uv_px, depth_m * params.depth_px_per_m])
    return dbscan(features, params.eps_px, params.min_points)


def boxes(
    points: Cloud, cluster: Int64, places: Float64, params: PlainSizeParams, label: Text | None = None
) -> Extents:
    """Return the extents of clusters (N,) that may be vehicles.

    Args:
        points: Whose extents in space are judged.
        cluster: Number of the cluster of each; -1: none.
        places: (N, D) what the extents are of: the points in space [m], or in an image [px].
        params: What is judged.
        label: (number of clusters,) of each cluster; `None`: there are none.
    """
    rows = members(cluster)
    kept = [number for number, own in enumerate(rows) if _may_be_vehicle(points.xyz[own], params)]
    if not kept:
        return no_extents(places.shape[1])
    rows = [rows[number] for number in kept]
    low, high = (np.array([reach(places[own], axis=0) for own in rows]) for reach in (np.min, np.max))
    middle = [(points.xyz[own].min(axis=0) + points.xyz[own].max(axis=0)) / 2 for own in rows]
    return extents(
        low, high, np.array([np.bitwise_or.reduce(points.source[own]) for own in rows]),
        distance_m=np.sqrt(np.square(middle).sum(axis=1)),
        range_rate_mps=np.array([_mean_rate(points.range_rate_mps[own]) for own in rows]),
        **({} if label is None else {"label": label[kept]}),
    )  # fmt: skip


def members(cluster: Int64) -> list[Int64]:
    """Rows of the points of each cluster (N,), by its number, ascending."""
    order = np.argsort(cluster, kind="stable")
    bounds = np.searchsorted(cluster[order], np.arange(int(cluster.max(initial=-1)) + 2))
    return [order[start:end] for start, end in pairwise(bounds)]


def _may_be_vehicle(xyz: Float64, params: PlainSizeParams) -> bool:
    if len(xyz) < params.least_points:
        return False
    x, y, height = np.ptp(xyz, axis=0)
    length, width = max(x, y), min(x, y)
    is_long = params.least_extent_m <= length <= params.most_extent_m
    is_high = params.least_height_m <= height <= params.most_height_m
    return bool(is_long and is_high and width <= params.most_width_m)


def _mean_rate(range_rate_mps: Float64) -> float:
    """Mean of the known ones, in ascending order, so that rounding doesn't depend on that of the points."""
    known = np.sort(range_rate_mps[np.isfinite(range_rate_mps)])
    return float(known.mean()) if len(known) else np.nan
