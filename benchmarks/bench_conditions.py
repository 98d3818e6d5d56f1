"""Conditions: CPU time on one core by message, beside the goals; images against the plain numpy formulation; and what
weather costs a log of the city beside what its pipeline costs.

    python benchmarks/bench_conditions.py [LOG]

Prints the best of several rounds [ms]; CPU times, so that they hold on a busy machine, too. Of a log, all messages are
disturbed, and all frames go through late3d.
"""

import argparse
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from common import UPRIGHT, best_s, frames_of

from fbench.replay.conditions.camera.fog import AIRLIGHT
from fbench.replay.conditions.camera.weather import disturb_image
from fbench.replay.conditions.disturb import Disturbance, DisturbedReader
from fbench.replay.conditions.effects import Effects
from fbench.replay.conditions.spec import load_condition, parse_conditions
from fbench.replay.conditions.weather import Weather, fog_extinction_per_m
from fbench.replay.contracts.conditions import Measurement, Site
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.plugins import make_pipeline
from fbench.replay.data.arrays import Float64
from fbench.replay.data.images import Pixels, decode
from fbench.replay.data.messages import Image, PointCloud, RadarScan
from fbench.replay.data.rig import KINDS, CameraModel, Mount, Rig
from fbench.replay.geometry.threads import VARIABLE
from fbench.replay.setup.source import LogRequest, log_source

NUM_POINTS, NUM_ECHOES = 120_000, 2_000
FAST_MS, SLOW_MS = 12.0, 150.0
FAST = ("fog", "lidar.beam_drop", "lidar.density", "lidar.fov", "lidar.occluder", "lidar.jitter", "lidar.uniform",
        "lidar.impulse", "lidar.crosstalk", "lidar.glare", "lidar.bulk_motion")  # fmt: skip
SLOW = ("rain", "snow", "wet", "lidar.cutout", "lidar.deskew_error")
RADAR = ("rain", "radar.clutter", "radar.ghost", "radar.spurious", "radar.point_loss", "radar.shift",
         "radar.nonpositional", "radar.interference", "radar.doppler_alias", "radar.azimuth_error",
         "radar.resolution")  # fmt: skip
HEIGHT_M, F_PX, SIZE_WH = 1.5, 1000.0, (1920, 1080)
FOG, NIGHT = Weather(visibility_m=150.0), Weather(lux=3.0)
FOG_MS, NIGHT_MS = 30.0, 60.0
WEATHERS = ("", "fog:3", "rain:3", "snow:3", "wet:3", "night:3")


def directions(rng: np.random.Generator, num: int, half_deg: float) -> Float64:
    azimuth, altitude = np.radians(rng.uniform(-half_deg, half_deg, num)), rng.uniform(-0.43, 0.05, num)
    flat = np.cos(altitude)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(altitude)], axis=1)


def street_cloud() -> PointCloud:
    """A sweep of 64 beams: road, and what stands up to 110 m away."""
    rng = np.random.Generator(np.random.Philox(1))
    unit = directions(rng, NUM_POINTS, 180.0)
    ground_m = np.where(unit[:, 2] < -0.01, -1.9 / np.minimum(unit[:, 2], -0.01), np.inf)
    range_m = np.minimum(ground_m, np.minimum(rng.exponential(20, NUM_POINTS) + 3, 110))
    ring, offset = rng.integers(0, 64, NUM_POINTS), np.linspace(-1e8, 0, NUM_POINTS)
    xyz = (unit * range_m[:, None]).astype(np.float32)
    intensity = rng.beta(1, 4, NUM_POINTS).astype(np.float32)
    return PointCloud("lidar", 0, 0, xyz, intensity, ring.astype(np.uint16), offset.astype(np.int32))


def street_scan() -> RadarScan:
    rng = np.random.Generator(np.random.Philox(2))
    unit, range_m = directions(rng, NUM_ECHOES, 50.0), rng.uniform(3, 100, NUM_ECHOES)
    rcs = 40 * np.log10(range_m / 100) - 7 + rng.uniform(0, 30, NUM_ECHOES)
    xyz, velocity, strength = (a.astype(np.float32) for a in (unit * range_m[:, None], -10 * unit[:, 0], rcs))
    return RadarScan("radar", 0, 0, xyz, velocity, strength)


