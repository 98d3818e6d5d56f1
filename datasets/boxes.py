"""A small synthetic log for demonstrations: a straight road with box-shaped traffic, one LiDAR, one radar, truth."""

from collections.abc import Iterator
from hashlib import blake2b
from pathlib import Path

import numpy as np

from fbench.datasets.boxes_world import BODIES, EGO_SPEED_MPS, MISS, Scene, cast, ego_x_m, scene
from fbench.replay.data import Boxes3D, Float64, Int64, LogInfo, Message, Mount, PointCloud, Pose, RadarScan, Rig, Truth
from fbench.replay.errors import ConfigError
from fbench.replay.logs.mcap.write import McapWriter

_START_NS = 1_000_000_000_000_000_000
_LIDAR_NS, _RADAR_NS, _RADAR_PHASE_NS = 100_000_000, 50_000_000, 7_000_000
_LATENCY_NS = {"lidar": 10_000_000, "radar": 5_000_000}
_JITTER_NS, _LATE_NS = 2_000_000, 60_000_000
_RANGE_M, _NOISE_M = 80.0, 0.01
_ALTITUDES_RAD = np.radians(np.concatenate([np.linspace(-25, -9, 8), np.linspace(-8, 3.5, 24)]))
_RADAR_RAYS, _RADAR_CLUTTER, _RADAR_NOISE_M, _RADAR_NOISE_MPS, _RADAR_LOSS = 1800, 8, 0.1, 0.1, 0.03
_RCS_DBSM = {"car": 10.0, "van": 12.0, "truck": 20.0, "wall": 5.0, "pole": 0.0}
_REFLECTIVITY = {"car": 0.6, "van": 0.6, "truck": 0.7, "wall": 0.4, "pole": 0.3}
_IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
_RIG = Rig(
    {
        "lidar": Mount("lidar", np.array([1.2, 0.0, 1.9]), _IDENTITY),
        "radar": Mount("radar", np.array([3.7, 0.0, 0.6]), _IDENTITY),
    },
    {},
)
_EGO_MPS = np.array([EGO_SPEED_MPS, 0.0, 0.0])


