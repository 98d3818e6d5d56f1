"""What is drawn into a camera image: points of LiDARs by depth, of radars by speed, and boxes of the truth."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.boxes import Boxes3D, finite
from fbench.replay.data import Kind, Truth
from fbench.replay.geometry.camera import in_image, project_body, project_edges
from fbench.reports.preview.colors import Colors, of_depth, of_speed
from fbench.reports.preview.sample import Sample

_MANY, _FEW = 20_000, 4_000


@dataclass(frozen=True, eq=False)
class Layer:
    """Points in an image, the farthest first, so that near ones are drawn over them."""

    uv_px: Float64
    """(N, 2) in the image."""
    depth_m: Float64
    radii_px: Float64
    """(N,) larger for nearer points and for sparse ones, so that both can be seen."""
    colors: Colors
    """(N, 3)."""


def layer(sample: Sample, camera: str, kind: Kind) -> Layer:
    """Points of all placed sensors of one kind that lie in the image of a camera.

    Raises:
        LogError: where the lens distortion of the camera isn't modelled.
    """
    points = sample.placed(kind)
    xyz = np.concatenate([p.xyz for p in points]) if points else np.zeros((0, 3))
    speed = np.concatenate([p.speed_mps for p in points]) if points else np.zeros(0)
    uv, depth = project_body(sample.rig, camera, xyz)
    rows = np.flatnonzero(in_image(sample.rig.cameras[camera], uv))
    rows = rows[np.argsort(-depth[rows], kind="stable")]
    uv, depth, speed = uv[rows], depth[rows], speed[rows]
    if kind == "radar":
        return Layer(uv, depth, np.clip(np.round(40 / depth**0.75), 3, 11), of_speed(speed))
    return Layer(uv, depth, _radii(depth), of_depth(depth))


def _radii(depth_m: Float64) -> Float64:
    share = np.clip((_MANY - len(depth_m)) / (_MANY - _FEW), 0, 1)
    return np.asarray(np.clip((1 + 1.3 * share) * np.sqrt(15 / depth_m), 1, 6), np.float64)


def wires(sample: Sample, camera: str) -> Iterator[Float64]:
    """Edges of the 3D boxes of the truth as lines (M, 2) of pixels, NaN where they aren't seen.

    Raises:
        LogError: where the lens distortion of the camera isn't modelled.
    """
    edges = project_edges(sample.rig, camera, boxes3d(sample.truth))
    yield from edges.reshape(-1, *edges.shape[2:])


def boxes3d(truth: Truth | None) -> Boxes3D:
    """The 3D boxes of the truth that can be drawn."""
    if truth is None or truth.boxes3d is None or truth.in_world:
        return Boxes3D.empty()
    return truth.boxes3d[finite(truth.boxes3d)[0]]


def rectangles(truth: Truth | None, camera: str) -> Float64:
    """Corners (N, 4) of the 2D boxes of the truth in the image of a camera."""
    if truth is None or truth.boxes2d is None:
        return np.zeros((0, 4))
    boxes = truth.boxes2d
    wanted = finite(boxes)[0] & (boxes.camera == camera)
    return np.asarray(boxes.xyxy_px[wanted], np.float64)


def outlines(rects: Float64) -> Sequence[Float64]:
    """Closed lines (5, 2) around rectangles (N, 4)."""
    return [r[[0, 1, 2, 1, 2, 3, 0, 3, 0, 1]].reshape(5, 2) for r in rects]
