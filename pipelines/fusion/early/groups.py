"""Points that make one object: those of a camera's box, and clusters that no camera box took."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fbench.pipelines.fusion.early.cloud import FusedCloud
from fbench.pipelines.fusion.joint import JointObservations, join_observations
from fbench.pipelines.fusion.observations import AssociationParams, CameraObservation, as_probability, observe_camera
from fbench.pipelines.fusion.sizes import SIZES
from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.points.ground import Plane
from fbench.replay.contracts.params import CheckedParams, in_range
from fbench.replay.data.arrays import Array, Bool, Float64, Int64
from fbench.replay.data.boxes import Source
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.camera import in_image, project_body


@dataclass(frozen=True)
class SemanticsParams(CheckedParams, prefix="fusion.semantics"):
    """How points take the labels of camera boxes."""

    inset: float = in_range(0.03, 0, 0.5)
    """This share of a box's width [0 to 0.5] is left out at each side, where its outline is loose."""
    margin_px: float = in_range(5.0, 0, 10_000)  # Points may lie this far above and below a box [px].
    radar_rad: float = in_range(
        0.01, 0, 1
    )  # Error of a radar's azimuths [rad]: its echoes may lie so far beside a box.
    gate: float = in_range(2.5, 0.1, 100)
    """Largest difference between a point's distance and that guessed from the image, in standard deviations."""
    depth_margin_m: float = in_range(0.7, 0, 100)
    """An object reaches this much farther from its near side [m] than its typical size says."""
    echo_share: float = in_range(0.3, 0, 1000)
    """A standing radar echo counts as so much of a LiDAR point when the depth of an object is looked for."""
    alone_share: float = in_range(0.5, 0, 1)
    """Boxes below this share of a camera's `min_score` [0 to 1] take points only where those of LiDAR and stereo are
    too few for a shape: elsewhere shapes tell more."""
    least: float = in_range(1.5, 0, 1e6)
    """So many points, weighted by how likely their depth is, are needed to see an object."""


@dataclass(frozen=True, eq=False)
class Observed:
    """Observations of cameras, and which points of a cloud they show."""

    observations: tuple[CameraObservation, ...]
    instance: Int64  # (N,) which of them a point belongs to, -1: none; one of those that show the same object
    height_px: Float64
    """(N,) how high a car at the point looks in a working camera [px], the best of several; 0 out of view and behind
    what the camera sees."""
    taken: tuple[Int64, ...]
    """Of each observation the points (rows of the cloud) that it shows, also where another camera's counts."""
    joint: JointObservations  # Which of them show one object
    is_weak: Bool  # (S,) whether they count only where LiDAR and stereo show no shape


def label_points(
    rig: Rig, cameras: Mapping[str, CameraDetections], cloud: FusedCloud, plane: Plane | None, params: SemanticsParams
) -> Observed:
    """Give points the camera boxes that they project into, where their depth fits.

    In each camera objects that it is sure of take their points first, the nearest of them before others, as it hides
    what lies behind it; then all others, the likeliest first. An object takes the points of one stretch of distances,
    as deep as it may be: that with most points, weighted by how well they fit the distance that the box's size and the
    ground suggest. What stands before and behind it keeps out. Of the observations of one object one counts: of those
    with its likeliest label that whose points most others show, too. Of two objects the likelier one takes a point.
    """
    height, known = np.zeros(len(cloud)), list[CameraObservation]()
    for name in sorted(cameras):
        found = observe_camera(rig, name, cameras[name], plane, AssociationParams())
        # Among dozens of unsure boxes some always are nearer than that which shows the object.
        known += sorted(found, key=lambda s: (not s.is_sure, s.near_m if s.is_sure else -s.score, *s.xyxy_px.tolist()))
    joint, taken = join_observations(rig, sorted(cameras), known, AssociationParams()), list[Int64]()
    weak = list[bool]()
    for name in sorted(cameras):
        uv, _ = project_body(rig, name, cloud.xyz)
        view = _View(cloud, uv, rig, name)
        least = as_probability(params.alone_share * cameras[name].min_score, cameras[name].min_score)
        for one, near in zip(known, joint.near_m.tolist(), strict=True):
            if one.camera == name:
                weak.append(one.score < least)
                taken.append(view.take(one, near, weak[-1], params))
        model, ray = rig.cameras[name], cloud.xyz - rig.body_T_sensor(name)[:3, 3]
        distance = np.maximum(np.hypot(ray[:, 0], ray[:, 1]), 1.0)
        tall = np.where(in_image(model, uv), float(model.K[1, 1]) * SIZES["car"].height_m / distance, 0.0)
        height = np.maximum(height, np.where(view.hidden, 0.0, tall))
    instance, best = np.full(len(cloud), -1), np.zeros(len(cloud))
    for one in np.unique(joint.number):
        at = _choose(np.flatnonzero(joint.number == one), known, taken, len(cloud))
        rows = taken[at]
        rows = rows[joint.score[at] > best[rows]]
        instance[rows], best[rows] = at, joint.score[at]
    return Observed(tuple(known), instance, height, tuple(taken), joint, np.array(weak, np.bool_))


