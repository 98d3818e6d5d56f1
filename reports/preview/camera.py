"""Camera images with what other sensors measured."""

from dataclasses import dataclass

import numpy as np

from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes3D, finite
from fbench.replay.data.images import Pixels
from fbench.replay.data.messages import Truth
from fbench.replay.data.rig import Kind
from fbench.replay.data.scores import format_count
from fbench.replay.geometry.camera import in_image, project_body, project_boxes, project_edges
from fbench.reports.preview import draw
from fbench.reports.preview.draw import FAR_M, INK, MAX_SPEED_MPS, NEAR_M, TRUTH, TRUTH_2D, Colors, of_depth, of_speed
from fbench.reports.preview.sample import Sample

MAX_WIDTH_PX = 1280
_MIN_WIDTH_PX, _ZOOM_WIDTH_PX = 960, 640
_MANY, _FEW = 20_000, 4_000
_TITLES = {"lidar": "LiDAR by depth", "radar": "radar by speed"}


@dataclass(frozen=True, eq=False)
class Layer:
    """Points in an image, the farthest first, so that near ones are drawn over them."""

    uv_px: Float64  # (N, 2) in the image
    depth_m: Float64
    radii_px: Float64  # (N,) larger for nearer points and for sparse ones, so that both can be seen
    colors: Colors  # (N, 3)


def layer(sample: Sample, camera: str, kind: Kind) -> Layer:
    """Points of the placed sensors of a kind in an image. Raises LogError for a lens whose distortion isn't modeled."""
    points = sample.points_of(kind)
    xyz = np.concatenate([np.zeros((0, 3)), *(p.xyz for p in points)])
    speed = np.concatenate([np.zeros(0), *(p.speed_mps for p in points)])
    uv, depth = project_body(sample.rig, camera, xyz)
    rows = np.flatnonzero(in_image(sample.rig.cameras[camera], uv))
    rows = rows[np.argsort(-depth[rows], kind="stable")]
    uv, depth, speed = uv[rows], depth[rows], speed[rows]
    if kind == "radar":
        return Layer(uv, depth, np.clip(np.round(40 / depth**0.75), 3, 11), of_speed(speed))
    share = np.clip((_MANY - len(depth)) / (_MANY - _FEW), 0, 1)
    radii = np.asarray(np.clip((1 + 1.3 * share) * np.sqrt(15 / depth), 1, 6), np.float64)
    return Layer(uv, depth, radii, of_depth(depth))


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


@dataclass(frozen=True)
class Window:
    """A rectangle of an image, scaled."""

    left: int
    top: int
    width: int
    height: int
    scale: float  # Pixels of the picture per pixel of the image

    @property
    def size_wh(self) -> tuple[int, int]:
        """Of the picture [px]."""
        return max(1, round(self.width * self.scale)), max(1, round(self.height * self.scale))

    def picture(self, pixels: Pixels) -> Pixels:
        """Cut and scale an image (H, W, 3)."""
        import cv2

        part = pixels[self.top : self.top + self.height, self.left : self.left + self.width]
        how = cv2.INTER_AREA if self.scale < 1 else cv2.INTER_LINEAR
        return np.ascontiguousarray(cv2.resize(part, self.size_wh, interpolation=how), np.uint8)

    def to_picture(self, uv: Float64) -> Float64:
        """Move pixels (N, 2) of the image into the picture; pixel centers are at integers in both."""
        return (uv - [self.left - 0.5, self.top - 0.5]) * self.scale - 0.5


