"""Weather on single images: ours against the plain numpy formulation, in one process and on one core.

Times are CPU times, so that ratios hold on a busy machine, too.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
from common import UPRIGHT, best_s

from fbench.replay.conditions.camera.fog import AIRLIGHT
from fbench.replay.conditions.camera.weather import disturb_image
from fbench.replay.conditions.weather import Weather, fog_extinction_per_m
from fbench.replay.contracts.conditions import Site
from fbench.replay.data.images import Pixels, decode
from fbench.replay.data.messages import Image, PointCloud
from fbench.replay.data.rig import CameraModel, Mount, Rig

NUM_POINTS = 120_000
HEIGHT_M, F_PX, SIZE_WH = 1.5, 1000.0, (1920, 1080)
FOG, NIGHT = Weather(visibility_m=150.0), Weather(lux=3.0)


def camera_scene() -> tuple[Image, Site]:
    """A 1080p image of blocks, and a LiDAR's sweep of a street with walls 40 m away."""
    rng = np.random.Generator(np.random.Philox(7))
    pixels = np.asarray(cv2.resize(rng.integers(0, 255, (54, 96, 3), np.uint8), SIZE_WH), np.uint8)
    azimuth = rng.uniform(-np.pi, np.pi, NUM_POINTS)
    altitude = np.radians(rng.integers(-50, 30, NUM_POINTS) / 2)
    range_m = np.minimum(np.where(altitude < 0, -2 / np.sin(np.minimum(altitude, -1e-3)), 40.0), 60.0)
    flat = range_m * np.cos(altitude)
    xyz = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), range_m * np.sin(altitude)], axis=1)
    mounts = {
        "camera": Mount("camera", np.array([1.5, 0, HEIGHT_M]), np.array([-0.5, 0.5, -0.5, 0.5])),
        "lidar": Mount("lidar", np.array([0, 0, 2.0]), UPRIGHT),
    }
    model = CameraModel(np.array([[F_PX, 0, 959.5], [0, F_PX, 539.5], [0, 0, 1]]), SIZE_WH)
    site = Site((0, "bench@1:3", "bench", "camera"), Rig(mounts, {"camera": model}), "camera", "camera", 0, 0)
    cloud = PointCloud("lidar", 0, 0, xyz.astype(np.float32))
    image = Image("camera", 0, 0, pixels.tobytes(), "bgr8", SIZE_WH)
    return image, replace(site, cloud=cloud)


def plain_fog(image: Image) -> Pixels:
    """Koschmieder's law on flat ground, which is the least that there is to do."""
    pixels = np.frombuffer(image.data, np.uint8).reshape(*SIZE_WH[::-1], 3) / 255
    u, v = (np.arange(SIZE_WH[0]) - 959.5) / F_PX, (np.arange(SIZE_WH[1])[:, None] - 539.5) / F_PX
    along = np.sqrt(u * u + v * v + 1)
    distance_m = np.minimum(HEIGHT_M * along / np.maximum(v, 1e-9), 300.0)
    t = np.exp(-fog_extinction_per_m(FOG) * distance_m)[..., None]
    return np.asarray(255 * (pixels * t + AIRLIGHT * (1 - t)) + 0.5, np.uint8)


def plain_night(image: Image) -> Pixels:
    """Little light of severity 4, each value drawn by itself."""
    rng = np.random.Generator(np.random.Philox(7))
    pixels = np.frombuffer(image.data, np.uint8).reshape(*SIZE_WH[::-1], 3) / 255
    light = 0.3 * ((pixels - pixels.min()) / np.ptp(pixels)) ** 2
    noisy = rng.poisson(light * 50) / 50 + rng.normal(0, 0.026, light.shape)
    return np.asarray(255 * np.clip(noisy, 0, 1) + 0.5, np.uint8)


def compare(name: str, ours: Callable[[], object], plain: Callable[[], object]) -> None:
    """Print both times."""
    ours()  # compiles
    a, b = best_s(ours, 9, time.process_time), best_s(plain, 3, time.process_time)
    print(f"{name}: {1e3 * a:.1f} ms, plain numpy {1e3 * b:.0f} ms, {b / a:.1f} times as fast")


def main() -> None:
    image, site = camera_scene()
    flat = replace(site, cloud=None)
    foggy, dark = (decode(disturb_image(image, weather, flat)) for weather in (FOG, NIGHT))
    assert foggy is not None
    assert dark is not None
    lower = np.s_[700:]  # near the horizon ours is smoothed
    assert np.abs(foggy[lower].astype(int) - plain_fog(image)[lower]).mean() < 2
    assert abs(dark.mean() - plain_night(image).mean()) < 0.5
    cv2.setNumThreads(1)
    size = f"{SIZE_WH[0]}x{SIZE_WH[1]} px"
    compare(f"fog on flat ground, {size}", partial(disturb_image, image, FOG, flat), partial(plain_fog, image))
    name = f"fog by {NUM_POINTS} LiDAR points, {size} (plain: flat ground)"
    compare(name, partial(disturb_image, image, FOG, site), partial(plain_fog, image))
    compare(f"little light, {size}", partial(disturb_image, image, NIGHT, flat), partial(plain_night, image))


if __name__ == "__main__":
    main()
