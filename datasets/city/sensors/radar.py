"""One scan of a radar: rays, reflection by surfaces, noise and resolution, and false echoes."""

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from fbench.datasets.city.instant import EGO, MISS, BodyStates, Rays
from fbench.datasets.city.mesh import MATERIALS
from fbench.datasets.city.rays.caster import Instant
from fbench.datasets.city.rig import RadarSpec
from fbench.replay.conditions.weather import radar_loss_db
from fbench.replay.data.arrays import Array, Float64, freeze_fields
from fbench.replay.data.messages import RadarScan


@dataclass(frozen=True, eq=False)
class Echoes:
    """K echoes, in polar coordinates of the sensor: azimuth from x towards y, altitude from there towards z."""

    range_m: Float64
    azimuth_rad: Float64
    altitude_rad: Float64
    speed_mps: Float64  # (K,) along the ray, positive when receding, relative to the sensor
    rcs_dbsm: Float64  # (K,) what the sensor takes for the radar cross-section: lower by what the air took
    margin_db: Float64  # (K,) how far the echo is above the weakest that the sensor finds
    body: Array  # (K,) int32 index of the actor, `STATIC`, or `MISS` of echoes where nothing is
    true_range_m: Float64  # (K,) of the surface, NaN where nothing is

    def __post_init__(self) -> None:
        one = ("f8", ("K",))
        freeze_fields(
            self, range_m=one, azimuth_rad=one, altitude_rad=one, speed_mps=one, rcs_dbsm=one, margin_db=one,
            body=("i4", ("K",)), true_range_m=one,
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.range_m)

    def __getitem__(self, rows: Array) -> Self:
        """Select echoes by mask or index array."""
        return type(self)(*(getattr(self, field.name)[rows] for field in fields(self)))


def directions(azimuth_rad: Float64, altitude_rad: Float64) -> Float64:
    """Return unit vectors (K, 3) in the sensor's axes: cos phi cos theta, cos phi sin theta, sin phi."""
    flat = np.cos(altitude_rad)
    return np.stack([flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.sin(altitude_rad)], axis=1)


_SIGMA = np.array([10 ** (material.radar_db / 10) for material in MATERIALS])
_LOBE_RAD = np.radians([material.radar_lobe_deg for material in MATERIALS])
ROUGH = 0.4
"""Share of what comes back at normal incidence that is sent evenly into all directions: by edges, gaps, grain."""
BODY_DB = 6.0
"""What road users send back beyond their outer surface: by way of wheel arches, underbodies, mirrors, limbs. With both,
a car has some 10 dBsm, a truck 20, a pedestrian -5, as at 77 GHz usual, and varies by 5 dB with its aspect."""
BEAM_SR = np.radians(0.6) ** 2
"""What the sensor's beam covers: its echo decides whether a surface is found, however many rays sample the beam."""
FAINTEST_DBSM = -7.0  # The weakest target that is found at the radar's range in clear air


def sigma0_db(material: Array, body: Array, cos_incidence: Float64) -> Float64:
    """Return the cross-section per area of surface (N,) [dB m2/m2].

    Both the lobe of smooth surfaces, a Gaussian whose half width the material says, and the even share follow the
    cosine of incidence, since the wave sees only the projected surface. `material` (N,) are indices into `MATERIALS`,
    `body` (N,) those of actors, below 0 for what stands; cosines (N,) are those between ray and normal, above 0.
    """
    angle = np.arccos(np.minimum(cos_incidence, 1)) / _LOBE_RAD[material]
    lobe = (1 - ROUGH) * np.exp(-np.log(2) * angle * angle) + ROUGH
    sigma = 10 * np.log10(_SIGMA[material] * lobe * cos_incidence) + np.where(body >= 0, BODY_DB, 0.0)
    return np.asarray(sigma, np.float64)


