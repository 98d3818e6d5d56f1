"""Clusters of LiDAR points or radar echoes, as fusion reads them."""

from dataclasses import dataclass

import numpy as np

from fbench.pipelines.fusion.late.kernels import inside_boxes
from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.camera import project_body


@dataclass(frozen=True, eq=False)
class Clusters:
    """K clusters of one sensor kind, in the order of their places, and N points."""

    boxes: Boxes3D
    """(K) one for each."""
    xyz: Float64
    """(N, 3) [m] points of the clusters in body coordinates, sorted by cluster."""
    first: Int64
    """(K + 1,) rows of `xyz` where clusters begin."""
    loose: Float64
    """(M, 3) [m] points of no cluster."""

    @property
    def num_points(self) -> Float64:
        """(K,) of each cluster."""
        return np.diff(self.first).astype(np.float64)

    @property
    def score(self) -> Float64:
        """(K,) 0 where the sensor gives none."""
        return np.zeros(len(self.boxes)) if self.boxes.score is None else self.boxes.score

    @property
    def are_judged_by_model(self) -> bool:
        """Whether scores of LiDAR clusters are probabilities: those by rules come without labels."""
        return self.boxes.label is not None

    def points(self, at: int) -> Float64:
        """Return the points of one cluster."""
        return self.xyz[self.first[at] : self.first[at + 1]]


def clusters(xyz: Float64, number: Int64, boxes: Boxes3D) -> Clusters:
    """Sort points (N, 3) by their clusters (N,), rows of `boxes` or -1, and those by place."""
    order = np.lexsort((*boxes.size_lwh_m.T[::-1], *boxes.center_m.T[::-1]))
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    member = number >= 0
    ranks = rank[number[member]]
    by_rank = np.argsort(ranks, kind="stable")
    first = np.searchsorted(ranks[by_rank], np.arange(len(order) + 1)).astype(np.int64)
    return Clusters(boxes[order], np.ascontiguousarray(xyz[member][by_rank]), first, xyz[~member])


@dataclass(frozen=True, eq=False)
class Overlap:
    """What of K clusters lies in S boxes of one camera."""

    num_inside: Float64
    """(S, K) points."""
    near_m: Float64
    """(S, K) distance of the near side of what is inside, from the camera, on the ground [m]."""
    bearing_rad: Float64
    """(S, K) direction of its middle, against that of the box's middle [rad], positive to the left."""


def edges_for_points(xyxy_px: Float64) -> Float64:
    """Edges (S, 4) in which points count as those of camera boxes (S, 4): a little narrower, since what is beside an
    object is seen at its left and right edges, and a little higher, since boxes end where points still are.
    """
    inset = 0.05 * (xyxy_px[:, 2] - xyxy_px[:, 0])
    left, top, right, bottom = xyxy_px.T
    return np.column_stack([left + inset, top - 5, right - inset, bottom + 5])


def overlap(rig: Rig, camera: str, found: Clusters, xyxy_px: Float64) -> Overlap:
    """Count the points of clusters in boxes (S, 4) of a camera."""
    uv, _ = project_body(rig, camera, found.xyz)
    eye = rig.body_T_sensor(camera)[:3, 3]
    distance = np.hypot(found.xyz[:, 0] - eye[0], found.xyz[:, 1] - eye[1])
    inside = inside_boxes(uv, distance, found.first, np.ascontiguousarray(xyxy_px, np.float64))
    aside = (xyxy_px[:, 0] + xyxy_px[:, 2])[:, None] / 2 - inside[:, :, 2]
    return Overlap(inside[:, :, 0], inside[:, :, 1], aside / rig.cameras[camera].K[0, 0])
