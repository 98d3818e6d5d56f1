"""A rig, clouds and scans for tests of conditions."""

import numpy as np

from fbench.replay.contracts.conditions import Site
from fbench.replay.data.messages import PointCloud, RadarScan
from fbench.replay.data.rig import Mount, Rig

UPRIGHT = np.array([0.0, 0, 0, 1])
QUARTER_LEFT = np.array([0.0, 0, np.sqrt(0.5), np.sqrt(0.5)])
"""A sensor that looks to the left: its x axis is the body's y axis."""


def site(kind="lidar", seed=0, truth=None, rotation=UPRIGHT, height_m=2.0, name="test@1:3"):
    rig = Rig({kind: Mount(kind, np.array([0.0, 0, height_m]), rotation)}, {})
    return Site((seed, name, "log", kind), rig, kind, kind, 0, 10**10, truth=truth)


def level(condition, severity):
    return {name: float(values[severity - 1]) for name, values in condition.levels.items()}


def disturb(condition, message, severity=3, **where):
    kind = "lidar" if isinstance(message, PointCloud) else "radar"
    (result,) = condition.disturb(message, level(condition, severity), site(kind, **where))
    return result


def cloud(xyz, intensity=None, stamp_ns=0, **fields):
    intensity = None if intensity is None else np.asarray(intensity, np.float32)
    return PointCloud("lidar", stamp_ns, stamp_ns, np.asarray(xyz, np.float32), intensity, **fields)


def along_x(range_m):
    return np.stack([range_m, np.zeros_like(range_m), np.zeros_like(range_m)], axis=1)


def street(num=20_000, seed=1, rings=64):
    """A flat road 2 m below a sensor of 64 rings, and walls to 10 m on both sides up to 60 m away."""
    rng = np.random.default_rng(seed)
    ring = np.sort(rng.integers(0, rings, num)).astype(np.uint16)
    azimuth, altitude = rng.uniform(-np.pi, np.pi, num), np.radians(5 - ring * (30 / rings))
    flat = np.cos(altitude)
    direction = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(altitude)], axis=1)
    with np.errstate(divide="ignore"):
        ground = np.where(direction[:, 2] < 0, -2.0 / direction[:, 2], np.inf)
        wall = np.minimum(10 / np.abs(direction[:, 1]), 60.0)
    range_m = np.minimum(ground, wall)
    cosine = np.where(ground < wall, -direction[:, 2], np.abs(direction[:, 1]))
    intensity = np.where(ground < wall, 0.2, 0.5) * cosine + 0.01
    offset = np.linspace(-50e6, 0, num).astype(np.int32)
    return cloud(direction * range_m[:, None], intensity, ring=ring, offset_ns=offset)


def scan(xyz, speed=None, rcs=None, has_polar=False, stamp_ns=0):
    xyz = np.asarray(xyz, np.float32)
    x, y, z = xyz.astype(np.float64).T
    flat = np.hypot(x, y)
    polar = {"range_m": np.hypot(flat, z), "azimuth_rad": np.arctan2(y, x), "altitude_rad": np.arctan2(z, flat)}
    values = {name: a.astype(np.float32) for name, a in polar.items()} if has_polar else {}
    one = [None if a is None else np.asarray(a, np.float32) for a in (speed, rcs)]
    return RadarScan("radar", stamp_ns, stamp_ns, xyz, *one, **values)


def standing(num=2000, seed=2, ego_mps=10.0, floor_dbsm=-7.0, **fields):
    """What stands around a radar that drives ahead: echoes up to 100 m within 50 degrees, as weak as the sensor finds
    at their range or up to 30 dB stronger.
    """
    rng = np.random.default_rng(seed)
    range_m, azimuth = rng.uniform(3, 100, num), np.radians(rng.uniform(-50, 50, num))
    altitude = np.radians(rng.uniform(-5, 5, num))
    flat = np.cos(altitude)
    unit = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(altitude)], axis=1)
    rcs = floor_dbsm + 40 * np.log10(range_m / 100) + rng.uniform(0, 30, num)
    return scan(unit * range_m[:, None], -ego_mps * unit[:, 0], rcs, has_polar=True, **fields)


def fields_of(message):
    return {name: value for name, value in vars(message).items() if isinstance(value, np.ndarray)}


def bytes_of(message):
    return {name: value.tobytes() for name, value in fields_of(message).items()}


def has_consistent_polar(message):
    again = scan(message.xyz, has_polar=True)
    return all(
        np.allclose(getattr(message, name), getattr(again, name), atol=2e-5, rtol=1e-6)
        for name in ("range_m", "azimuth_rad", "altitude_rad")
    )