def add_noise(echoes: Echoes, spec: RadarSpec, normals: Float64) -> Echoes:
    """Return K echoes as they are measured, with standard normal numbers (4, K) of range, azimuth, altitude, speed."""
    return replace(
        echoes,
        range_m=np.maximum(echoes.range_m + spec.range_noise_m * normals[0], 0.0),
        azimuth_rad=echoes.azimuth_rad + np.radians(spec.azimuth_noise_deg) * normals[1],
        altitude_rad=echoes.altitude_rad + np.radians(spec.altitude_noise_deg) * normals[2],
        speed_mps=echoes.speed_mps + spec.speed_noise_mps * normals[3],
    )


def quantize(echoes: Echoes, spec: RadarSpec) -> Echoes:
    """Return echoes whose range, direction and speed are multiples of the sensor's resolution, where it has one."""
    steps = {
        "range_m": spec.range_resolution_m, "azimuth_rad": np.radians(spec.azimuth_resolution_deg),
        "altitude_rad": np.radians(spec.altitude_resolution_deg), "speed_mps": spec.speed_resolution_mps,
    }  # fmt: skip
    cells = {name: np.round(getattr(echoes, name) / step) * step for name, step in steps.items() if step > 0}
    return replace(echoes, **cells)


def merge_cells(echoes: Echoes) -> Echoes:
    """Return one echo for all of equal range, direction and speed: powers add up, the rest is that of the strongest.
    Sorted by range, azimuth, altitude, speed.
    """
    cells = (echoes.range_m, echoes.azimuth_rad, echoes.altitude_rad, echoes.speed_mps)
    order = np.lexsort((-echoes.rcs_dbsm, *cells[::-1]))
    ordered = echoes[order]
    differs = np.zeros(len(echoes), bool)
    differs[:1] = True
    for value in cells:
        differs[1:] |= value[order][1:] != value[order][:-1]
    first = np.flatnonzero(differs)
    if not len(first):
        return ordered
    power = np.add.reduceat(10 ** (ordered.rcs_dbsm / 10), first)
    return replace(ordered[first], rcs_dbsm=10 * np.log10(power))


def radial_speeds(states: BodyStates, body: Array, point_m: Float64, direction: Float64, sensor_m: Float64) -> Float64:
    """Return the speeds (N,) of points along rays [m/s], relative to the sensor, positive when receding.

    Bodies are rigid: their velocity and turn rate move every point of theirs; wheels don't spin, limbs don't swing.

    `states` are those of all bodies, of which the first carries the sensor, that is at `sensor_m` (3,) in the world;
    `body` (N,) says which body each of `point_m` (N, 3) is on, below 0 on one that stands; `direction` (N, 3) are unit
    vectors in the world, away from the sensor.
    """
    sensor = _velocity(states, np.array([EGO]), sensor_m[None])
    moving = np.flatnonzero(body >= 0)
    relative = np.tile(-sensor, (len(body), 1))
    relative[moving] += _velocity(states, body[moving], point_m[moving])
    return np.asarray((relative * direction).sum(axis=1))


def _velocity(states: BodyStates, body: Array, point_m: Float64) -> Float64:
    """Velocities (N, 3) over ground of points on bodies."""
    arm = point_m - states.position_m[body]
    rate = states.yaw_rate_radps[body]
    turn = np.stack([-rate * arm[:, 1], rate * arm[:, 0], np.zeros(len(arm))], axis=1)
    return np.asarray(states.velocity_mps[body] + turn, np.float64)


_GOLDEN = (np.sqrt(5) - 1) / 2


def radar_rays(spec: RadarSpec, rng: np.random.Generator) -> tuple[Float64, Float64, Float64]:
    """Return azimuths and altitudes (N,) of points_per_s / rate_hz rays in polar coordinates of the sensor, spread
    evenly, never where they were before; and the solid angle (N,) of the field of view that each stands for. A
    golden-ratio lattice at a random place: every part of the field of view gets its share of rays in every scan.
    """
    num = max(1, round(spec.points_per_s / spec.rate_hz))
    width, height = np.radians(spec.horizontal_fov_deg), np.radians(spec.vertical_fov_deg)
    shift, i = rng.random(2), np.arange(num)
    azimuth = ((i + shift[0]) / num - 0.5) * width
    altitude = ((i * _GOLDEN + shift[1]) % 1 - 0.5) * height
    return azimuth, altitude, np.cos(altitude) * (width * height / num)


