"""One scan of a radar: rays, their echoes, and what the sensor makes of them."""

from dataclasses import dataclass

import numpy as np

from fbench.datasets.city.instant import Instant
from fbench.datasets.city.rays.hits import MISS, Rays
from fbench.datasets.city.rig import RadarSpec
from fbench.datasets.city.sensors.doppler import radial_speeds
from fbench.datasets.city.sensors.radar_echoes import Echoes, directions, joined
from fbench.datasets.city.sensors.radar_false_echoes import clutter, ghosts
from fbench.datasets.city.sensors.radar_field import Looks, looks
from fbench.datasets.city.sensors.radar_reflection import BEAM_SR, footprint_m2, margin_db, sigma0_db
from fbench.datasets.city.sensors.radar_resolution import merged_cells, noisy, stepped
from fbench.replay.arrays import Array, Float64, freeze_fields
from fbench.replay.data import RadarScan
from fbench.replay.weather import radar_loss_db

_BLIND_M = 0.2
"""Nearer surfaces give no echo."""
_EDGE_ON = 1e-3
"""Smallest cosine of incidence: the footprint on a surface seen edge-on stays finite."""


@dataclass(frozen=True, eq=False)
class Scan:
    """One message and what is true of it."""

    message: RadarScan
    body: Array
    """(N,) int32 index of the actor, `STATIC`, or `MISS` of clutter and ghosts."""
    true_range_m: Float64
    """(N,) of the surface, NaN of clutter and ghosts."""

    def __post_init__(self) -> None:
        freeze_fields(self, body=("i4", ("N",)), true_range_m=("f8", ("N",)))


def scan(now: Instant, spec: RadarSpec) -> Scan:
    """Return what a radar measures at one instant: the echoes in their order of azimuth, then ghosts, then clutter.

    Rain and fog weaken echoes on their way there and back; no car radar makes up for it, so the RCS that it gives
    falls by the same.
    """
    view = looks(spec, now.draws("radar"))
    normals = now.draws("radar", "noise").standard_normal((5, len(view.azimuth_rad)))
    received = _received(now, spec, view, normals[4])
    found = np.flatnonzero(received.margin_db >= 0)
    echoes = noisy(received[found], spec, normals[:4, found])
    false = _false_echoes(echoes, now, spec, now.draws("radar", "false"))
    echoes = stepped(joined([echoes, *false]), spec)
    return _scan(merged_cells(echoes) if spec.merge_cells else echoes, now)


def _received(now: Instant, spec: RadarSpec, view: Looks, fading: Float64) -> Echoes:
    """Return the echoes of all rays that hit something, however weak; `fading` (N,) are standard normal numbers."""
    world_T_sensor, states = now.world_T_sensor, now.states
    toward = _turned(world_T_sensor, directions(view.azimuth_rad, view.altitude_rad))
    sensor_m = world_T_sensor[:3, 3]
    hits = now.caster.cast(Rays(sensor_m[None], toward.astype(np.float32), spec.range_m), states)
    material = now.caster.material(hits, states)
    hit = np.flatnonzero((hits.body != MISS) & (hits.range_m >= _BLIND_M))
    direction, distance, body = toward[hit], hits.range_m[hit].astype(np.float64), hits.body[hit]
    cos = np.clip(-(direction * hits.normal[hit]).sum(axis=1), _EDGE_ON, 1)
    sigma = sigma0_db(material[hit], body, cos)
    change = spec.rcs_noise_db * fading[hit] - radar_loss_db(now.weather, distance)
    beam = sigma + 10 * np.log10(footprint_m2(distance, cos, np.full(len(hit), BEAM_SR))) + change
    return Echoes(
        range_m=distance,
        azimuth_rad=view.azimuth_rad[hit],
        altitude_rad=view.altitude_rad[hit],
        speed_mps=radial_speeds(states, body, sensor_m + direction * distance[:, None], direction, sensor_m),
        rcs_dbsm=sigma + 10 * np.log10(footprint_m2(distance, cos, view.solid_angle_sr[hit])) + change,
        margin_db=margin_db(beam, distance, spec.range_m),
        body=body,
        true_range_m=distance,
    )


def _false_echoes(echoes: Echoes, now: Instant, spec: RadarSpec, rng: np.random.Generator) -> tuple[Echoes, Echoes]:
    world_T_sensor = now.world_T_sensor
    axes = np.ascontiguousarray(world_T_sensor[:3, :3].T)  # a standing point along each axis approaches by the velocity
    standing = np.full(3, MISS)
    sensor_mps = -radial_speeds(now.states, standing, axes, axes, world_T_sensor[:3, 3])
    return ghosts(echoes, spec, rng), clutter(spec, sensor_mps, rng)


def _scan(echoes: Echoes, now: Instant) -> Scan:
    """Points are those of the very polar values in the message."""
    polar = [a.astype(np.float32) for a in (echoes.range_m, echoes.azimuth_rad, echoes.altitude_rad)]
    range_m, azimuth, altitude = (a.astype(np.float64) for a in polar)
    message = RadarScan(
        now.sensor,
        now.stamp_ns,
        now.log_ns,
        xyz=(directions(azimuth, altitude) * range_m[:, None]).astype(np.float32),
        radial_velocity_mps=echoes.speed_mps.astype(np.float32),
        rcs_dbsm=echoes.rcs_dbsm.astype(np.float32),
        range_m=polar[0],
        azimuth_rad=polar[1],
        altitude_rad=polar[2],
    )
    return Scan(message, echoes.body, echoes.true_range_m)


def _turned(dst_T_src: Float64, vectors: Float64) -> Float64:
    """Turn vectors (N, 3) without moving them."""
    turned: Float64 = (vectors[:, None, :] * dst_T_src[:3, :3]).sum(axis=2)
    return turned
