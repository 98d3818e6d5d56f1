"""Camera images with what other sensors measured."""

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.data import Kind
from fbench.replay.geometry.camera import project_boxes
from fbench.replay.images import Pixels
from fbench.reports.preview import draw
from fbench.reports.preview.colors import FAR_M, INK, MAX_SPEED_MPS, NEAR_M, TRUTH, TRUTH_2D, of_depth, of_speed
from fbench.reports.preview.layers import Layer, boxes3d, layer, outlines, rectangles, wires
from fbench.reports.preview.sample import Sample
from fbench.reports.preview.window import Window, around, whole

_TITLES = {"lidar": "LiDAR by depth", "radar": "radar by speed"}
_ZOOM_WIDTH_PX = 640


def bare(sample: Sample, camera: str) -> Pixels:
    """The image alone, with 2D truth."""
    pixels = sample.image(camera)
    window = whole((pixels.shape[1], pixels.shape[0]))
    picture = window.picture(pixels)
    _draw_rectangles(picture, sample, camera, window)
    draw.lines(picture, [draw.plain(camera)], [INK])
    return picture


def overlay(sample: Sample, camera: str, kind: Kind) -> Pixels:
    """The image with the points of all LiDARs or radars, and truth.

    Raises:
        LogError: where the lens distortion of the camera isn't modelled.
    """
    found = layer(sample, camera, kind)
    picture = _drawn(sample, camera, found, whole(sample.rig.cameras[camera].size_wh), kind == "radar")
    sensors = ", ".join(draw.plain(points.sensor, 20) for points in sample.placed(kind))
    texts = [f"{draw.plain(camera)}: {_TITLES[kind]} ({len(found.uv_px)} points of {sensors})"]
    draw.lines(picture, texts, [INK])
    _legend(picture, kind)
    return picture


def zoom(sample: Sample, camera: str, kind: Kind) -> Pixels | None:
    """LiDAR or radar around the nearest truth, else where most points are, large; `None` where there is neither.

    Raises:
        LogError: where the lens distortion of the camera isn't modelled.
    """
    found = layer(sample, camera, kind)
    rect = _interesting(sample, camera, found)
    if rect is None:
        return None
    window = around(sample.rig.cameras[camera].size_wh, rect, _ZOOM_WIDTH_PX)
    picture = _drawn(sample, camera, found, window, kind == "radar")
    size = sample.rig.cameras[camera].size_wh
    draw.lines(picture, [f"{_TITLES[kind]}, {window.width} of {size[0]} px wide"], [INK])
    return picture


def _drawn(sample: Sample, camera: str, found: Layer, window: Window, rim: bool) -> Pixels:
    """Draw points of one kind and truth into a part of an image."""
    picture = window.picture(sample.image(camera))
    grow = np.sqrt(window.scale / whole(sample.rig.cameras[camera].size_wh).scale)
    radii = np.maximum(1, np.round(found.radii_px * grow))
    draw.disks(picture, window.to_picture(found.uv_px), radii, found.colors, rim)
    for line in wires(sample, camera):
        draw.path(picture, window.to_picture(line), TRUTH, rim=True)
    _draw_rectangles(picture, sample, camera, window)
    return picture


def _draw_rectangles(picture: Pixels, sample: Sample, camera: str, window: Window) -> None:
    for outline in outlines(rectangles(sample.truth, camera)):
        draw.path(picture, window.to_picture(outline), TRUTH_2D, rim=True)


def _legend(picture: Pixels, kind: Kind) -> None:
    ramp = np.linspace(0, 1, 128)
    if kind == "radar":
        ends = [(0.0, "nearing -10"), (0.5, "0"), (1.0, "+10 receding")]
        draw.color_bar(picture, of_speed((2 * ramp - 1) * MAX_SPEED_MPS), ends, "radial velocity [m/s]")
        return
    span = np.log(FAR_M / NEAR_M)
    marks = [(float(np.log(d / NEAR_M) / span), str(d)) for d in (2, 5, 10, 20, 40, 80)]
    draw.color_bar(picture, of_depth(NEAR_M * np.exp(ramp * span)), marks, "depth [m]")


def _interesting(sample: Sample, camera: str, found: Layer) -> Float64 | None:
    """Rectangle [px] that is worth a closer look: nearest truth that is wholly seen with points in it, else the region
    with most points between 5 and 40 m.
    """
    size_wh = sample.rig.cameras[camera].size_wh
    rects, seen = project_boxes(sample.rig, camera, boxes3d(sample.truth))
    distance = np.sqrt(np.sum(boxes3d(sample.truth).center_m ** 2, axis=1))
    candidates = [rects[i] for i in np.argsort(distance, kind="stable") if seen[i]]
    if candidates:
        wanted = [r for r in candidates if _num_inside(found, r) >= 3 and _is_whole(r, size_wh)]
        return np.asarray((wanted or candidates)[0], np.float64)
    flat = rectangles(sample.truth, camera)
    if len(flat):
        area = (flat[:, 2] - flat[:, 0]) * (flat[:, 3] - flat[:, 1])
        return np.asarray(flat[np.argsort(-area, kind="stable")[0]], np.float64)
    return _densest(found, size_wh)


def _num_inside(found: Layer, rect: Float64) -> int:
    inside = np.all((found.uv_px >= rect[:2]) & (found.uv_px <= rect[2:]), axis=1)
    return int(np.count_nonzero(inside))


def _is_whole(rect: Float64, size_wh: tuple[int, int]) -> bool:
    """Tell whether a rectangle doesn't touch the border of the image."""
    return bool((rect[:2] > 0).all() and rect[2] < size_wh[0] - 1 and rect[3] < size_wh[1] - 1)


def _densest(found: Layer, size_wh: tuple[int, int]) -> Float64 | None:
    wanted = (found.depth_m > 5) & (found.depth_m < 40)
    uv = found.uv_px[wanted] if wanted.any() else found.uv_px
    if not len(uv):
        return None
    width, height = size_wh
    counts, us, vs = np.histogram2d(uv[:, 0], uv[:, 1], bins=(12, 6), range=((-0.5, width - 0.5), (-0.5, height - 0.5)))
    column, row = np.unravel_index(int(np.argmax(counts)), counts.shape)
    return np.array([us[column], vs[row], us[column + 1], vs[row + 1]], np.float64)