GHOST_LOSS_DB, _GHOST_DETOUR_M = 10.0, (1.0, 10.0)
_CLUTTER_FROM_M, _CLUTTER_DBSM, _CLUTTER_MPS = 1.0, (-10.0, 5.0), 0.5
"""All of these are chosen, not measured: what is published gives kinds of false echoes, but hardly figures."""


def ghosts(echoes: Echoes, spec: RadarSpec, rng: np.random.Generator) -> Echoes:
    """Return second echoes of road users that are strong enough for it, with the chance `spec.multipath` each. They
    come from the same direction, 1 to 10 m farther and 10 dB weaker, with once or twice the relative speed: reflected
    once more by another surface, or by the ego vehicle itself. An echo is strong where its ghost would still be found.
    """
    strong = echoes[(echoes.body >= 0) & (echoes.margin_db >= GHOST_LOSS_DB)]
    chance, detour, twice = rng.random((3, len(strong)))
    farther = strong.range_m + _GHOST_DETOUR_M[0] + (_GHOST_DETOUR_M[1] - _GHOST_DETOUR_M[0]) * detour
    all_ghosts = replace(
        strong,
        range_m=farther,
        speed_mps=strong.speed_mps * np.where(twice < 0.5, 1.0, 2.0),
        rcs_dbsm=strong.rcs_dbsm - GHOST_LOSS_DB,
        margin_db=strong.margin_db - GHOST_LOSS_DB,
        body=np.full(len(strong), MISS, np.int32),
        true_range_m=np.full(len(strong), np.nan),
    )
    return all_ghosts[(chance < spec.multipath) & (farther <= spec.range_m)]


def clutter(spec: RadarSpec, sensor_mps: Float64, rng: np.random.Generator) -> Echoes:
    """Return false echoes, Poisson many, evenly over the field of view, their density falling with 1 / range. -10 dBsm
    with a deviation of 5 dB, and 0.5 m/s over ground: what drops, spray and leaves do. `sensor_mps` (3,) is the
    sensor's velocity over ground, in its own axes.
    """
    num = int(rng.poisson(spec.clutter))
    share, across, up = rng.random((3, num))
    nearest = min(_CLUTTER_FROM_M, spec.range_m)
    azimuth = (across - 0.5) * np.radians(spec.horizontal_fov_deg)
    altitude = (up - 0.5) * np.radians(spec.vertical_fov_deg)
    return Echoes(
        range_m=nearest * (spec.range_m / nearest) ** share,
        azimuth_rad=azimuth,
        altitude_rad=altitude,
        speed_mps=rng.normal(0.0, _CLUTTER_MPS, num) - (directions(azimuth, altitude) * sensor_mps).sum(axis=1),
        rcs_dbsm=rng.normal(*_CLUTTER_DBSM, num),
        margin_db=np.zeros(num),
        body=np.full(num, MISS, np.int32),
        true_range_m=np.full(num, np.nan),
    )


_BLIND_M = 0.2  # Nearer surfaces give no echo
_EDGE_ON = 1e-3  # Smallest cosine of incidence: the footprint on a surface seen edge-on stays finite


@dataclass(frozen=True, eq=False)
class Scan:
    """One message and what is true of it."""

    message: RadarScan
    body: Array  # (N,) int32 index of the actor, `STATIC`, or `MISS` of clutter and ghosts
    true_range_m: Float64  # (N,) of the surface, NaN of clutter and ghosts

    def __post_init__(self) -> None:
        freeze_fields(self, body=("i4", ("N",)), true_range_m=("f8", ("N",)))


