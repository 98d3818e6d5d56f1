"""Stereo pairs that look at surfaces with a known pattern."""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation
from tests.pipelines.frames import AHEAD

from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import Image
from fbench.replay.data.rig import CameraModel, Mount, Rig
from fbench.replay.geometry.camera import rays

SIZE = (400, 300)
BASELINE_M = 0.4
HEIGHT_M = 1.2
K = np.array([[200.0, 0, 199.5], [0, 200, 149.5], [0, 0, 1]])
Depth = Callable[[np.ndarray, np.ndarray], np.ndarray]


def rig(turned_deg=0.0, distortion=(), size=SIZE, names=("left", "right")) -> Rig:
    """Cameras 1.2 m above the body's origin; the right one is turned to the side."""
    model = CameraModel(K, size, "plumb_bob" if distortion else "", np.array(distortion, float))
    aside = (Rotation.from_euler("z", turned_deg, degrees=True) * Rotation.from_quat(AHEAD)).as_quat()
    mounts = {
        names[0]: Mount("camera", np.array([0, BASELINE_M / 2, HEIGHT_M]), AHEAD),
        names[1]: Mount("camera", np.array([0, -BASELINE_M / 2, HEIGHT_M]), aside),
    }
    return Rig(mounts, dict.fromkeys(names, model))


def pattern(a, b):
    """Grey levels of a surface with coordinates [m]: waves of many lengths, so that no place looks like another."""
    value = np.zeros(a.shape)
    for i, length_m in enumerate((2.9, 1.7, 0.97, 0.61, 0.43, 0.31)):
        turn = 1.1 * i
        value += np.sin(2 * np.pi / length_m * (a * np.cos(turn) + b * np.sin(turn)) + i * i)
    return 128 + 18 * value


def seen(sensors: Rig, name: str, surfaces) -> np.ndarray:
    """What a camera sees of planes n x = e (body coordinates) with limits: (normal, offset, lower, upper corner)."""
    camera, body_T = sensors.cameras[name], sensors.body_T_sensor(name)
    u, v = np.meshgrid(np.arange(camera.size_wh[0]), np.arange(camera.size_wh[1]))
    ray = rays(camera, np.column_stack([u.ravel(), v.ravel()])) @ body_T[:3, :3].T
    best, grey = np.full(len(ray), np.inf), np.full(len(ray), 200.0)
    for normal, offset, low, high in surfaces:
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (offset - np.dot(normal, body_T[:3, 3])) / (ray @ normal)
        place = body_T[:3, 3] + distance[:, None] * ray
        hit = (distance > 0) & (distance < best) & np.all((place >= low) & (place <= high), axis=1)
        best = np.where(hit, distance, best)
        axes = [i for i in range(3) if i != int(np.argmax(np.abs(normal)))]
        grey = np.where(hit, pattern(place[:, axes[0]] + offset, place[:, axes[1]] - 3 * offset), grey)
    return np.round(grey).astype(np.uint8).reshape(u.shape)


def wall(distance_m, low=(-100.0, -100.0, -100.0), high=(100.0, 100.0, 100.0)):
    return np.array([1.0, 0, 0]), distance_m, np.array(low), np.array(high)


def road():
    return np.array([0, 0, 1.0]), 0.0, np.full(3, -100.0), np.full(3, 100.0)


def car(x_m, y_m):
    """Back and roofless sides of a car whose back is at `x_m`, 1.8 m wide and 4.2 m long."""
    low, high = np.array([x_m, y_m - 0.9, 0.2]), np.array([x_m + 4.2, y_m + 0.9, 1.5])
    side = np.array([0, 1.0, 0])
    return [wall(x_m, low - 1e-6, high), (side, y_m - 0.9, low - 1e-6, high), (side, y_m + 0.9, low, high + 1e-6)]


def image(name: str, grey, size=None) -> Image:
    pixels = np.ascontiguousarray(grey)
    return Image(name, 0, 0, pixels.tobytes(), "mono8", size or (pixels.shape[1], pixels.shape[0]))


def frame(sensors: Rig, surfaces, noise=0.0, index=0) -> Frame:
    """One frame of both cameras, with independent noise [grey levels]."""
    messages = {}
    for number, name in enumerate(sorted(sensors.cameras)):
        grey = seen(sensors, name, surfaces)
        rough = np.random.default_rng(number).normal(0, noise, grey.shape) if noise else 0.0
        messages[name] = image(name, np.clip(np.round(grey + rough), 0, 255).astype(np.uint8))
    return Frame(index, index * 100_000_000, 0, messages)
