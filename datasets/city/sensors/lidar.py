"""One turn of a spinning LiDAR."""

from dataclasses import dataclass

import numpy as np

from fbench.datasets.city.instant import Instant
from fbench.datasets.city.motion import EGO, BodyStates
from fbench.datasets.city.rays.hits import MISS, Rays
from fbench.datasets.city.rig import LidarSpec
from fbench.datasets.city.sensors.lidar_echoes import Echoes, echoes
from fbench.datasets.city.sensors.lidar_firing import Firing, firing
from fbench.datasets.city.sensors.lidar_reflection import reflectivity
from fbench.replay.arrays import Array, Float64, freeze_fields
from fbench.replay.data import PointCloud
from fbench.replay.geometry.transforms import transform


@dataclass(frozen=True, eq=False)
class Sweep:
    """The N points of one turn, in firing order, and what they are of."""

    cloud: PointCloud
    body: Array
    """(N,) int32 actor, `STATIC`, or `MISS` for fog and drops."""
    range_m: Float64
    """(N,) how far away that surface is; of fog and drops, as measured."""

    def __post_init__(self) -> None:
        freeze_fields(self, body=("i4", ("N",)), range_m=("f8", ("N",)))


def sweep(now: Instant, spec: LidarSpec) -> Sweep:
    """Return what a LiDAR measures in the turn that ends at an instant, in its own coordinates at each shot.

    Ranges have normal noise of `noise_m`; intensity is the received power corrected for range, 0 to 1. Without
    `motion` nothing moves in the turn and the cloud is as if compensated, though `offset_ns` still says when each point
    was shot; else it is raw. Light plays no part.
    """
    shots = firing(spec)
    rays = _rays(now.states, spec, now.body_T_sensor, shots)
    hits = now.caster.cast(rays, now.states)
    true_m = hits.range_m.astype(np.float64)
    reflected = reflectivity(hits, now.caster.material(hits, now.states), rays.direction)
    received = echoes(true_m, reflected, now.weather, spec.range_m, now.draws("lidar air"))
    own = now.draws("lidar")
    measured_m = received.range_m + spec.noise_m * own.standard_normal(len(true_m))
    kept = np.flatnonzero(np.isfinite(received.range_m) & (own.random(len(true_m)) >= spec.dropout))
    cloud = _cloud(shots, np.maximum(measured_m[kept], 0.0), received, kept, now)
    scattered = received.is_scattered[kept]
    body = np.where(scattered, np.int32(MISS), hits.body[kept])
    return Sweep(cloud, body, np.where(scattered, received.range_m[kept], true_m[kept]))


def _cloud(shots: Firing, range_m: Float64, received: Echoes, kept: Array, now: Instant) -> PointCloud:
    xyz = (shots.direction[kept] * range_m[:, None]).astype(np.float32)
    intensity = np.minimum(received.intensity[kept], 1.0).astype(np.float32)
    return PointCloud(now.sensor, now.stamp_ns, now.log_ns, xyz, intensity, shots.ring[kept], shots.offset_ns[kept])


def _rays(states: BodyStates, spec: LidarSpec, body_T_sensor: Float64, shots: Firing) -> Rays:
    """Return the beams in the world, each from where the sensor is when it is shot."""
    offset_s = shots.offset_ns * 1e-9 if spec.motion else np.zeros(1)
    yaw = states.yaw_rad[EGO] + states.yaw_rate_radps[EGO] * offset_s
    middle = states.position_m[EGO] + states.velocity_mps[EGO] * offset_s[:, None]
    rotation = body_T_sensor.copy()
    rotation[:3, 3] = 0.0
    origin_m = middle + _turned(body_T_sensor[None, :3, 3], yaw)
    direction = _turned(transform(rotation, shots.direction), yaw).astype(np.float32)
    return Rays(origin_m, direction, spec.range_m, offset_s if spec.motion else None)


def _turned(xyz: Float64, yaw_rad: Float64) -> Float64:
    """Turn vectors (N, 3) or (1, 3) about z by angles (N,) or (1,)."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y, z = xyz[:, 0], xyz[:, 1], xyz[:, 2]
    return np.stack(np.broadcast_arrays(cos * x - sin * y, sin * x + cos * y, z), axis=1)