def write_boxes_log(out: Path, seconds: float = 10.0, seed: int = 0) -> list[str]:
    """Write a log of a drive past six vehicles; returns lines that say what is in it.

    LiDAR at 10 Hz (32 rings, 720 azimuths), radar at 20 Hz, poses and truth with track ids at the LiDAR's stamps.
    All sensors arrive later than their stamps; some radar scans are lost and one LiDAR sweep is very late. The same
    seed gives the same bytes.

    Raises:
        ConfigError: where `seconds` is less than one sweep, 0.1, or isn't finite.
    """
    if not 0.1 <= seconds < np.inf:
        raise ConfigError(f"seconds: expected at least 0.1, got {seconds}")
    num = round(seconds * 10)
    metadata = {"dataset": "moving boxes (simulated)", "seed": str(seed), "reference": "lidar"}
    with McapWriter(out, LogInfo(out.stem, f"boxes-{num}-{seed}", metadata), _RIG) as writer:
        for i in range(num):
            for message in _instant(seed, i, late=i == num // 2 and num > 1):
                writer.write(message)
    lost = sum(_is_lost(seed, stamp_ns) for i in range(num) for stamp_ns in _radar_stamps_ns(i))
    vehicles = sum(body.track > 0 for body in BODIES)
    return [
        f"simulated: {num / 10:g} s with {vehicles} vehicles, {num} LiDAR sweeps, {2 * num - lost} radar scans",
        f"seed {seed}, faults on purpose: {lost} radar scans lost, one LiDAR sweep {_LATE_NS // 1_000_000} ms late",
    ]


def _instant(seed: int, i: int, late: bool) -> Iterator[Message | Truth]:
    """All that is measured from one LiDAR sweep to the next."""
    stamp_ns = _START_NS + i * _LIDAR_NS
    at = scene(_time_s(stamp_ns))
    position = np.array([ego_x_m(_time_s(stamp_ns)), 0.0, 0.0])
    yield Pose("pose", stamp_ns, stamp_ns + 1_000_000, position, _IDENTITY)
    sweep, lidar_hit = _sweep(at, seed, stamp_ns, _LATE_NS if late else 0)
    yield sweep
    nearest_ns, _ = _radar_stamps_ns(i)
    scans = {ns: _scan(seed, ns) for ns in _radar_stamps_ns(i) if not _is_lost(seed, ns)}
    yield from (radar for radar, _ in scans.values())
    radar_hit = scans[nearest_ns][1] if nearest_ns in scans else np.zeros(0, np.int64)
    yield Truth(stamp_ns, stamp_ns, _truth(at, lidar_hit, radar_hit))


def _radar_stamps_ns(i: int) -> tuple[int, int]:
    first_ns = _START_NS + i * _LIDAR_NS + _RADAR_PHASE_NS
    return first_ns, first_ns + _RADAR_NS


def _truth(at: Scene, lidar_hit: Int64, radar_hit: Int64) -> Boxes3D:
    """Vehicles within the sensors' range, seen or not; counts are of the sweep and of the radar scan next to it."""
    ids = np.arange(len(BODIES))
    boxes = Boxes3D(
        center_m=at.center_m,
        size_lwh_m=at.size_lwh_m,
        yaw_rad=at.yaw_rad,
        velocity_mps=at.velocity_mps,
        label=np.array([b.label for b in BODIES]),
        track_id=at.track,
        num_lidar_pts=(lidar_hit[None, :] == ids[:, None]).sum(axis=1),
        num_radar_pts=(radar_hit[None, :] == ids[:, None]).sum(axis=1),
        source_label=np.array([b.label for b in BODIES]),
    )
    return boxes[(at.track > 0) & (np.hypot(at.center_m[:, 0], at.center_m[:, 1]) < _RANGE_M)]


def _sweep(at: Scene, seed: int, stamp_ns: int, late_ns: int) -> tuple[PointCloud, Int64]:
    """One LiDAR sweep, all points at one instant, and what each point hit."""
    rng = _generator(seed, "lidar", stamp_ns)
    altitude, azimuth = np.meshgrid(_ALTITUDES_RAD, np.radians(np.arange(720) / 2), indexing="ij")
    direction = _directions(azimuth.ravel(), altitude.ravel())
    range_m, hit = cast(at, _RIG.mounts["lidar"].translation_m, direction, _RANGE_M)
    noisy_m = range_m + _noise(rng, len(hit), _NOISE_M)
    seen = hit != MISS
    reflectivity = np.array([*(_REFLECTIVITY[b.label] for b in BODIES), 0.0, 0.1])  # the last one: GROUND
    cloud = PointCloud(
        "lidar", stamp_ns, _arrival_ns(rng, "lidar", stamp_ns) + late_ns,
        (direction[seen] * noisy_m[seen, None]).astype(np.float32), reflectivity[hit[seen]].astype(np.float32),
        np.repeat(np.arange(32, dtype=np.uint16), 720)[seen],
    )  # fmt: skip
    return cloud, hit[seen]


def _scan(seed: int, stamp_ns: int) -> tuple[RadarScan, Int64]:
    """One radar scan, and what each point hit: random rays on bodies, then clutter anywhere."""
    rng = _generator(seed, "radar", stamp_ns)
    arrival_ns = _arrival_ns(rng, "radar", stamp_ns)
    at = scene(_time_s(stamp_ns))
    azimuth, altitude = np.radians(rng.uniform(-60, 60, _RADAR_RAYS)), np.radians(rng.uniform(-5, 7, _RADAR_RAYS))
    range_m, hit = cast(at, _RIG.mounts["radar"].translation_m, _directions(azimuth, altitude), _RANGE_M)
    clutter = np.arange(_RADAR_RAYS) < _RADAR_CLUTTER
    kept = (hit >= 0) | clutter
    azimuth, altitude, range_m, hit, clutter = azimuth[kept], altitude[kept], range_m[kept], hit[kept], clutter[kept]
    hit[clutter] = MISS
    direction, num = _directions(azimuth, altitude), len(hit)
    velocity = np.concatenate([at.velocity_mps, np.zeros((2, 3))])  # the last two: MISS and GROUND
    rcs = np.array([*(_RCS_DBSM[b.label] for b in BODIES), -15.0, 0.0])[hit] + _noise(rng, num, 2.0)
    range_m = np.where(clutter, rng.uniform(2, _RANGE_M, num), range_m + _noise(rng, num, _RADAR_NOISE_M))
    speed = ((velocity[hit] - _EGO_MPS) * direction).sum(axis=1) + _noise(rng, num, _RADAR_NOISE_MPS)
    speed = np.where(clutter, rng.uniform(-20, 20, num), speed)
    columns = (direction * range_m[:, None], speed, rcs, range_m, azimuth, altitude)
    xyz, speed32, rcs32, range32, azimuth32, altitude32 = (c.astype(np.float32) for c in columns)
    return RadarScan("radar", stamp_ns, arrival_ns, xyz, speed32, rcs32, range32, azimuth32, altitude32), hit


def _generator(seed: int, sensor: str, stamp_ns: int) -> np.random.Generator:
    digest = blake2b(f"{seed}/{sensor}/{stamp_ns}".encode(), digest_size=16).digest()
    return np.random.Generator(np.random.Philox(key=int.from_bytes(digest, "little")))


def _is_lost(seed: int, stamp_ns: int) -> bool:
    return bool(_generator(seed, "radar loss", stamp_ns).random() < _RADAR_LOSS)


def _arrival_ns(rng: np.random.Generator, sensor: str, stamp_ns: int) -> int:
    return stamp_ns + _LATENCY_NS[sensor] + int(rng.integers(_JITTER_NS))


def _noise(rng: np.random.Generator, num: int, sigma: float) -> Float64:
    """Gaussian noise (num,), cut off at 3 sigma."""
    return np.clip(rng.standard_normal(num), -3, 3) * sigma


def _directions(azimuth_rad: Float64, altitude_rad: Float64) -> Float64:
    cos = np.cos(altitude_rad)
    return np.stack([cos * np.cos(azimuth_rad), cos * np.sin(azimuth_rad), np.sin(altitude_rad)], axis=1)


def _time_s(stamp_ns: int) -> float:
    return (stamp_ns - _START_NS) / 1e9
