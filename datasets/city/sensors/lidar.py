"""One turn of a spinning LiDAR: firing, reflection, and the echoes that it receives."""

from dataclasses import dataclass

import numpy as np

from fbench.datasets.city.instant import EGO, MISS, BodyStates, Hits, Rays
from fbench.datasets.city.mesh import MATERIALS
from fbench.datasets.city.rays.caster import Instant
from fbench.datasets.city.rig import LidarSpec
from fbench.replay.conditions.lidar.weather import receive
from fbench.replay.conditions.weather import CLEAR_MOR_M, Weather, fog_extinction_per_m
from fbench.replay.data.arrays import Array, Float32, Float64, freeze_fields
from fbench.replay.data.messages import PointCloud
from fbench.replay.geometry.transforms import transform

JUST_SEEN = 0.1  # Reflectivity of the target that is just seen at the sensor's range in clear air, at normal incidence


def power_floor(range_m: float) -> float:
    """Return the weakest power that is received, in units of reflectivity / m^2."""
    clear = fog_extinction_per_m(Weather(visibility_m=CLEAR_MOR_M))
    return float(JUST_SEEN * np.exp(-2 * clear * range_m) / range_m**2)


def firing(spec: LidarSpec) -> tuple[Float64, Array, Array]:
    """Return the shots of one turn in firing order, `points_per_s / rate_hz` of them, to the nearest: directions
    (N, 3), unit vectors in the sensor's coordinates; rings (N,) uint16, 0 the highest; and times (N,) int32 [ns] after
    the turn's end, at which the last shot is made: none is above 0.

    Shot k is channel k modulo `channels`. Channels lie evenly from `upper_deg` down to `lower_deg`, one alone lies in
    between. The head starts backwards and turns clockwise seen from above (back, left, front, right), a step a shot.
    """
    num = max(1, round(spec.points_per_s / spec.rate_hz))
    shot = np.arange(num)
    ring = shot % spec.channels
    azimuth = np.pi - shot * (2 * np.pi / num)
    altitude = np.radians(np.linspace(spec.upper_deg, spec.lower_deg, spec.channels))
    if spec.channels == 1:
        altitude = np.radians([(spec.upper_deg + spec.lower_deg) / 2])
    flat, up = np.cos(altitude)[ring], np.sin(altitude)[ring]
    direction = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up], axis=1)
    offset_ns = np.rint((shot - (num - 1)) * (1e9 / spec.rate_hz / num))
    return direction, ring.astype(np.uint16), offset_ns.astype(np.int32)


_NOTHING = [0.0] * (256 - len(MATERIALS))
_DIFFUSE = np.array([material.lidar for material in MATERIALS] + _NOTHING)
_RETRO = np.array([material.retro for material in MATERIALS] + _NOTHING)


def reflectivity(hits: Hits, material: Array, direction: Float32) -> Float64:
    """Return the reflectivity (N,) in which beams of `direction` (N, 3) see what they hit; 0 where that is nothing.

    Lambert's diffuse part times the cosine of incidence, and what retroreflectors add at any angle. A white diffuse
    surface at normal incidence has 1; a sign has more, and saturates the sensor. `material` (N,) is of what was hit, as
    `EmbreeCaster.material` gives it; directions are unit vectors in the world.
    """
    n, d = hits.normal, direction
    cosine = np.abs(n[:, 0] * d[:, 0] + n[:, 1] * d[:, 1] + n[:, 2] * d[:, 2]).astype(np.float64)
    return np.asarray(_DIFFUSE[material] * cosine + _RETRO[material], np.float64)


@dataclass(frozen=True, eq=False)
class Sweep:
    """The N points of one turn, in firing order, and what they are of."""

    cloud: PointCloud
    body: Array  # (N,) int32 actor, `STATIC`, or `MISS` for fog and drops
    range_m: Float64  # (N,) how far away that surface is; of fog and drops, as measured

    def __post_init__(self) -> None:
        freeze_fields(self, body=("i4", ("N",)), range_m=("f8", ("N",)))


def sweep(now: Instant, spec: LidarSpec) -> Sweep:
    """Return what a LiDAR measures in the turn that ends at an instant, in its own coordinates at each shot.

    Ranges have normal noise of `noise_m`; intensity is the received power corrected for range, 0 to 1. Without
    `motion` nothing moves in the turn and the cloud is as if compensated, though `offset_ns` still says when each point
    was shot; else it is raw. Light plays no part.
    """
    fired, ring, offset_ns = firing(spec)
    rays = _rays(now.states, spec, now.body_T_sensor, fired, offset_ns)
    hits = now.caster.cast(rays, now.states)
    true_m = hits.range_m.astype(np.float64)
    reflected = reflectivity(hits, now.caster.material(hits, now.states), rays.direction)
    air, own = now.generator("lidar air"), now.generator("lidar")
    received_m, power, is_scattered = receive(true_m, reflected, now.weather, power_floor(spec.range_m), air)
    measured_m = received_m + spec.noise_m * own.standard_normal(len(true_m))
    kept = np.flatnonzero(np.isfinite(received_m) & (own.random(len(true_m)) >= spec.dropout))
    xyz = (fired[kept] * np.maximum(measured_m[kept], 0.0)[:, None]).astype(np.float32)
    intensity = np.minimum(power[kept], 1.0).astype(np.float32)
    cloud = PointCloud(now.sensor, now.stamp_ns, now.log_ns, xyz, intensity, ring[kept], offset_ns[kept])
    scattered = is_scattered[kept]
    body = np.where(scattered, np.int32(MISS), hits.body[kept])
    return Sweep(cloud, body, np.where(scattered, received_m[kept], true_m[kept]))


def _rays(states: BodyStates, spec: LidarSpec, body_T_sensor: Float64, fired: Float64, offset_ns: Array) -> Rays:
    """Return the beams in the world, each from where the sensor is when it is shot."""
    offset_s = offset_ns * 1e-9 if spec.motion else np.zeros(1)
    yaw = states.yaw_rad[EGO] + states.yaw_rate_radps[EGO] * offset_s
    middle = states.position_m[EGO] + states.velocity_mps[EGO] * offset_s[:, None]
    rotation = body_T_sensor.copy()
    rotation[:3, 3] = 0.0
    origin_m = middle + _turn(body_T_sensor[None, :3, 3], yaw)
    direction = _turn(transform(rotation, fired), yaw).astype(np.float32)
    return Rays(origin_m, direction, spec.range_m, offset_s if spec.motion else None)


def _turn(xyz: Float64, yaw_rad: Float64) -> Float64:
    """Turn vectors (N, 3) or (1, 3) about z by angles (N,) or (1,)."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y, z = xyz[:, 0], xyz[:, 1], xyz[:, 2]
    return np.stack(np.broadcast_arrays(cos * x - sin * y, sin * x + cos * y, z), axis=1)