def whole(size_wh: tuple[int, int]) -> Window:
    """Show a whole image: at most 1280 px wide, small ones enlarged."""
    width, height = size_wh
    scale = MAX_WIDTH_PX / width if width > MAX_WIDTH_PX else max(1, _MIN_WIDTH_PX // width)
    return Window(0, 0, width, height, scale)


def around(size_wh: tuple[int, int], rect: Float64, width_px: int) -> Window:
    """Show what is around a rectangle (left, top, right, bottom), in a picture of 5:3 that is `width_px` wide."""
    width, height = size_wh
    side = max(float(rect[2] - rect[0]) * 1.5, float(rect[3] - rect[1]) * 1.5 * 5 / 3, width / 12)
    w = max(1, min(round(side), width, round(height * 5 / 3)))
    h = max(1, min(round(w * 3 / 5), height))
    left = round(float(rect[0] + rect[2]) / 2 - w / 2)
    top = round(float(rect[1] + rect[3]) / 2 - h / 2)
    return Window(min(max(left, 0), width - w), min(max(top, 0), height - h), w, h, width_px / w)


def bare(sample: Sample, camera: str) -> Pixels:
    """The image alone, with 2D truth."""
    pixels = sample.image(camera)
    window = whole((pixels.shape[1], pixels.shape[0]))
    picture = window.picture(pixels)
    _draw_rectangles(picture, sample, camera, window)
    draw.lines(picture, [draw.plain(camera)], [INK])
    return picture


def overlay(sample: Sample, camera: str, kind: Kind) -> Pixels:
    """LiDARs or radars, and truth, in an image. Raises LogError for a lens whose distortion isn't modeled."""
    found = layer(sample, camera, kind)
    picture = _draw(sample, camera, found, whole(sample.rig.cameras[camera].size_wh), kind == "radar")
    sensors = ", ".join(draw.plain(points.sensor, 20) for points in sample.points_of(kind))
    texts = [f"{draw.plain(camera)}: {_TITLES[kind]} ({format_count(len(found.uv_px), 'point')} of {sensors})"]
    draw.lines(picture, texts, [INK])
    ramp, span = np.linspace(0, 1, 128), np.log(FAR_M / NEAR_M)
    if kind == "radar":
        ends = [(0.0, "nearing -10"), (0.5, "0"), (1.0, "+10 receding")]
        draw.color_bar(picture, of_speed((2 * ramp - 1) * MAX_SPEED_MPS), ends, "radial velocity [m/s]")
    else:
        marks = [(float(np.log(d / NEAR_M) / span), str(d)) for d in (2, 5, 10, 20, 40, 80)]
        draw.color_bar(picture, of_depth(NEAR_M * np.exp(ramp * span)), marks, "depth [m]")
    return picture


def zoom(sample: Sample, camera: str, kind: Kind) -> Pixels | None:
    """LiDAR or radar around the nearest truth, else where most points are, large; `None` where there is neither. Raises
    LogError where the lens distortion of the camera isn't modeled.
    """
    found = layer(sample, camera, kind)
    rect = _interesting(sample, camera, found)
    if rect is None:
        return None
    window = around(sample.rig.cameras[camera].size_wh, rect, _ZOOM_WIDTH_PX)
    picture = _draw(sample, camera, found, window, kind == "radar")
    size = sample.rig.cameras[camera].size_wh
    draw.lines(picture, [f"{_TITLES[kind]}, {window.width} of {size[0]} px wide"], [INK])
    return picture


def _draw(sample: Sample, camera: str, found: Layer, window: Window, rim: bool) -> Pixels:
    """Draw points of one kind and truth into a part of an image."""
    picture = window.picture(sample.image(camera))
    grow = np.sqrt(window.scale / whole(sample.rig.cameras[camera].size_wh).scale)
    radii = np.maximum(1, np.round(found.radii_px * grow))
    draw.disks(picture, window.to_picture(found.uv_px), radii, found.colors, rim)
    edges = project_edges(sample.rig, camera, boxes3d(sample.truth))
    for line in edges.reshape(-1, *edges.shape[2:]):
        draw.path(picture, window.to_picture(line), TRUTH, rim=True)
    _draw_rectangles(picture, sample, camera, window)
    return picture


def _draw_rectangles(picture: Pixels, sample: Sample, camera: str, window: Window) -> None:
    for rect in rectangles(sample.truth, camera):
        draw.path(picture, window.to_picture(rect[draw.OUTLINE].reshape(5, 2)), TRUTH_2D, rim=True)


def _interesting(sample: Sample, camera: str, found: Layer) -> Float64 | None:
    """Rectangle [px] to look closer at: nearest truth wholly seen with points in it, else most points in 5 to 40 m."""
    width, height = sample.rig.cameras[camera].size_wh
    rects, seen = project_boxes(sample.rig, camera, boxes3d(sample.truth))
    distance = np.sqrt(np.sum(boxes3d(sample.truth).center_m ** 2, axis=1))
    candidates = [rects[i] for i in np.argsort(distance, kind="stable") if seen[i]]
    for rect in candidates:
        num_inside = np.count_nonzero(np.all((found.uv_px >= rect[:2]) & (found.uv_px <= rect[2:]), axis=1))
        if num_inside >= 3 and (rect[:2] > 0).all() and rect[2] < width - 1 and rect[3] < height - 1:
            return np.asarray(rect, np.float64)
    if candidates:
        return np.asarray(candidates[0], np.float64)
    flat = rectangles(sample.truth, camera)
    if len(flat):
        area = (flat[:, 2] - flat[:, 0]) * (flat[:, 3] - flat[:, 1])
        return np.asarray(flat[np.argsort(-area, kind="stable")[0]], np.float64)
    wanted = (found.depth_m > 5) & (found.depth_m < 40)
    uv = found.uv_px[wanted] if wanted.any() else found.uv_px
    if not len(uv):
        return None
    counts, us, vs = np.histogram2d(uv[:, 0], uv[:, 1], bins=(12, 6), range=((-0.5, width - 0.5), (-0.5, height - 0.5)))
    column, row = np.unravel_index(int(np.argmax(counts)), counts.shape)
    return np.array([us[column], vs[row], us[column + 1], vs[row + 1]], np.float64)