def scan(now: Instant, spec: RadarSpec) -> Scan:
    """Return what a radar measures at one instant: the echoes in their order of azimuth, then ghosts, then clutter.
    Rain and fog weaken echoes on their way there and back; no car radar makes up for it, so the RCS that it gives falls
    by the same.
    """
    azimuth, altitude, solid_angle = radar_rays(spec, now.generator("radar"))
    normals, false = now.generator("radar", "noise").standard_normal((5, len(azimuth))), now.generator("radar", "false")
    received = _receive(now, spec, azimuth, altitude, solid_angle, normals[4])
    found = np.flatnonzero(received.margin_db >= 0)
    true = add_noise(received[found], spec, normals[:4, found])
    axes = np.ascontiguousarray(now.world_T_sensor[:3, :3].T)  # a standing point along each approaches by the velocity
    sensor_mps = -radial_speeds(now.states, np.full(3, MISS), axes, axes, now.world_T_sensor[:3, 3])
    parts = [true, ghosts(true, spec, false), clutter(spec, sensor_mps, false)]
    joined = (np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Echoes))
    echoes = quantize(Echoes(*joined), spec)
    echoes = merge_cells(echoes) if spec.merge_cells else echoes
    polar = [a.astype(np.float32) for a in (echoes.range_m, echoes.azimuth_rad, echoes.altitude_rad)]
    range_m, azimuth, altitude = (a.astype(np.float64) for a in polar)  # points are those of the very polar values
    message = RadarScan(
        now.sensor, now.stamp_ns, now.log_ns, (directions(azimuth, altitude) * range_m[:, None]).astype(np.float32),
        echoes.speed_mps.astype(np.float32), echoes.rcs_dbsm.astype(np.float32),
        range_m=polar[0], azimuth_rad=polar[1], altitude_rad=polar[2],
    )  # fmt: skip
    return Scan(message, echoes.body, echoes.true_range_m)


def _receive(
    now: Instant, spec: RadarSpec, azimuth: Float64, altitude: Float64, solid_angle: Float64, fading: Float64
) -> Echoes:
    """Return the echoes of all rays that hit something, however weak; `fading` (N,) are standard normal numbers.
    Received power falls with the range's 4th power. At a range of 100 m cars are found throughout, walls as far where
    they face the sensor, asphalt to some 15 m.
    """
    world_T_sensor, states = now.world_T_sensor, now.states
    toward = (directions(azimuth, altitude)[:, None, :] * world_T_sensor[:3, :3]).sum(axis=2)  # in the world's axes
    sensor_m = world_T_sensor[:3, 3]
    hits = now.caster.cast(Rays(sensor_m[None], toward.astype(np.float32), spec.range_m), states)
    material = now.caster.material(hits, states)
    hit = np.flatnonzero((hits.body != MISS) & (hits.range_m >= _BLIND_M))
    direction, distance, body = toward[hit], hits.range_m[hit].astype(np.float64), hits.body[hit]
    cos = np.clip(-(direction * hits.normal[hit]).sum(axis=1), _EDGE_ON, 1)
    sigma = sigma0_db(material[hit], body, cos)
    change = spec.rcs_noise_db * fading[hit] - radar_loss_db(now.weather, distance)
    # Surfaces that the whole beam, and each ray, light up [m2].
    beam, lit = BEAM_SR * distance * distance / cos, solid_angle[hit] * distance * distance / cos
    return Echoes(
        range_m=distance,
        azimuth_rad=azimuth[hit],
        altitude_rad=altitude[hit],
        speed_mps=radial_speeds(states, body, sensor_m + direction * distance[:, None], direction, sensor_m),
        rcs_dbsm=sigma + 10 * np.log10(lit) + change,
        margin_db=sigma + 10 * np.log10(beam) + change - 40 * np.log10(distance / spec.range_m) - FAINTEST_DBSM,
        body=body,
        true_range_m=distance,
    )
