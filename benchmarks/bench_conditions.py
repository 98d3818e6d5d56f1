"""Disturbing one message: time on one core, by condition, beside what the issue of robustness asks for.

`python benchmarks/bench_conditions.py` prints milliseconds, the best of several rounds.
"""

import time
from collections.abc import Callable, Sequence

import numpy as np
from common import UPRIGHT, best_s

from fbench.replay.conditions.spec import load_condition
from fbench.replay.contracts.conditions import Measurement, Site
from fbench.replay.data.arrays import Float64
from fbench.replay.data.messages import PointCloud, RadarScan
from fbench.replay.data.rig import KINDS, Mount, Rig

NUM_POINTS, NUM_ECHOES = 120_000, 2_000
FAST_MS, SLOW_MS = 12.0, 150.0
FAST = ("fog", "lidar.beam_drop", "lidar.density", "lidar.fov", "lidar.occluder", "lidar.jitter", "lidar.uniform",
        "lidar.impulse", "lidar.crosstalk", "lidar.glare", "lidar.bulk_motion")  # fmt: skip
SLOW = ("rain", "snow", "wet", "lidar.cutout", "lidar.deskew_error")
RADAR = ("rain", "radar.clutter", "radar.ghost", "radar.spurious", "radar.point_loss", "radar.shift",
         "radar.nonpositional", "radar.interference", "radar.doppler_alias", "radar.azimuth_error",
         "radar.resolution")  # fmt: skip


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


def main() -> None:
    bench_lidar()
    bench_radar()


if __name__ == "__main__":
    main()
