"""A car with two cameras and a LiDAR, its images and clouds, for tests of what disturbs images."""

from functools import lru_cache

import numpy as np

from fbench.replay.contracts.conditions import Site
from fbench.replay.data.images import decode
from fbench.replay.data.messages import Image, PointCloud
from fbench.replay.data.rig import CameraModel, Mount, Rig

SIZE = (320, 240)
F = 160.0
HEIGHT_M = 1.5
AHEAD = np.array([-0.5, 0.5, -0.5, 0.5])  # Camera axes of a camera that looks ahead
UPRIGHT = np.array([0.0, 0, 0, 1])
K = np.array([[F, 0, 159.5], [0, F, 119.5], [0, 0, 1]])
CAMERAS = {"left": 0.2, "right": -0.2}  # m to the left
RIG = Rig(
    {
        **{name: Mount("camera", np.array([1.0, y, HEIGHT_M]), AHEAD) for name, y in CAMERAS.items()},
        "lidar": Mount("lidar", np.array([0.0, 0, 2]), UPRIGHT),
    },
    dict.fromkeys(CAMERAS, CameraModel(K, SIZE)),
)


def site(sensor="left", rig=RIG, seed=0, condition="x@1:3", **fields):
    return Site((seed, condition, "log", sensor), rig, sensor, "camera", 0, 10**10, **fields)


def image(pixels, sensor="left", stamp_ns=0):
    pixels = np.ascontiguousarray(pixels, np.uint8)
    encoding = "bgr8" if pixels.ndim == 3 else "mono8"
    return Image(sensor, stamp_ns, stamp_ns, pixels.tobytes(), encoding, pixels.shape[1::-1])


def even(value, size=SIZE):
    return np.full((size[1], size[0], 3), value, np.uint8)


@lru_cache
def street(seed=1):
    """A scene of colors, edges and textures."""
    rng = np.random.default_rng(seed)
    blocks = np.kron(rng.integers(20, 235, (12, 16, 3)), np.ones((20, 20, 1)))
    pixels = np.clip(blocks + rng.normal(0, 6, (240, 320, 3)), 0, 255).astype(np.uint8)
    pixels.setflags(write=False)
    return pixels


def pixels_of(message):
    pixels = decode(message)
    assert pixels is not None
    return pixels


def edit(condition, message, severity, at=None):
    """What a condition makes of the pixels of an image at a severity."""
    level = {name: values[severity - 1] for name, values in condition.levels.items()}
    (result,) = condition.disturb(message, level, at or site(message.sensor, condition=f"x@1:{severity}"))
    return pixels_of(result)


def wall(range_m, low_deg=-25, high_deg=15, side=0):
    """A cloud of channels 0.5 degrees apart that meets a wall across the street, or its left (1) or right (-1) half."""
    azimuth, altitude = np.radians(np.meshgrid(np.arange(-60, 60, 0.4), np.arange(low_deg, high_deg, 0.5)))
    if side:
        azimuth, altitude = azimuth[side * azimuth > 0], altitude[side * azimuth > 0]
    x = np.full(azimuth.size, float(range_m))
    xyz = np.stack([x, x * np.tan(azimuth.ravel()), x * np.tan(altitude.ravel()) / np.cos(azimuth.ravel())], axis=1)
    return PointCloud("lidar", 0, 0, xyz.astype(np.float32))
