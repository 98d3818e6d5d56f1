"""Where the sensors sit on the body, and where they look."""

from collections.abc import Callable

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.data import CameraModel, Rig
from fbench.replay.geometry.camera import not_projectable, rays
from fbench.replay.geometry.transforms import transform
from fbench.replay.images import Pixels
from fbench.reports.preview import draw
from fbench.reports.preview.colors import GRID, INK, QUIET, of_sensor

_SIZE_PX, _VIEW_M = 760, 25.0
_AXES = ((0, (80, 80, 255)), (1, (90, 220, 90)))
_STEPS_M = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)


def mounting(rig: Rig) -> Pixels:
    """Draw the rig from above: x forward is up. A thick line shows where a sensor looks, of LiDARs and radars its x
    axis; thin ones are its other axes, red x, green y.
    """
    names = rig.sensors("camera", "lidar", "radar")
    places = np.array([rig.mounts[name].translation_m[:2] for name in names]).reshape(-1, 2)
    middle = (np.vstack([places, np.zeros((1, 2))]).max(axis=0) + np.vstack([places, np.zeros((1, 2))]).min(axis=0)) / 2
    half = max(0.4, float(np.abs(np.vstack([places, np.zeros((1, 2))]) - middle).max()) * 1.6)
    plan = _Plan(middle, _SIZE_PX / (2 * half))
    picture = draw.canvas(_SIZE_PX, _SIZE_PX)
    _draw_grid(picture, plan, half)
    for number, name in enumerate(names):
        _draw_sensor(picture, plan, rig, name, number)
    texts = ["rig from above: x forward is up, y left is left"]
    texts += [f"{draw.plain(name)} ({rig.mounts[name].kind})" for name in names]
    draw.lines(picture, texts, [INK, *(of_sensor(i) for i in range(len(names)))])
    return picture


def draw_sensors(picture: Pixels, to_picture: Callable[[Float64], Float64], rig: Rig) -> None:
    """Mark where sensors are in a view from above, and draw the borders of what cameras see, 25 m long."""
    for number, name in enumerate(rig.sensors("camera", "lidar", "radar")):
        matrix, color = rig.body_T_sensor(name), of_sensor(number)
        camera = rig.cameras.get(name)
        for ray in () if camera is None else _borders(camera):
            ends = transform(matrix, np.stack([np.zeros(3), ray * _VIEW_M]))[:, :2]
            draw.path(picture, to_picture(ends), color)
        draw.disks(picture, to_picture(matrix[None, :2, 3]), np.array([3]), np.array([color], np.uint8), rim=True)


def _borders(camera: CameraModel) -> list[Float64]:
    """Directions (3,) of the middle of the left and right border of an image, where the lens is known."""
    if not_projectable(camera) is not None:
        return []
    width, height = camera.size_wh
    found = rays(camera, np.array([[0.0, height / 2], [width - 1.0, height / 2]]))
    return [ray for ray in found if np.isfinite(ray).all()]


class _Plan:
    """The ground around the body."""

    def __init__(self, middle_m: Float64, scale: float) -> None:
        self._middle_m, self._scale = middle_m, scale

    def to_picture(self, xy: Float64) -> Float64:
        return _SIZE_PX / 2 - (np.asarray(xy, np.float64) - self._middle_m)[:, ::-1] * self._scale


def _draw_grid(picture: Pixels, plan: _Plan, half: float) -> None:
    step = next((s for s in _STEPS_M if half / s <= 6), _STEPS_M[-1])
    lines = np.arange(-40, 41) * step
    far = 1000.0
    for at in lines:
        for line in (np.array([[at, -far], [at, far]]), np.array([[-far, at], [far, at]])):
            draw.path(picture, plan.to_picture(line), QUIET if at == 0 else GRID)
    for at in lines:
        x, y = plan.to_picture(np.array([[at, 0.0]]))[0]
        if 0 < y < _SIZE_PX:
            draw.write(picture, f"{at:g} m", (x + 4, y - 4), QUIET)


def _draw_sensor(picture: Pixels, plan: _Plan, rig: Rig, name: str, number: int) -> None:
    matrix = rig.body_T_sensor(name)
    at = plan.to_picture(matrix[None, :2, 3])[0]
    for axis, color in _AXES:
        tip = at - matrix[:2, axis][::-1] * 28
        draw.path(picture, np.stack([at, tip]), color)
    looks = matrix[:2, 2 if rig.mounts[name].kind == "camera" else 0]
    draw.path(picture, np.stack([at, at - looks[::-1] * 62]), of_sensor(number), 3)
    draw.disks(picture, at[None], np.array([5]), np.array([of_sensor(number)], np.uint8), rim=True)