def _choose(members: Int64, known: list[CameraObservation], taken: list[Int64], num_points: int) -> int:
    """Of observations of one object with its likeliest label that whose points most others show, too."""
    if len(members) == 1:
        return int(members[0])
    labels = np.array([known[at].label for at in members])
    scores = np.array([known[at].score for at in members])
    votes = np.array([scores[labels == label].sum() for label in labels])
    shown = np.bincount(np.concatenate([taken[at] for at in members]), minlength=num_points) - 1
    able = members[votes >= votes.max()]
    return int(max(able, key=lambda at: (int(shown[taken[at]].sum()), -at)))


class _View:
    """The points before one camera, of which objects take theirs one after the other."""

    def __init__(self, cloud: FusedCloud, uv: Float64, rig: Rig, camera: str) -> None:
        self._rows: Int64 = np.flatnonzero(np.isfinite(uv).all(axis=1))
        own, eye = cloud[self._rows], rig.body_T_sensor(camera)[:3, 3]
        self._uv, self._is_echo, self._moving = uv[self._rows], own.source == int(Source.R), own.is_moving
        self._distance = np.hypot(own.xyz[:, 0] - eye[0], own.xyz[:, 1] - eye[1])
        self._free, self._exactness = np.ones(len(self._rows), np.bool_), own.exactness
        self.hidden = np.zeros(len(uv), np.bool_)  # which points of the cloud lie behind objects so far
        self._focal_px = float(rig.cameras[camera].K[0, 0])

    def take(self, one: CameraObservation, near_m: float, is_weak: bool, params: SemanticsParams) -> Int64:
        """Rows of the cloud that belong to an observation, by where all cameras guess its near side [m]; none where too
        little is there.
        """
        left, top, right, bottom = one.xyxy_px
        u, v = self._uv[:, 0], self._uv[:, 1]
        aside = np.where(self._is_echo, params.radar_rad * self._focal_px, -params.inset * (right - left))
        inside = (u > left - aside) & (u < right + aside)
        # Radar is too poor at heights to ask for them.
        inside &= ((v > top - params.margin_px) & (v < bottom + params.margin_px)) | self._is_echo
        if one.is_sure:
            self.hidden[self._rows] |= inside & (self._distance > near_m)
        rows: Int64 = np.flatnonzero(self._free & inside)
        rows = rows[np.argsort(self._distance[rows], kind="stable")]
        deviation = np.log(np.maximum(self._distance[rows], 0.1) / near_m) / one.std
        near = np.abs(deviation) < params.gate
        rows, deviation = rows[near], deviation[near]
        if not len(rows):
            return rows
        distance, is_still = self._distance[rows], self._is_echo[rows] & ~self._moving[rows]
        worth = np.where(is_still, params.echo_share, self._exactness[rows]) * np.exp(-0.5 * deviation**2)
        total = np.concatenate([[0.0], np.cumsum(worth)])
        stop = np.searchsorted(distance, distance + 2 * one.depth_m + params.depth_margin_m)
        support = total[stop] - total[:-1]
        begin = int(np.argmax(support))
        if support[begin] < params.least:
            return rows[:0]
        taken = rows[begin : stop[begin]]
        if is_weak and np.count_nonzero(~self._is_echo[taken]) >= _FEW:
            return rows[:0]
        self._free[taken] = False
        return self._rows[taken]


