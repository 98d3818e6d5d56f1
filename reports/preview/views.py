"""Points and truth from above and from the side, and the mounting of the sensors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.data.arrays import Float64
from fbench.replay.data.images import Pixels
from fbench.replay.data.rig import Rig
from fbench.replay.data.scores import format_count
from fbench.replay.geometry.camera import not_projectable, rays
from fbench.replay.geometry.iou import corners
from fbench.replay.geometry.transforms import transform
from fbench.reports.preview import draw
from fbench.reports.preview.camera import boxes3d
from fbench.reports.preview.draw import GRID, INK, QUIET, TRUTH, Colors, of_sensor, of_speed
from fbench.reports.preview.sample import Points, Sample

_SIZE_PX, _VIEW_M = 760, 25.0
_AXES = ((0, (80, 80, 255)), (1, (90, 220, 90)))
_STEPS_M = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
MAX_PX = 1100
_REACH_M = 100.0
_RINGS_M = (5, 10, 20, 30, 40, 50, 60, 80, 100)
_FEW = 2_000  # Echoes that are drawn as large disks
_SIDE_Z_M = (-4.0, 6.0)
_FOOTPRINT = [0, 2, 3, 1, 0]  # Corners of a box around its foot; those of 0 and 2 are in front


def mounting(rig: Rig) -> Pixels:
    """Draw the rig from above: x forward is up. A thick line shows where a sensor looks, of LiDARs and radars its x
    axis; thin ones are its other axes, red x, green y.
    """
    names = rig.sensors("camera", "lidar", "radar")
    places = np.array([*(rig.mounts[name].translation_m[:2] for name in names), np.zeros(2)])
    middle_m = (places.max(axis=0) + places.min(axis=0)) / 2
    half = max(0.4, float(np.abs(places - middle_m).max()) * 1.6)
    scale = _SIZE_PX / (2 * half)

    def to_picture(xy: Float64) -> Float64:
        moved: Float64 = _SIZE_PX / 2 - (np.asarray(xy, np.float64) - middle_m)[:, ::-1] * scale
        return moved

    picture, far = draw.canvas(_SIZE_PX, _SIZE_PX), 1000.0
    grid = np.arange(-40, 41) * next((s for s in _STEPS_M if half / s <= 6), _STEPS_M[-1])
    for at in grid:
        for line in (np.array([[at, -far], [at, far]]), np.array([[-far, at], [far, at]])):
            draw.path(picture, to_picture(line), QUIET if at == 0 else GRID)
    for at in grid:
        x, y = to_picture(np.array([[at, 0.0]]))[0]
        if 0 < y < _SIZE_PX:
            draw.write(picture, f"{at:g} m", (x + 4, y - 4), QUIET)
    for number, name in enumerate(names):
        matrix, color = rig.body_T_sensor(name), of_sensor(number)
        at = to_picture(matrix[None, :2, 3])[0]
        for axis, own in _AXES:
            draw.path(picture, np.stack([at, at - matrix[:2, axis][::-1] * 28]), own)
        looks = matrix[:2, 2 if rig.mounts[name].kind == "camera" else 0]
        draw.path(picture, np.stack([at, at - looks[::-1] * 62]), color, 3)
        draw.disks(picture, at[None], np.array([5]), np.array([color], np.uint8), rim=True)
    texts = ["rig from above: x forward is up, y left is left"]
    texts += [f"{draw.plain(name)} ({rig.mounts[name].kind})" for name in names]
    draw.lines(picture, texts, [INK, *(of_sensor(i) for i in range(len(names)))])
    return picture


def draw_sensors(picture: Pixels, to_picture: Callable[[Float64], Float64], rig: Rig) -> None:
    """Mark where sensors are in a view from above, and draw the borders of what cameras see, 25 m long."""
    for number, name in enumerate(rig.sensors("camera", "lidar", "radar")):
        matrix, color = rig.body_T_sensor(name), of_sensor(number)
        camera = rig.cameras.get(name)
        if camera is not None and not_projectable(camera) is None:
            width, height = camera.size_wh  # [px]; the middles of the left and right border
            for ray in rays(camera, np.array([[0.0, height / 2], [width - 1.0, height / 2]])):
                if np.isfinite(ray).all():
                    ends = transform(matrix, np.stack([np.zeros(3), ray * _VIEW_M]))[:, :2]
                    draw.path(picture, to_picture(ends), color)
        draw.disks(picture, to_picture(matrix[None, :2, 3]), np.array([3]), np.array([color], np.uint8), rim=True)


@dataclass(frozen=True)
class Ground:
    """A part of the ground plane; x forward is up, y left is left."""

    low_m: tuple[float, float]
    high_m: tuple[float, float]
    scale: float  # Pixels per meter

    @property
    def size_wh(self) -> tuple[int, int]:
        """Of the picture [px]."""
        wide, long = self.high_m[1] - self.low_m[1], self.high_m[0] - self.low_m[0]
        return round(wide * self.scale), round(long * self.scale)

    def to_picture(self, xy: Float64) -> Float64:
        """Move points (N, 2) [m] into the picture."""
        return np.stack([(self.high_m[1] - xy[:, 1]) * self.scale, (self.high_m[0] - xy[:, 0]) * self.scale], axis=1)


def ground_of(samples: Sequence[Sample]) -> Ground:
    """Choose the part of the ground that holds 98 % of all points and the truth within 100 m, and the body."""
    parts = [p.xyz[:, :2] for sample in samples for p in sample.points if p.is_placed]
    parts += [boxes3d(sample.truth).center_m[:, :2] for sample in samples]
    xy = np.concatenate([np.zeros((1, 2)), *parts])
    xy = xy[np.sum(xy**2, axis=1) < _REACH_M**2]
    low = np.minimum(np.quantile(xy, 0.01, axis=0), -5) // 5 * 5
    high = -(np.minimum(np.quantile(-xy, 0.01, axis=0), -5) // 5 * 5)
    middle, half = (low + high) / 2, (high - low) / 2
    half = np.maximum(half, half.max() / 2)  # not narrower than 1:2
    low, high = middle - half, middle + half
    return Ground((float(low[0]), float(low[1])), (float(high[0]), float(high[1])), MAX_PX / (2 * float(half.max())))


def from_above(sample: Sample, ground: Ground, lidars: Sequence[str]) -> Pixels:
    """LiDARs, each in a color of its own, radars by speed, truth, range rings, and where the sensors look."""
    picture = draw.canvas(*ground.size_wh)
    rings = draw_rings(picture, ground)
    for points in sample.points_of("lidar"):
        color = of_sensor(lidars.index(points.sensor))
        _draw_points(picture, ground, points, np.full((len(points.xyz), 3), color, np.uint8), 1)
    boxes = boxes3d(sample.truth)
    for eight, center in zip(corners(boxes), boxes.center_m, strict=True):
        draw.path(picture, ground.to_picture(eight[_FOOTPRINT, :2]), TRUTH)
        front = (eight[0, :2] + eight[2, :2]) / 2
        draw.path(picture, ground.to_picture(np.stack([center[:2], front])), TRUTH)
    for points in sample.points_of("radar"):
        _draw_points(picture, ground, points, of_speed(points.speed_mps), 4)
    draw_sensors(picture, ground.to_picture, sample.rig)
    write_rings(picture, rings)
    _draw_axes(picture, ground)
    rows = [(f"frame {sample.frame.index}, from above", INK)]
    for points in sample.points_of("lidar"):
        text = f"LiDAR {draw.plain(points.sensor)}: {format_count(len(points.xyz), 'point')}"
        rows.append((text, of_sensor(lidars.index(points.sensor))))
    for points in sample.points_of("radar"):
        text = f"radar {draw.plain(points.sensor)}: {format_count(len(points.xyz), 'point')}, red recedes, blue nears"
        rows.append((text, INK))
    rows += (
        [(f"truth: {format_count(len(boxes), 'box', 'boxes')}, lines point to the front", TRUTH)] if len(boxes) else []
    )
    draw.lines(picture, [text for text, _ in rows], [color for _, color in rows])
    return picture


def from_own(points: Points) -> Pixels:
    """Points of a sensor without a place, in its own coordinates."""
    xy = points.xyz[:, :2]
    near = xy[np.isfinite(xy).all(axis=1) & (np.sum(xy**2, axis=1) < _REACH_M**2)]
    reach = max(10.0, float(np.quantile(np.abs(near), 0.98)) if len(near) else 10.0)
    ground = Ground((-reach, -reach), (reach, reach), 700 / (2 * reach))
    picture = draw.canvas(*ground.size_wh)
    write_rings(picture, draw_rings(picture, ground))
    is_radar = points.kind == "radar"
    colors = of_speed(points.speed_mps) if is_radar else np.full((len(points.xyz), 3), of_sensor(0), np.uint8)
    _draw_points(picture, ground, points, colors, 4 if is_radar else 1)
    _draw_axes(picture, ground)
    draw.lines(picture, [f"{draw.plain(points.sensor)} in its own coordinates"], [INK])
    return picture


def from_side(sample: Sample, ground: Ground, lidars: Sequence[str]) -> Pixels:
    """Everything within 10 m left and right of the body; heights are drawn twice as large as lengths."""
    low, high = ground.low_m[0], ground.high_m[0]
    scale = MAX_PX / (high - low)
    picture = draw.canvas(MAX_PX, round((_SIDE_Z_M[1] - _SIDE_Z_M[0]) * scale * 2))

    def to_picture(xyz: Float64) -> Float64:
        return np.stack([(xyz[:, 0] - low) * scale, (_SIDE_Z_M[1] - xyz[:, 2]) * scale * 2], axis=1)

    for z in range(round(_SIDE_Z_M[0]) + 1, round(_SIDE_Z_M[1])):
        line = to_picture(np.array([[low, 0, z], [high, 0, z]]))
        draw.path(picture, line, QUIET if z == 0 else GRID)
        if z % 2 == 0:
            draw.write(picture, f"z {z} m", (4, line[0, 1] - 3), QUIET)
    for points in (*sample.points_of("lidar"), *sample.points_of("radar")):
        near = np.abs(points.xyz[:, 1]) < 10
        is_lidar = points.kind == "lidar"
        color = of_sensor(lidars.index(points.sensor)) if is_lidar else (0, 0, 0)
        colors = np.full((len(points.xyz), 3), color, np.uint8) if is_lidar else of_speed(points.speed_mps)
        radii = np.full(int(near.sum()), 1 if is_lidar else 3)
        draw.disks(picture, to_picture(points.xyz[near]), radii, colors[near], rim=not is_lidar)
    boxes = boxes3d(sample.truth)
    for eight in corners(boxes[np.abs(boxes.center_m[:, 1]) < 10]):
        flat = eight[:, [0, 2]]
        rect = np.array([*flat.min(axis=0), *flat.max(axis=0)])[draw.OUTLINE].reshape(5, 2)
        draw.path(picture, to_picture(np.insert(rect, 1, 0, axis=1)), TRUTH)
    draw.lines(picture, ["from the left side, |y| < 10 m, heights x 2: flat ground must be level"], [INK], (70, 20))
    return picture


def draw_rings(picture: Pixels, ground: Ground) -> list[tuple[str, Float64]]:
    """Draw circles around the body; return their labels with places, see `write_rings`."""
    circle = np.linspace(0, 2 * np.pi, 181)
    labels: list[tuple[str, Float64]] = []
    for radius in _RINGS_M:
        if radius * ground.scale < 45:
            continue
        draw.path(picture, ground.to_picture(radius * np.stack([np.cos(circle), np.sin(circle)], axis=1)), GRID)
        at = ground.to_picture(radius * np.array([[np.cos(-0.55), np.sin(-0.55)]]))[0]
        labels.append((f"{radius} m", at))
    return labels


def write_rings(picture: Pixels, labels: Sequence[tuple[str, Float64]]) -> None:
    """Write the labels of circles, over what was drawn since."""
    for text, at in labels:
        draw.write(picture, text, (at[0] - 12, at[1]), QUIET, boxed=True)


def _draw_points(picture: Pixels, ground: Ground, points: Points, colors: Colors, radius: int) -> None:
    uv = ground.to_picture(points.xyz[:, :2])
    radius = radius if len(uv) <= _FEW else 1  # large disks of many echoes hide each other, and take long
    draw.disks(picture, uv, np.full(len(uv), radius), colors, rim=radius > 1)


def _draw_axes(picture: Pixels, ground: Ground) -> None:
    import cv2

    origin = ground.to_picture(np.zeros((1, 2)))[0]
    for step, text, at in ((np.array([0, -60]), "x forward", (10, 0)), (np.array([-60, 0]), "y left", (-52, -10))):
        end = origin + step
        begin_px, end_px = ((round(float(x)), round(float(y))) for x, y in (origin, end))
        cv2.arrowedLine(picture, begin_px, end_px, INK, 2, cv2.LINE_AA, tipLength=0.2)
        draw.write(picture, text, (end[0] + at[0], end[1] + at[1]), INK, boxed=True)
