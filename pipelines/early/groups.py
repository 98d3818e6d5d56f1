"""Points that make one object: those of a camera's box, and clusters that no camera box took."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.early.cloud import Cloud
from fbench.pipelines.early.semantics import Labels
from fbench.replay.arrays import Array, Float64, Int64
from fbench.replay.data import Source

_LARGER = 1.3
"""So many times as long as the diagonal of a typical object a cluster of one may be."""


@dataclass(frozen=True, eq=False)
class Groups:
    """Candidates for objects; the points of each are rows of a cloud."""

    rows: Int64
    """(P,) rows of the cloud, sorted by group."""
    first: Int64
    """(M + 1,) where in `rows` groups begin."""
    sighting: Int64
    """(M,) number of the sighting that a group shows, -1: no camera's box took it."""

    def __len__(self) -> int:
        return len(self.sighting)

    @property
    def number(self) -> Int64:
        """(P,) group of each of `rows`."""
        return np.repeat(np.arange(len(self)), np.diff(self.first))

    def sums(self, values: Array) -> Float64:
        """Sums (M,) over the points of each group of values (P,)."""
        return np.asarray(np.bincount(self.number, values, len(self)), np.float64)

    def select(self, keep: Array) -> "Groups":
        """Groups by mask (M,)."""
        sizes = np.diff(self.first)[keep]
        return Groups(self.rows[keep[self.number]], np.concatenate([[0], np.cumsum(sizes)]), self.sighting[keep])


def grouped(cloud: Cloud, labels: Labels, cluster: Int64, weight: Float64) -> Groups:
    """Put points (N,) into groups: those of each sighting first, then those of each cluster that is left.

    A sighting's points are those in the cluster in which most of them lie, by `weight` (N,), the lowest number on ties;
    points of no cluster count only where none of them has one. A cluster that is no larger than what a camera sees in
    it isn't cut: it is all of the sighting that has most of it. In larger ones each sighting takes its own points.
    """
    num = len(labels.sightings)
    group = np.where(cluster >= 0, cluster + num, -1)
    extent, is_taken = _diagonals(cloud, cluster), np.zeros(len(cloud) + 1, np.bool_)
    own = _own_points(labels, cluster, weight)
    for one in sorted(own, key=lambda one: (-float(weight[own[one]].sum()), one)):
        rows, at = own[one], int(cluster[own[one][0]])
        if at >= 0 and is_taken[at]:
            continue
        length, width = labels.sightings[one].size_lwh_m[:2]
        is_taken[at] = at >= 0 and extent[at] <= _LARGER * float(np.hypot(length, width))
        group[np.flatnonzero(cluster == at) if is_taken[at] else rows] = one
    rows = np.flatnonzero(group >= 0)
    rows = rows[np.argsort(group[rows], kind="stable")]
    names, first = np.unique(group[rows], return_index=True)
    return Groups(rows, np.append(first, len(rows)), np.where(names < num, names, -1))


def _own_points(labels: Labels, cluster: Int64, weight: Float64) -> dict[int, Int64]:
    """Points of each sighting that lie in one cluster, or in none."""
    seen = np.flatnonzero(labels.instance >= 0)
    result = {}
    for one in np.unique(labels.instance[seen]).tolist():
        rows = seen[labels.instance[seen] == one]
        in_cluster = rows[cluster[rows] >= 0]
        if len(in_cluster):
            best = int(np.argmax(np.bincount(cluster[in_cluster], weight[in_cluster])))
            rows = in_cluster[cluster[in_cluster] == best]
        result[one] = rows
    return result


def _diagonals(cloud: Cloud, cluster: Int64) -> Float64:
    """Diagonals of clusters' outlines along x and y (K,) [m]."""
    rows = np.flatnonzero(cluster >= 0)
    if not len(rows):
        return np.zeros(0)
    rows = rows[np.argsort(cluster[rows], kind="stable")]
    first, xy = np.flatnonzero(np.diff(cluster[rows], prepend=-1)), cloud.xyz[rows, :2]
    sides = np.maximum.reduceat(xy, first) - np.minimum.reduceat(xy, first)
    return np.asarray(np.hypot(sides[:, 0], sides[:, 1]), np.float64)


@dataclass(frozen=True, eq=False)
class Counts:
    """What groups (M,) consist of."""

    dense: Float64
    """Points of LiDAR and stereo."""
    moving: Float64
    """Moving radar echoes."""
    standing: Float64
    """Other radar echoes."""
    sources: Array
    """uint8 bits of `Source`: of points, and of cameras."""


def counted(groups: Groups, cloud: Cloud) -> Counts:
    """Count the points of groups by sensor."""
    source, moving = cloud.source[groups.rows], cloud.is_moving[groups.rows]
    has = {bit: groups.sums(source == int(bit)) for bit in (Source.L, Source.R, Source.S)}
    num_moving = groups.sums(moving)
    sources = np.where(groups.sighting >= 0, int(Source.C), 0)
    for bit, num in has.items():
        sources = sources | np.where(num > 0, int(bit), 0)
    return Counts(has[Source.L] + has[Source.S], num_moving, has[Source.R] - num_moving, sources.astype(np.uint8))