_FEW = 4  # So many points of LiDAR and stereo show a shape
_LARGER = 1.3  # So many times as long as the diagonal of a typical object a cluster of one may be


@dataclass(frozen=True, eq=False)
class Groups:
    """Candidates for objects; the points of each are rows of a cloud."""

    rows: Int64  # (P,) rows of the cloud, sorted by group
    first: Int64  # (M + 1,) where in `rows` groups begin
    observation: Int64  # (M,) number of the camera's observation that a group shows, -1: no camera's box took it

    def __len__(self) -> int:
        return len(self.observation)

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
        return Groups(self.rows[keep[self.number]], np.concatenate([[0], np.cumsum(sizes)]), self.observation[keep])


def group_points(cloud: FusedCloud, seen: Observed, cluster: Int64, weight: Float64) -> Groups:
    """Put points (N,) into groups: those of each observation first, then those of each cluster that is left.

    An observation's points are those in the cluster in which most of them lie, by `weight` (N,), the lowest number on
    ties; points of no cluster count only where none of them has one. A cluster that is no larger than what a camera
    sees in it isn't cut: it is all of the observation that has most of it. In larger ones each takes its own points.
    """
    num = len(seen.observations)
    group = np.where(cluster >= 0, cluster + num, -1)
    sorted_rows = np.argsort(cluster, kind="stable")
    sorted_rows = sorted_rows[np.searchsorted(cluster[sorted_rows], 0) :]
    begin, xy = np.flatnonzero(np.diff(cluster[sorted_rows], prepend=-1)), cloud.xyz[sorted_rows, :2]
    sides = np.maximum.reduceat(xy, begin) - np.minimum.reduceat(xy, begin) if len(xy) else np.zeros((0, 2))
    extent, is_taken = np.hypot(sides[:, 0], sides[:, 1]), np.zeros(len(cloud) + 1, np.bool_)  # diagonals [m]
    own, shown = {}, np.flatnonzero(seen.instance >= 0)
    dense = np.bincount(cluster[sorted_rows], cloud.source[sorted_rows] != int(Source.R), 1)
    for one in np.unique(seen.instance[shown]).tolist():
        rows = shown[seen.instance[shown] == one]
        in_cluster = rows[cluster[rows] >= 0]
        if len(in_cluster):
            best = int(np.argmax(np.bincount(cluster[in_cluster], weight[in_cluster])))
            rows = in_cluster[cluster[in_cluster] == best]
        own[one] = rows
    for one in sorted(own, key=lambda one: (-float(weight[own[one]].sum()), one)):
        rows, at = own[one], int(cluster[own[one][0]])
        if at >= 0 and (is_taken[at] or (seen.is_weak[one] and dense[at] >= _FEW)):
            continue
        length, width = seen.observations[one].size_lwh_m[:2]
        is_taken[at] = at >= 0 and extent[at] <= _LARGER * float(np.hypot(length, width))
        group[np.flatnonzero(cluster == at) if is_taken[at] else rows] = one
    rows = np.flatnonzero(group >= 0)
    rows = rows[np.argsort(group[rows], kind="stable")]
    names, first = np.unique(group[rows], return_index=True)
    return Groups(rows, np.append(first, len(rows)), np.where(names < num, names, -1))


@dataclass(frozen=True, eq=False)
class Counts:
    """Numbers of points of groups (M,)."""

    dense: Float64  # Points of LiDAR and stereo
    moving: Float64  # Moving radar echoes
    standing: Float64  # Other radar echoes
    sources: Array  # uint8 bits of `Source`: of points, and of cameras


def count_points(groups: Groups, cloud: FusedCloud) -> Counts:
    """Count the points of groups by sensor."""
    source, moving = cloud.source[groups.rows], cloud.is_moving[groups.rows]
    has = {bit: groups.sums(source == int(bit)) for bit in (Source.L, Source.R, Source.S)}
    num_moving = groups.sums(moving)
    sources = np.where(groups.observation >= 0, int(Source.C), 0)
    for bit, num in has.items():
        sources = sources | np.where(num > 0, int(bit), 0)
    return Counts(has[Source.L] + has[Source.S], num_moving, has[Source.R] - num_moving, sources.astype(np.uint8))