def print_times(message: Measurement, names: Sequence[str], limit_ms: float | None) -> None:
    """Time each condition at severities 1, 3 and 5."""
    kind = KINDS[message.sensor]
    rig = Rig({message.sensor: Mount(kind, np.array([0, 0, 1.9]), UPRIGHT)}, {})
    for name in names:
        condition = load_condition(name)
        times = []
        for severity in (1, 3, 5):
            level = {key: float(values[severity - 1]) for key, values in condition.levels.items()}
            site = Site((0, name, "bench", message.sensor), rig, message.sensor, kind, 0, 10**10)
            disturb: Callable[[], object] = lambda: condition.disturb(message, level, site)  # noqa: B023, E731
            times.append(1e3 * best_s(disturb, 20, time.process_time))
        limit = "" if limit_ms is None else f"   at most {limit_ms:g} ms{'' if max(times) <= limit_ms else ': MISSED'}"
        print(f"{kind} {name:22}" + "".join(f"{ms:8.1f}" for ms in times) + f" ms{limit}")


def bench_lidar() -> None:
    cloud = street_cloud()
    print(f"clouds of {NUM_POINTS} points, severities 1, 3, 5")
    print_times(cloud, FAST, FAST_MS)
    print_times(cloud, SLOW, SLOW_MS)


def bench_radar() -> None:
    print(f"scans of {NUM_ECHOES} echoes, severities 1, 3, 5")
    print_times(street_scan(), RADAR, None)


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


def compare(name: str, limit_ms: float, ours: Callable[[], object], plain: Callable[[], object]) -> None:
    """Print both times."""
    ours()  # compiles
    a, b = 1e3 * best_s(ours, 9, time.process_time), 1e3 * best_s(plain, 3, time.process_time)
    missed = "" if a <= limit_ms else ": MISSED"
    print(f"{name}: {a:.1f} ms, plain numpy {b:.0f} ms, {b / a:.1f} times as fast   at most {limit_ms:g} ms{missed}")


def bench_camera() -> None:
    image, site = camera_scene()
    flat = replace(site, cloud=None)
    foggy, dark = (decode(disturb_image(image, weather, flat)) for weather in (FOG, NIGHT))
    assert foggy is not None
    assert dark is not None
    lower = np.s_[700:]  # near the horizon ours is smoothed
    assert np.abs(foggy[lower].astype(int) - plain_fog(image)[lower]).mean() < 2
    assert abs(dark.mean() - plain_night(image).mean()) < 0.5
    size = f"{SIZE_WH[0]}x{SIZE_WH[1]} px"
    compare(f"fog on flat ground, {size}", FOG_MS, partial(disturb_image, image, FOG, flat), partial(plain_fog, image))
    name = f"fog by {NUM_POINTS} LiDAR points, {size} (plain: flat ground)"
    compare(name, FOG_MS, partial(disturb_image, image, FOG, site), partial(plain_fog, image))
    compare(f"little light, {size}", NIGHT_MS, partial(disturb_image, image, NIGHT, flat), partial(plain_night, image))


def bench_log(log: Path) -> None:
    """Print what weather adds to reading a log, a frame, and what late3d costs, both with their images' decoding."""
    rig, info, frames = frames_of(log)
    os.environ[VARIABLE] = "1"
    pipeline, _ = make_pipeline("late3d", [])
    pipeline.start(rig, info)
    for frame in frames[:5]:  # compiles
        pipeline.step(frame)

    def step_all() -> None:
        pipeline.reset("again")
        for frame in frames:
            pipeline.step(frame)

    def read(text: str) -> None:
        source = log_source(LogRequest(log))
        disturbance = Disturbance(parse_conditions(text), 0, source.span())
        for _ in DisturbedReader(source.open(FaultLog()), disturbance, Effects()).messages():
            pass

    num = len(frames)
    late3d_ms = 1e3 * best_s(step_all, 2, time.process_time) / num
    times = {text: 1e3 * best_s(partial(read, text), 2, time.process_time) / num for text in WEATHERS}
    print(f"{log.stem}, {num} frames: late3d {late3d_ms:.1f} ms a frame, on one thread")
    for text in WEATHERS[1:]:
        own = times[text] - times[""]
        print(f"  {text:8} adds {own:6.1f} ms, {own / late3d_ms:.2f} of that{': MISSED' if own > late3d_ms else ''}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path, nargs="?")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    bench_lidar()
    bench_radar()
    bench_camera()
    if args.log is not None:
        bench_log(args.log)


if __name__ == "__main__":
    main()
